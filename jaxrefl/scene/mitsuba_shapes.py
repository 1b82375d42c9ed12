"""Shapes of a Mitsuba scene file -> triangles in world space.

Meshes are loaded by Mitsuba itself, so that normals, transforms and texture coordinates are its own. Spheres, disks and
cylinders are tessellated with exact normals. Triangles face the way the shading normals do, as those decide in Mitsuba
which side shines and which is the inside.
"""

from dataclasses import dataclass

import numpy as np

from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.mitsuba_nodes import Node, loaded

SEGMENTS = 128
"""Segments around tessellated spheres, disks and cylinders: they lie at most 0.03 % of the radius inside the shape."""

_MESHES = {
    "obj": ("filename", "face_normals", "flip_tex_coords"),
    "ply": ("filename", "face_normals", "flip_tex_coords"),
    "serialized": ("filename", "face_normals", "shape_index"),
    "rectangle": (),
    "cube": (),
}
"""Plugins that Mitsuba turns into triangles, and the properties that matter for them."""

_ROUND = ("sphere", "disk", "cylinder")


@dataclass(frozen=True)
class Geometry:
    """Triangles of one shape in world space; the fields mean what they mean in `Part`."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uv: np.ndarray | None = None
    colours: np.ndarray | None = None

    def flipped(self) -> "Geometry":
        """The same triangles, facing the other way."""
        return Geometry(self.vertices, self.faces[:, ::-1], -self.normals, self.uv, self.colours)

    def moved(self, matrix: np.ndarray) -> "Geometry":
        """The same triangles under an affine transform [4 4]; the outside stays outside."""
        linear = matrix[:3, :3]
        mirrored = np.linalg.det(linear) < 0
        normals = _normals_under(linear, self.normals)
        faces = self.faces[:, ::-1] if mirrored else self.faces
        return Geometry(self.vertices @ linear.T + matrix[:3, 3], faces, normals, self.uv, self.colours)


def geometry(node: Node, *, attribute: str | None) -> Geometry | None:
    """Triangles of a shape.

    Args:
        node: A shape.
        attribute: Vertex attribute that the material takes its colour from; None: it takes none.
    Returns:
        The triangles; None, with a note, if the plugin is not known here.
    Raises:
        SceneError: If a mesh file is missing or broken.
    """
    if node.plugin in _MESHES:
        found = _mesh(node, attribute)
    elif node.plugin in _ROUND:
        found = _round(node)
        text = f"spheres, disks and cylinders are made of triangles, {SEGMENTS} around"
        node.scene.notes.group(text, node.name or node.place)
    else:
        node.scene.notes.group(f"shapes of the type {node.plugin} are left out", node.name or node.place)
        return None
    return found.flipped() if bool(node.get("flip_normals", False)) else found


def _mesh(node: Node, attribute: str | None) -> Geometry:
    settings = {"type": node.plugin, **{k: node.get(k, None) for k in (*_MESHES[node.plugin], "to_world") if k in node}}
    if "filename" in settings:
        path = node.scene.resolve(node, str(settings["filename"]))
        if not path.is_file():
            raise SceneError(f"{node.scene.path}: {node.place}: the mesh file {path} does not exist")
        settings["filename"] = str(path)
    mesh = loaded(node, settings)
    vertices = np.asarray(mesh.vertex_positions_buffer(), np.float64).reshape(-1, 3)
    faces = np.asarray(mesh.faces_buffer(), np.int64).reshape(-1, 3)
    uv = np.asarray(mesh.vertex_texcoords_buffer(), np.float64).reshape(-1, 2) if mesh.has_vertex_texcoords() else None
    colours = _attribute(node, mesh, attribute, len(vertices))
    corners = vertices[faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if not mesh.has_vertex_normals():
        return _faceted(Geometry(vertices, faces, vertices, uv, colours), facing)
    normals = np.asarray(mesh.vertex_normals_buffer(), np.float64).reshape(-1, 3)
    agreement = (facing * np.nan_to_num(normals)[faces].mean(1)).sum()
    return Geometry(vertices, faces[:, ::-1] if agreement < 0 else faces, normals, uv, colours)


def _faceted(shared: Geometry, facing: np.ndarray) -> Geometry:
    """Three vertices of its own for each triangle, so that it stays flat whatever its neighbours are."""
    source = shared.faces.reshape(-1)
    length = np.linalg.norm(facing, axis=1, keepdims=True)
    normals = facing / np.where(length > 0, length, 1)
    uv, colours = (None if a is None else a[source] for a in (shared.uv, shared.colours))
    faces = np.arange(source.size).reshape(-1, 3)
    return Geometry(shared.vertices[source], faces, np.repeat(normals, 3, axis=0), uv, colours)


def _attribute(node: Node, mesh, name: str | None, count: int) -> np.ndarray | None:
    """Linear vertex colours, if the mesh has the attribute."""
    if name is None:
        return None
    try:
        values = np.asarray(mesh.attribute_buffer(name), np.float64) if name.startswith("vertex_") else None
    except (RuntimeError, KeyError, IndexError):
        values = None
    if values is None or values.size not in (count, 3 * count):
        node.scene.notes.group(
            f"the mesh attribute {name} is missing or not one of vertices; white is used", node.place
        )
        return None
    return np.repeat(values[:, None], 3, 1) if values.size == count else values.reshape(count, 3)


def _round(node: Node) -> Geometry:
    matrix = node.matrix()
    if node.plugin == "sphere":
        local = _sphere()
        matrix = matrix @ _shifted(node.vector("center", (0, 0, 0)), node.number("radius", 1.0) * np.eye(3))
    elif node.plugin == "disk":
        local = _disk()
    else:
        local = _cylinder()
        start, end = node.vector("p0", (0, 0, 0)), node.vector("p1", (0, 0, 1))
        matrix = matrix @ _shifted(start, _axis_frame(end - start, node.number("radius", 1.0)))
    moved = local.moved(matrix)
    # Mitsuba turns the normals of mirrored spheres, and of nothing else, inwards.
    return moved.flipped() if node.plugin == "sphere" and np.linalg.det(matrix[:3, :3]) < 0 else moved


def _sphere() -> Geometry:
    """The unit sphere; u around +Z from +X, v from +Z to -Z."""
    rows = SEGMENTS // 2
    i, j = np.meshgrid(np.arange(SEGMENTS + 1), np.arange(rows + 1))
    azimuth, polar = 2 * np.pi * i / SEGMENTS, np.pi * j / rows
    points = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    uv = np.stack([i / SEGMENTS, j / rows], -1)
    uv[[0, -1], :, 0] += 0.5 / SEGMENTS  # at the poles each triangle has the middle of its edge
    faces = _grid_faces(rows, SEGMENTS)
    keep = np.ones(len(faces), bool)
    keep[: 2 * SEGMENTS : 2] = False  # triangles with two corners at a pole
    keep[-2 * SEGMENTS + 1 :: 2] = False
    points = points.reshape(-1, 3)
    return Geometry(points, faces[keep], points, uv.reshape(-1, 2))


def _disk() -> Geometry:
    """The unit disk in the plane z = 0, facing +Z; u is the radius, v the angle from +X."""
    azimuth = 2 * np.pi * np.arange(SEGMENTS + 1) / SEGMENTS
    rim = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], -1)
    turn = np.arange(SEGMENTS + 1) / SEGMENTS
    centre_uv = np.stack([0 * turn[:-1], turn[:-1] + 0.5 / SEGMENTS], -1)
    vertices = np.concatenate([rim, np.zeros((SEGMENTS, 3))])
    uv = np.concatenate([np.stack([np.ones(SEGMENTS + 1), turn], -1), centre_uv])
    i = np.arange(SEGMENTS)
    faces = np.stack([SEGMENTS + 1 + i, i, i + 1], -1)
    return Geometry(vertices, faces, np.broadcast_to([0.0, 0.0, 1.0], vertices.shape).copy(), uv)


def _cylinder() -> Geometry:
    """The open unit cylinder around +Z from 0 to 1; u around from +X, v along."""
    j, i = np.meshgrid(np.arange(2), np.arange(SEGMENTS + 1), indexing="ij")
    azimuth = 2 * np.pi * i / SEGMENTS
    normals = np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], -1).reshape(-1, 3)
    vertices = normals + np.stack([0 * i, 0 * i, j], -1).reshape(-1, 3)
    uv = np.stack([i / SEGMENTS, j], -1).reshape(-1, 2).astype(np.float64)
    return Geometry(vertices, _grid_faces(1, SEGMENTS)[:, ::-1], normals, uv)


def _grid_faces(rows: int, columns: int) -> np.ndarray:
    """Two triangles per cell of a grid of (rows + 1) x (columns + 1) vertices."""
    j, i = (a.reshape(-1) for a in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    a = j * (columns + 1) + i
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    return np.stack([np.stack([a, d, b], -1), np.stack([a, c, d], -1)], 1).reshape(-1, 3)


def _shifted(origin: np.ndarray, linear: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, origin
    return matrix


def _axis_frame(axis: np.ndarray, radius: float) -> np.ndarray:
    """[3 3] with the axis as its third column and two vectors of the radius's length at right angles before it.

    Source: Duff et al., "Building an Orthonormal Basis, Revisited", 2017, as in Mitsuba, so that texture coordinates
    agree.
    """
    length = float(np.linalg.norm(axis))
    x, y, z = axis / (length if length > 0 else 1.0)
    sign = 1.0 if z >= 0 else -1.0
    a = -1 / (sign + z)
    b = x * y * a
    s, t = np.array([1 + sign * x * x * a, sign * b, -sign * x]), np.array([b, sign + y * y * a, -y])
    return np.stack([radius * s, radius * t, axis], -1)


def _normals_under(linear: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Unit normals under a linear map: by its inverse transpose, up to a positive factor."""
    cofactor = np.stack([np.cross(linear[(i + 1) % 3], linear[(i + 2) % 3]) for i in range(3)])
    turned = normals @ (cofactor if np.linalg.det(linear) >= 0 else -cofactor).T
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return turned / np.where(length > 0, length, 1)
