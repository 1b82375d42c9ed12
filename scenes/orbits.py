"""Camera paths of the built-in scenes: smooth closed loops around a view that makes the best still.

numbers -> tuple of `Camera`. Frame 0 is always the still; a loop comes back to it after the last frame.
"""

import math

import numpy as np
from jaxtyping import Float

from jaxrefl._types import Camera, Size
from jaxrefl.core.cameras import look_at
from scenes._check import Real

Eye = tuple[Real, Real, Real]


def check_frames(frames: int) -> None:
    """Check the length of a camera path.

    Args:
        frames: Number of cameras, >= 1.
    Raises:
        ValueError: If it is not a whole number of at least 1.
    """
    if isinstance(frames, bool) or int(frames) != frames or frames < 1:
        raise ValueError(f"frames: expected a whole number of at least 1, got {frames}")


def loop(
    frames: int, *, eye: Eye, target: Eye, sway: Real = 15.0, rise: Real = 4.0, fov_y: Real = 45.0, size: Size
) -> tuple[Camera, ...]:
    r"""A closed loop in front of a target: the eye sways to both sides and rises a little in between.

    With $a_i = 2\pi i / \text{frames}$ the eye turns about the vertical through the target by $\text{sway} \sin a_i$
    and about the target upwards by $\text{rise} (1 - \cos a_i) / 2$; its distance stays.

    Args:
        frames: Number of cameras, >= 1.
        eye: [3] Camera position of frame 0.
        target: [3] Point that stays in the middle of the image.
        sway: Largest turn to either side, degrees.
        rise: Largest turn upwards, degrees.
        fov_y: Vertical field of view, degrees.
        size: (width, height) in pixels.
    Returns:
        The cameras.
    Raises:
        ValueError: If `frames` or a camera is invalid.
    """
    check_frames(frames)
    away = np.asarray(eye, np.float64) - np.asarray(target, np.float64)
    distance, heading = np.linalg.norm(away), math.atan2(away[0], away[2])
    elevation = math.asin(away[1] / distance)
    cameras = []
    for i in range(frames):
        a = 2 * math.pi * i / frames
        turn = heading + math.radians(sway) * math.sin(a)
        lift = elevation + math.radians(rise) * 0.5 * (1 - math.cos(a))
        position = np.asarray(target) + distance * _direction(turn, lift)
        cameras.append(look_at(position, target, fov_y=float(fov_y), size=size))
    return tuple(cameras)


def orbit(
    frames: int, *, eye: Eye, target: Eye, step: Real = 3.0, fov_y: Real = 45.0, size: Size
) -> tuple[Camera, ...]:
    """A circle about the vertical through a target.

    Args:
        frames: Number of cameras, >= 1.
        eye: [3] Camera position of frame 0.
        target: [3] Point that stays in the middle of the image.
        step: Largest turn from frame to frame, degrees, positive from +Z to +X; with 360 / `step` frames or more the
            circle closes.
        fov_y: Vertical field of view, degrees.
        size: (width, height) in pixels.
    Returns:
        The cameras.
    Raises:
        ValueError: If `frames` or a camera is invalid.
    """
    check_frames(frames)
    away = np.asarray(eye, np.float64) - np.asarray(target, np.float64)
    distance, heading = np.linalg.norm(away), math.atan2(away[0], away[2])
    elevation = math.asin(away[1] / distance)
    turns = heading + math.radians(math.copysign(min(abs(step), 360 / frames), step)) * np.arange(frames)
    eyes = [np.asarray(target) + distance * _direction(turn, elevation) for turn in turns]
    return tuple(look_at(position, target, fov_y=float(fov_y), size=size) for position in eyes)


def fitted_fov(fov_x: Real, size: Size) -> float:
    """Vertical field of view of an image that shows a fixed angle from left to right.

    Args:
        fov_x: Horizontal field of view, degrees.
        size: (width, height) in pixels.
    Returns:
        Vertical field of view, degrees, at most 120.
    """
    tangent = math.tan(math.radians(fov_x) / 2) * size[1] / max(size[0], 1)
    return min(2 * math.degrees(math.atan(tangent)), 120.0)


def _direction(heading: Real, elevation: Real) -> Float[np.ndarray, "3"]:
    level = math.cos(elevation)
    return np.array([level * math.sin(heading), math.sin(elevation), level * math.cos(heading)])
