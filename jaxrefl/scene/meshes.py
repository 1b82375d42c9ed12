"""Parts -> one `Mesh`: checks, removal of triangles that cannot be rendered, and merging.

Input: `Part`s of a `Description` (NumPy). Output: NumPy arrays gathered in `Merged`, which `assemble` hands to JAX.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from jaxrefl._validate import checked_array, checked_indices
from jaxrefl.scene.description import Part
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.normals import face_normals, repaired_normals
from jaxrefl.scene.tangents import any_orthogonal, vertex_tangents


@dataclass(frozen=True)
class Merged:
    """All triangles of a description; the fields mean what they mean in `jaxrefl.Mesh`."""

    vertices: np.ndarray
    faces: np.ndarray
    material: np.ndarray
    object: np.ndarray
    normals: np.ndarray | None
    uv: np.ndarray | None
    tangents: np.ndarray | None
    colours: np.ndarray | None


def checked_part(part: Part) -> Part:
    """A part whose arrays have the right shapes and whose indices point at its vertices.

    Args:
        part: Any part.
    Returns:
        The same part with positions in float64 and indices in int64.
    Raises:
        SceneError: If a shape is wrong, an index is out of range, or a position, texture coordinate or colour is NaN
            or infinite; names the object and the array.
    Edge cases: normals may be of any length, NaN and zero included; `merge` repairs them and counts.
    """
    v = len(part.vertices)
    try:
        return dataclasses.replace(
            part,
            vertices=checked_array("vertices", part.vertices, (None, 3)),
            faces=checked_indices("faces", part.faces, v),
            normals=_checked_attribute("normals", part.normals, (v, 3), finite=False),
            uv=_checked_attribute("uv", part.uv, (v, 2)),
            tangents=_checked_attribute("tangents", part.tangents, (v, 4)),
            colours=_checked_attribute("colours", part.colours, (v, 3)),
        )
    except ValueError as error:
        raise SceneError(f"object {part.name!r}: {error}") from error


def without_broken_triangles(part: Part, notes: list[str]) -> Part:
    """A part without the triangles that touch a NaN or infinite position; for data from files.

    Args:
        part: A part whose indices are in range.
        notes: Receives a sentence with the count if there are any.
    Returns:
        The part; bad positions, texture coordinates and colours are set to 0.
    """
    finite = np.isfinite(part.vertices).all(1)
    replaced = {}
    if not finite.all():
        keep = finite[part.faces].all(1)
        replaced = {"vertices": np.where(finite[:, None], part.vertices, 0.0), "faces": part.faces[keep]}
        notes.append(
            f"object {part.name!r}: {int((~finite).sum())} vertices are NaN or infinite; "
            f"left out {int((~keep).sum())} triangles that use them"
        )
    for name in ("uv", "colours"):
        values = getattr(part, name)
        if values is not None and not np.isfinite(values).all():
            bad = ~np.isfinite(values)
            notes.append(f"object {part.name!r}: {int(bad.any(1).sum())} {name} are NaN or infinite; set to 0")
            replaced[name] = np.where(bad, 0.0, values)
    return dataclasses.replace(part, **replaced) if replaced else part


def without_degenerate_triangles(part: Part, notes: list[str]) -> Part:
    """A part without the triangles that have no area, and without vertices that no triangle uses.

    Args:
        part: A checked part.
        notes: Receives a sentence with the count if there are any.
    Returns:
        The part; it may be empty.
    """
    vertices = part.vertices.astype(np.float32)
    _, areas = face_normals(vertices, part.faces)
    keep = areas > 0
    dropped = int((~keep).sum())
    if dropped:
        notes.append(f"object {part.name!r}: left out {dropped} of {len(keep)} triangles that have no area")
    used = np.zeros(len(vertices), bool)
    used[part.faces[keep].reshape(-1)] = True
    if not dropped and used.all():
        return part
    row = np.cumsum(used) - 1
    arrays = {name: getattr(part, name) for name in ("vertices", "normals", "uv", "tangents", "colours")}
    arrays = {name: None if array is None else array[used] for name, array in arrays.items()}
    return dataclasses.replace(part, faces=row[part.faces[keep]], **arrays)


def merge(
    parts: list[Part], material_rows: list[int], object_rows: list[int], notes: list[str], *, textured: bool
) -> Merged:
    """All parts as one mesh.

    Args:
        parts: Checked parts without degenerate triangles, none of them empty.
        material_rows: Row in the material table of each part.
        object_rows: Object number of each part.
        notes: Receives what was repaired.
        textured: True keeps texture coordinates.
    Returns:
        The merged arrays; what no part has, or nothing needs, is None.
    Edge cases: where some parts have normals and others do not, the flat ones get their own vertices per triangle with
        the face normal; textured parts without texture coordinates get (0, 0); parts without colours get white.
    """
    smooth = any(p.normals is not None for p in parts)
    mapped = [p.material.normal_texture is not None for p in parts]
    prepared = [_prepared(p, notes, smooth, any(mapped) and m) for p, m in zip(parts, mapped, strict=True)]
    offsets = np.cumsum([0] + [len(p.vertices) for p in prepared])
    faces = np.concatenate([p.faces + offset for p, offset in zip(prepared, offsets[:-1], strict=True)])
    counts = [len(p.faces) for p in prepared]
    return Merged(
        vertices=np.concatenate([p.vertices for p in prepared]).astype(np.float32),
        faces=faces.astype(np.int32),
        material=np.repeat(np.asarray(material_rows, np.int32), counts),
        object=np.repeat(np.asarray(object_rows, np.int32), counts),
        normals=_stacked(prepared, "normals", 3) if smooth else None,
        uv=_stacked(prepared, "uv", 2) if textured else None,
        tangents=_stacked_tangents(prepared) if any(mapped) else None,
        colours=_stacked(prepared, "colours", 3) if any(p.colours is not None for p in parts) else None,
    )


def _prepared(part: Part, notes: list[str], smooth: bool, needs_tangents: bool) -> Part:
    """One part with unit normals where any part has them, and with tangents where its normal map needs them."""
    if smooth and part.normals is None:
        part = _unshared(part)
    elif part.normals is not None:
        normals, _, broken = repaired_normals(part.vertices, part.faces, part.normals)
        if broken:
            notes.append(f"object {part.name!r}: {broken} normals are zero or NaN; replaced by the mean of their faces")
        part = dataclasses.replace(part, normals=normals)
    if part.uv is None and _uses_texture(part):
        notes.append(
            f"object {part.name!r}: its material {part.material.name!r} is textured but it has no texture "
            "coordinates; the texture's corner (0, 0) is used everywhere"
        )
    if not needs_tangents or part.uv is None:
        return dataclasses.replace(part, tangents=None)
    if part.tangents is not None:
        return part
    normals = part.normals if part.normals is not None else _unshared(part).normals
    if part.normals is None:
        part = _unshared(part)
    assert normals is not None
    faces, source, tangents = vertex_tangents(part.vertices, part.faces, normals, part.uv)
    return dataclasses.replace(_gathered(part, faces, source), tangents=tangents)


def _unshared(part: Part) -> Part:
    """The part with three vertices of its own per triangle and the face normal at each."""
    source = part.faces.reshape(-1)
    normals, _ = face_normals(part.vertices, part.faces)
    faces = np.arange(source.size).reshape(-1, 3)
    return dataclasses.replace(_gathered(part, faces, source), normals=np.repeat(normals, 3, axis=0))


def _gathered(part: Part, faces: np.ndarray, source: np.ndarray) -> Part:
    """The part with new faces whose vertices are copies of the `source` vertices."""
    names = ("normals", "uv", "tangents", "colours")
    arrays = {n: None if getattr(part, n) is None else getattr(part, n)[source] for n in names}
    return dataclasses.replace(part, vertices=part.vertices[source], faces=faces, **arrays)


def _uses_texture(part: Part) -> bool:
    m = part.material
    images = (m.base_colour_texture, m.metallic_roughness_texture, m.normal_texture, m.emission_texture)
    return any(image is not None for image in images)


def _stacked(parts: list[Part], name: str, columns: int) -> np.ndarray:
    fill = 1.0 if name == "colours" else 0.0
    arrays = [
        np.full((len(p.vertices), columns), fill) if getattr(p, name) is None else getattr(p, name) for p in parts
    ]
    return np.concatenate(arrays).astype(np.float32)


def _stacked_tangents(parts: list[Part]) -> np.ndarray:
    arrays = []
    for part in parts:
        if part.tangents is not None:
            arrays.append(part.tangents)
            continue
        n = part.normals if part.normals is not None else np.tile([0.0, 0.0, 1.0], (len(part.vertices), 1))
        arrays.append(np.concatenate([any_orthogonal(n), np.ones((len(n), 1))], 1))
    return np.concatenate(arrays).astype(np.float32)


def _checked_attribute(name: str, value: np.ndarray | None, shape: tuple, *, finite: bool = True) -> np.ndarray | None:
    return None if value is None else checked_array(name, value, shape, finite=finite)
