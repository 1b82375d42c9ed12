"""Sensors of a Mitsuba scene file -> `Camera`s.

Mitsuba's cameras look along +Z with +X to the left; ours along -Z with +X to the right. The tests compare the rays
through pixel centres.
"""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Camera
from jaxrefl.core.cameras import perspective
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.mitsuba_nodes import Node

_DEFAULT_SIZE = (768, 576)
_FULL_FRAME = math.hypot(36.0, 24.0)
_AXES = np.diag([-1.0, 1.0, -1.0, 1.0])


def read_camera(node: Node) -> Camera | None:
    """The camera that a sensor describes.

    Args:
        node: A sensor.
    Returns:
        The camera with the size of the film's crop window; None, with a note, if it is not a perspective one.
    Raises:
        SceneError: If the size, the field of view or the transform is out of range.
    """
    notes, label = node.scene.notes, node.name or node.place
    if node.plugin not in ("perspective", "thinlens"):
        notes.group(f"sensors of the type {node.plugin} are ignored", label)
        return None
    if node.plugin == "thinlens":
        notes.group("these cameras have no depth of field here (thinlens becomes a pinhole)", label)
    films = node.children("Film")
    size, (x0, y0, width, height) = _film(films[0] if films else None)
    matrix = node.matrix() @ _AXES
    if np.linalg.det(matrix[:3, :3]) < 0:
        notes.group("the camera's transform mirrors the picture; the mirroring is ignored", label)
        matrix = matrix @ np.diag([-1.0, 1.0, 1.0, 1.0])
    try:
        focal = _focal(node, size)
        fov_y = math.degrees(2 * math.atan(0.5 * height / focal))
        camera = perspective(matrix, fov_y=fov_y, size=(width, height))
    except (ValueError, ZeroDivisionError) as error:
        raise SceneError(f"{node.scene.path}: {node.place}: {error}") from error
    shift = [node.number(f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
    centre = [size[0] * (0.5 - shift[0]) - x0, size[1] * (0.5 - shift[1]) - y0]
    return dataclasses.replace(camera, centre=jnp.asarray(centre, jnp.float32))


def _film(film: Node | None) -> tuple[tuple[int, int], tuple[int, int, int, int]]:
    """Size of the whole film, and its crop window as offset and size."""
    if film is None:
        return _DEFAULT_SIZE, (0, 0, *_DEFAULT_SIZE)
    width, height = (int(film.number(k, d)) for k, d in zip(("width", "height"), _DEFAULT_SIZE, strict=True))
    x0, y0 = (int(film.number(f"crop_offset_{axis}", 0)) for axis in "xy")
    crop = (int(film.number("crop_width", width)), int(film.number("crop_height", height)))
    return (width, height), (x0, y0, *crop)


def _focal(node: Node, size: tuple[int, int]) -> float:
    """Focal length in pixels, from a field of view along some axis or from that of a full-frame camera."""
    width, height = size
    spans = {"x": width, "y": height, "diagonal": math.hypot(width, height)}
    spans |= {"smaller": min(width, height), "larger": max(width, height)}
    if "fov" not in node:
        text = str(node.get("focal_length", "50mm"))
        millimetres = float(text.removesuffix("mm"))
        return spans["diagonal"] * millimetres / _FULL_FRAME
    axis, fov = str(node.get("fov_axis", "x")), node.number("fov", 45.0)
    if axis not in spans:
        raise ValueError(f"fov_axis: expected one of {', '.join(spans)}, got {axis!r}")
    if not 0 < fov < 180:
        raise ValueError(f"fov: expected degrees between 0 and 180, got {fov}")
    return 0.5 * spans[axis] / math.tan(math.radians(fov) / 2)
