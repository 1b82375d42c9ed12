"""Martin Newell's teapot: its 32 bicubic Bezier patches, and one closed mesh made of them.

numbers -> `Geometry`. The patches follow from the profile of body and lid and from the halves of handle and spout by
symmetry. As published they are open and pass through each other: handle and spout end inside the body, the lid does not
touch the rim, the spout is open. A glass teapot needs an inside, so `teapot` cuts handle and spout where they meet the
body, opens the body there, and closes the gap under the lid and the spout: a single closed surface with one handle in
the topological sense too.

Source: M. Newell, 1975; original proportions, with Crow's bottom. Axes here: +Y up, the spout points to +X.
"""

from functools import cache, lru_cache

import numpy as np
from jaxtyping import Float, Int

from scenes.shapes import Geometry, fan, grid_faces, merge

Patches = Float[np.ndarray, "*p 4 4 3"]
Points = Float[np.ndarray, "*b 3"]
Numbers = Float[np.ndarray, "*b"]

# (radius, height) of the control points from the bottom's centre to the tip of the knob: bottom, lower and upper body,
# rim; lid, knob. Neighbouring pieces share a point.
BODY = [(0, 0), (1.425, 0), (1.5, 0.075), (1.5, 0.15), (1.5, 0.225), (2, 0.45), (2, 0.9), (2, 1.35), (1.75, 1.875)]
BODY += [(1.5, 2.4), (1.4375, 2.53125), (1.3375, 2.53125), (1.4, 2.4)]
LID = [(1.3, 2.4), (1.3, 2.55), (0.4, 2.55), (0.2, 2.7), (0, 2.85), (0.8, 3.15), (0, 3.15)]
ROUND = 0.56
"""Control distance of a quarter circle in the published data (0.5523 is rounder)."""

# (x, y, z) of half the tube, row by row away from the body; the other half has -z. Rows 3 and 4 share their points.
HANDLE = [
    [(-1.6, 2.025, 0), (-1.6, 2.025, 0.3), (-1.5, 2.25, 0.3), (-1.5, 2.25, 0)],
    [(-2.3, 2.025, 0), (-2.3, 2.025, 0.3), (-2.5, 2.25, 0.3), (-2.5, 2.25, 0)],
    [(-2.7, 2.025, 0), (-2.7, 2.025, 0.3), (-3, 2.25, 0.3), (-3, 2.25, 0)],
    [(-2.7, 1.8, 0), (-2.7, 1.8, 0.3), (-3, 1.8, 0.3), (-3, 1.8, 0)],
    [(-2.7, 1.575, 0), (-2.7, 1.575, 0.3), (-3, 1.35, 0.3), (-3, 1.35, 0)],
    [(-2.5, 1.125, 0), (-2.5, 1.125, 0.3), (-2.65, 0.9375, 0.3), (-2.65, 0.9375, 0)],
    [(-2, 0.9, 0), (-2, 0.9, 0.3), (-1.9, 0.6, 0.3), (-1.9, 0.6, 0)],
]
SPOUT = [
    [(1.7, 1.425, 0), (1.7, 1.425, 0.66), (1.7, 0.6, 0.66), (1.7, 0.6, 0)],
    [(2.6, 1.425, 0), (2.6, 1.425, 0.66), (3.1, 0.825, 0.66), (3.1, 0.825, 0)],
    [(2.3, 2.1, 0), (2.3, 2.1, 0.25), (2.4, 2.025, 0.25), (2.4, 2.025, 0)],
    [(2.7, 2.4, 0), (2.7, 2.4, 0.25), (3.3, 2.4, 0.25), (3.3, 2.4, 0)],
    [(2.8, 2.475, 0), (2.8, 2.475, 0.25), (3.525, 2.49375, 0.25), (3.525, 2.49375, 0)],
    [(2.9, 2.475, 0), (2.9, 2.475, 0.15), (3.45, 2.5125, 0.15), (3.45, 2.5125, 0)],
    [(2.8, 2.4, 0), (2.8, 2.4, 0.15), (3.2, 2.4, 0.15), (3.2, 2.4, 0)],
]


@cache
def patches() -> dict[str, Patches]:
    """Control points of the 32 patches.

    Returns:
        By name: `body` [4 pieces, 4 quarters, 4, 4, 3] and `lid` [2, 4, 4, 4, 3], pieces from the bottom up, quarters
        from +Z over -X; `handle` and `spout` [2 pieces, 2 halves, 4, 4, 3], halves -Z and +Z. Rows lead upwards along
        the profile or away from the body, columns leftwards seen from the outside.
    """
    return {"body": _turned(BODY), "lid": _turned(LID), "handle": _mirrored(HANDLE), "spout": _mirrored(SPOUT)}


def teapot(segments: int) -> Geometry:
    """The teapot as one closed surface: standing on y = 0, 3.15 high, 6.43 long, the spout towards +X.

    Args:
        segments: Number of segments along an edge of a patch, >= 3.
    Returns:
        The closed shape with analytic normals, about 60 `segments`^2 triangles.
    Raises:
        ValueError: If there are too few segments to open the body for handle and spout.
    """
    if segments < 3:
        raise ValueError(f"segments: expected at least 3, got {segments}")
    around = 4 * segments
    small = max(2, segments // 2)
    starts = np.cumsum([0, small, segments, segments, small])  # first grid row of each piece of the body
    body = _revolved(patches()["body"], np.diff(starts), segments)
    lid = _revolved(patches()["lid"], np.array([segments, small]), segments)

    ends = [("handle", 0), ("handle", 1), ("spout", 0)]
    windows = [_window(_meet(name, end, 64), starts, segments) for name, end in ends]
    columns, rows = np.maximum(windows[0][2:], windows[1][2:])  # both ends of the handle need the same ring
    windows[:2] = [_widened(w, int(columns), int(rows)) for w in windows[:2]]
    seams = [_meet(name, end, 2 * int(w[2] + w[3])) for (name, end), w in zip(ends, windows, strict=True)]

    along = max(4, round(1.6 * segments))
    handle = _tube("handle", seams[0][:, 0], seams[1][:, 0], along)
    spout = _tube("spout", seams[2][:, 0], np.full(len(seams[2]), 2.0), along)
    mouth = len(seams[2]) + 1
    tip = fan(spout.vertices[: -mouth - 1 : -1], (0.0, 1.0, 0.0))
    rings = [handle.vertices[: len(seams[0])], handle.vertices[-len(seams[1]) - 1 : -1], spout.vertices[: mouth - 1]]
    joints = [_joint(*x, starts, body) for x in zip(seams, rings, windows, strict=True)]

    keep = np.ones((starts[-1], around, 2), bool)
    for row, column, width, height in windows:
        keep[row : row + height, column : column + width] = False
    keep[0, :, 0] = False  # the bottom's centre
    faces = grid_faces(len(keep) + 1, around + 1).reshape(keep.shape + (3,))
    open_body = _used(body, faces[keep])
    gap = _flat_ring(body.vertices[-around - 1 :], lid.vertices[: around + 1])
    return merge(open_body, gap, lid, *joints, handle, spout, tip)


def evaluate(control: Patches, s: Numbers, t: Numbers) -> tuple[Points, Points, Points]:
    """Points of bicubic Bezier patches and their derivatives.

    Args:
        control: Control points; rows follow `s`, columns `t`.
        s: Parameter along the rows, 0 to 1 on the patch; the polynomial goes on outside.
        t: Parameter along the columns.
    Returns:
        Position, derivative by `s`, derivative by `t`.
    """
    (a, da), (b, db) = _bernstein(s), _bernstein(t)
    blend = "...i,...j,...ijc->...c"
    return np.einsum(blend, a, b, control), np.einsum(blend, da, b, control), np.einsum(blend, a, db, control)


def _bernstein(t: Numbers) -> tuple[np.ndarray, np.ndarray]:
    r = 1 - t
    value = np.stack([r**3, 3 * r * r * t, 3 * r * t * t, t**3], -1)
    slope = np.stack([-3 * r * r, 3 * r * (r - 2 * t), 3 * t * (2 * r - t), 3 * t * t], -1)
    return value, slope


def _turned(profile: list) -> np.ndarray:
    # The one published exception to ROUND: the knob's widest row has 0.45 for a radius of 0.8.
    pieces = []
    for first in range(0, len(profile) - 1, 3):
        rows = []
        for r, y in profile[first : first + 4]:
            k = r * (0.5625 if r == 0.8 else ROUND)
            rows.append([[0, y, r], [-k, y, r], [-r, y, k], [-r, y, 0]])  # from +Z to -X
        quarter = np.array(rows, np.float64)
        quarters = [quarter]
        for _ in range(3):  # the next quarter: +Z goes to -X, -X goes to -Z
            quarter = np.stack([-quarter[..., 2], quarter[..., 1], quarter[..., 0]], -1)
            quarters.append(quarter)
        pieces.append(quarters)
    return np.array(pieces)


def _mirrored(rows: list) -> np.ndarray:
    half = np.array([rows[0:4], rows[3:7]], np.float64)
    return np.stack([half * np.array([1, 1, -1]), half[:, :, ::-1]], 1)


def _surface(control: np.ndarray, s: Numbers, t: Numbers) -> tuple[Points, Points, Points]:
    """Evaluates a chain of patches at `s` in [0, pieces] and `t` in [0, columns of patches], beyond its ends too."""
    piece = np.clip(np.floor(s), 0, control.shape[0] - 1).astype(int)
    column = np.floor(t).astype(int) % control.shape[1]
    return evaluate(control[piece, column], s - piece, t - np.floor(t))


def _unit(v: Points, fallback: np.ndarray) -> Points:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(length > 1e-9, v / np.where(length > 1e-9, length, 1), fallback)


def _revolved(control: np.ndarray, rows: Int[np.ndarray, "p"], segments: int) -> Geometry:
    """Vertices of pieces of revolution with `rows` rows of cells each; faces without those at the axis."""
    s = np.concatenate([[0.0]] + [i + np.linspace(0, 1, n + 1)[1:] for i, n in enumerate(rows)])
    t = np.arange(4 * segments + 1) / segments
    piece = np.minimum(np.floor(s), len(rows) - 1)
    values = [_grid(control[i], s[piece == i] - i, t) for i in range(len(rows))]
    p, ds, dt = (np.concatenate(x) for x in zip(*values, strict=True))
    p[:, -1] = p[:, 0]  # neighbours agree to the last bit, so that the mesh is closed
    for end in (0, -1):
        if np.abs(p[end][:, [0, 2]]).max() == 0:  # a pole
            p[end] = p[end, 0]
    pole = np.broadcast_to(np.where(s < 1, -1.0, 1.0)[:, None, None] * np.array([0.0, 1.0, 0.0]), p.shape)
    normals = _unit(np.cross(ds, dt), pole)
    uv = np.stack(np.broadcast_arrays(1 - t / 4, 1 - s[:, None] / len(rows)), -1)
    faces = grid_faces(len(s), len(t)).reshape(len(s) - 1, len(t) - 1, 2, 3)
    keep = np.ones(faces.shape[:3], bool)
    keep[-1, :, 1] = np.abs(p[-1, 0, [0, 2]]).max() > 0
    return Geometry(p.reshape(-1, 3), faces[keep], normals.reshape(-1, 3), uv.reshape(-1, 2))


def _grid(
    quarters: np.ndarray, s: Float[np.ndarray, "s"], t: Float[np.ndarray, "t"]
) -> tuple[Float[np.ndarray, "s t 3"], Float[np.ndarray, "s t 3"], Float[np.ndarray, "s t 3"]]:
    (a, da), (b, db) = _bernstein(s), _bernstein(t - np.floor(t))
    column = np.floor(t).astype(int) % len(quarters)
    blend = "si,tj,tijc->stc"
    control = quarters[column]
    return (
        np.einsum(blend, a, b, control, optimize=True),
        np.einsum(blend, da, b, control, optimize=True),
        np.einsum(blend, a, db, control, optimize=True),
    )


@lru_cache(maxsize=64)
def _meet(name: str, end: int, columns: int) -> Float[np.ndarray, "c 3"]:
    """Where the first or last end of a tube crosses the body: (u, s, t) of each column, by Newton's method."""
    tube, body = patches()[name], patches()["body"]
    v = 2 * np.arange(columns) / columns
    u = np.full(columns, 1.95 if end else 0.15)
    p = _surface(tube, u, v)[0]
    heights = np.linspace(1, 3, 200)  # lower and upper body, whose y grows with s
    s = np.interp(p[:, 1], _surface(body, heights, np.zeros(200))[0][:, 1], heights)
    x = np.stack([u, s, np.arctan2(-p[:, 0], p[:, 2]) / (np.pi / 2) % 4], -1)
    for _ in range(20):
        p, du, _ = _surface(tube, x[:, 0], v)
        q, ds, dt = _surface(body, x[:, 1], x[:, 2])
        step = np.linalg.solve(np.stack([du, -ds, -dt], -1), (q - p)[..., None])[..., 0]
        x = x + np.clip(step, -0.2, 0.2)
    return x


def _window(seam: Float[np.ndarray, "c 3"], starts: Int[np.ndarray, "p"], segments: int) -> np.ndarray:
    """Cells of the body's grid that a seam touches, and a margin: first row and column, width, height."""
    row = np.interp(seam[:, 1], np.arange(len(starts)), starts)
    column = seam[:, 2] * segments
    middle = segments * round(float(seam[:, 2].mean()))
    half = int(np.floor(np.abs(column - middle).max() + 0.5)) + 1
    low, high = int(np.floor(row.min() - 0.4)), int(np.ceil(row.max() + 0.4))
    return np.array([low, middle - half, 2 * half, high - low])


def _widened(window: np.ndarray, columns: int, rows: int) -> np.ndarray:
    row, column, width, height = window
    return np.array([row - (rows - height) // 2, column - (columns - width) // 2, columns, rows])


def _joint(
    seam: Float[np.ndarray, "c 3"], tube: Points, window: np.ndarray, starts: Int[np.ndarray, "p"], body: Geometry
) -> Geometry:
    """The piece of the body between the window cut into its grid and the first ring of a tube, as rings inwards."""
    row, column, width, height = window
    across, up = np.arange(width), np.arange(height)
    left, right, low, high = column + width, column, row, row + height  # columns grow leftwards
    ring = np.concatenate(  # clockwise from the lower right corner, seen from the outside
        [
            np.stack([np.full(width, low), right + across], -1),
            np.stack([low + up, np.full(height, left)], -1),
            np.stack([np.full(width, high), left - across], -1),
            np.stack([high - up, np.full(height, right)], -1),
        ]
    )
    grid = body.vertices.reshape(starts[-1] + 1, -1, 3)
    outer = np.stack([np.interp(ring[:, 0], starts, np.arange(len(starts))), 4 * ring[:, 1] / (grid.shape[1] - 1)], -1)
    x, y = -seam[:, 2], seam[:, 1]
    clockwise = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0
    order = np.arange(len(seam)) if clockwise else np.arange(len(seam))[::-1]
    orders = [np.roll(order, i) for i in range(len(order))]
    order = min(orders, key=lambda o: np.sum((seam[o, 1:] - outer) ** 2))
    closed = np.append(np.arange(len(order)), 0)
    w = np.linspace(0, 1, 1 + max(1, round(0.25 * min(width, height))))[:, None, None]
    st = (outer * (1 - w) + seam[order, 1:] * w)[:, closed]
    p, ds, dt = _surface(patches()["body"], st[..., 0], st[..., 1])
    p[0], p[-1] = grid[tuple(ring.T)][closed], tube[order][closed]  # the same to the last bit as the neighbours
    normals = _unit(np.cross(ds, dt), np.array([0.0, 1.0, 0.0]))
    uv = np.stack([1 - st[..., 1] / 4, 1 - st[..., 0] / 4], -1)
    return Geometry(p.reshape(-1, 3), grid_faces(*st.shape[:2]), normals.reshape(-1, 3), uv.reshape(-1, 2))


def _tube(name: str, start: Numbers, stop: Numbers, along: int) -> Geometry:
    columns = len(start)
    w = np.linspace(0, 1, along + 1)[:, None]
    u = (1 - w) * np.append(start, start[0]) + w * np.append(stop, stop[0])
    v = np.broadcast_to(2 * (np.arange(columns + 1) % columns) / columns, u.shape)
    p, du, dv = _surface(patches()[name], u, v)
    normals = _unit(np.cross(du, dv), np.array([0.0, 1.0, 0.0]))
    p[:, -1] = p[:, 0]
    uv = np.stack(np.broadcast_arrays(1 - np.arange(columns + 1) / columns, 1 - w), -1)
    return Geometry(p.reshape(-1, 3), grid_faces(*u.shape), normals.reshape(-1, 3), uv.reshape(-1, 2))


def _flat_ring(outer: Points, inner: Points) -> Geometry:
    vertices = np.concatenate([outer, inner])
    normals = np.broadcast_to(np.array([0.0, 1.0, 0.0]), vertices.shape).copy()
    return Geometry(vertices, grid_faces(2, len(outer)), normals, np.zeros((len(vertices), 2)))


def _used(shape: Geometry, faces: Int[np.ndarray, "f 3"]) -> Geometry:
    rows, index = np.unique(faces, return_inverse=True)
    return Geometry(shape.vertices[rows], index.reshape(-1, 3), shape.normals[rows], shape.uv[rows])
