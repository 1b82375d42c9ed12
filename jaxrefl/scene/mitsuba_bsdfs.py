"""Materials of a Mitsuba scene file -> `Material`s, with a note for whatever is approximated.

Input: BSDF nodes. Output: a `Surface` per node: the material, the transform of its texture coordinates, and whether the
triangles must be turned around. Wrappers (twosided, mask, normalmap, ...) change the surface beneath them.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from jaxrefl.scene.description import Material, matte
from jaxrefl.scene.mitsuba_nodes import Node, Triple, loaded
from jaxrefl.scene.mitsuba_principled import principled
from jaxrefl.scene.mitsuba_textures import Texture, TextureReader, mapped
from jaxrefl.scene.plastic import albedo_beneath

DEFAULT_COLOUR = (0.5, 0.5, 0.5)
"""Albedo of Mitsuba's default material, and of materials that are not known here."""


@dataclass(frozen=True)
class Surface:
    """What a shape is made of."""

    material: Material
    """The material; its name is empty where the file gives no id."""
    to_uv: np.ndarray | None = None
    """[3 3] transform of the texture coordinates; None: the identity."""
    inverted: bool = False
    """True: the index of refraction is that of the other side, so that the triangles must be turned around."""
    attribute: str | None = None
    """Vertex attribute that multiplies the base colour."""
    two_sided: bool = False
    """True: both sides look alike, or light passes."""
    invisible: bool = False
    """True: the surface only bounds a medium."""


@dataclass
class SurfaceReader:
    """Reads the materials of one file, each once."""

    textures: TextureReader
    label: str = ""
    """What to call the material that is being read in notes: the id of the outermost BSDF."""
    _surfaces: dict[int, Surface] = field(default_factory=dict)

    def read(self, node: Node) -> Surface:
        """The surface that a BSDF node describes.

        Args:
            node: Any BSDF.
        Returns:
            The surface; matte grey, with a note, if the plugin is not known.
        Raises:
            SceneError: If a parameter has the wrong type.
        """
        if node.index not in self._surfaces:
            outer = self.label
            self.label = node.name or outer or node.place
            surface = _MAKERS.get(node.plugin, _unknown)(self, node)
            self.label = outer
            if node.name:
                surface = dataclasses.replace(surface, material=surface.material.replace(name=node.name))
            self._surfaces[node.index] = surface
        return self._surfaces[node.index]

    def nested(self, node: Node) -> Surface:
        """The surface beneath a wrapper; the default material if there is none."""
        inner = node.children("BSDF")
        return self.read(inner[0]) if inner else Surface(matte("", DEFAULT_COLOUR))

    def with_colour(self, texture: Texture, material: Material, **changes) -> Surface:
        """A surface whose base colour is a texture."""
        material = material.replace(base_colour=texture.factor, base_colour_texture=texture.image)
        return Surface(material, texture.to_uv, attribute=texture.attribute, **changes)

    def with_number(self, node: Node, surface: Surface, texture: Texture, slot: str) -> Surface:
        """The surface with one more image, if its texture coordinates agree with those that are there."""
        if texture.image is None:
            return surface
        pictures = [getattr(surface.material, f.name) for f in dataclasses.fields(Material) if "texture" in f.name]
        first = all(picture is None for picture in pictures)
        same = texture.to_uv is surface.to_uv or (
            texture.to_uv is not None and surface.to_uv is not None and np.allclose(texture.to_uv, surface.to_uv)
        )
        if not first and not same:
            text = "the transform to_uv of these textures is ignored, as another texture of the same material differs"
            node.scene.notes.group(text, texture.image.name)
        changed = surface.material.replace(**{slot: texture.image})
        return dataclasses.replace(surface, material=changed, to_uv=texture.to_uv if first else surface.to_uv)


def _diffuse(reader: SurfaceReader, node: Node) -> Surface:
    colour = reader.textures.colour(node, "reflectance", DEFAULT_COLOUR)
    return reader.with_colour(colour, matte("", (1, 1, 1)))


def _plastic(reader: SurfaceReader, node: Node) -> Surface:
    colour = reader.textures.colour(node, "diffuse_reflectance", DEFAULT_COLOUR)
    eta, inverted = _relative_index(reader, node, "polypropylene", "air")
    alpha, rough = _alpha(reader, node, smooth="rough" not in node.plugin)
    _note_specular(reader, node)
    if not node.get("nonlinear", False):
        # Mitsuba divides by 1 - r, not by 1 - albedo r; this is the albedo that looks the same here.
        if colour.image is None:
            red, green, blue = albedo_beneath(np.array(colour.factor), eta).tolist()
            colour = dataclasses.replace(colour, factor=(red, green, blue))
        else:
            image = mapped(colour.image, functools.partial(albedo_beneath, eta=eta))
            colour = dataclasses.replace(colour, image=image)
        text = "the albedo beneath these plastics is changed so that they look as with nonlinear = false"
        node.scene.notes.group(text, reader.label)
    material = Material("", alpha=alpha, eta=eta, coupled=True)
    return reader.with_number(
        node, reader.with_colour(colour, material, inverted=inverted), rough, "metallic_roughness_texture"
    )


def _conductor(reader: SurfaceReader, node: Node) -> Surface:
    colour = reader.textures.colour(node, "specular_reflectance", (1.0, 1.0, 1.0))
    alpha, rough = _alpha(reader, node, smooth="rough" not in node.plugin)
    surface = reader.with_colour(
        colour, Material("", metallic=1.0, alpha=alpha, conductor=_complex_index(reader, node))
    )
    return reader.with_number(node, surface, rough, "metallic_roughness_texture")


def _dielectric(reader: SurfaceReader, node: Node) -> Surface:
    colour = reader.textures.colour(node, "specular_transmittance", (1.0, 1.0, 1.0))
    eta, inverted = _relative_index(reader, node, "bk7", "air")
    alpha, rough = _alpha(reader, node, smooth="rough" not in node.plugin)
    _note_specular(reader, node)
    thin = node.plugin == "thindielectric"
    material = Material("", alpha=alpha, eta=eta, transmission=1.0, thin=thin)
    surface = reader.with_colour(colour, material, inverted=inverted and not thin, two_sided=True)
    return reader.with_number(node, surface, rough, "metallic_roughness_texture")


def _two_sided(reader: SurfaceReader, node: Node) -> Surface:
    inner = node.children("BSDF")
    if len(inner) > 1 and inner[0].index != inner[1].index:
        node.scene.notes.group("the back of these materials is not read; it looks like the front", reader.label)
    return dataclasses.replace(reader.nested(node), two_sided=True)


def _mask(reader: SurfaceReader, node: Node) -> Surface:
    surface, opacity = reader.nested(node), reader.textures.number(node, "opacity", 0.5)
    if opacity.image is None:
        cut = min(max(opacity.mean, 0.0), 1.0)
        return dataclasses.replace(surface, material=surface.material.replace(opacity=surface.material.opacity * cut))
    rgba = np.full_like(opacity.image.rgba, 255)
    rgba[..., 3] = opacity.image.rgba[..., 0]
    image = dataclasses.replace(opacity.image, rgba=rgba)
    return reader.with_number(node, surface, dataclasses.replace(opacity, image=image), "opacity_texture")


def _normal_map(reader: SurfaceReader, node: Node) -> Surface:
    return reader.with_number(node, reader.nested(node), reader.textures.linear(node, "normalmap"), "normal_texture")


def _bump_map(reader: SurfaceReader, node: Node) -> Surface:
    node.scene.notes.group("bump maps are ignored", reader.label)
    return reader.nested(node)


def _blend(reader: SurfaceReader, node: Node) -> Surface:
    inner = [reader.read(child) for child in node.children("BSDF")]
    weight = reader.textures.number(node, "weight", 0.5)
    share = weight.mean if weight.image is None else float(weight.image.rgba[..., 0].mean()) / 255
    node.scene.notes.group("of these blends only the heavier material is shown", reader.label)
    return inner[int(share > 0.5)] if len(inner) == 2 else reader.nested(node)


def _principled(reader: SurfaceReader, node: Node) -> Surface:
    found = principled(reader.textures, node, reader.label)
    surface = reader.with_colour(found.colour, found.material, two_sided=found.material.transmission > 0)
    return reader.with_number(node, surface, found.metallic_roughness, "metallic_roughness_texture")


def _null(reader: SurfaceReader, node: Node) -> Surface:
    return Surface(matte("", (0, 0, 0)), two_sided=True, invisible=True)


def _unknown(reader: SurfaceReader, node: Node) -> Surface:
    if node.children("BSDF"):
        node.scene.notes.group(f"{node.plugin} is ignored; the material beneath it is shown", reader.label)
        return reader.nested(node)
    node.scene.notes.group(f"{node.plugin} is not known here; a matte surface of its colour is shown", reader.label)
    keys = [key for key in ("diffuse_reflectance", "reflectance", "base_color") if key in node]
    colour = reader.textures.colour(node, keys[0] if keys else "reflectance", DEFAULT_COLOUR)
    return reader.with_colour(colour, matte("", (1, 1, 1)))


_MAKERS: dict[str, Callable[[SurfaceReader, Node], Surface]] = {
    "diffuse": _diffuse,
    "plastic": _plastic,
    "roughplastic": _plastic,
    "conductor": _conductor,
    "roughconductor": _conductor,
    "dielectric": _dielectric,
    "roughdielectric": _dielectric,
    "thindielectric": _dielectric,
    "principled": _principled,
    "principledthin": _principled,
    "twosided": _two_sided,
    "mask": _mask,
    "normalmap": _normal_map,
    "bumpmap": _bump_map,
    "blendbsdf": _blend,
    "null": _null,
}


def _relative_index(reader: SurfaceReader, node: Node, inside: str, outside: str) -> tuple[float, bool]:
    """Index of the denser side over that of the other, and True if the denser side is the outside."""
    given = {key: node.get(key, default) for key, default in (("int_ior", inside), ("ext_ior", outside))}
    if any(isinstance(value, str) for value in given.values()):
        dielectric = loaded(node, {"type": "dielectric", **given})
        ratio = float(node.scene.mi.traverse(dielectric)["eta"])
    else:
        ratio = node.number("int_ior", 1.5) / node.number("ext_ior", 1.0)
    if not math.isfinite(ratio) or ratio <= 0:
        node.scene.notes.group("the index of refraction is not a positive number; 1.5 is used", reader.label)
        return 1.5, False
    return (ratio, False) if ratio >= 1 else (1 / ratio, True)


def _complex_index(reader: SurfaceReader, node: Node) -> tuple[Triple, Triple]:
    """Index of refraction eta + i k; that of copper if nothing is said, as in Mitsuba."""
    if "eta" in node or "k" in node:
        textures = [reader.textures.colour(node, key, (0.0, 0.0, 0.0), meaning="index") for key in ("eta", "k")]
        if any(texture.image is not None for texture in textures):
            node.scene.notes.group("textures of eta and k are ignored", reader.label)
        return textures[0].factor, textures[1].factor
    material = str(node.get("material", "Cu"))
    parameters = node.scene.mi.traverse(loaded(node, {"type": "conductor", "material": material}))
    eta, k = (np.broadcast_to(np.asarray(parameters[f"{key}.value"], np.float64), 3).tolist() for key in ("eta", "k"))
    return (eta[0], eta[1], eta[2]), (k[0], k[1], k[2])


def _alpha(reader: SurfaceReader, node: Node, *, smooth: bool) -> tuple[float, Texture]:
    """GGX width, and the image that varies it."""
    if smooth:
        return 0.0, Texture()
    distribution = str(node.get("distribution", "beckmann"))
    if distribution != "ggx":
        text = (
            "GGX of the same alpha takes the place of the distribution {} (tails of highlights are longer and their "
            "peaks lower)"
        )
        node.scene.notes.group(text.format(distribution), reader.label)
    if "alpha_u" in node or "alpha_v" in node:
        u, v = (reader.textures.number(node, key, 0.1).mean for key in ("alpha_u", "alpha_v"))
        if u != v:
            text = "these anisotropic materials get the geometric mean of alpha_u and alpha_v"
            node.scene.notes.group(text, reader.label)
        return _unit(math.sqrt(max(u * v, 0.0))), Texture()
    alpha = reader.textures.number(node, "alpha", 0.1)
    if alpha.image is None:
        return _unit(alpha.mean), Texture()
    rough = np.sqrt(alpha.image.rgba[..., 1:2] / 255)
    rgba = np.concatenate([np.full_like(rough, 255), np.round(255 * rough)], -1)
    rgba = np.concatenate([rgba, np.full((*rgba.shape[:2], 2), 255)], -1).astype(np.uint8)
    return 1.0, dataclasses.replace(alpha, image=dataclasses.replace(alpha.image, rgba=rgba))


def _unit(value: float) -> float:
    return min(max(value, 0.0), 1.0)


def _note_specular(reader: SurfaceReader, node: Node) -> None:
    if "specular_reflectance" in node:
        found = reader.textures.colour(node, "specular_reflectance", (1.0, 1.0, 1.0))
        if found.image is not None or found.factor != (1.0, 1.0, 1.0):
            node.scene.notes.group("specular_reflectance is ignored; it counts as 1", reader.label)
