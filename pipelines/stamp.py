"""Where a result comes from: versions, seed, command, hardware. The stamp in every image, row and report.

Images carry a stamp without anything that depends on the moment or on how often a run was interrupted, so that the same
job gives the same bytes.
"""

import functools
import hashlib
import importlib.metadata
import os
import platform
from pathlib import Path
from typing import Any

from pipelines.job import Job, job_text

PACKAGES = ("jaxrefl", "jax", "jaxlib", "numpy", "equinox", "embreex", "OpenEXR")
"""Packages whose version can change an image."""

COMMAND = "jaxrefl render --job job.toml --out DIR"
"""The command that makes any image again from the job text beside it."""


@functools.cache
def versions() -> dict[str, str]:
    """Versions of Python and of the packages that make images.

    Returns:
        Versions by name; a package that is not installed is left out.
    """
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


@functools.cache
def hardware() -> dict[str, str | int]:
    """Processor, cores, memory and operating system of this machine.

    Returns:
        `processor`, `cores` (that this process may use), `memory_gib`, `system`.
    """
    import psutil

    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    memory = round(psutil.virtual_memory().total / 2**30)
    system = f"{platform.system()} {platform.machine()}"
    return {"processor": _processor(), "cores": count, "memory_gib": memory, "system": system}


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def stamp(job: Job, *, command: str | None = None) -> dict[str, Any]:
    """The stamp of a result.

    Args:
        job: Resolved job.
        command: What was typed; None: the command that makes the result again.
    Returns:
        `versions`, `seed`, `command`, `hardware`, and `job`: the SHA-256 of the job's text.
    """
    return {
        "versions": versions(),
        "seed": job.seed,
        "command": command or COMMAND,
        "hardware": hardware(),
        "job": hashlib.sha256(job_text(job).encode()).hexdigest(),
    }
