"""Normals on the host: face normals, smooth vertex normals by crease angle, and repair of authored ones.

Input and output are NumPy arrays in float64. Triangles without an area have no normal: their face normal is the zero
vector and they do not contribute to their vertices.
"""

import numpy as np

FLAT_COSINE = float(np.cos(np.radians(0.1)))
"""Vertex normals within 0.1 degrees of the face normal make a flat triangle."""


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Unit normal and area of each triangle.

    $$ n = \frac{(b - a) \times (c - a)}{|(b - a) \times (c - a)|} $$

    Args:
        vertices: [v 3] positions.
        faces: [f 3] indices, counter-clockwise from the outside.
    Returns:
        Normals [f 3] and areas [f] in squared units of the vertices.
    Edge cases: a triangle without an area has the normal (0, 0, 0) and area 0. "Without" is relative: an area below
        1e-9 of the squared longest edge is rounding error.
    """
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    longest = np.maximum(((b - a) ** 2).sum(1), np.maximum(((c - b) ** 2).sum(1), ((a - c) ** 2).sum(1)))
    solid = length > 1e-9 * longest
    normals = np.where(solid[:, None], cross / np.where(solid, length, 1.0)[:, None], 0.0)
    return normals, np.where(solid, 0.5 * length, 0.0)


def corner_angles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Interior angles of each triangle.

    Args:
        vertices: [v 3] positions.
        faces: [f 3] indices.
    Returns:
        Angles [f 3] in radians, one per corner.
    Edge cases: corners at an edge of length zero have the angle 0.
    """
    p = vertices[faces].astype(np.float64)
    angles = np.empty(faces.shape)
    for i in range(3):
        u, w = p[:, (i + 1) % 3] - p[:, i], p[:, (i + 2) % 3] - p[:, i]
        angles[:, i] = np.arctan2(np.linalg.norm(np.cross(u, w), axis=1), (u * w).sum(1))
    return angles


def weld(vertices: np.ndarray) -> np.ndarray:
    """Which vertices stand at the same place.

    Args:
        vertices: [v 3] positions.
    Returns:
        [v] number of the place of each vertex, 0 to (places - 1).
    Edge cases: "the same" means equal as float32; 0 and -0 are equal.
    """
    keys = vertices.astype(np.float32) + np.float32(0)
    order = np.lexsort(keys.T)
    ordered = keys[order]
    new = np.ones(len(ordered), bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(1)
    place = np.empty(len(vertices), np.int64)
    place[order] = np.cumsum(new) - 1
    return place


def smooth_normals(
    vertices: np.ndarray, faces: np.ndarray, *, crease_angle: float = 40.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertex normals that are smooth across edges flatter than the crease angle and sharp across all others.

    Corners at the same place belong to one smooth group when a chain of triangles, each sharing an edge with the next
    whose dihedral angle is below `crease_angle`, joins them. A group's normal is the sum of its face normals, weighted
    by the angle of the corner. Vertices are split where groups meet; seams in texture coordinates stay split but get
    the same normal on both sides, because edges are matched by position.

    Args:
        vertices: [v 3] positions.
        faces: [f 3] indices.
        crease_angle: Degrees in [0, 180]; 0 makes every edge sharp that is not exactly flat.
    Returns:
        New faces [f 3], the source vertex [w] of each new vertex, and the unit normals [w 3].
    Edge cases: edges of one triangle, or of more than two, are sharp. Triangles without an area get (0, 0, 1) where
        they have no neighbour.
    Source: angle weights after Thürmer and Wüthrich, "Computing vertex normals from polygonal facets", 1998.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(faces)
    normals, _ = face_normals(vertices, faces)
    first, second, corner = _shared_edges(weld(vertices)[faces])
    # corner[i] holds, for both ends of edge i, the corner number 3 * face + k in its two triangles
    smooth = (normals[first] * normals[second]).sum(1) >= np.cos(np.radians(crease_angle)) - 1e-9
    linked = corner[smooth].reshape(-1, 2)
    graph = coo_array((np.ones(len(linked), bool), (linked[:, 0], linked[:, 1])), shape=(3 * count, 3 * count))
    _, group = connected_components(graph, directed=False)
    weights = corner_angles(vertices, faces).reshape(-1)
    contributions = np.repeat(normals, 3, axis=0) * weights[:, None]
    sums = np.stack([np.bincount(group, contributions[:, i]) for i in range(3)], 1)
    # one new vertex per (group, original vertex): a group never spans two places, but may span a texture seam
    key = group.astype(np.int64) * len(vertices) + faces.reshape(-1)
    unique, inverse = np.unique(key, return_inverse=True)
    source = unique % len(vertices)
    return inverse.reshape(-1, 3), source, normalised(sums)[unique // len(vertices)]


def repaired_normals(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, int]:
    """Authored normals brought to unit length; unusable ones replaced by the mean of the surrounding faces.

    Args:
        vertices: [v 3] positions.
        faces: [f 3] indices.
        normals: [v 3] authored normals of any length.
    Returns:
        Unit normals [v 3], and how many were unusable (zero, NaN or infinite) at a vertex that a triangle uses.
    """
    finite = np.asarray(np.isfinite(normals).all(axis=1))
    lengths = np.linalg.norm(np.where(finite[:, None], normals, 0.0), axis=1)
    usable = finite & (lengths > 0) & np.isfinite(lengths)
    result = normalised(np.where(usable[:, None], normals, 0.0))
    used = np.zeros(len(vertices), bool)
    used[faces.reshape(-1)] = True
    broken = used & ~usable
    if broken.any():
        faced, areas = face_normals(vertices, faces)
        sums = np.zeros((len(vertices), 3))
        np.add.at(sums, faces.reshape(-1), np.repeat(faced * areas[:, None], 3, axis=0))
        result = np.where(usable[:, None], result, normalised(sums))
    return result, int(broken.sum())


def normalised(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors along the given ones.

    Args:
        vectors: [n 3] of any length.
    Returns:
        [n 3] in float64; (0, 0, 1) where the length is 0.
    """
    vectors = np.asarray(vectors, np.float64)
    largest = np.abs(vectors).max(1, keepdims=True, initial=0.0)
    scaled = vectors / np.where(largest > 0, largest, 1.0)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    return np.where(length > 0, scaled / np.where(length > 0, length, 1.0), np.array([0.0, 0.0, 1.0]))


def _shared_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of triangles with a common edge: first [e], second [e], and the corners [e 2 2] to join at both ends."""
    start, stop = np.arange(3), np.array([1, 2, 0])
    corners = 3 * np.arange(len(faces))[:, None]
    ends = np.stack([faces[:, start].reshape(-1), faces[:, stop].reshape(-1)], 1)
    corner = np.stack([(corners + start).reshape(-1), (corners + stop).reshape(-1)], 1)
    swap = ends[:, 0] > ends[:, 1]
    ends[swap], corner[swap] = ends[swap][:, ::-1], corner[swap][:, ::-1]
    size = int(faces.max(initial=0)) + 1
    key = ends[:, 0] * size + ends[:, 1]
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    same = ordered[1:] == ordered[:-1]
    before = np.concatenate([[False], same[:-1]]) if len(same) else same
    after = np.concatenate([same[1:], [False]]) if len(same) else same
    pair = np.flatnonzero(same & ~before & ~after)  # exactly two triangles
    a, b = order[pair], order[pair + 1]
    both = np.stack([corner[a], corner[b]], -1)  # [e end triangle]
    return a // 3, b // 3, both
