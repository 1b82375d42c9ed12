"""Tessellated shapes of the built-in scenes: boxes, rectangles, lathed and swept surfaces.

numbers -> `Geometry` (host NumPy, float64). All shapes are right-handed with +Y up and have counter-clockwise faces
seen from the outside and analytic unit normals. Vertices are doubled only where normals or texture coordinates
differ, so closed shapes are watertight once equal positions are merged.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float, Int

from jaxrefl.scene.description import Material, Part
from scenes._check import Real
from scenes.profiles import Profile, arc, chain, line

Points = Float[np.ndarray, "n 3"]


@dataclasses.dataclass(frozen=True)
class Geometry:
    """Triangles before they get a name and a material."""

    vertices: Float[np.ndarray, "v 3"]
    """Positions."""
    faces: Int[np.ndarray, "f 3"]
    """Vertex indices, counter-clockwise from the outside."""
    normals: Float[np.ndarray, "v 3"]
    """Unit shading normals."""
    uv: Float[np.ndarray, "v 2"]
    """Texture coordinates."""

    def moved(self, *, to=(0.0, 0.0, 0.0), turn: Real = 0.0, tilt: Real = 0.0, scale: Real = 1.0) -> "Geometry":
        """The shape scaled, tilted, turned and shifted, in this order.

        Args:
            to: [3] Where the origin goes.
            turn: Angle about +Y, degrees; +Z turns towards +X.
            tilt: Angle about +X, degrees, before `turn`; +Y turns towards +Z.
            scale: Size factor, > 0.
        Returns:
            The moved shape.
        """
        a, b = math.radians(turn), math.radians(tilt)
        about_y = np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
        about_x = np.array([[1, 0, 0], [0, math.cos(b), -math.sin(b)], [0, math.sin(b), math.cos(b)]])
        rotation = _without_dust(about_y @ about_x)
        vertices = scale * self.vertices @ rotation.T + np.asarray(to, np.float64)
        return dataclasses.replace(self, vertices=vertices, normals=self.normals @ rotation.T)

    def flipped(self) -> "Geometry":
        """The shape seen from its other side: faces turned round, normals negated."""
        return dataclasses.replace(self, faces=self.faces[:, ::-1], normals=-self.normals)

    def part(self, name: str, material: Material) -> Part:
        """A named part of a scene made of this shape.

        Args:
            name: Object name; parts with one name are one object.
            material: What it is made of.
        Returns:
            The part, without texture coordinates where the material has no texture.
        """
        textured = material.base_colour_texture is not None or material.normal_texture is not None
        return Part(name, self.vertices, self.faces, material, self.normals, self.uv if textured else None)


def merge(*shapes: Geometry) -> Geometry:
    """Several shapes as one.

    Args:
        *shapes: At least one shape.
    Returns:
        Their vertices and faces one after another; nothing is welded.
    """
    starts = np.cumsum([0] + [len(s.vertices) for s in shapes[:-1]])
    return Geometry(
        np.concatenate([s.vertices for s in shapes]),
        np.concatenate([s.faces + start for s, start in zip(shapes, starts, strict=True)]),
        np.concatenate([s.normals for s in shapes]),
        np.concatenate([s.uv for s in shapes]),
    )


def rectangle(corner, right, up, *, tiles: tuple[Real, Real] = (1.0, 1.0)) -> Geometry:
    """A flat parallelogram of two triangles that faces `right x up`.

    Args:
        corner: [3] Lower left corner seen from the front.
        right: [3] Edge from the lower left to the lower right corner.
        up: [3] Edge from the lower left to the upper left corner.
        tiles: How often a texture repeats along `right` and `up`.
    Returns:
        The shape; uv (0, 0) is the upper left corner as in glTF.
    """
    corner, right, up = (np.asarray(x, np.float64) for x in (corner, right, up))
    normal = np.cross(right, up)
    vertices = np.stack([corner, corner + right, corner + right + up, corner + up])
    uv = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]) * np.asarray(tiles)
    normals = np.broadcast_to(normal / np.linalg.norm(normal), (4, 3)).copy()
    return Geometry(vertices, np.array([[0, 1, 2], [0, 2, 3]]), normals, uv)


def box(lower, upper) -> Geometry:
    """An axis-aligned box of twelve triangles with sharp edges.

    Args:
        lower: [3] Smallest coordinates.
        upper: [3] Largest coordinates, each above the one of `lower`.
    Returns:
        The closed shape.
    Raises:
        ValueError: If the box has no volume.
    """
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    if not (lower < upper).all():
        raise ValueError(f"box: expected lower < upper in each coordinate, got {lower.tolist()} and {upper.tolist()}")
    edges = np.diag(upper - lower)
    sides = []
    for axis in range(3):
        right, up = edges[(axis + 1) % 3], edges[(axis + 2) % 3]
        sides += [rectangle(lower + edges[axis], right, up), rectangle(lower, up, right)]
    return merge(*sides)


def lathe(profile: Profile, normals: Profile, *, around: int, angles: tuple[Real, Real] = (0, 360)) -> Geometry:
    r"""Surface of revolution about +Y.

    $$ p(\phi, s) = (r(s) \cos\phi,\ y(s),\ r(s) \sin\phi) $$

    Args:
        profile: (r, y) from the bottom to the top along the outside, r >= 0; a point given twice makes a crease.
        normals: Outward (r, y) normal at each point, any length > 0.
        around: Number of segments around the axis, >= 3 for a whole turn.
        angles: First and last angle, degrees from +X towards +Z.
    Returns:
        The shape; after a whole turn closed where the profile starts and ends on the axis or at the same point.
    Edge cases: segments of length 0 (creases) make no faces; points on the axis make one triangle per segment.
    """
    phi = np.radians(np.linspace(angles[0], angles[1], around + 1))
    if angles[1] - angles[0] == 360:
        phi[-1] = phi[0]  # the seam's two columns agree to the last bit
    directions = _without_dust(np.stack([np.cos(phi), np.sin(phi)], -1))
    radius, height = profile[:, None, 0], profile[:, None, 1]
    unit = normals / np.linalg.norm(normals, axis=-1, keepdims=True)

    def turned(r, y):
        return np.stack(np.broadcast_arrays(r * directions[:, 0], y, r * directions[:, 1]), -1).reshape(-1, 3)

    steps = np.linalg.norm(np.diff(profile, axis=0), axis=-1)
    along = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    uv = np.stack(np.broadcast_arrays(1 - np.linspace(0, 1, around + 1), 1 - along[:, None]), -1).reshape(-1, 2)
    faces = grid_faces(len(profile), around + 1).reshape(len(profile) - 1, around, 2, 3)
    keep = np.ones(faces.shape[:3], bool)
    keep[steps == 0] = False
    keep[profile[:-1, 0] == 0, :, 0] = False  # the triangle with two corners in the lower row
    keep[profile[1:, 0] == 0, :, 1] = False
    return Geometry(turned(radius, height), faces[keep], turned(unit[:, None, 0], unit[:, None, 1]), uv)


def grid_faces(rows: int, columns: int) -> Int[np.ndarray, "f 3"]:
    """Triangles of a grid of vertices that is seen with its rows upwards and its columns leftwards.

    Args:
        rows: Number of vertex rows, >= 2.
        columns: Number of vertex columns, >= 2; a closed ring repeats its first column.
    Returns:
        Two triangles per cell: first the one with two corners in the lower row, then the other.
    """
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return np.stack([np.stack([a, c, b], -1), np.stack([a, d, c], -1)], -2).reshape(-1, 3)


def sphere(radius: Real, *, around: int) -> Geometry:
    """A sphere about the origin.

    Args:
        radius: Radius, > 0.
        around: Number of segments around the axis, >= 3; half as many from pole to pole.
    Returns:
        The closed shape.
    """
    return lathe(*arc((0, 0), radius, -90, 90, max(2, around // 2)), around=around)


def cylinder(bottom: Real, top: Real, height: Real, *, around: int) -> Geometry:
    """A cylinder or truncated cone that stands on y = 0.

    Args:
        bottom: Radius at the bottom, > 0.
        top: Radius at the top, >= 0; 0 makes a cone.
        height: Height, > 0.
        around: Number of segments around the axis, >= 3.
    Returns:
        The closed shape with sharp rims.
    """
    pieces = [line((0, 0), (bottom, 0)), line((bottom, 0), (top, height))]
    if top > 0:
        pieces.append(line((top, height), (0, height)))
    return lathe(*chain(*pieces), around=around)


def torus(ring: Real, tube: Real, *, around: int) -> Geometry:
    """A torus about the y axis.

    Args:
        ring: Radius of the circle in the middle of the tube, > `tube`.
        tube: Radius of the tube, > 0.
        around: Number of segments around the axis, >= 3; half as many, at least 3, around the tube.
    Returns:
        The closed shape.
    """
    points, normals = arc((ring, 0), tube, -180, 180, max(3, around // 2))
    points[-1], normals[-1] = points[0], normals[0]  # the seam agrees to the last bit
    return lathe(points, normals, around=around)


def sweep(path: Points, radius: Real, *, around: int) -> Geometry:
    """A round tube along a smooth open curve, with flat ends.

    Args:
        path: Points of the middle line, at least 2, no two neighbours equal.
        radius: Radius of the tube, below the curve's radius of curvature.
        around: Number of segments around the tube, >= 3.
    Returns:
        The closed shape.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    side = np.empty_like(path)
    seed = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    for i, t in enumerate(tangent):  # carry the frame along, so that the tube does not twist
        across = seed - t * (seed @ t)
        seed = side[i] = across / np.linalg.norm(across)
    phi = np.linspace(0, 2 * np.pi, around + 1)[:, None]
    phi[-1] = 0
    normals = side[:, None] * np.cos(phi) + np.cross(side, tangent)[:, None] * np.sin(phi)
    rings = path[:, None] + radius * normals
    steps = np.linspace(0, 1, len(path))
    uv = np.stack(np.broadcast_arrays(1 - np.linspace(0, 1, around + 1), 1 - steps[:, None]), -1)
    wall = Geometry(rings.reshape(-1, 3), grid_faces(len(path), around + 1), normals.reshape(-1, 3), uv.reshape(-1, 2))
    return merge(wall, fan(rings[0], -tangent[0]), fan(rings[-1, ::-1], tangent[-1]))


def fan(ring: Points, normal) -> Geometry:
    """A flat disk that closes a ring of points.

    Args:
        ring: Points in counter-clockwise order seen against `normal`; the last repeats the first.
        normal: [3] Direction in which the disk faces, unit.
    Returns:
        One triangle per edge of the ring, around the mean of its points.
    """
    count = len(ring) - 1
    centre = ring[:-1].mean(0, keepdims=True)
    index = np.arange(count)
    vertices = np.concatenate([centre, ring])
    faces = np.stack([np.zeros(count, int), index + 1, index + 2], -1)
    normals = np.broadcast_to(np.asarray(normal, np.float64), vertices.shape).copy()
    return Geometry(vertices, faces, normals, np.full((len(vertices), 2), 0.5))


def _without_dust(x: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b"]:
    """Sines and cosines with exact zeros, so that points on a coordinate plane lie on it."""
    return np.where(np.abs(x) < 1e-15, 0.0, x)
