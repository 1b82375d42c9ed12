"""Running a job: plan the missing work, do it here or on workers, store each frame as it comes, write the tables.

A run may be killed at any moment. Started again it plans only what is missing, and ends with the same images and
figures as an unbroken run: every frame's randomness depends on the seed and its number alone, and errors are measured
against the reference as it is on disk.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxrefl.techniques import TECHNIQUES, Technique
from pipelines.folder import claim, collect, locked, store
from pipelines.frames import FrameFiles, Unit, render_unit
from pipelines.job import Job
from pipelines.lightmaps import wants_lightmap
from pipelines.plan import plan, references_of
from pipelines.progress import Silent, shown
from pipelines.resolve import resolve
from pipelines.stage import Stage
from pipelines.toml_tables import JobError


@dataclass(frozen=True)
class Result:
    """What a run leaves."""

    folder: Path
    """The results folder."""
    rows: list[dict[str, Any]]
    """All rows of metrics.json."""
    rendered: int
    """Frames rendered by this run; the others were there before."""


def run_job(
    job: Job,
    out: Path,
    *,
    scheduler: str | None = None,
    command: str | None = None,
    quiet: bool = False,
    techniques: Mapping[str, Technique] = TECHNIQUES,
) -> Result:
    """Render what is missing of a job into a folder.

    Args:
        job: Any job; it is resolved first.
        out: Results folder; made if needed.
        scheduler: None: this process; `local:N`: N processes here; `tcp://...`: a dask.distributed scheduler.
        command: What was typed, for the rows.
        quiet: True: say nothing on the way.
        techniques: The techniques that exist; with a scheduler only those of `jaxrefl.techniques`.
    Returns:
        The rows of all frames, and how many were rendered now.
    Raises:
        ValueError: If the job or an input file does not fit, or the folder is in use or another job's.
        OSError: If the disk is full; what was finished before stays.
    """
    if not job.techniques:
        raise JobError("techniques: expected at least one; a job without any is one of `jaxrefl reference`")
    job = resolve(job, techniques=techniques)
    with locked(out):
        claim(out, job)
        units = plan(job, out, techniques=techniques)
        total = sum(len(unit.missing) for unit in units)
        try:
            if units and quiet:
                _do(job, out, units, Silent(), scheduler, command, techniques)
            elif units:
                with shown(total) as progress:
                    _do(job, out, units, progress, scheduler, command, techniques)
        finally:
            rows = collect(out, job)
    return Result(out, rows, total)


def _do(job, out, units, progress, scheduler, command, techniques) -> None:
    if scheduler is None:
        finished = _here(job, out, units, progress, command, techniques)
    else:
        from pipelines.cluster import render_remotely

        if wants_lightmap(job):  # baked once, here, rather than by each worker
            Stage(job, folder=out, say=progress.note)

        finished = render_remotely(job, out, units, progress, scheduler=scheduler, command=command)
    for frame in finished:
        store(out, frame)
        progress.advance(f"{frame.technique} {frame.frame:04d}", frame.seconds)


def _here(job, out, units: Iterable[Unit], progress, command, techniques) -> Iterator[FrameFiles]:
    stage = Stage(job, techniques=techniques, folder=out, say=progress.note)
    for note in stage.notes:
        progress.note(note)
    for unit in units:
        yield from render_unit(stage, unit, references_of(job, out, unit), command=command)
