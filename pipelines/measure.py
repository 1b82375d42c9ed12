"""What a step costs and how wrong its image is: one row per frame, technique and mask.

`seconds` is the steady wall-clock time of the technique's `step`, until its results are there. JAX reports when it
compiles; a step in which it did is run a second time, the second time counts, and what the first took longer is
`compile_seconds`. What an earlier technique or the reference compiled already is not compiled again, unless the job is
`cold`: then each technique starts with empty caches.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.monitoring
import numpy as np

from jaxrefl.metrics import FIGURES, compare

MASKS = ("reflective", "frame")
"""Over what errors are averaged: pixels that have a reflection, and all."""

_COMPILE_EVENT = "/jax/core/compile/"


class Timed(NamedTuple):
    """A result and what it cost."""

    value: Any
    """What the call returned."""
    seconds: float
    """Wall-clock seconds without compilation."""
    compile_seconds: float
    """Seconds spent on tracing and compiling."""
    peak_mib: float | None
    """Largest resident memory of the process during the call, MiB; None where the system does not tell."""


def timed(call: Callable[[], Any], *, repeat: bool = True) -> Timed:
    """Run a call until its results are there, and tell steady time from compile time.

    Args:
        call: A call without side effects.
        repeat: True: where JAX compiled, run it again and report the second run. False: subtract what JAX reports as
            compile time, for calls too long to run twice.
    Returns:
        The result, and its time and memory.
    """
    measured = reset_peak_memory()
    with compile_seconds() as spent:
        began = time.perf_counter()
        value = jax.block_until_ready(call())
        seconds = time.perf_counter() - began
    compiling = 0.0
    if spent:
        compiling = min(sum(spent), seconds)
        if repeat:
            first = seconds
            reset_peak_memory()
            began = time.perf_counter()
            value = jax.block_until_ready(call())
            seconds = time.perf_counter() - began
            compiling = max(first - seconds, 0.0)
        else:
            seconds -= compiling
    return Timed(value, seconds, compiling, peak_memory() if measured else None)


@contextlib.contextmanager
def compile_seconds() -> Iterator[list[float]]:
    """Collect what JAX reports as time spent on tracing, lowering and compiling.

    Yields:
        A list that grows by one duration, in seconds, per event.
    """
    spent: list[float] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.startswith(_COMPILE_EVENT):
            spent.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield spent
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def reset_peak_memory() -> bool:
    """Start a new measurement of the process's peak memory.

    Returns:
        False where the system has no such thing (it exists on Linux).
    """
    try:
        with open("/proc/self/clear_refs", "w") as stream:
            stream.write("5")
    except OSError:
        return False
    return True


def peak_memory() -> float | None:
    """Largest resident memory of the process since `reset_peak_memory`.

    Returns:
        MiB, or None where the system does not tell.
    """
    try:
        with open("/proc/self/status") as stream:
            lines = [line for line in stream if line.startswith("VmHWM")]
    except OSError:
        return None
    return int(lines[0].split()[1]) / 1024 if lines else None


def errors(
    image: np.ndarray, reference: np.ndarray | None, mask: np.ndarray, *, exposure: float
) -> dict[str, float | None]:
    """Figures of an image against its reference.

    Args:
        image: [h w 3] linear radiance.
        reference: [h w 3] linear radiance; None: there is none.
        mask: [h w] pixels to average over.
        exposure: Stops by which both are brightened for figures on pictures.
    Returns:
        One number per name in `jaxrefl.metrics.FIGURES`; None where it is not defined, not finite or not measured.
    """
    if reference is None:
        return dict.fromkeys(FIGURES)
    figures = compare(image, reference, mask, exposure=exposure)
    return {name: None if value is None or not np.isfinite(value) else float(value) for name, value in figures.items()}


def rows(
    image: np.ndarray,
    reference: np.ndarray | None,
    reflective: np.ndarray,
    facts: Mapping[str, Any],
    *,
    exposure: float = 0.0,
) -> list[dict[str, Any]]:
    """The rows of one frame of one technique.

    Args:
        image: [h w 3] linear radiance.
        reference: [h w 3] linear radiance; None: errors are null.
        reflective: [h w] pixels that have a reflection.
        facts: `scene`, `technique`, `frame`, and what the frame cost.
        exposure: Stops, for figures on pictures.
    Returns:
        One row per mask in `MASKS`.
    """
    masks = {"reflective": reflective, "frame": np.ones_like(reflective)}
    names = ("scene", "technique", "frame")
    cost = {key: value for key, value in facts.items() if key not in names}
    share = float(reflective.mean())
    return [
        {
            **{name: facts[name] for name in names},
            "mask": mask,
            **errors(image, reference, masks[mask], exposure=exposure),
            **cost,
            "reflective_share": share,
        }
        for mask in MASKS
    ]
