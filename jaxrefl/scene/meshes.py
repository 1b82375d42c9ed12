"""Parts -> one mesh: common attributes for all, tangents where normal maps need them, one list of triangles.

Input: checked `Part`s (NumPy, see `parts.py`). Output: `Merged`, whose arrays `assemble` hands to JAX.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from jaxrefl.scene.description import Part
from jaxrefl.scene.normals import face_normals, repaired_normals
from jaxrefl.scene.parts import gathered
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
        normals, broken = repaired_normals(part.vertices, part.faces, part.normals)
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
    if part.normals is None:
        part = _unshared(part)
    normals, uv = np.asarray(part.normals), np.asarray(part.uv)
    faces, source, tangents = vertex_tangents(part.vertices, part.faces, normals, uv)
    return dataclasses.replace(gathered(part, faces, source), tangents=tangents)


def _unshared(part: Part) -> Part:
    """The part with three vertices of its own per triangle and the face normal at each."""
    source = part.faces.reshape(-1)
    normals, _ = face_normals(part.vertices, part.faces)
    faces = np.arange(source.size).reshape(-1, 3)
    return dataclasses.replace(gathered(part, faces, source), normals=np.repeat(normals, 3, axis=0))


def _uses_texture(part: Part) -> bool:
    m = part.material
    colours = (m.base_colour_texture, m.emission_texture, m.opacity_texture)
    return any(image is not None for image in (*colours, m.metallic_roughness_texture, m.normal_texture))


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
