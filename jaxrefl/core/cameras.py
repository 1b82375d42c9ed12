"""Pinhole cameras: construction, resizing, projection.

`Camera` looks along its -Z axis with +Y up; pixel (column, row) has its centre at (column + 0.5, row + 0.5) and row 0
is on top, so image y grows downwards while camera y grows upwards.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrefl._types import Camera, Size
from jaxrefl.core.safe import divide

Numbers = np.ndarray | Array | Sequence[Any]
"""What the host-side constructors take for a vector or matrix: an array, or (nested) sequences of numbers."""


def _checked_size(size: Size) -> tuple[int, int]:
    width, height = (int(s) for s in size)
    if width < 1 or height < 1:
        raise ValueError(f"size: expected a width and height of at least 1 pixel, got {tuple(size)}")
    return width, height


def perspective(world_from_camera: Numbers, *, fov_y: float, size: Size) -> Camera:
    """Camera with square pixels and the principal point in the middle.

    Args:
        world_from_camera: [4 4] camera-to-world transform; scale in it is removed.
        fov_y: Vertical field of view, degrees, in (0, 180).
        size: (width, height) in pixels.
    Returns:
        The camera.
    Raises:
        ValueError: If the transform is singular or not finite, or the field of view or size is out of range.
    """
    width, height = _checked_size(size)
    if not 0 < fov_y < 180:
        raise ValueError(f"fov_y: expected degrees between 0 and 180, got {fov_y}")
    matrix = np.asarray(world_from_camera, np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"world_from_camera: expected a finite 4x4 matrix, got {matrix.tolist()}")
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    rotation = matrix[:3, :3] / np.where(lengths > 0, lengths, 1)
    if abs(np.linalg.det(rotation)) < 1e-3:
        raise ValueError(f"world_from_camera: singular, its axes span no volume: {matrix[:3, :3].tolist()}")
    rigid = np.eye(4)
    rigid[:3, :3], rigid[:3, 3] = rotation, matrix[:3, 3]
    focal = 0.5 * height / math.tan(math.radians(fov_y) / 2)
    return Camera(
        world_from_camera=jnp.asarray(rigid, jnp.float32),
        focal=jnp.full(2, focal, jnp.float32),
        centre=jnp.asarray([width / 2, height / 2], jnp.float32),
        width=width,
        height=height,
    )


def look_at(
    eye: Numbers, target: Numbers, *, up: Numbers = (0.0, 1.0, 0.0), fov_y: float = 45.0, size: Size = (512, 512)
) -> Camera:
    """Camera at `eye` that looks at `target`.

    Args:
        eye: [3] camera position, world space.
        target: [3] point in the middle of the image.
        up: [3] direction that points up in the image.
        fov_y: Vertical field of view, degrees.
        size: (width, height) in pixels.
    Returns:
        The camera.
    Raises:
        ValueError: If `eye` and `target` coincide or `up` is parallel to the line of sight.
    """
    eye, target, up = (np.asarray(x, np.float64) for x in (eye, target, up))
    backward = eye - target
    right = np.cross(up, backward)
    if not np.isfinite(right).all() or np.linalg.norm(right) < 1e-9 * np.linalg.norm(up) * np.linalg.norm(backward):
        raise ValueError(
            f"look_at: eye {eye.tolist()}, target {target.tolist()}, up {up.tolist()} span no camera frame"
        )
    if np.linalg.norm(right) == 0:
        raise ValueError(f"look_at: eye and target coincide at {eye.tolist()}")
    backward, right = backward / np.linalg.norm(backward), right / np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, np.cross(backward, right), backward, eye
    return perspective(matrix, fov_y=fov_y, size=size)


def resize(camera: Camera, size: Size) -> Camera:
    """The same view at another resolution.

    The vertical field of view is kept; a new aspect ratio shows more or less at the sides.

    Args:
        camera: Any camera.
        size: New (width, height) in pixels.
    Returns:
        The resized camera.
    """
    width, height = _checked_size(size)
    scale = height / camera.height
    middle = jnp.asarray([camera.width / 2, camera.height / 2], jnp.float32)
    centre = (camera.centre - middle) * scale + jnp.asarray([width / 2, height / 2], jnp.float32)
    return Camera(camera.world_from_camera, camera.focal * scale, centre, width, height)


def project(camera: Camera, p: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 2"], Float[Array, "*b"]]:
    """Image position and depth of world points.

    Args:
        camera: Any camera.
        p: World positions.
    Returns:
        (x, y) in pixels and depth along the camera's axis; points with depth <= 0 lie behind the camera and their
        position is that of the point on the camera's axis.
    """
    rotation, eye = camera.world_from_camera[:3, :3], camera.world_from_camera[:3, 3]
    offset = p - jnp.broadcast_to(eye, p.shape)
    x, y, z = (_dot_column(offset, rotation[:, i]) for i in range(3))
    depth = -z
    inverse = jnp.where(depth > 0, divide(jnp.ones_like(depth), depth), 0)
    xy = jnp.stack(
        [camera.centre[0] + camera.focal[0] * x * inverse, camera.centre[1] - camera.focal[1] * y * inverse], -1
    )
    return xy, depth


def _dot_column(v: Float[Array, "*b 3"], column: Float[Array, "3"]) -> Float[Array, "*b"]:
    return v[..., 0] * column[0] + v[..., 1] * column[1] + v[..., 2] * column[2]
