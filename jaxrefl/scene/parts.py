"""Checks and repairs of single parts, before they are merged into one mesh.

Input and output: `Part`s of a `Description` (NumPy). What was left out or added is counted in a note.
"""

import dataclasses

import numpy as np

from jaxrefl._validate import checked_array, checked_indices
from jaxrefl.scene.description import Part
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.normals import FLAT_COSINE, face_normals, smooth_normals

LARGEST = 1e18
"""Largest coordinate: beyond it squares of lengths leave the range of float32."""


def checked_part(part: Part) -> Part:
    """A part whose arrays have the right shapes and whose indices point at its vertices.

    Args:
        part: Any part.
    Returns:
        The same part with positions in float64 and indices in int64.
    Raises:
        SceneError: If a shape is wrong, an index is out of range, or a position, texture coordinate or colour is NaN
            or infinite or a position beyond 1e18; names the object and the array.
    Edge cases: normals may be of any length, NaN and zero included; `merge` repairs them and counts.
    """
    v = len(part.vertices)
    try:
        vertices = checked_array("vertices", part.vertices, (None, 3))
        if (largest := np.abs(vertices).max(initial=0.0)) > LARGEST:
            raise ValueError(f"vertices: expected coordinates up to {LARGEST:g}, got {largest:g}; change the units")
        return dataclasses.replace(
            part,
            vertices=vertices,
            faces=checked_indices("faces", part.faces, v),
            normals=_checked_attribute("normals", part.normals, (v, 3), finite=False),
            uv=_checked_attribute("uv", part.uv, (v, 2)),
            tangents=_checked_attribute("tangents", part.tangents, (v, 4)),
            colours=_checked_attribute("colours", part.colours, (v, 3)),
        )
    except ValueError as error:
        raise SceneError(f"object {part.name!r}: {error}") from error


def without_broken_triangles(parts: list[Part], notes: list[str]) -> list[Part]:
    """Parts without the triangles that touch a NaN, infinite or huge position; for data from files.

    Args:
        parts: Parts whose indices are in range.
        notes: Receives the counts.
    Returns:
        The parts; bad positions, texture coordinates and colours are set to 0.
    """
    result, vertices, triangles, names = [], 0, 0, []
    for part in parts:
        finite = np.asarray((np.abs(part.vertices) <= LARGEST).all(axis=1))  # False for NaN
        if not finite.all():
            keep = np.asarray(finite[part.faces].all(axis=1))
            vertices, triangles = vertices + int((~finite).sum()), triangles + int((~keep).sum())
            names.append(part.name)
            part = dataclasses.replace(
                part, vertices=np.where(finite[:, None], part.vertices, 0.0), faces=part.faces[keep]
            )
        for name in ("uv", "colours"):
            values = getattr(part, name)
            if values is not None and not np.isfinite(values).all():
                bad = ~np.isfinite(values)
                notes.append(f"object {part.name!r}: {int(bad.any(1).sum())} {name} are NaN or infinite; set to 0")
                part = dataclasses.replace(part, **{name: np.where(bad, 0.0, values)})
        result.append(part)
    if vertices:
        notes.append(
            f"{vertices} vertices are NaN, infinite or beyond {LARGEST:g}; "
            f"left out {triangles} triangles that use them, in {_listed(names)}"
        )
    return result


def without_degenerate_triangles(parts: list[Part], notes: list[str]) -> list[Part]:
    """Parts without the triangles that have no area, and without vertices that no triangle uses.

    Args:
        parts: Checked parts.
        notes: Receives the count if there are any.
    Returns:
        The parts that still have triangles.
    """
    result, dropped, names = [], 0, []
    for part in parts:
        vertices = part.vertices.astype(np.float32)
        keep = face_normals(vertices, part.faces)[1] > 0
        if not keep.all():
            dropped += int((~keep).sum())
            names.append(part.name)
        if keep.any():
            result.append(_compacted(part, part.faces[keep]))
    if dropped:
        notes.append(f"left out {dropped} triangles that have no area, in {_listed(names)}")
    return result


def _compacted(part: Part, faces: np.ndarray) -> Part:
    """The part with some of its faces and only the vertices they use."""
    used = np.zeros(len(part.vertices), bool)
    used[faces.reshape(-1)] = True
    if used.all():
        return dataclasses.replace(part, faces=faces)
    row = np.cumsum(used) - 1
    arrays = {name: getattr(part, name) for name in ("vertices", "normals", "uv", "tangents", "colours")}
    arrays = {name: None if array is None else array[used] for name, array in arrays.items()}
    return dataclasses.replace(part, faces=row[faces], **arrays)


def _listed(names: list[str]) -> str:
    names = list(dict.fromkeys(names))
    return f"{len(names)} object{'s' if len(names) > 1 else ''} ({', '.join(names[:3])}{', ...' * (len(names) > 3)})"


def note_normals(parts: list[Part], notes: list[str]) -> None:
    """Count the normals of a file that are not of unit length; `merge` brings them to it.

    Args:
        parts: Any parts.
        notes: Receives the count if there are any.
    """
    count, names = 0, []
    for part in parts:
        if part.normals is not None:
            lengths = np.linalg.norm(part.normals, axis=1)
            off = int((np.isfinite(lengths) & (lengths > 0) & (np.abs(lengths - 1) > 0.01)).sum())
            count += off
            names += [part.name] * (off > 0)
    if count:
        notes.append(f"{count} normals are not of unit length; they are normalised, in {_listed(names)}")


def with_smooth_normals(parts: list[Part], crease_angle: float, notes: list[str]) -> list[Part]:
    """Parts with the normals of the file, or with smooth ones by crease angle.

    Args:
        parts: Parts without degenerate triangles.
        crease_angle: Degrees; edges with a larger angle between their triangles stay sharp.
        notes: Receives which objects were smoothed.
    Returns:
        The parts in the same order; objects that are flat everywhere stay without normals. The parts of one
        object are smoothed together, so that a change of material does not make an edge.
    """
    rows: dict[str, list[int]] = {}
    for i, part in enumerate(parts):
        if part.normals is None:
            rows.setdefault(part.name, []).append(i)
    result, smoothed = list(parts), []
    for group in rows.values():
        members = [parts[i] for i in group]
        offsets = np.cumsum([0] + [len(p.vertices) for p in members])
        starts = np.cumsum([0] + [len(p.faces) for p in members])
        vertices = np.concatenate([p.vertices for p in members])
        joined = np.concatenate([p.faces + o for p, o in zip(members, offsets[:-1], strict=True)])
        faces, source, normals = smooth_normals(vertices, joined, crease_angle=crease_angle)
        facing, _ = face_normals(vertices, joined)
        if ((normals[faces] * facing[:, None]).sum(-1) >= FLAT_COSINE).all():
            continue  # flat shading gives the same, and costs no vertices
        smoothed.append(members[0].name)
        for i, part, offset, start in zip(group, members, offsets[:-1], starts[:-1], strict=True):
            used, own = np.unique(faces[start : start + len(part.faces)], return_inverse=True)
            moved = gathered(part, own.reshape(-1, 3), source[used] - offset)
            result[i] = dataclasses.replace(moved, normals=normals[used])
    if smoothed:
        notes.append(
            f"no normals in the file: made smooth ones up to a crease angle of {crease_angle:g} degrees "
            f"for {_listed(smoothed)}"
        )
    return result


def gathered(part: Part, faces: np.ndarray, source: np.ndarray) -> Part:
    """The part with new faces whose vertices are copies of the `source` vertices.

    Args:
        part: Any part; its tangents and normals go along.
        faces: [f 3] new indices.
        source: [w] old vertex of each new one.
    Returns:
        The part.
    """
    names = ("normals", "uv", "tangents", "colours")
    arrays = {n: None if getattr(part, n) is None else getattr(part, n)[source] for n in names}
    return dataclasses.replace(part, vertices=part.vertices[source], faces=faces, **arrays)


def _checked_attribute(name: str, value: np.ndarray | None, shape: tuple, *, finite: bool = True) -> np.ndarray | None:
    return None if value is None else checked_array(name, value, shape, finite=finite)
