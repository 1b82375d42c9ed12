"""The camera of a scene that brings none: Scene -> Camera.

A view is good if it shows the fronts of surfaces: an open box is looked into, not at its back. Of the views in `VIEWS`
the first is taken that is about as good as the best; a scene that shows its backs all around is a closed room, and the
camera goes inside.
"""

import math

import numpy as np

from jaxrefl._types import Camera, Scene, Tracer
from jaxrefl.core.cameras import look_at
from jaxrefl.rays import camera_rays

VIEWS = ((0.4, 0.3, 1.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
"""Directions from the scene's centre to the camera, the preferred one first."""

FOV_Y = 40.0
"""Vertical field of view outside, degrees."""

INSIDE_FOV_Y = 65.0
"""Vertical field of view inside a closed room, degrees."""

_PROBE = (48, 36)
_MARGIN = 1.05
_AS_GOOD = 0.95
_BACKS = 0.5


def framing_camera(scene: Scene, tracer: Tracer, size: tuple[int, int]) -> Camera:
    """A camera that shows the scene.

    Args:
        scene: Any scene.
        tracer: Ray queries against it.
        size: Width and height in pixels.
    Returns:
        A camera outside from which the whole bounding box is seen, as close as can be; or, in a closed room, one near
        its +Z wall that looks along -Z.
    """
    shares = [front_share(scene, tracer, _outside(scene, view, _PROBE)) for view in VIEWS]
    if max(shares) < _BACKS:
        return _inside(scene, size)
    good = next(view for view, share in zip(VIEWS, shares, strict=True) if share >= _AS_GOOD * max(shares))
    return _outside(scene, good, size)


def _bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = (np.asarray(x, np.float64) for x in (scene.lower, scene.upper))
    return (lower + upper) / 2, np.maximum((upper - lower) / 2, 1e-6)


def _outside(scene: Scene, view: tuple[float, float, float], size: tuple[int, int]) -> Camera:
    centre, half = _bounds(scene)
    aim = look_at(centre + np.array(view), centre, fov_y=FOV_Y, size=size)
    axes = np.asarray(aim.world_from_camera, np.float64)[:3, :3]
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    corners = (signs * half) @ axes
    slope_y = math.tan(math.radians(FOV_Y) / 2)
    slopes = np.array([slope_y * size[0] / size[1], slope_y]) / _MARGIN
    # A corner (x, y, z) is in the picture if |x| and |y| are at most the slope times (distance - z).
    distance = float((corners[:, 2] + (np.abs(corners[:, :2]) / slopes).max(-1)).max())
    return look_at(centre + axes[:, 2] * distance, centre, fov_y=FOV_Y, size=size)


def _inside(scene: Scene, size: tuple[int, int]) -> Camera:
    centre, half = _bounds(scene)
    eye = centre + np.array([0.0, 0.0, 0.9 * half[2]])
    return look_at(eye, centre, fov_y=INSIDE_FOV_Y, size=size)


def front_share(scene: Scene, tracer: Tracer, camera: Camera) -> float:
    """How much of what a camera sees are the fronts of triangles.

    Args:
        scene: The scene.
        tracer: Ray queries against it.
        camera: The camera.
    Returns:
        Share of the pixels with a hit, in [0, 1]; 0 if nothing is seen.
    """
    rays = camera_rays(camera)
    hits = tracer.closest(rays)
    valid = np.asarray(hits.valid)
    front = valid & ~seen_from_behind(scene, np.asarray(hits.triangle), np.asarray(rays.direction))
    return float(front.sum() / max(valid.sum(), 1))


def seen_from_behind(scene: Scene, triangle: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether rays meet the backs of triangles.

    Args:
        scene: The scene.
        triangle: [*b] rows of its faces.
        direction: [*b 3] directions of the rays.
    Returns:
        [*b] bool.
    """
    corners = np.asarray(scene.mesh.vertices)[np.asarray(scene.mesh.faces)[triangle]]
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    return (normal * direction).sum(-1) > 0
