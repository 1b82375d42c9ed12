"""Emitters of a Mitsuba scene file -> punctual lights and the sky. Area lights belong to shapes; see `mitsuba.py`.

Mitsuba's environment maps look along -Z at their left edge, ours in the middle; the tests compare both numerically.
Mitsuba has the first and the last row at the poles themselves, not half a row beside them; this difference of at most
half a row is not made up for.
"""

import math

import numpy as np

from jaxrefl.scene.description import PunctualLight, Sky, constant_sky
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.images import read_image, read_radiance
from jaxrefl.scene.mitsuba_nodes import Node, Triple
from jaxrefl.scene.mitsuba_textures import TextureReader
from jaxrefl.scene.srgb_bytes import linear_from_srgb

_HALF_TURN = np.diag([-1.0, 1.0, -1.0])


def read_light(textures: TextureReader, node: Node) -> PunctualLight | None:
    """A light without a shape.

    Args:
        textures: Reader of the file's colours.
        node: An emitter.
    Returns:
        The light; None if it is of another kind.
    """
    name, matrix = node.name or node.plugin, node.matrix()
    if node.plugin == "point":
        position = node.vector("position", (0, 0, 0)) if "position" in node else matrix[:3, 3]
        return PunctualLight(name, _constant(textures, node, "intensity"), position=_triple(position))
    if node.plugin == "directional":
        direction = node.vector("direction", (0, 0, 1)) if "direction" in node else matrix[:3, 2]
        light = _constant(textures, node, "irradiance")
        return PunctualLight(name, light, direction=_unit(node, direction), directional=True)
    if node.plugin != "spot":
        return None
    cutoff = node.number("cutoff_angle", 20.0)
    beam = min(node.number("beam_width", cutoff * 3 / 4), cutoff)
    if node.child("texture") is not None:
        node.scene.notes.group("textures of spot lights are ignored", name)
    node.scene.notes.group(
        "between beam_width and cutoff_angle these spots fade with the square of the cosine's share, in Mitsuba "
        "linearly with the angle",
        name,
    )
    return PunctualLight(
        name,
        _constant(textures, node, "intensity"),
        position=_triple(matrix[:3, 3]),
        direction=_unit(node, matrix[:3, 2]),
        cos_inner=math.cos(math.radians(beam)),
        cos_outer=math.cos(math.radians(cutoff)),
    )


def read_sky(textures: TextureReader, node: Node) -> Sky | None:
    """Light from infinitely far away.

    Args:
        textures: Reader of the file's colours.
        node: An emitter.
    Returns:
        The sky; None if the emitter is of another kind.
    Raises:
        SceneError: If the map cannot be read or its transform is singular.
    """
    if node.plugin == "constant":
        return constant_sky(_constant(textures, node, "radiance"))
    if node.plugin != "envmap":
        return None
    path = node.scene.resolve(node, str(node.get("filename", "")))
    try:
        radiance = _radiance(path)
    except SceneError as error:
        raise SceneError(f"{node.scene.path}: {node.place}: {error}") from error
    linear = node.matrix()[:3, :3]
    lengths = np.linalg.norm(linear, axis=0)
    if abs(np.linalg.det(linear / np.where(lengths > 0, lengths, 1))) < 1e-3:
        raise SceneError(f"{node.scene.path}: {node.place}: to_world: expected a rotation, got {linear.tolist()}")
    rotation = linear / lengths
    if np.linalg.det(rotation) < 0:  # a mirrored map: mirror the picture instead, which turns x around
        radiance, rotation = radiance[:, ::-1], rotation @ np.diag([-1.0, 1.0, 1.0])
    u, _, v = np.linalg.svd(rotation)
    if np.abs(u @ v - rotation).max() > 1e-3:
        node.scene.notes.group("the transform is no rotation; the nearest rotation is used", node.place)
    return Sky(radiance * np.float32(node.number("scale", 1.0)), u @ v @ _HALF_TURN, name=path.name)


def _radiance(path) -> np.ndarray:
    if path.suffix.lower() in (".exr", ".hdr", ".rgbe", ".pic"):
        return read_radiance(path)
    return linear_from_srgb(read_image(path)[..., :3] / 255).astype(np.float32)


def _constant(textures: TextureReader, node: Node, key: str) -> Triple:
    found = textures.colour(node, key, (1.0, 1.0, 1.0), meaning="emission")
    if found.image is not None:
        node.scene.notes.group(f"the texture of its {key} is ignored", node.name or node.place)
    red, green, blue = (max(c, 0.0) for c in found.factor)
    return red, green, blue


def _unit(node: Node, direction: np.ndarray) -> Triple:
    length = float(np.linalg.norm(direction))
    if length == 0:
        raise SceneError(f"{node.scene.path}: {node.place}: expected a direction, got the zero vector")
    return _triple(direction / length)


def _triple(values: np.ndarray) -> Triple:
    x, y, z = (float(v) for v in values)
    return x, y, z
