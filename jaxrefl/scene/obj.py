"""Wavefront OBJ files -> `Description`: positions, normals, texture coordinates, vertex colours, groups and materials.

trimesh misreads relative (negative) indices and reads one material library only, so the text is read here, with array
operations per kind of line. Texture coordinates are turned around: OBJ counts v from the bottom of the image.

Source: "Object Files (.obj)", Advanced Visualizer manual, appendix B1 (Wavefront Technologies).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxrefl.scene.description import Description, Material, Part, matte
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.mtl import read_mtl
from jaxrefl.scene.vertex_colours import linear_from_stored

DEFAULT_MATERIAL = matte("default", (0.8, 0.8, 0.8))
"""What surfaces without a material are made of: a matte light grey."""

_KNOWN = {"v", "vt", "vn", "f", "o", "g", "s", "usemtl", "mtllib"}
_REST = {0: "/0/0", 1: "/0", 2: ""}


@dataclass(frozen=True)
class _Lines:
    """The statements of a file: keyword, rest and line number of each."""

    keyword: np.ndarray
    rest: list[str]
    number: np.ndarray

    def rows(self, keyword: str) -> np.ndarray:
        return np.flatnonzero(self.keyword == keyword)


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
    lines = _statements(path)
    notes: list[str] = []
    for keyword in sorted(set(lines.keyword.tolist()) - _KNOWN):
        notes.append(f"{(lines.keyword == keyword).sum()} lines starting with {keyword!r} are ignored")
    positions, colours = _vectors(path, lines, "v", 3)
    texture, _ = _vectors(path, lines, "vt", 2)
    normal, _ = _vectors(path, lines, "vn", 3)
    corners, faces, owner = _triangles(path, lines, (len(positions), len(texture), len(normal)))
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


def _statements(path: Path) -> _Lines:
    text = path.read_bytes().decode("utf-8", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    raw = text.replace("\\\n", " ").replace("\t", " ").split("\n")
    pairs = [(i, *line.split("#", 1)[0].strip().partition(" ")) for i, line in enumerate(raw, 1)]
    pairs = [pair for pair in pairs if pair[1]]
    keyword = np.array([pair[1] for pair in pairs], dtype=np.str_)
    known = np.isin(keyword, sorted(_KNOWN))
    if len(pairs) and not known.any():
        raise SceneError(f"{path}: expected OBJ statements such as 'v 0 0 0', got {pairs[0][1][:40]!r}")
    return _Lines(keyword, [pair[3] for pair in pairs], np.array([pair[0] for pair in pairs], np.int64))


def _vectors(path: Path, lines: _Lines, keyword: str, columns: int) -> tuple[np.ndarray, np.ndarray | None]:
    """The vectors [n columns] after a keyword and, where each has six numbers or more, linear colours [n 3]."""
    rows = lines.rows(keyword)
    values = []
    for row in rows:
        try:
            values.append([float(token) for token in lines.rest[row].split()])
        except ValueError as error:
            raise SceneError(f"{path}: line {lines.number[row]}: {error}") from error
        if len(values[-1]) < columns:
            raise SceneError(
                f"{path}: line {lines.number[row]}: expected {columns} numbers after {keyword!r}, got {len(values[-1])}"
            )
    vectors = np.array([value[:columns] for value in values], np.float64).reshape(-1, columns)
    if not values or min(map(len, values)) < 6:
        return vectors, None
    return vectors, linear_from_stored(np.array([value[-3:] for value in values]))


def _triangles(path: Path, lines: _Lines, sizes: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners [n 3] as 0-based (v, vt, vn) with -1 for none, triangles [f 3] of corners, and the face line of each."""
    rows = lines.rows("f")
    split = [lines.rest[row].split() for row in rows]
    count = np.array([len(refs) for refs in split], np.int64)
    for row in rows[count < 3]:
        raise SceneError(f"{path}: line {lines.number[row]}: expected a face of at least 3 vertices: {lines.rest[row]}")
    line = np.repeat(np.arange(len(rows)), count)
    try:
        text = "/".join([ref + _REST[ref.count("/")] for refs in split for ref in refs])
        flat = [int(token) if token else 0 for token in text.split("/")] if text else []
        index = np.array(flat, np.int64).reshape(-1, 3)
    except (KeyError, ValueError) as error:
        raise SceneError(f"{path}: broken face: expected vertex/texture/normal numbers ({error})") from error
    for column, keyword in enumerate(("v", "vt", "vn")):
        defined = np.cumsum(lines.keyword == keyword)[rows][line]  # how many stand above the face
        given = index[:, column]
        resolved = np.where(given < 0, defined + given, given - 1)
        wrong = (given != 0) & ((resolved < 0) | (resolved >= sizes[column]))
        wrong |= (given == 0) & (keyword == "v")
        if wrong.any():
            first = int(np.flatnonzero(wrong)[0])
            raise SceneError(
                f"{path}: line {lines.number[rows[line[first]]]}: {keyword} index {given[first]} is out of range: "
                f"expected 1 to {sizes[column]} or -{defined[first]} to -1 ({int(wrong.sum())} such indices)"
            )
        index[:, column] = np.where(given == 0, -1, resolved)
    start = np.cumsum(count) - count
    fan = np.maximum(count - 2, 0)
    owner = np.repeat(np.arange(len(rows)), fan)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(fan) - fan, fan)
    first = start[owner]
    return index, np.stack([first, first + step + 1, first + step + 2], 1), owner


def _named_state(lines: _Lines, keyword: str, default: str) -> tuple[list[str], np.ndarray]:
    """The distinct names after a keyword, and for each statement the number of the one that is in force."""
    rows = lines.rows(keyword)
    given = [lines.rest[row].strip() or default for row in rows]
    number = {name: i for i, name in enumerate(dict.fromkeys([default, *given]))}
    values = np.array([0] + [number[name] for name in given], np.int64)
    return list(number), values[np.cumsum(lines.keyword == keyword)]


def _materials(path: Path, lines: _Lines, notes: list[str]) -> dict[str, Material]:
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
