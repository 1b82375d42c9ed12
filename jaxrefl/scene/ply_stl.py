"""PLY and STL files -> `Description`, through trimesh.

Both hold one object without materials: a matte light grey is used, to be replaced by overrides. STL has no shared
vertices; they are welded so that normals can be smooth.
"""

import warnings
from pathlib import Path

import numpy as np

from jaxrefl.scene.description import Description, Part
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.normals import weld
from jaxrefl.scene.obj import DEFAULT_MATERIAL
from jaxrefl.scene.vertex_colours import linear_from_stored

_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def describe_ply(path: Path) -> Description:
    """The mesh in a PLY file.

    Args:
        path: A `.ply` file, text or binary.
    Returns:
        The description: one part with the file's normals, texture coordinates and vertex colours (taken as sRGB).
    Raises:
        SceneError: If the file is broken or truncated, or has no triangles.
    Edge cases: polygons are triangulated by trimesh; a texture that the header names is ignored with a note.
    """
    import trimesh.exchange.ply

    mesh = _read(path, trimesh.exchange.ply.load_ply, fix_texture=False, skip_materials=True, prefer_color="vertex")
    if "vertices" not in mesh or "faces" not in mesh:
        raise SceneError(f"{path}: expected a PLY file with vertices and faces, got a point cloud or nothing")
    notes = ["surfaces without a material are matte grey (0.8)"]
    elements = mesh["metadata"]["_ply_raw"]
    for name, element in elements.items():
        if _row_count(element) != element["length"]:
            raise SceneError(f"{path}: truncated: expected {element['length']} of {name!r}, got {_row_count(element)}")
    data = elements["vertex"]["data"]
    fields = data.dtype.names or () if isinstance(data, np.ndarray) else tuple(data)
    count = len(mesh["vertices"])
    uv = colours = None
    for u, v in _UV_NAMES:
        if u in fields and v in fields:
            uv = np.stack([np.ravel(data[u]), 1.0 - np.ravel(data[v])], 1)
    if mesh.get("vertex_colors") is not None:
        colours = linear_from_stored(np.asarray(mesh["vertex_colors"]))
    for unknown in sorted(set(elements) - {"vertex", "face"}):
        notes.append(f"PLY element {unknown!r} is ignored")
    if "texcoord" in elements["face"]["properties"]:
        notes.append("texture coordinates per face (texcoord) are ignored")
    faces = np.asarray(mesh["faces"], np.int64)
    _check_indices(path, faces, count)
    normals = mesh.get("vertex_normals")
    part = Part(
        path.stem,
        np.asarray(mesh["vertices"], np.float64),
        faces,
        DEFAULT_MATERIAL,
        normals=None if normals is None else np.asarray(normals, np.float64),
        uv=uv,
        colours=colours,
    )
    return Description(path.stem, [part], notes=notes)


def describe_stl(path: Path) -> Description:
    """The mesh in an STL file.

    Args:
        path: An `.stl` file, text or binary.
    Returns:
        The description: one part whose vertices at the same place are shared; the stored face normals are not used.
    Raises:
        SceneError: If the file is broken, truncated or empty.
    """
    import trimesh.exchange.stl

    mesh = _read(path, trimesh.exchange.stl.load_stl)
    solids = list(mesh["geometry"].items()) if "geometry" in mesh else [(path.stem, mesh)]
    if not any(len(solid.get("faces", [])) for _, solid in solids):
        raise SceneError(f"{path}: expected an STL file with triangles, got none; the file is broken or truncated")
    parts = []
    for name, solid in solids:
        vertices = np.asarray(solid["vertices"], np.float64).reshape(-1, 3)
        faces = np.asarray(solid["faces"], np.int64).reshape(-1, 3)
        _check_indices(path, faces, len(vertices))
        place = weld(vertices)
        _, first = np.unique(place, return_index=True)
        parts.append(Part(name if len(solids) > 1 else path.stem, vertices[first], place[faces], DEFAULT_MATERIAL))
    return Description(path.stem, parts, notes=["surfaces without a material are matte grey (0.8)"])


def _row_count(element: dict) -> int:
    data = element.get("data")
    if data is None:
        return 0
    return len(next(iter(data.values()))) if isinstance(data, dict) else len(data)


def _read(path: Path, reader, **options) -> dict:
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # NumPy's word for text that is not a number
            return reader(file, **options)
    except Exception as error:  # trimesh raises whatever its parsers stumble upon
        reason = f"{type(error).__name__}: {error}"
        raise SceneError(f"{path}: cannot be read; the file is broken or truncated ({reason})") from error


def _check_indices(path: Path, faces: np.ndarray, count: int) -> None:
    outside = (faces < 0) | (faces >= count)
    if outside.any():
        raise SceneError(
            f"{path}: expected vertex indices from 0 to {count - 1}, got {int(outside.sum())} outside, "
            f"the first is {int(faces[outside][0])}"
        )
