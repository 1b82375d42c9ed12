"""Mitsuba scene files (XML) -> `Description`.

Needs the package mitsuba, which parses and upgrades the file and loads its meshes. Shapes become parts, one per shape,
with the shape's area light in their material; sensors become cameras. Order: shapes, lights, sensors, notes.
"""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxrefl._types import Camera
from jaxrefl.scene.description import Description, Part, PunctualLight, Sky, matte
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.export_shapes import OTHER_SIDE
from jaxrefl.scene.materials import unique_names
from jaxrefl.scene.mitsuba_bsdfs import DEFAULT_COLOUR, Surface, SurfaceReader
from jaxrefl.scene.mitsuba_cameras import read_camera
from jaxrefl.scene.mitsuba_lights import read_light, read_sky
from jaxrefl.scene.mitsuba_nodes import MitsubaFile, Node, open_scene
from jaxrefl.scene.mitsuba_shapes import Geometry, geometry
from jaxrefl.scene.mitsuba_textures import TextureReader
from jaxrefl.scene.normals import repaired_normals
from jaxrefl.scene.parts import gathered
from jaxrefl.scene.tangents import vertex_tangents

_ONE_SIDED = "these materials have a black back in Mitsuba (no twosided around them); here both sides look alike"


def describe_mitsuba(path: Path) -> Description:
    """The scene in a Mitsuba file.

    Args:
        path: An `.xml` file of the versions 0.5, 0.6, 2 or 3.
    Returns:
        The description, in world space; materials are named by the ids of their BSDFs.
    Raises:
        SceneError: If Mitsuba is not installed, the file is broken, or a mesh or environment map is missing.
    Edge cases: what Mitsuba itself would refuse as unused is ignored; unknown shapes are left out, unknown materials
        are matte, each with a note.
    """
    with open_scene(path) as file:
        reader = _Reader(file)
        for node in file.root.children("Shape"):
            reader.add_shape(node, np.eye(4))
        for node in file.root.children("Emitter"):
            reader.add_emitter(node)
        cameras: dict[str, Camera] = {}
        for i, node in enumerate(file.root.children("Sensor")):
            camera = read_camera(node)
            if camera is not None:
                cameras[node.name or f"camera {i}"] = camera
        parts = _with_both_sides(reader.parts)
        names = unique_names([part.name for part in parts])
        parts = [dataclasses.replace(part, name=name) for part, name in zip(parts, names, strict=True)]
        return Description(
            path.stem if path.stem != "scene" else path.absolute().parent.name,
            parts,
            lights=reader.lights,
            sky=reader.sky,
            cameras=cameras,
            notes=file.notes.sentences(),
        )


@dataclass
class _Reader:
    """Collects what the nodes of one file become."""

    file: MitsubaFile
    parts: list[Part] = field(default_factory=list)
    lights: list[PunctualLight] = field(default_factory=list)
    sky: Sky | None = None

    def __post_init__(self) -> None:
        self.textures = TextureReader()
        self.surfaces = SurfaceReader(self.textures)

    def add_shape(self, node: Node, world: np.ndarray) -> None:
        """Add the part or, for an instance, the parts of a shape, moved by `world`."""
        if node.plugin in ("shapegroup", "merge"):
            # A group shows up only through its instances.
            for child in node.children("Shape") if node.plugin == "merge" else []:
                self.add_shape(child, world)
            return
        if node.plugin == "instance":
            for group in node.children("Shape"):
                for child in group.children("Shape"):
                    self.add_shape(child, world @ node.matrix())
            return
        surface = self._surface(node)
        if surface.invisible and np.max(surface.material.emission) == 0:
            self.file.notes.group("shapes that only bound a medium (null) are left out", node.name or node.place)
            return
        found = geometry(node, attribute=surface.attribute)
        if found is None:
            return
        found = found.flipped() if surface.inverted else found
        found = found if np.array_equal(world, np.eye(4)) else found.moved(world)
        self.parts.append(_part(node, found, surface))

    def add_emitter(self, node: Node) -> None:
        """Add a light that has no shape."""
        light = read_light(self.textures, node)
        if light is not None:
            self.lights.append(light)
            return
        sky = read_sky(self.textures, node)
        if sky is None:
            self.file.notes.group(f"emitters of the type {node.plugin} are ignored", node.name or node.place)
        self.sky = sky or self.sky

    def _surface(self, node: Node) -> Surface:
        """The shape's material with the light it emits, under the name of the BSDF or else of the shape."""
        bsdfs, emitters = node.children("BSDF"), node.children("Emitter")
        # What only emits reflects nothing: so Mitsuba has it.
        default = (0.0, 0.0, 0.0) if emitters else DEFAULT_COLOUR
        surface = self.surfaces.read(bsdfs[0]) if bsdfs else Surface(matte("", default))
        name = surface.material.name or _shape_name(node)
        surface = dataclasses.replace(surface, material=surface.material.replace(name=name))
        if not surface.two_sided and not emitters:
            self.file.notes.group(_ONE_SIDED, name)
        if node.child("exterior") is not None:
            self.file.notes.group("the medium outside is ignored", name)
        surface = self._with_absorption(node, surface)
        return self._with_emission(node, surface, emitters[0]) if emitters else surface

    def _with_absorption(self, node: Node, surface: Surface) -> Surface:
        """The surface with what a homogeneous medium inside absorbs."""
        medium, name = node.child("interior"), surface.material.name
        if medium is None:
            return surface
        if medium.plugin != "homogeneous" or surface.material.transmission == 0 or surface.material.thin:
            self.file.notes.group("media are ignored, but for homogeneous ones inside glass", name)
            return surface
        scale = medium.number("scale", 1.0)
        if "sigma_a" in medium:
            absorption = np.array(self.textures.colour(medium, "sigma_a", (0, 0, 0), meaning="index").factor)
            scatters = "sigma_s" in medium
        else:
            total = self.textures.colour(medium, "sigma_t", (1, 1, 1), meaning="index").factor
            albedo = np.array(self.textures.colour(medium, "albedo", (0.75, 0.75, 0.75)).factor)
            absorption, scatters = np.array(total) * (1 - albedo), bool(albedo.any())
        if scatters:
            self.file.notes.group("the media inside these absorb but do not scatter here", name)
        red, green, blue = (scale * absorption).tolist()
        return dataclasses.replace(surface, material=surface.material.replace(attenuation=(red, green, blue)))

    def _with_emission(self, node: Node, surface: Surface, emitter: Node) -> Surface:
        if emitter.plugin != "area":
            self.file.notes.group(f"emitters of the type {emitter.plugin} are ignored", node.name or node.place)
            return surface
        light = self.textures.colour(emitter, "radiance", (1.0, 1.0, 1.0), meaning="emission")
        red, green, blue = (max(c, 0.0) for c in light.factor)
        material = surface.material.replace(emission=(red, green, blue), emits_back=False)
        surface = dataclasses.replace(surface, material=material)
        return self.surfaces.with_number(emitter, surface, light, "emission_texture")


def _with_both_sides(parts: list[Part]) -> list[Part]:
    """The parts without those that `export_mitsuba` added for the backs of emissive ones, which shine both ways."""
    names = {part.name for part in parts}
    shown = [p for p in parts if not (p.name.endswith(OTHER_SIDE) and p.name.removesuffix(OTHER_SIDE) in names)]
    return [
        dataclasses.replace(p, material=p.material.replace(emits_back=True)) if p.name + OTHER_SIDE in names else p
        for p in shown
    ]


def _part(node: Node, found: Geometry, surface: Surface) -> Part:
    uv = found.uv
    if uv is not None and surface.to_uv is not None:
        uv = uv @ surface.to_uv[:2, :2].T + surface.to_uv[:2, 2]
    values: dict[str, Any] = {"normals": found.normals, "uv": uv, "colours": found.colours}
    part = Part(_shape_name(node), found.vertices, found.faces, surface.material, **values)
    return part if surface.material.normal_texture is None or uv is None else _with_tangents(part, uv)


def _with_tangents(part: Part, uv: np.ndarray) -> Part:
    """The part with Mitsuba's tangent frames: along growing u, with the bitangent always at cross(normal, tangent)."""
    if part.normals is None:
        raise SceneError(f"object {part.name!r}: expected normals")
    normals, _ = repaired_normals(part.vertices, part.faces, part.normals)
    faces, source, tangents = vertex_tangents(part.vertices, part.faces, normals, uv)
    tangents = np.concatenate([tangents[:, :3], np.ones((len(tangents), 1))], 1)
    return dataclasses.replace(gathered(part, faces, source), tangents=tangents)


def _shape_name(node: Node) -> str:
    filename = node.get("filename", None)
    return node.name or (node.plugin if filename is None else Path(str(filename)).stem)
