"""One row of the material table -> Mitsuba BSDF elements, with a note for whatever is approximated.

Wrappers, from the outside: mask (opacity), twosided (unless light passes), normalmap, and the surface itself: diffuse,
plastic, conductor, dielectric, a blend of two of them, or principled where roughness and metalness vary.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxrefl._types import Materials
from jaxrefl.scene.conductor_fit import fitted_conductor
from jaxrefl.scene.export_files import TextureFiles
from jaxrefl.scene.notes import Notes
from jaxrefl.scene.plastic import albedo_beneath
from jaxrefl.scene.srgb_bytes import as_bytes, linear_from_srgb, srgb_from_linear

COLOURS = "vertex_color"
"""Name of the mesh attribute that holds vertex colours."""


def element(parent: ET.Element | None, tag: str, **attributes: object) -> ET.Element:
    """A new XML element; numbers get nine digits, which keep a float32."""
    values = {k: f"{v:.9g}" if isinstance(v, float) else str(v) for k, v in attributes.items()}
    return ET.Element(tag, values) if parent is None else ET.SubElement(parent, tag, values)


def rgb(parent: ET.Element, name: str, colour: np.ndarray) -> ET.Element:
    """A constant colour."""
    return element(parent, "rgb", name=name, value=", ".join(f"{float(c):.9g}" for c in colour))


def bitmap(parent: ET.Element, name: str, filename: str, *, wrap: str, raw: bool) -> ET.Element:
    """A bitmap texture."""
    texture = element(parent, "texture", type="bitmap", name=name)
    element(texture, "string", name="filename", value=filename)
    element(texture, "boolean", name="raw", value=str(raw).lower())
    element(texture, "string", name="wrap_mode", value=wrap)
    return texture


@dataclass
class BsdfWriter:
    """Writes the materials of one scene."""

    materials: Materials
    names: tuple[str, ...]
    files: TextureFiles
    notes: Notes
    tinted: frozenset[int] = frozenset()
    """Materials whose meshes have vertex colours."""
    mirrored: frozenset[int] = frozenset()
    """Materials with a normal map on triangles whose texture runs the other way round."""

    def write(self, parent: ET.Element, row: int, *, id: str) -> None:
        """Add the BSDF of a material.

        Args:
            parent: Receives the element.
            row: Row in the material table.
            id: Its id.
        """
        m = self.materials
        outer = parent
        if m.opacity is not None and (float(m.opacity[row]) < 1 or self._texture(row, "opacity_texture") >= 0):
            outer = element(outer, "bsdf", type="mask")
            self._opacity(outer, row)
        if float(m.transmission[row]) == 0:
            outer = element(outer, "bsdf", type="twosided")
        if self._texture(row, "normal_texture") >= 0:
            outer = element(outer, "bsdf", type="normalmap")
            self._normal_map(outer, row)
        self._surface(outer, row)
        parent[-1].set("id", id)

    def emission(self, parent: ET.Element, row: int) -> None:
        """Add the area light of an emissive material to a shape."""
        emitter = element(parent, "emitter", type="area")
        colour, image = np.asarray(self.materials.emission[row], np.float64), self._texture(row, "emission_texture")
        if image < 0:
            rgb(emitter, "radiance", colour)
            return
        values = linear_from_srgb(self.files.texels(image)[..., :3] / 255) * colour
        filename = self.files.write_exr(f"{self.names[row]}_emission", values)
        bitmap(emitter, "radiance", filename, wrap=self._wrap(row, image), raw=True)

    def _surface(self, parent: ET.Element, row: int) -> None:
        m = self.materials
        metallic, transmission = float(m.metallic[row]), float(m.transmission[row])
        packed = self._packed(row)
        if packed is not None and not (metallic == 1 and (packed[..., 2] == 255).all() and transmission == 0):
            self._principled(parent, row, packed)
            return
        layers: list[tuple[float, Callable[[ET.Element, int], None]]] = [
            (metallic, self._metal),
            ((1 - metallic) * transmission, self._glass),
            ((1 - metallic) * (1 - transmission), self._dielectric),
        ]
        layers = [(share, write) for share, write in layers if share > 0]
        while len(layers) > 1:  # a blend holds two; the rest goes into the second
            (share, write), rest = layers[0], sum(s for s, _ in layers[1:])
            parent = element(parent, "bsdf", type="blendbsdf")
            element(parent, "float", name="weight", value=rest / (share + rest))
            write(parent, row)
            layers = layers[1:]
        layers[0][1](parent, row)

    def _dielectric(self, parent: ET.Element, row: int) -> None:
        m = self.materials
        eta, alpha = float(m.eta[row]), float(m.alpha[row])
        if eta == 1:
            self._colour(element(parent, "bsdf", type="diffuse"), "reflectance", row)
            return
        plastic = element(parent, "bsdf", type="roughplastic" if alpha > 0 else "plastic")
        self._interface(plastic, row)
        element(plastic, "boolean", name="nonlinear", value="true")
        if m.coupled is not None and bool(m.coupled[row]):
            self._colour(plastic, "diffuse_reflectance", row)
            return
        self.notes.group(
            "plastics whose diffuse layer is not coupled to the interface get the albedo beneath it that returns the "
            "same share of the light that enters; diffuse light is a little darker towards grazing angles",
            self.names[row],
        )
        self._colour(plastic, "diffuse_reflectance", row, lambda colour: albedo_beneath(colour, eta))

    def _metal(self, parent: ET.Element, row: int) -> None:
        m, name = self.materials, self.names[row]
        alpha, packed = float(m.alpha[row]), self._packed(row)
        metal = element(parent, "bsdf", type="roughconductor" if alpha > 0 else "conductor")
        if packed is not None:
            values = as_bytes(alpha * (packed[..., 1] / 255.0) ** 2)
            filename, image = self.files.write_png(f"{name}_alpha", values), self._texture(row, _PACKED)
            bitmap(metal, "alpha", filename, wrap=self._wrap(row, image), raw=True)
        elif alpha > 0:
            element(metal, "float", name="alpha", value=alpha)
        if alpha > 0:
            element(metal, "string", name="distribution", value="ggx")
        base = np.asarray(m.base_colour[row], np.float64)
        if m.conductor is not None and bool(m.conductor.known[row]):
            rgb(metal, "eta", np.asarray(m.conductor.eta[row]))
            rgb(metal, "k", np.asarray(m.conductor.k[row]))
            self._colour(metal, "specular_reflectance", row)
        elif self._texture(row, "base_colour_texture") >= 0 or row in self.tinted:
            text = "metals with a textured colour do not become white towards grazing angles (eta 0, k 1)"
            self.notes.group(text, name)
            element(metal, "string", name="material", value="none")
            self._colour(metal, "specular_reflectance", row)
        else:
            found = np.array([fitted_conductor(float(f0)) for f0 in base])
            worst = float(found[:, 2].max())
            if worst > 0:
                text = "eta and k are fitted to Schlick's reflectance; the largest difference over the angle is {:.3f}"
                self.notes.group(text.format(worst), name)
            rgb(metal, "eta", found[:, 0])
            rgb(metal, "k", found[:, 1])

    def _glass(self, parent: ET.Element, row: int) -> None:
        m = self.materials
        alpha, thin = float(m.alpha[row]), bool(m.thin[row])
        alpha = 0.0 if float(m.eta[row]) == 1 else alpha  # no interface: nothing is scattered
        if thin and alpha > 0:
            self.notes.group("rough thin panes are smooth (thindielectric)", self.names[row])
        kind = "thindielectric" if thin else "roughdielectric" if alpha > 0 else "dielectric"
        glass = element(parent, "bsdf", type=kind)
        self._interface(glass, row, rough=kind.startswith("rough"))
        self._colour(glass, "specular_transmittance", row)

    def _principled(self, parent: ET.Element, row: int, packed: np.ndarray) -> None:
        m, name = self.materials, self.names[row]
        self.notes.group(
            "materials whose roughness or metalness varies become principled, whose diffuse part is brighter or darker "
            "towards grazing angles",
            name,
        )
        surface = element(parent, "bsdf", type="principled")
        transmission = float(m.transmission[row])
        # Light that passes takes the root of the colour there, and the colour itself here.
        self._colour(surface, "base_color", row, np.square if transmission == 1 else lambda x: x)
        wrap = self._wrap(row, self._texture(row, _PACKED))
        factors = (("roughness", float(np.sqrt(m.alpha[row])), 1), ("metallic", float(m.metallic[row]), 2))
        for key, factor, channel in factors:
            values = as_bytes(factor * packed[..., channel] / 255.0)
            if (values == values.flat[0]).all():
                element(surface, "float", name=key, value=float(factor * packed[0, 0, channel] / 255))
                continue
            filename = self.files.write_png(f"{name}_{key}", values)
            bitmap(surface, key, filename, wrap=wrap, raw=True)
        element(surface, "float", name="eta", value=max(float(m.eta[row]), 1.001))
        if transmission > 0:
            element(surface, "float", name="spec_trans", value=transmission)

    def _interface(self, parent: ET.Element, row: int, *, rough: bool = True) -> None:
        element(parent, "float", name="int_ior", value=float(self.materials.eta[row]))
        element(parent, "float", name="ext_ior", value=1.0)
        alpha = float(self.materials.alpha[row])
        if rough and alpha > 0:
            element(parent, "float", name="alpha", value=alpha)
            element(parent, "string", name="distribution", value="ggx")

    def _colour(
        self, parent: ET.Element, key: str, row: int, change: Callable[[np.ndarray], np.ndarray] = lambda x: x
    ) -> None:
        """Base colour: a constant, a texture with factor and change baked in, or vertex colours."""
        base, image = np.asarray(self.materials.base_colour[row], np.float64), self._texture(row, "base_colour_texture")
        if row in self.tinted and image < 0:
            element(element(parent, "texture", type="mesh_attribute", name=key), "string", name="name", value=COLOURS)
            if change(np.array(0.5)) != 0.5:
                self.notes.group("vertex colours are those outside the interface, not beneath it", self.names[row])
            return
        if row in self.tinted:
            self.notes.group("vertex colours on textured materials are ignored", self.names[row])
        if image < 0:
            rgb(parent, key, change(base))
            return
        texels = self.files.texels(image)[..., :3]
        levels = linear_from_srgb(np.arange(256) / 255)
        table = as_bytes(srgb_from_linear(change(levels[:, None] * base)))
        pixels = np.stack([table[texels[..., i], i] for i in range(3)], -1)
        filename = self.files.write_png(f"{self.names[row]}_colour", pixels)
        bitmap(parent, key, filename, wrap=self._wrap(row, image), raw=False)

    def _opacity(self, parent: ET.Element, row: int) -> None:
        m, image = self.materials, self._texture(row, "opacity_texture")
        opacity = 1.0 if m.opacity is None else float(m.opacity[row])
        if image < 0:
            element(parent, "float", name="opacity", value=opacity)
            return
        values = as_bytes(opacity * self.files.texels(image)[..., 3] / 255.0)
        filename = self.files.write_png(f"{self.names[row]}_opacity", values)
        bitmap(parent, "opacity", filename, wrap=self._wrap(row, image), raw=True)

    def _normal_map(self, parent: ET.Element, row: int) -> None:
        image, scale = self._texture(row, "normal_texture"), float(self.materials.normal_scale[row])
        pixels = self.files.texels(image)[..., :3]
        if scale != 1:
            n = (pixels / 127.5 - 1) * (scale, scale, 1)
            length = np.linalg.norm(n, axis=-1, keepdims=True)
            pixels = as_bytes((n / np.where(length > 0, length, 1) + 1) / 2)
        filename = self.files.write_png(f"{self.names[row]}_normals", np.ascontiguousarray(pixels))
        bitmap(parent, "normalmap", filename, wrap=self._wrap(row, image), raw=True)
        text = "normal maps tilt in frames that Mitsuba makes from the texture coordinates of each triangle"
        self.notes.group(text, self.names[row])
        if row in self.mirrored:
            text = "normal maps are wrong where the texture runs the other way round, as Mitsuba has no handedness"
            self.notes.group(text, self.names[row])

    def _packed(self, row: int) -> np.ndarray | None:
        """The metallic-roughness image, if the material has one."""
        image = self._texture(row, _PACKED)
        return None if image < 0 else self.files.texels(image)

    def _texture(self, row: int, column: str) -> int:
        rows = getattr(self.materials, column)
        return -1 if rows is None else int(rows[row])

    def _wrap(self, row: int, image: int) -> str:
        mode, same = self.files.wrap_mode(image)
        if not same:
            text = "textures that repeat in one direction only do in both, or in none (as in u)"
            self.notes.group(text, self.names[row])
        return mode


_PACKED = "metallic_roughness_texture"
