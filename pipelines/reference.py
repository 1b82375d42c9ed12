"""`jaxrefl reference`: path traced images of every frame of a job, as good as asked for, with their standard errors.

A run may be killed at any moment and given again: a frame goes on from the state that was saved last and ends bit for
bit the same for the same number of samples. Asking for more goes on from what there is, because states are kept.
"""

import contextlib
import dataclasses
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrefl.composite import tone_map
from jaxrefl.core import hash_words
from jaxrefl.radiance.progressive import (
    Estimate,
    Goal,
    ProgressiveState,
    estimate,
    relative_error,
    render_progressively,
    sample_count,
)
from pipelines.folder import FolderError, claim, frame_path, is_done, locked, store
from pipelines.frames import FrameFiles, suffixes
from pipelines.job import Job
from pipelines.layers import path_channels, rgb_channels
from pipelines.measure import compile_seconds
from pipelines.outputs import exr_bytes, json_text, png_bytes
from pipelines.path_knobs import progressive_options
from pipelines.progress import Progress, Silent, shown
from pipelines.reference_state import Cost, load_state, save_state, state_path
from pipelines.resolve import resolve
from pipelines.run import Result
from pipelines.stage import REFERENCE, Stage
from pipelines.stamp import stamp

GOAL = Goal(spp=1024, error=0.01)
"""Where to stop if nothing is asked for."""
SAVE_EVERY = 30.0
"""Seconds between saved states."""


def run_reference(
    job: Job,
    out: Path,
    *,
    goal: Goal = GOAL,
    keep_state: bool = True,
    command: str | None = None,
    quiet: bool = False,
    save_every: float = SAVE_EVERY,
) -> Result:
    """Path trace what is missing of a job's frames into a folder.

    Args:
        job: Any job; techniques and what belongs to them are left aside.
        out: Results folder; made if needed.
        goal: When a frame is good enough; `seconds` count over all runs of it, compilation included.
        keep_state: True: keep what it takes to go on with a finished frame.
        command: What was typed, for the rows.
        quiet: True: say nothing on the way.
        save_every: Seconds between saved states.
    Returns:
        The rows of all frames, and how many were worked on now.
    Raises:
        ValueError: If the job or an input file does not fit, or the folder is in use or another job's.
        OSError: If the disk is full; what was saved before stays.
    """
    job = resolve(reference_job(job))
    with locked(out):
        claim(out, job)
        todo = [n for n in range(job.frames or 0) if not _is_good(out, job, n, goal)]
        if todo:
            with contextlib.nullcontext(Silent()) if quiet else shown(len(todo)) as progress:
                stage = Stage(job)
                for note in stage.notes:
                    progress.note(note)
                for frame in todo:
                    _Frame(stage, out, frame, progress, save_every).run(goal, keep_state, command)
        rows = [read_row(out, frame) for frame in range(job.frames or 0)]
    return Result(out, rows, len(todo))


def reference_job(job: Job) -> Job:
    """The part of a job that decides the reference.

    Args:
        job: Any job.
    Returns:
        The job without techniques, with the path tracer's knobs.
    """
    return dataclasses.replace(
        job, techniques=(), technique={}, reference=None, light={}, composite={}, cold=False, path=job.path or {}
    )


def read_row(folder: Path, frame: int) -> dict[str, Any]:
    """The row of a finished frame.

    Args:
        folder: Results folder.
        frame: Number of the frame.
    Returns:
        Figures by name.
    Raises:
        FolderError: If it is missing or broken; names the file.
    """
    path = frame_path(folder, REFERENCE, frame, ".json")
    try:
        (row,) = json.loads(path.read_text(encoding="utf-8"))
        return {**row, "spp": int(row["spp"])}
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise FolderError(f"{path}: expected the row of a frame of `jaxrefl reference`: {error}") from error


def _is_good(folder: Path, job: Job, frame: int, goal: Goal) -> bool:
    """True if a frame has all its files and reaches the goal."""
    if not is_done(folder, job, REFERENCE, frame):
        return False
    row = read_row(folder, frame)
    error = row["relative_error"]
    return (
        (goal.spp is not None and row["spp"] >= goal.spp)
        or (goal.error is not None and error is not None and error <= goal.error)
        or (goal.seconds is not None and row["seconds"] + row["compile_seconds"] >= goal.seconds)
    )


class _Frame:
    """One frame while it is worked on."""

    def __init__(self, stage: Stage, out: Path, frame: int, progress: Progress, save_every: float):
        self.stage, self.out, self.frame, self.progress, self.save_every = stage, out, frame, progress, save_every
        self.state: ProgressiveState | None = None
        self.before = Cost()
        saved = load_state(out, frame)
        if saved is not None:
            self.state, self.before = saved
        self.began = self.saved_at = time.perf_counter()
        self.rays_before = stage.tracer.rays
        self.compiling: list[float] = []

    @property
    def cost(self) -> Cost:
        """What the frame has cost until now."""
        spent, compiling = time.perf_counter() - self.began, sum(self.compiling)
        rays = self.before.rays + self.stage.tracer.rays - self.rays_before
        return Cost(
            self.before.seconds + max(spent - compiling, 0), self.before.compile_seconds + min(compiling, spent), rays
        )

    def run(self, goal: Goal, keep_state: bool, command: str | None) -> None:
        """Add samples until the goal is reached and write the frame's files."""
        if goal.seconds is not None:
            goal = dataclasses.replace(goal, seconds=max(goal.seconds - self.before.total, 1e-6))
        stage, job = self.stage, self.stage.job
        seed = hash_words(jnp.asarray(job.seed, jnp.uint32), self.frame)
        options = progressive_options(job.path or {})
        with compile_seconds() as self.compiling:
            try:
                self.state = render_progressively(
                    *(stage.scene, stage.tracer, stage.camera(self.frame), seed),
                    **{"goal": goal, "options": options, "state": self.state, "after": self._after},
                )
            except KeyboardInterrupt:
                self._save()
                raise
            cost = self.cost
        finished = frame_files(stage, self.frame, self.state, cost, command=command)
        # The samples come first and the row goes before the images change, so that a run that is killed in between
        # finds the frame unfinished and writes it again.
        if keep_state:
            save_state(self.out, self.frame, self.state, cost)
        frame_path(self.out, REFERENCE, self.frame, ".json").unlink(missing_ok=True)
        store(self.out, finished)
        if not keep_state:
            state_path(self.out, self.frame).unlink(missing_ok=True)
        self.progress.advance(f"{REFERENCE} {self.frame:04d}", finished.seconds)

    def _after(self, state: ProgressiveState) -> None:
        self.state = state
        if time.perf_counter() - self.saved_at >= self.save_every:
            self._save()
            error = relative_error(state)
            shown = "unknown" if error is None else f"{100 * error:.3g} %"
            self.progress.note(
                f"frame {self.frame}: {sample_count(state)} samples per pixel, relative error {shown}, saved"
            )

    def _save(self) -> None:
        if self.state is not None:
            save_state(self.out, self.frame, self.state, self.cost)
            self.saved_at = time.perf_counter()


def frame_files(
    stage: Stage, frame: int, state: ProgressiveState, cost: Cost, *, command: str | None = None
) -> FrameFiles:
    """The files of a frame.

    Args:
        stage: The loaded job.
        frame: Number of the frame.
        state: Its samples.
        cost: What they cost.
        command: What was typed, for the row.
    Returns:
        Content by suffix.
    Raises:
        FloatingPointError: If pixels are not finite; says how many.
    """
    found, spp, job = estimate(state), sample_count(state), stage.job
    image = np.asarray(found.radiance)
    if not np.isfinite(image).all():
        count = int((~np.isfinite(image)).any(-1).sum())
        raise FloatingPointError(f"{REFERENCE}: frame {frame}: {count} pixels are not finite")
    mark = stamp(job, command=f"jaxrefl reference --job job.toml --spp {spp} --out DIR")
    channels = path_channels(found, refractive=stage.scene.features.refractive)
    makers = {
        ".png": lambda: png_bytes(np.asarray(tone_map(found.radiance, exposure=job.outputs.exposure)), mark),
        ".exr": lambda: exr_bytes(rgb_channels(image), mark),
        ".layers.exr": lambda: exr_bytes(channels, mark),
        ".json": lambda: json_text([_row(stage, frame, state, found, cost, command)]).encode(),
    }
    files = {suffix: makers[suffix]() for suffix in suffixes(job, REFERENCE)}
    return FrameFiles(REFERENCE, frame, files, cost.seconds)


def _row(stage, frame: int, state: ProgressiveState, found: Estimate, cost: Cost, command) -> Mapping[str, Any]:
    camera, spp = stage.camera(frame), sample_count(state)
    paths = spp * camera.width * camera.height
    return {
        "scene": stage.scene.names.scene,
        "technique": REFERENCE,
        "frame": frame,
        "mask": "frame",
        "spp": spp,
        "relative_error": relative_error(state),
        "standard_error": None if found.error is None else float(jnp.sqrt((found.error**2).mean())),
        "seconds": cost.seconds,
        "compile_seconds": cost.compile_seconds,
        "paths_per_second": paths / cost.seconds if cost.seconds > 0 else None,
        "rays": cost.rays,
        "camera": camera_facts(camera),
        "stamp": stamp(stage.job, command=command),
    }


def camera_facts(camera: Any) -> dict[str, Any]:
    """A camera as plain numbers.

    Args:
        camera: The camera.
    Returns:
        `world_from_camera`, `focal` and `centre`.
    """
    return {name: np.asarray(getattr(camera, name)).tolist() for name in ("world_from_camera", "focal", "centre")}
