"""Errors against a folder that `jaxrefl reference` made: does it fit the job, and its frames as the job's reference."""

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxrefl._types import Camera
from jaxrefl.composite import tone_map
from pipelines.job import Job, SceneSource, read_job
from pipelines.outputs import json_text, png_bytes, read_exr
from pipelines.stamp import stamp
from pipelines.toml_tables import JobError

_CLOSE = 1e-5
"""Cameras count as the same up to this share of the largest of their numbers: float32 has 6e-8."""


def _file(folder: Path, frame: int, suffix: str) -> Path:
    return folder / "reference" / f"frame_{frame:04d}{suffix}"


def check_reference(job: Job, folder: Path) -> dict[str, str]:
    """Whether a folder's images can serve as the reference of a job.

    Args:
        job: The job, resolved but for this.
        folder: Folder that `jaxrefl reference` made.
    Returns:
        SHA-256 of the images that the job uses, by path.
    Raises:
        JobError: If the folder is none of `jaxrefl reference`, shows another scene or size, has no image of a frame, or
            its pixels are not sampled at their centres; names what was expected and what is there.
    """
    if not (folder / "job.toml").is_file():
        raise JobError(f"reference {folder}: expected a folder made by `jaxrefl reference`, but it has no job.toml")
    made = read_job(folder / "job.toml")
    if made.path is None or made.techniques:
        raise JobError(f"reference {folder}: expected a folder made by `jaxrefl reference`, got one of another command")
    if made.path.get("pixel") != "centre":
        raise JobError(
            f"reference {folder}: its pixels are {made.path.get('pixel')!r}, but techniques sample their centres; make "
            "one with --pixel centre"
        )
    there, wanted = _identity(made), _identity(job)
    for name in (n for n in wanted if wanted[n] != there[n]):
        values = f"{there[name]!r} there, {wanted[name]!r} here"
        raise JobError(f"reference {folder}: shows another scene: {name} is {values}")
    if made.size != job.size:
        sizes = [f"{size[0]} x {size[1]}" if size else "unknown" for size in (made.size, job.size)]
        raise JobError(f"reference {folder}: its images have {sizes[0]} pixels, the job's {sizes[1]}")
    digests = {}
    for frame in range(job.frames or 0):
        image = _file(folder, frame, ".exr")
        if not (image.is_file() and _file(folder, frame, ".json").is_file()):
            raise JobError(
                f"reference {image}: missing or not finished; the job has {job.frames} frames, the reference's job "
                f"{made.frames}"
            )
        digests[str(image)] = hashlib.sha256(image.read_bytes()).hexdigest()
    return digests


def _identity(job: Job) -> dict[str, Any]:
    """What the scene of a resolved job is: its files by content, not by path."""
    values = {field.name: getattr(job.scene, field.name) for field in dataclasses.fields(SceneSource)}
    return {name: job.digests.get(v, v) if isinstance(v, str) else v for name, v in values.items()}


def given_files(job: Job, cameras: Sequence[Camera], frame: int) -> dict[str, bytes]:
    """The files of a frame of the reference, taken from its folder.

    Args:
        job: Resolved job whose reference is a folder.
        cameras: The job's cameras; all are checked, so that a wrong path is found at the first frame.
        frame: Number of the frame.
    Returns:
        Content by suffix; the row says where it comes from.
    Raises:
        JobError: If a camera is not the one that the image was made with, or the image changed since the job was
            resolved.
    """
    folder = Path((job.reference.folder if job.reference is not None else None) or "")
    rows = [_row(folder, number) for number in range(len(cameras))]
    for number, (row, camera) in enumerate(zip(rows, cameras, strict=True)):
        _check_camera(folder, number, row, camera)
    path = _file(folder, frame, ".exr")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != job.digests.get(str(path)):
        raise JobError(f"{path}: changed since the job was made; start it again in another folder")
    planes = read_exr(path)
    image = np.stack([planes[axis] for axis in "RGB"], -1)
    files = {}
    if job.outputs.png:
        files[".png"] = png_bytes(np.asarray(tone_map(image, exposure=job.outputs.exposure)), stamp(job))
    return {**files, ".exr": data, ".json": json_text([{**rows[frame], "folder": str(folder)}]).encode()}


def _row(folder: Path, frame: int) -> dict[str, Any]:
    path = _file(folder, frame, ".json")
    try:
        (row,) = json.loads(path.read_text(encoding="utf-8"))
        return dict(row)
    except (OSError, ValueError, TypeError) as error:
        raise JobError(f"{path}: expected the row of a frame of `jaxrefl reference`: {error}") from error


def _check_camera(folder: Path, frame: int, row: dict[str, Any], camera: Camera) -> None:
    facts = row.get("camera") or {}
    for name in ("world_from_camera", "focal", "centre"):
        here = np.asarray(getattr(camera, name), np.float64)
        there = np.asarray(facts.get(name, []), np.float64)
        if there.shape != here.shape or np.abs(there - here).max() > _CLOSE * max(np.abs(here).max(), 1):
            raise JobError(
                f"reference {folder}: frame {frame} was made with another camera ({name} differs); paths of built-in "
                "scenes and loops depend on the number of frames"
            )
