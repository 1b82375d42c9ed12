"""Camera paths from `transforms.json`, the NeRF and Blender convention: camera-to-world, looking along -Z, +Y up.

Intrinsics stand for all frames (`camera_angle_x`, or `fl_x`, `fl_y`, `cx`, `cy` with `w`, `h`) or in each frame. Lens
distortion is not modelled: coefficients other than 0 are refused rather than ignored.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Camera
from jaxrefl.core.cameras import perspective, resize
from pipelines.toml_tables import JobError

Y_UP_FROM = {"y": np.eye(4), "z": np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)}
"""World rotation that makes the named axis point up along +Y."""

_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")


@dataclass(frozen=True)
class CameraFileFacts:
    """What a camera file says before the scene is loaded."""

    frames: int
    """How many cameras it holds."""
    size: tuple[int, int] | None
    """Width and height in pixels, where it names them."""


def camera_file_facts(path: Path) -> CameraFileFacts:
    """How many cameras a file holds, and their size.

    Args:
        path: transforms.json.
    Returns:
        The facts.
    Raises:
        JobError: If the file is missing or not of this kind.
    """
    table = _read(path)
    return CameraFileFacts(len(table["frames"]), _size(table, path))


def read_cameras(path: Path, *, frames: int, size: tuple[int, int], up: str = "y") -> tuple[Camera, ...]:
    """Cameras of a file.

    Args:
        path: transforms.json.
        frames: How many; the first ones of the file.
        size: Width and height to render at; where the file names another size, the vertical field of view is kept.
        up: Axis that points up in the file, "y" or "z".
    Returns:
        One camera per frame.
    Raises:
        JobError: If the file holds fewer cameras, a matrix is singular, not finite or no 4x4 matrix, or the field of
            view is missing or out of range; names the frame.
    """
    table = _read(path)
    if len(table["frames"]) < frames:
        raise JobError(f"{path}: expected at least {frames} cameras, got {len(table['frames'])}")
    cameras = []
    for number, frame in enumerate(table["frames"][:frames]):
        where = f"{path}: frame {number}"
        if not isinstance(frame, Mapping) or "transform_matrix" not in frame:
            raise JobError(f"{where}: expected a table with transform_matrix, got {frame!r:.80}")
        cameras.append(_camera({**table, **frame}, where, size, Y_UP_FROM[up]))
    return tuple(cameras)


def _read(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise JobError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise JobError(f"{path}: is not valid JSON: {error}") from error
    frames = table.get("frames") if isinstance(table, dict) else None
    if not isinstance(frames, list) or not frames:
        raise JobError(f"{path}: expected a list 'frames' with at least one camera, as in transforms.json")
    return table


def _number(table: Mapping[str, Any], key: str, where: object) -> float | None:
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise JobError(f"{where}: {key}: expected a finite number, got {value!r}")
    return float(value)


def _size(table: Mapping[str, Any], where: object) -> tuple[int, int] | None:
    width, height = (_number(table, key, where) for key in ("w", "h"))
    if width is None or height is None:
        return None
    if min(width, height) < 1:
        raise JobError(f"{where}: w and h: expected at least 1 pixel, got {width:g} {height:g}")
    return int(width), int(height)


def _camera(table: Mapping[str, Any], where: str, size: tuple[int, int], y_up: np.ndarray) -> Camera:
    for key in _DISTORTION:
        if _number(table, key, where):
            raise JobError(f"{where}: {key}: lens distortion is not supported; undistort the cameras first")
    try:
        matrix = y_up @ np.asarray(table["transform_matrix"], np.float64)
        rigid = perspective(matrix, fov_y=45.0, size=size).world_from_camera
    except (ValueError, TypeError) as error:
        raise JobError(f"{where}: transform_matrix: {error}") from error
    width, height = own = _size(table, where) or size
    focal_x, focal_y = (_number(table, key, where) for key in ("fl_x", "fl_y"))
    if focal_x is None:
        angle = _number(table, "camera_angle_x", where)
        if angle is None:
            raise JobError(f"{where}: expected camera_angle_x or fl_x, got neither")
        if not 0 < angle < math.pi:
            raise JobError(f"{where}: camera_angle_x: expected radians between 0 and pi, got {angle}")
        focal_x = 0.5 * width / math.tan(angle / 2)
    focal_y = focal_x if focal_y is None else focal_y
    if min(focal_x, focal_y) <= 0:
        raise JobError(f"{where}: fl_x and fl_y: expected pixels > 0, got {focal_x} {focal_y}")
    x, y = (_number(table, key, where) for key in ("cx", "cy"))
    centre = [width / 2 if x is None else x, height / 2 if y is None else y]
    camera = Camera(rigid, jnp.asarray([focal_x, focal_y], jnp.float32), jnp.asarray(centre, jnp.float32), *own)
    return camera if own == size else resize(camera, size)
