"""Frames on several processes or machines, through dask.distributed.

Workers get the job's text, build the scene once and return finished files as bytes; only this process writes. Workers
need the job's input files under the same paths, not the results folder. A worker that dies loses its frames to others.
"""

import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.folder import is_done
from pipelines.frames import FrameFiles, Unit, render_unit
from pipelines.job import Job, job_text, parse_job
from pipelines.plan import references_of
from pipelines.progress import Progress
from pipelines.stage import REFERENCE, Stage
from pipelines.toml_tables import JobError

_AHEAD = 2
"""Units per worker that are handed out at a time, so that a long job does not fill the scheduler's memory."""

TIMEOUT = 10
"""Seconds to wait for a scheduler to answer."""

_stage: tuple[str, Stage] | None = None
_turn = threading.Lock()


def _render(
    text: str, unit: Unit, references: Mapping[int, np.ndarray], command: str | None, folder: str
) -> tuple[list[FrameFiles], list[str]]:
    """On a worker: render a unit, with the stage of the last job kept."""
    global _stage
    with _turn:  # a worker with several threads renders one unit at a time: JAX and Embree use all cores anyway
        if _stage is None or _stage[0] != text:
            _stage = None
            _stage = text, Stage(parse_job(text), folder=Path(folder))
        return list(render_unit(_stage[1], unit, references, command=command)), _stage[1].notes


def render_remotely(
    job: Job, out: Path, units: list[Unit], progress: Progress, *, scheduler: str, command: str | None = None
) -> Iterator[FrameFiles]:
    """Render units on workers.

    Args:
        job: Resolved job.
        out: Results folder, to read references from.
        units: What to do; a unit is handed out as soon as its references are stored.
        progress: Where notes go.
        scheduler: `local:N` or the address of a scheduler, such as `tcp://host:8786`.
        command: What was typed, for the rows.
    Yields:
        Finished frames, in the order in which they come; each must be stored before the next is asked for.
    Raises:
        JobError: If the extra `cluster` is not installed, or the scheduler is not understood or cannot be reached.
    """
    text, waiting, said = job_text(job), list(units), set()
    with ExitStack() as stack:
        client = _connect(scheduler, stack)
        from distributed import KilledWorker, as_completed

        running: dict[Any, Unit] = {}
        completed = as_completed()
        while waiting or running:
            room = _AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"])) - len(running)
            for unit in [u for u in waiting if _is_ready(job, out, u)][: max(room, 0)]:
                waiting.remove(unit)
                arguments = (text, unit, references_of(job, out, unit), command, str(out.absolute()))
                future = client.submit(_render, *arguments, pure=False)
                running[future] = unit
                completed.add(future)
            future = next(completed)
            running.pop(future)
            try:
                frames, notes = future.result()
            except KilledWorker as error:
                raise ChildProcessError(f"workers died again and again on the same frames: {error}") from error
            for note in (n for n in notes if n not in said):
                said.add(note)
                progress.note(note)
            yield from frames


def _is_ready(job: Job, out: Path, unit: Unit) -> bool:
    if job.reference is None or unit.technique == REFERENCE:
        return True
    return all(is_done(out, job, REFERENCE, frame) for frame in unit.missing)


def _connect(scheduler: str, stack: ExitStack) -> Any:
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise JobError("--scheduler needs dask.distributed: pip install 'jaxrefl[cluster]'") from error
    kind, _, rest = scheduler.partition(":")
    if kind == "local":
        if not rest.isdecimal() or int(rest) < 1:
            raise JobError(f"--scheduler: expected local:N with N processes, at least 1, got {scheduler!r}")
        options: dict[str, Any] = {"threads_per_worker": 1, "memory_limit": 0, "dashboard_address": None}
        cluster = LocalCluster(n_workers=int(rest), processes=True, **options)
        return stack.enter_context(Client(stack.enter_context(cluster)))
    if not rest:
        raise JobError(f"--scheduler: expected local:N or an address such as tcp://host:8786, got {scheduler!r}")
    try:
        return stack.enter_context(Client(scheduler, timeout=TIMEOUT))
    except (OSError, ValueError) as error:
        raise JobError(f"--scheduler {scheduler}: cannot be reached: {error}") from error
