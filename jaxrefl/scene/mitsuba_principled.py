"""Mitsuba's `principled` and `principledthin` materials -> metallic-roughness parameters.

Source: Burley, "Extending the Disney BRDF to a BSDF", 2015, as Mitsuba 3 implements it: alpha = roughness^2, light that
is refracted takes the square root of the base colour.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from jaxrefl.scene.description import Image, Material
from jaxrefl.scene.mitsuba_nodes import Node
from jaxrefl.scene.mitsuba_textures import Texture, TextureReader, mapped

_IGNORED = ("anisotropic", "spec_tint", "clearcoat", "clearcoat_gloss", "sheen", "sheen_tint", "flatness", "diff_trans")


@dataclass(frozen=True)
class Principled:
    """A principled material in our terms."""

    material: Material
    """Numbers; the colour stands beside it."""
    colour: Texture
    """Base colour."""
    metallic_roughness: Texture
    """Image with roughness (G) and metalness (B), if one of them varies."""


def principled(textures: TextureReader, node: Node, label: str) -> Principled:
    """Metallic-roughness parameters of a principled material.

    Args:
        textures: Reader of the file's textures.
        node: The BSDF.
        label: What to call it in notes.
    Returns:
        The parameters; what has no counterpart is noted if it is not 0.
    """
    notes = node.scene.notes
    colour = textures.colour(node, "base_color", (0.5, 0.5, 0.5))
    rough, metallic = textures.number(node, "roughness", 0.5), textures.number(node, "metallic", 0.0)
    transmission = textures.number(node, "spec_trans", 0.0)
    if transmission.image is not None:
        notes.group("textures of spec_trans are ignored; the material is opaque", label)
        transmission = Texture(factor=(0.0, 0.0, 0.0))
    share = min(max(transmission.mean, 0.0), 1.0)
    if share == 1:
        red, green, blue = (math.sqrt(c) for c in colour.factor)
        image = None if colour.image is None else mapped(colour.image, np.sqrt)
        colour = dataclasses.replace(colour, factor=(red, green, blue), image=image)
    for key in _IGNORED:
        if key in node and (node.child(key) is not None or node.number(key, 0.0) != 0):
            notes.group(f"{key} is ignored", label)
    notes.group("the diffuse part of these principled materials is Lambertian (no retro-reflection)", label)
    material = Material(
        "",
        metallic=min(max(metallic.mean, 0.0), 1.0) if metallic.image is None else 1.0,
        alpha=min(max(rough.mean, 0.0), 1.0) ** 2 if rough.image is None else 1.0,
        eta=_index(node),
        transmission=share,
        thin=node.plugin == "principledthin" and share > 0,
    )
    return Principled(material, colour, _packed(node, label, rough, metallic))


def _index(node: Node) -> float:
    if "eta" in node and "specular" not in node:
        eta = node.number("eta", 1.5)
    else:
        # specular is the reflectance at normal incidence over 0.08
        eta = 2 / (1 - math.sqrt(0.08 * min(max(node.number("specular", 0.5), 0.0), 1.0))) - 1
    if eta < 1:
        node.scene.notes.group("an index of refraction below 1 is turned around", node.name or node.place)
        return 1 / max(eta, 1e-3)
    return eta


def _packed(node: Node, label: str, rough: Texture, metallic: Texture) -> Texture:
    """One image of roughness and metalness; where their sizes differ the metalness is sampled to the other's size."""
    source = rough if rough.image is not None else metallic
    if source.image is None:
        return Texture()
    height, width = source.image.rgba.shape[:2]
    rgba = np.full((height, width, 4), 255, np.uint8)
    if rough.image is not None:
        rgba[..., 1] = rough.image.rgba[..., 0]
    if metallic.image is not None:
        other = metallic.image.rgba[..., 0]
        rows, columns = (np.arange(n) * m // n for n, m in zip((height, width), other.shape, strict=True))
        rgba[..., 2] = other[np.ix_(rows, columns)]
        if rough.image is not None and not _same(rough.to_uv, metallic.to_uv):
            node.scene.notes.group(
                "the transform to_uv of the metalness is ignored, as the roughness has another", label
            )
    return dataclasses.replace(source, image=Image(source.image.name, rgba, source.image.repeat))


def _same(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    return np.allclose(np.eye(3) if a is None else a, np.eye(3) if b is None else b)
