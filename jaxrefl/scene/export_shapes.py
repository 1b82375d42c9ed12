"""Triangles of a `Scene` -> PLY meshes and `<shape>` elements, one per object and material.

Mitsuba's area lights shine from the front alone: triangles that shine from both sides get a second, black mesh that
lies behind them and shines from there.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from jaxrefl._types import Mesh, Scene
from jaxrefl.scene.export_bsdfs import BsdfWriter, element, rgb
from jaxrefl.scene.export_files import file_name, write_ply
from jaxrefl.scene.materials import unique_names
from jaxrefl.scene.normals import face_normals

OTHER_SIDE = " (other side)"
"""End of the id of a mesh that stands for the back of another one."""

GAP = 1e-4
"""How far behind the front such a mesh lies, as a share of the scene's diagonal, so that rays can tell them apart."""


def coloured_materials(mesh: Mesh) -> frozenset[int]:
    """Materials on triangles whose vertex colours are not all white."""
    if mesh.colours is None:
        return frozenset()
    tinted = (np.asarray(mesh.colours) != 1).any(-1)[np.asarray(mesh.faces)].any(-1)
    return frozenset(np.unique(np.asarray(mesh.material)[tinted]).tolist())


def mirrored_materials(scene: Scene) -> frozenset[int]:
    """Materials with a normal map on triangles with tangents of negative handedness."""
    mesh = scene.mesh
    if mesh.tangents is None:
        return frozenset()
    mirrored = (np.asarray(mesh.tangents)[:, 3] < 0)[np.asarray(mesh.faces)].any(-1)
    mapped = np.asarray(scene.materials.normal_texture)[np.asarray(mesh.material)] >= 0
    return frozenset(np.unique(np.asarray(mesh.material)[mirrored & mapped]).tolist())


def plain_id(name: str) -> str:
    """An id that Mitsuba accepts: not empty, and without dots, which separate the parts of parameter names there."""
    return name.replace(".", "_") or "unnamed"


def write_shapes(root: ET.Element, scene: Scene, folder: Path, writer: BsdfWriter, ids: list[str]) -> list[str]:
    """Write all meshes and add their elements.

    Args:
        root: The scene element.
        scene: The scene.
        folder: Folder of the scene file.
        writer: Writes emission.
        ids: Ids of all materials.
    Returns:
        Ids of the shapes: names of the objects, with a number where a material or another shape has that name.
    Raises:
        OSError: If a file cannot be written.
    """
    mesh, count = scene.mesh, len(scene.names.materials)
    owner, material = np.asarray(mesh.object, np.int64), np.asarray(mesh.material, np.int64)
    pairs, group = np.unique(owner * count + material, return_inverse=True)
    order = np.argsort(group, kind="stable")
    bounds = np.searchsorted(group[order], np.arange(len(pairs) + 1))
    objects = [plain_id(scene.names.objects[pair // count]) for pair in pairs.tolist()]
    names = unique_names([*ids, *objects])[count:]
    taken: set[str] = set()
    for i, (pair, name) in enumerate(zip(pairs.tolist(), names, strict=True)):
        rows = np.sort(order[bounds[i] : bounds[i + 1]])
        _write_shape(root, scene, folder, writer, rows, name, ids[pair % count], file_name(name, taken))
    return names


def _write_shape(
    root: ET.Element, scene: Scene, folder: Path, writer: BsdfWriter, rows: np.ndarray, name: str, bsdf: str, file: str
) -> None:
    materials, mesh = scene.materials, scene.mesh
    row = int(mesh.material[int(rows[0])])
    arrays = _part(mesh, rows, np.asarray(materials.base_colour[row], np.float64) if row in writer.tinted else None)
    write_ply(folder / "meshes" / f"{file}.ply", **arrays)
    shape = _shape(root, name, f"{file}.ply", flat=mesh.normals is None)
    element(shape, "ref", id=bsdf)
    attenuation = np.asarray(materials.attenuation[row], np.float64)
    if attenuation.any() and float(materials.transmission[row]) > 0 and not bool(materials.thin[row]):
        medium = element(shape, "medium", type="homogeneous", name="interior")
        rgb(medium, "sigma_t", attenuation)
        element(medium, "float", name="albedo", value=0.0)
    if not bool((np.asarray(materials.emission[row]) > 0).any()):
        return
    writer.emission(shape, row)
    if materials.emits_back is not None and not bool(materials.emits_back[row]):
        return
    text = "triangles that shine from both sides have a black mesh {:g} of the diagonal behind them for their back"
    writer.notes.group(text.format(GAP), name)
    diagonal = float(np.linalg.norm(np.asarray(scene.upper) - np.asarray(scene.lower)))
    write_ply(folder / "meshes" / f"{file}.back.ply", **_turned(arrays, GAP * diagonal))
    back = _shape(root, name + OTHER_SIDE, f"{file}.back.ply", flat=True)
    rgb(element(back, "bsdf", type="diffuse"), "reflectance", np.zeros(3))
    writer.emission(back, row)


def _shape(root: ET.Element, name: str, filename: str, *, flat: bool) -> ET.Element:
    shape = element(root, "shape", type="ply", id=name)
    element(shape, "string", name="filename", value=f"meshes/{filename}")
    if flat:
        element(shape, "boolean", name="face_normals", value="true")
    return shape


def _part(mesh: Mesh, rows: np.ndarray, tint: np.ndarray | None) -> dict[str, np.ndarray]:
    """Arrays of some triangles, with the vertices they use; vertex colours, times `tint`, where they are wanted."""
    used, faces = np.unique(np.asarray(mesh.faces)[rows], return_inverse=True)
    arrays = {"vertices": np.asarray(mesh.vertices)[used], "faces": faces.reshape(-1, 3)}
    for name in ("normals", "uv"):
        values = getattr(mesh, name)
        if values is not None:
            arrays[name] = np.asarray(values)[used]
    if tint is not None and mesh.colours is not None:
        arrays["colours"] = np.asarray(mesh.colours)[used] * tint
    return arrays


def _turned(arrays: dict[str, np.ndarray], gap: float) -> dict[str, np.ndarray]:
    """The triangles turned around and moved backwards, each with vertices of its own."""
    normals, _ = face_normals(arrays["vertices"], arrays["faces"])
    source = arrays["faces"].reshape(-1)
    moved = arrays["vertices"][source] - gap * np.repeat(normals, 3, 0)
    turned = {"vertices": moved, "faces": np.arange(source.size).reshape(-1, 3)[:, ::-1]}
    return turned | ({"uv": arrays["uv"][source]} if "uv" in arrays else {})
