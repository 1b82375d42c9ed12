"""Planning: what of a job is missing, in which pieces it can be handed out, and what each piece needs.

A piece is an interval of frames of one technique. It is one frame long unless the technique carries state from frame to
frame; then the interval starts from `init`, and a run that was killed takes up its work at the start of one.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxrefl.techniques import TECHNIQUES, Technique
from pipelines.folder import is_done, read_reference
from pipelines.frames import Unit
from pipelines.job import Job
from pipelines.knobs import build, find_technique
from pipelines.stage import REFERENCE


def plan(job: Job, folder: Path, *, techniques: Mapping[str, Technique] = TECHNIQUES) -> list[Unit]:
    """The work that is missing, in the order in which to do it.

    Args:
        job: Resolved job.
        folder: Its results folder.
        techniques: The techniques that exist.
    Returns:
        Units with at least one missing frame, by their last frame; a frame's reference comes before whatever is
        measured against it.
    """
    count = job.frames or 0
    names = (*((REFERENCE,) if job.reference is not None else ()), *job.techniques)
    units = []
    for name in names:
        length = _interval(job, name, techniques)
        for first in range(0, count, length):
            last = min(first + length, count) - 1
            missing = tuple(n for n in range(first, last + 1) if not is_done(folder, job, name, n))
            if missing:
                units.append(Unit(name, first, last, missing))
    return sorted(units, key=lambda unit: (unit.last, names.index(unit.technique)))


def _interval(job: Job, name: str, techniques: Mapping[str, Technique]) -> int:
    """Frames that must be rendered in order by one process; 1 unless a technique carries state from frame to frame."""
    chosen, values = name, job.technique.get(name, {})
    if name == REFERENCE and job.reference is not None:
        if job.reference.folder is not None:
            return 1
        chosen, values = job.reference.technique, job.reference.knobs
    technique = find_technique(chosen, techniques)
    if technique.interval is None:
        return 1
    return technique.interval(build(technique.Options, values, where=f"[technique.{chosen}]"))


def references_of(job: Job, folder: Path, unit: Unit) -> dict[int, np.ndarray]:
    """The reference images that a unit is measured against.

    Args:
        job: Resolved job.
        folder: Its results folder.
        unit: The unit.
    Returns:
        [h w 3] linear radiance by frame; empty for the reference itself and for jobs without one.
    Raises:
        OSError: If one is missing or broken.
    """
    if job.reference is None or unit.technique == REFERENCE:
        return {}
    return {frame: read_reference(folder, frame) for frame in unit.missing}
