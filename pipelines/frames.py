"""Rendering: an interval of frames of one technique -> the files of each frame, as bytes.

Nothing here writes to the results folder, so the same function serves this process and workers elsewhere.
"""

import zlib
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from jax import Array

from jaxrefl._types import Frame, Reflection
from jaxrefl.composite import blend, tone_map
from jaxrefl.surface import reflective
from pipelines.job import Job
from pipelines.layers import frame_channels, rgb_channels, technique_channels
from pipelines.measure import Timed, rows, timed
from pipelines.outputs import exr_bytes, json_text, png_bytes
from pipelines.reference_folder import given_files
from pipelines.stage import REFERENCE, Prepared, Stage, View
from pipelines.stamp import stamp


class Unit(NamedTuple):
    """What is handed out at once: an interval of frames of one technique, first to last, both included."""

    technique: str
    """Name of a technique of the job, or `REFERENCE`."""
    first: int
    """First frame."""
    last: int
    """Last frame."""
    missing: tuple[int, ...]
    """Frames of the interval that are wanted; the others are only run through, for the state they leave."""


class FrameFiles(NamedTuple):
    """A finished frame."""

    technique: str
    """Name of the folder."""
    frame: int
    """Number of the frame."""
    files: dict[str, bytes]
    """Content by suffix; `.json`, the rows, comes last."""
    seconds: float
    """Steady seconds of the technique's step."""


def suffixes(job: Job, technique: str) -> tuple[str, ...]:
    """Which files a frame leaves.

    Args:
        job: Resolved job.
        technique: Name of a technique of the job, or `REFERENCE`.
    Returns:
        Suffixes in the order in which they are written.
    """
    wanted = {
        ".png": job.outputs.png,
        ".exr": job.outputs.exr or technique == REFERENCE,
        # Those of a reference that was rendered before stay where they are.
        ".layers.exr": job.outputs.layers and not (technique == REFERENCE and _is_given(job)),
    }
    return (*(suffix for suffix, on in wanted.items() if on), ".json")


def _is_given(job: Job) -> bool:
    return job.reference is not None and job.reference.folder is not None


def render_unit(
    stage: Stage, unit: Unit, references: Mapping[int, np.ndarray], *, command: str | None = None
) -> Iterator[FrameFiles]:
    """Render an interval of frames.

    Args:
        stage: The loaded job.
        unit: Which frames of which technique.
        references: [h w 3] linear radiance by frame; empty where errors are not measured.
        command: What was typed, for the rows.
    Yields:
        The files of each missing frame, in order.
    """
    if unit.technique == REFERENCE and _is_given(stage.job):
        for number in unit.missing:
            yield FrameFiles(REFERENCE, number, given_files(stage.job, stage.cameras, number), 0.0)
        return
    prepared = stage.prepared(unit.technique)
    state = prepared.state
    for number in range(unit.first, unit.last + 1):
        view = stage.view(number)
        step = _step(stage, prepared, state, view, number, unit)
        state = step.value[0]
        if number in unit.missing:
            finished = _Finished(unit.technique, number, view, step, prepared.init_seconds)
            yield _files(stage, finished, references.get(number), command)


def _step(stage: Stage, prepared: Prepared, state: Any, view: View, number: int, unit: Unit) -> Timed:
    name = unit.technique
    # A stream of its own for each technique, and another for the reference, so that no noise is shared.
    key = stage.key(number, zlib.crc32(name.encode()) | 1)
    ahead = _next_key(prepared, number - unit.first)
    frame = Frame(
        scene=stage.scene,
        camera=stage.camera(number),
        gbuffer=view.gbuffer,
        key=key,
        tracer=stage.tracer,
        ahead=None if ahead is None else stage.camera(min(unit.first + ahead, len(stage.cameras) - 1)),
    )
    # Long references are not worth a second run for the sake of their time.
    call = lambda: prepared.technique.step(state, frame, prepared.params, options=prepared.options)  # noqa: E731
    return timed(call, repeat=name != REFERENCE)


def _next_key(prepared: Prepared, number: int) -> int | None:
    """Number of the key frame after frame `number` of a unit; None where the technique does not look ahead."""
    every = 0 if prepared.technique.ahead is None else prepared.technique.ahead(prepared.options)
    return None if every == 0 else (number // every + 1) * every


class _Finished(NamedTuple):
    """One step, before it is composited and encoded."""

    technique: str
    frame: int
    view: View
    step: Timed
    init_seconds: float


def _files(stage: Stage, finished: _Finished, reference: np.ndarray | None, command: str | None) -> FrameFiles:
    gbuffer, diffuse, _ = finished.view
    reflection: Reflection = finished.step.value[1]
    job, mark = stage.job, stamp(stage.job)
    composed = timed(lambda: blend(gbuffer, diffuse, reflection, options=stage.composite))
    image = np.asarray(composed.value)
    if not np.isfinite(image).all():
        count = int((~np.isfinite(image)).any(-1).sum())
        raise FloatingPointError(f"{finished.technique}: frame {finished.frame}: {count} pixels are not finite")
    wanted = suffixes(job, finished.technique)
    files = {}
    if ".png" in wanted:
        files[".png"] = png_bytes(np.asarray(tone_map(composed.value, exposure=job.outputs.exposure)), mark)
    if ".exr" in wanted:
        files[".exr"] = exr_bytes(rgb_channels(image), mark)
    if ".layers.exr" in wanted:
        files[".layers.exr"] = exr_bytes(
            frame_channels(image, gbuffer, diffuse, reflection) | technique_channels(finished.step.value[2].layers),
            mark,
        )
    shared = {**finished.view.seconds, "composite": composed.seconds}
    facts = {**_facts(stage, finished), "shared": shared, "stamp": stamp(job, command=command)}
    against = image if finished.technique == REFERENCE else reference
    mask = np.asarray(reflective(gbuffer))
    table = rows(image, against, mask, facts, exposure=job.outputs.exposure)
    files[".json"] = json_text(table).encode()
    return FrameFiles(finished.technique, finished.frame, files, finished.step.seconds)


def _facts(stage: Stage, finished: _Finished) -> dict[str, Any]:
    info = finished.step.value[2]
    return {
        "scene": stage.scene.names.scene,
        "technique": finished.technique,
        "frame": finished.frame,
        "seconds": finished.step.seconds,
        "compile_seconds": finished.step.compile_seconds,
        "init_seconds": finished.init_seconds,
        "stages": {name: float(seconds) for name, seconds in info.seconds.items()},
        "rays": int(info.rays),
        "peak_mib": finished.step.peak_mib,
        "info": {name: _scalar(value) for name, value in info.counts.items()},
    }


def _scalar(value: Any) -> Any:
    return value.item() if isinstance(value, Array | np.generic) else value
