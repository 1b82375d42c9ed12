"""Wavefront OBJ files -> `Description`: positions, normals, texture coordinates, vertex colours, groups and materials.

trimesh misreads relative (negative) indices and reads one material library only, so the text is read here, with array
operations per kind of line. Texture coordinates are turned around: OBJ counts v from the bottom of the image.

Source: "Object Files (.obj)", Advanced Visualizer manual, appendix B1 (Wavefront Technologies).
"""

from pathlib import Path

import numpy as np

from jaxrefl.scene.description import Description, Material, Part, matte
from jaxrefl.scene.mtl import read_mtl
from jaxrefl.scene.obj_statements import KNOWN, Statements, read_statements, read_triangles, read_vectors
from jaxrefl.scene.vertex_colours import linear_from_stored

DEFAULT_MATERIAL = matte("default", (0.8, 0.8, 0.8))
"""What surfaces without a material are made of: a matte light grey."""


def describe_obj(path: Path) -> Description:
    """Everything in an OBJ file and the material libraries it names.

    Args:
        path: An `.obj` file.
    Returns:
        The description, in the file's own axes and units. Objects are named after `o`, or after `g` in a file without
        `o`, or after the file; each has one part per material.
    Raises:
        SceneError: If a number cannot be read or an index points outside the file; names the line.
    Edge cases: polygons are cut into a fan around their first vertex, which is right for convex ones. Faces without a
        material, or with one that no library defines, get a matte grey of 0.8 and a note. Six numbers after `v` are a
        position and a colour, taken as sRGB. Smoothing groups are not used: see `smooth_normals`.
    """
    lines = read_statements(path)
    notes: list[str] = []
    for keyword in sorted(set(lines.keyword.tolist()) - KNOWN):
        notes.append(f"{(lines.keyword == keyword).sum()} lines starting with {keyword!r} are ignored")
    positions, extra = read_vectors(lines, "v", 3)
    colours = None if extra is None or extra.shape[1] < 3 else linear_from_stored(extra[:, -3:])
    texture, _ = read_vectors(lines, "vt", 2)
    normal, _ = read_vectors(lines, "vn", 3)
    corners, faces, owner = read_triangles(lines, (len(positions), len(texture), len(normal)))
    if not len(normal) and len(lines.rows("s")):
        notes.append("smoothing groups (s) are ignored; normals are smooth up to the crease angle")
    objects, object_of = _named_state(lines, "o" if len(lines.rows("o")) else "g", path.stem)
    used, material_of = _named_state(lines, "usemtl", "")
    materials = _materials(path, lines, notes)
    rows = lines.rows("f")[owner]
    key = object_of[rows] * max(len(used), 1) + material_of[rows]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    parts = []
    for chunk in np.split(order, starts[1:]) if len(order) else []:
        row = rows[chunk[0]]
        material = _material(used[material_of[row]], materials, notes)
        arrays = _part_arrays(corners[faces[chunk]], positions, texture, normal, colours)
        parts.append(Part(objects[object_of[row]], material=material, **arrays))
    return Description(path.stem, parts, notes=list(dict.fromkeys(notes)))


def _named_state(lines: Statements, keyword: str, default: str) -> tuple[list[str], np.ndarray]:
    """The distinct names after a keyword, and for each statement the number of the one that is in force."""
    rows = lines.rows(keyword)
    given = [lines.rest[row].strip() or default for row in rows]
    number = {name: i for i, name in enumerate(dict.fromkeys([default, *given]))}
    values = np.array([0] + [number[name] for name in given], np.int64)
    return list(number), values[np.cumsum(lines.keyword == keyword)]


def _materials(path: Path, lines: Statements, notes: list[str]) -> dict[str, Material]:
    materials: dict[str, Material] = {}
    for row in lines.rows("mtllib"):
        whole = lines.rest[row].strip()
        for name in [whole] if (path.parent / whole).is_file() else whole.split():
            file = path.parent / name.replace("\\", "/")
            if file.is_file():
                materials |= read_mtl(file, notes)
            else:
                notes.append(f"material library {name!r} is missing")
    return materials


def _material(name: str, materials: dict[str, Material], notes: list[str]) -> Material:
    if not name:
        notes.append("surfaces without a material are matte grey (0.8)")
        return DEFAULT_MATERIAL
    if name not in materials:
        notes.append(f"material {name!r} is not defined; it is matte grey (0.8)")
        return DEFAULT_MATERIAL.replace(name=name)
    return materials[name]


def _part_arrays(
    triangles: np.ndarray,
    positions: np.ndarray,
    texture: np.ndarray,
    normal: np.ndarray,
    colours: np.ndarray | None,
) -> dict:
    """Arrays of one part from its corners [f 3 3]: one vertex per distinct (v, vt, vn)."""
    corner = triangles.reshape(-1, 3)
    key = np.unique(corner[:, 0] * (len(texture) + 1) + corner[:, 1] + 1, return_inverse=True)[1]
    key = key * (len(normal) + 1) + corner[:, 2] + 1
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    v, vt, vn = corner[first].T
    uv = normals = None
    if (vt >= 0).any():
        uv = np.where((vt >= 0)[:, None], texture[vt], 0.0) * [1, -1] + [0, 1]
    if (vn >= 0).any():
        normals = np.where((vn >= 0)[:, None], normal[vn], np.nan)  # the rest is repaired and counted by `merge`
    return {
        "vertices": positions[v],
        "faces": inverse.reshape(-1, 3),
        "uv": uv,
        "normals": normals,
        "colours": None if colours is None else colours[v],
    }
