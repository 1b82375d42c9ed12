"""Camera paths from keyframes: positions and targets on Catmull-Rom splines, rotations on a smooth rotation spline.

The path passes through every keyframe. Frames are spread evenly over time, from the first keyframe to the last; on a
closed path the last frame lies one step before the first.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from jaxrefl._types import Camera
from jaxrefl.core.cameras import look_at, perspective
from pipelines.camera_files import Y_UP_FROM
from pipelines.job import Keyframe
from pipelines.toml_tables import JobError


def keyframe_cameras(
    keyframes: Sequence[Keyframe], *, frames: int, size: tuple[int, int], closed: bool = False, up: str = "y"
) -> tuple[Camera, ...]:
    """Cameras along keyframes.

    Args:
        keyframes: At least one; all with a target or all with a rotation.
        frames: How many cameras.
        size: Width and height in pixels.
        closed: True: the path returns to the first keyframe; with times, over one more step of mean length.
        up: Axis that points up in the keyframes, "y" or "z".
    Returns:
        One camera per frame.
    Raises:
        JobError: If keyframes mix targets and rotations, times do not increase, or a camera on the way is singular.
    """
    if not keyframes:
        raise JobError("camera.keyframes: expected at least one")
    aimed = _checked_kind(keyframes)
    times = _times(keyframes)
    if closed and len(keyframes) > 1:
        step = (times[-1] - times[0]) / (len(keyframes) - 1)
        keyframes = [*keyframes, dataclasses.replace(keyframes[0], time=None)]
        times = np.append(times, times[-1] + step)
    at = np.linspace(times[0], times[-1], frames, endpoint=not closed or len(keyframes) == 1)
    position = catmull_rom(times, np.array([k.position for k in keyframes]), at, closed=closed)
    fov = catmull_rom(times, np.array([k.fov_y for k in keyframes]), at, closed=closed)
    world = Y_UP_FROM[up]
    if aimed:
        target = catmull_rom(times, np.array([k.target for k in keyframes], float), at, closed=closed)
        upward = catmull_rom(times, np.array([k.up for k in keyframes]), at, closed=closed)
        position, target, upward = (v @ world[:3, :3].T for v in (position, target, upward))
        build = lambda i: look_at(position[i], target[i], up=upward[i], fov_y=float(fov[i]), size=size)  # noqa: E731
    else:
        turn = rotations(times, np.array([k.rotation for k in keyframes], float), at)
        build = lambda i: perspective(world @ _rigid(turn[i], position[i]), fov_y=float(fov[i]), size=size)  # noqa: E731
    return tuple(_named(build, i) for i in range(frames))


def _named(build: Callable[[int], Camera], number: int) -> Camera:
    try:
        return build(number)
    except ValueError as error:
        raise JobError(f"camera.keyframes: frame {number}: {error}") from error


def _checked_kind(keyframes: Sequence[Keyframe]) -> bool:
    """True if the keyframes have targets, False if they have rotations."""
    for number, keyframe in enumerate(keyframes):
        if (keyframe.target is None) == (keyframe.rotation is None):
            raise JobError(f"camera.keyframes[{number}]: expected either target or rotation")
        if keyframe.rotation is not None and np.linalg.norm(keyframe.rotation) < 1e-6:
            raise JobError(f"camera.keyframes[{number}]: rotation: expected a quaternion other than 0")
        if (keyframe.target is None) != (keyframes[0].target is None):
            raise JobError(f"camera.keyframes[{number}]: all keyframes need a target, or all a rotation")
    return keyframes[0].target is not None


def _times(keyframes: Sequence[Keyframe]) -> np.ndarray:
    times = np.array([float(i) if k.time is None else k.time for i, k in enumerate(keyframes)])
    if len({k.time is None for k in keyframes}) > 1:
        raise JobError("camera.keyframes: time: all keyframes need one, or none")
    if (np.diff(times) <= 0).any():
        raise JobError(f"camera.keyframes: time: expected increasing numbers, got {times.tolist()}")
    return times


def catmull_rom(times: np.ndarray, values: np.ndarray, at: np.ndarray, *, closed: bool = False) -> np.ndarray:
    """Values on a Catmull-Rom spline through keys at any times.

    $$ m_i = \\frac{v_{i+1} - v_{i-1}}{t_{i+1} - t_{i-1}} $$

    Args:
        times: [k] increasing.
        values: [k ...] values; with `closed` the last repeats the first.
        at: [n] times inside [times[0], times[-1]].
        closed: True: the slope at both ends is that of a loop.
    Returns:
        [n ...] values; the keys at their times, and straight lines where keys lie on one at even times.
    Edge cases: a single key gives its value everywhere.
    """
    # Imported where it is needed: it would add half a second to the start of every command.
    from scipy.interpolate import CubicHermiteSpline

    if len(times) == 1:
        return np.broadcast_to(values[0], (len(at), *values.shape[1:])).copy()
    spread = (slice(None),) + (None,) * (values.ndim - 1)
    slopes = np.empty_like(values, dtype=float)
    slopes[1:-1] = (values[2:] - values[:-2]) / (times[2:] - times[:-2])[spread]
    if closed:
        slopes[0] = slopes[-1] = (values[1] - values[-2]) / (times[1] - times[0] + times[-1] - times[-2])
    else:
        slopes[0] = (values[1] - values[0]) / (times[1] - times[0])
        slopes[-1] = (values[-1] - values[-2]) / (times[-1] - times[-2])
    return CubicHermiteSpline(times, values, slopes)(at)


def rotations(times: np.ndarray, quaternions: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Rotation matrices on a spline through rotations, with continuous angular velocity and acceleration.

    Args:
        times: [k] increasing.
        quaternions: [k 4] as (w, x, y, z), any length other than 0, either sign.
        at: [n] times inside [times[0], times[-1]].
    Returns:
        [n 3 3] rotation matrices; two keys give the turn at constant speed (slerp).
    Edge cases: a single key gives its rotation everywhere.
    """
    from scipy.spatial.transform import Rotation, RotationSpline

    keys = Rotation.from_quat(quaternions, scalar_first=True)
    if len(times) == 1:
        return np.broadcast_to(keys.as_matrix()[0], (len(at), 3, 3)).copy()
    return RotationSpline(times, keys)(at).as_matrix()


def _rigid(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return matrix
