"""Projection and rasterisation: Mesh + Views -> the triangle that each texel sees, without an acceleration structure.

All in JAX. Groups of consecutive triangles are culled against each view's frustum; what is left is projected, and every
pixel centre in the bounding box of a triangle's image is tested against its edges. Edges are planes through the eye
([OG97], homogeneous rasterisation), so nothing is clipped where it passes the eye. The nearest wins; of two at exactly
the same depth the one with the smaller number. Loops run as often as there is something to draw.
"""

from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera, Hits, Mesh, Rays
from jaxrefl.rays.attach import attach_hits
from jaxrefl.rays.views import Views, view_of, view_rays

GROUP = 64
"""Consecutive triangles that are culled together."""
_PAIRS = 128
"""Groups, each in one view, that are projected at once."""
_FRAGMENTS = 16384
"""Pixels of bounding boxes that are tested at once."""
_NEAR = 1e-5
"""Share of a triangle's largest depth below which its parts are not looked for in its bounding box."""
_SLACK = 1e-4
"""Texels by which edges reach outward: rounding leaves no cracks between triangles."""


def draw_triangles(mesh: Mesh, views: Views, *, room: int, begin: Float[Array, "m"] | None = None) -> Int[Array, "m"]:
    """The triangle that each texel of many views sees at its centre.

    Args:
        mesh: The triangles.
        views: The views; their clipping planes and unseen sides count.
        room: Length of the list of texels, at least `texel_count(views)`.
        begin: Largest 1 / z that each texel sees; None: there is no limit but the clipping plane.
    Returns:
        Rows in `mesh.faces`; -1 where nothing is seen.
    Edge cases: triangles that pass through the eye's plane are drawn where they are ahead of it. Texels whose centre
        lies on an edge, within a ten-thousandth of a texel, are seen by both triangles.
    Source: [OG97].
    """
    corners = mesh.vertices[mesh.faces]
    begin = jnp.full(room, jnp.inf, jnp.float32) if begin is None else begin
    return _draw(corners, mesh.object, views, begin)


def raster_hits(mesh: Mesh, views: Views, texel: Int[Array, "n"], triangle: Int[Array, "n"]) -> tuple[Rays, Hits]:
    """Rays through texels and their hits on the triangles that were drawn there.

    Args:
        mesh: The triangles.
        views: The views.
        texel: Numbers of texels.
        triangle: From `draw_triangles`, at those texels.
    Returns:
        Rays from the clipping plane or the eye on, and hits as a tracer gives them.
    """
    rays, *_ = view_rays(views, texel)
    zero = jnp.zeros(texel.shape, jnp.float32)
    found = Hits(triangle >= 0, zero, jnp.maximum(triangle, 0), jnp.stack([zero, zero], -1))
    return rays, attach_hits(mesh, rays, found)


@jax.jit
def raster_camera(mesh: Mesh, camera: Camera) -> Hits:
    """What a camera's pixels see, by rasterisation: the same as casting its rays.

    Args:
        mesh: The triangles.
        camera: The camera.
    Returns:
        Hits [h w].
    """
    views, count = view_of(camera), camera.width * camera.height
    texel = jnp.arange(count, dtype=jnp.int32)
    _, hits = raster_hits(mesh, views, texel, draw_triangles(mesh, views, room=count))
    return jax.tree.map(lambda x: x.reshape(camera.height, camera.width, *x.shape[1:]), hits)


class _Groups(NamedTuple):
    """Triangles in groups, and the pairs of group and view that may show something."""

    corner: Float[Array, "g k 3 3"]
    object: Int[Array, "g k"]
    group: Int[Array, "p"]
    view: Int[Array, "p"]
    pairs: Int[Array, ""]


@jax.jit
def _draw(
    corners: Float[Array, "f 3 3"], objects: Int[Array, "f"], views: Views, begin: Float[Array, "m"]
) -> Int[Array, "m"]:
    groups = _cull(corners, objects, views)
    none = jnp.iinfo(jnp.int32).max

    def pairs(number: Array, image: tuple[Array, Array]) -> tuple[Array, Array]:
        at = number * _PAIRS + jnp.arange(_PAIRS, dtype=jnp.int32)
        group = jax.lax.dynamic_slice_in_dim(groups.group, number * _PAIRS, _PAIRS)
        view = jax.lax.dynamic_slice_in_dim(groups.view, number * _PAIRS, _PAIRS)
        rows, boxes = _project(groups, views, group, view, at < groups.pairs)
        area = boxes[:, 2] * boxes[:, 3]
        ends = jax.lax.associative_scan(jnp.add, area)
        triangle = (group[:, None] * GROUP + jnp.arange(GROUP, dtype=jnp.int32)[None, :]).reshape(-1)

        def fragments(state: tuple[Array, tuple[Array, Array]]) -> tuple[Array, tuple[Array, Array]]:
            start, image = state
            return start + _FRAGMENTS, _shade(rows, boxes, ends, triangle, start, image, begin)

        state = (jnp.zeros((), jnp.int32), image)
        return jax.lax.while_loop(lambda state: state[0] < ends[-1], fragments, state)[1]

    image = (jnp.zeros_like(begin), jnp.full(begin.shape, none, jnp.int32))
    _, winner = jax.lax.fori_loop(0, (groups.pairs + _PAIRS - 1) // _PAIRS, pairs, image)
    return jnp.where(winner == none, -1, winner)


def _cull(corners: Array, objects: Array, views: Views) -> _Groups:
    """Groups whose bounding sphere reaches into a view's frustum."""
    f = corners.shape[0]
    padding = -f % GROUP
    corners = jnp.concatenate([corners, jnp.broadcast_to(corners[-1:, :1], (padding, 3, 3))])  # without area
    grouped = corners.reshape(-1, GROUP, 3, 3)
    low, high = grouped.min((1, 2)), grouped.max((1, 2))
    centre, extent = (low + high) / 2, (high - low) / 2
    radius = jnp.sqrt((extent * extent).sum(-1))

    offset = [centre[:, None, i] - views.eye[None, :, i] for i in range(3)]
    x, y, z = (_total(offset[i] * views.axes[None, :, a, i] for i in range(3)) for a in range(3))
    far = views.low + views.pitch * views.size.astype(views.pitch.dtype)
    shown = (views.size[:, 0] > 0)[None, :]
    for lateral, axis in ((x, 0), (y, 1)):
        for edge, sign in ((views.low[None, :, axis], 1.0), (far[None, :, axis], -1.0)):
            shown = shown & (sign * (lateral - edge * z) >= -radius[:, None] * jnp.sqrt(1 + edge * edge))
    ahead = _total(centre[:, None, i] * views.clip[None, :, i] for i in range(3)) + views.clip[None, :, 3]
    shown = shown & (ahead >= -radius[:, None])

    # View by view, so that neighbouring pairs write to the same part of the list of texels.
    flat = shown.T.reshape(-1)
    rank = jax.lax.associative_scan(jnp.add, flat.astype(jnp.int32))
    n = flat.shape[0]
    order = jnp.zeros(n + _PAIRS, jnp.int32)
    order = order.at[jnp.where(flat, rank - 1, n + _PAIRS)].set(jnp.arange(n, dtype=jnp.int32), mode="drop")
    count = radius.shape[0]
    owners = jnp.pad(objects, (0, padding), constant_values=-1).reshape(-1, GROUP)
    return _Groups(grouped, owners, order % count, order // count, rank[-1])


def _project(
    groups: _Groups, views: Views, group: Array, view: Array, real: Bool[Array, "p"]
) -> tuple[Float[Array, "t 15"], Int[Array, "t 4"]]:
    """Edges, 1 / z and clipping of triangles as linear functions of texels, and their bounding boxes.

    Returns:
        Coefficients (x, y, 1), relative to the box's corner, of three edges, 1 / z and the height above the clipping
        plane over z; and boxes: the first texel, texels from row to row, width, height.
    """
    eye, axes = views.eye[view], views.axes[view]
    low, pitch, size = views.low[view], views.pitch[view], views.size[view]
    corner = groups.corner[group]
    offset = [corner[..., i] - eye[:, None, None, i] for i in range(3)]
    x, y, z = (_total(offset[i] * axes[:, None, None, a, i] for i in range(3)) for a in range(3))
    x, y = ((v - low[:, None, None, i] * z) / pitch[:, None, None, i] for i, v in enumerate((x, y)))
    side = jnp.where(_triple(x, y, z) < 0, 1, 2)
    own = groups.object[group] == views.own[view][:, None]
    plane = views.clip[view]
    above = (_total(corner[..., i] * plane[:, None, None, i] for i in range(3)) + plane[:, None, None, 3]).max(-1) > 0
    drawn = real[:, None] & above & ~(own & (views.unseen[view][:, None] & side > 0)) & (z.max(-1) > 0)

    first, last = _bounds((x, y), z, size)
    width, height = (jnp.where(drawn, jnp.maximum(b - a + 1, 0), 0) for a, b in zip(first, last, strict=True))

    x, y = (a - origin[..., None].astype(z.dtype) * z for a, origin in zip((x, y), first, strict=True))
    volume = _triple(x, y, z)
    sign, inverse = jnp.sign(volume), 1 / jnp.where(volume == 0, 1, volume)
    edges = []
    for j, k in ((1, 2), (2, 0), (0, 1)):
        a, b, c = _cross(x, y, z, j, k)
        edges.append((a * sign, b * sign, c * sign + _SLACK * (jnp.abs(a) + jnp.abs(b))))
    plain = [_cross(x, y, z, j, k) for j, k in ((1, 2), (2, 0), (0, 1))]
    depth = [_total(e[i] for e in plain) * inverse for i in range(3)]
    n = [_total(plane[:, i] * axes[:, a, i] for i in range(3)) for a in range(3)]
    level = _total(plane[:, i] * eye[:, i] for i in range(3)) + plane[:, 3]
    slope = [low[:, None, i] + pitch[:, None, i] * first[i].astype(low.dtype) for i in range(2)]
    clip = (
        n[0][:, None] * pitch[:, None, 0] + level[:, None] * depth[0],
        n[1][:, None] * pitch[:, None, 1] + level[:, None] * depth[1],
        n[2][:, None] + n[0][:, None] * slope[0] + n[1][:, None] * slope[1] + level[:, None] * depth[2],
    )
    empty = volume == 0
    rows = jnp.stack([*edges[0], *edges[1], *edges[2], *depth, *clip], -1).reshape(-1, 15)
    boxes = [*first, jnp.where(empty, 0, width), jnp.where(empty, 0, height)]
    start = views.offset[view][:, None] + first[1] * size[:, None, 0] + first[0]
    boxes = jnp.stack([start, jnp.broadcast_to(size[:, None, 0], start.shape), *boxes[2:]], -1)
    return rows, boxes.reshape(-1, 4)


def _bounds(xy: tuple[Array, Array], z: Array, size: Array) -> tuple[list[Array], list[Array]]:
    """First and last pixels that the part of each triangle ahead of the eye may cover, along x and along y."""
    plane = jnp.maximum(_NEAR * jnp.max(z, -1, keepdims=True), jnp.finfo(z.dtype).tiny)
    ahead, after = z > plane, jnp.roll(z, -1, -1)
    cut = ahead != jnp.roll(ahead, -1, -1)
    share = (z - plane) / jnp.where(cut, z - after, 1)
    first, last = [], []
    for a, most in zip(xy, (size[:, None, 0], size[:, None, 1]), strict=True):
        corner = a / jnp.where(ahead, z, 1)
        crossing = (a + (jnp.roll(a, -1, -1) - a) * share) / plane
        least, greatest = (
            either(*(extreme(jnp.where(k, v, fill), -1) for k, v in ((ahead, corner), (cut, crossing))))
            for either, extreme, fill in ((jnp.minimum, jnp.min, jnp.inf), (jnp.maximum, jnp.max, -jnp.inf))
        )
        limit = most.astype(jnp.float32)
        first.append(jnp.ceil(jnp.clip(least - 0.5 - _SLACK, 0, limit)).astype(jnp.int32))
        last.append(jnp.floor(jnp.clip(greatest - 0.5 + _SLACK, -1, limit - 1)).astype(jnp.int32))
    return first, last


def _total(terms: Iterable[Array]) -> Array:
    """Sum of three arrays."""
    a, b, c = terms
    return a + b + c


def _cross(x: Array, y: Array, z: Array, j: int, k: int) -> tuple[Array, Array, Array]:
    """Cross product of two corners, taken as vectors from the eye."""
    return (
        y[..., j] * z[..., k] - z[..., j] * y[..., k],
        z[..., j] * x[..., k] - x[..., j] * z[..., k],
        x[..., j] * y[..., k] - y[..., j] * x[..., k],
    )


def _triple(x: Array, y: Array, z: Array) -> Array:
    """Six times the signed volume between the eye and a triangle."""
    a, b, c = _cross(x, y, z, 1, 2)
    return a * x[..., 0] + b * y[..., 0] + c * z[..., 0]


def _shade(
    rows: Array, boxes: Array, ends: Array, triangle: Array, start: Array, image: tuple[Array, Array], begin: Array
) -> tuple[Array, Array]:
    """Test the pixels from number `start` on of all boxes, one after another, and keep the nearest."""
    count = rows.shape[0]
    starts = ends - boxes[:, 2] * boxes[:, 3]
    reached = (ends > start) & (ends > starts) & (starts < start + _FRAGMENTS)
    place = jnp.where(reached, jnp.maximum(starts - start, 0), _FRAGMENTS)
    owner = jnp.zeros(_FRAGMENTS, jnp.int32).at[place].max(jnp.arange(count, dtype=jnp.int32), mode="drop")
    owner = jax.lax.associative_scan(jnp.maximum, owner)
    number = start + jnp.arange(_FRAGMENTS, dtype=jnp.int32)
    row, box = rows[owner], boxes[owner]
    within = number - starts[owner]
    width = jnp.maximum(box[:, 2], 1)
    line = within // width
    column = within - line * width
    u, v = column.astype(jnp.float32) + 0.5, line.astype(jnp.float32) + 0.5

    def value(i: int) -> Array:
        return row[:, 3 * i] * u + row[:, 3 * i + 1] * v + row[:, 3 * i + 2]

    depth = value(3)
    inside = (number < ends[-1]) & (value(0) >= 0) & (value(1) >= 0) & (value(2) >= 0) & (depth > 0) & (value(4) > 0)
    nearest, winner = image
    texel = jnp.where(inside, box[:, 0] + line * box[:, 1] + column, nearest.shape[0])
    inside = inside & (depth <= begin.at[texel].get(mode="fill", fill_value=0))
    texel = jnp.where(inside, texel, nearest.shape[0])
    before = nearest.at[texel].get(mode="fill", fill_value=0)
    nearest = nearest.at[texel].max(depth, mode="drop")
    now = nearest.at[texel].get(mode="fill", fill_value=0)
    best = inside & (depth == now)
    newly = jnp.where(best & (now > before), texel, nearest.shape[0])
    winner = winner.at[newly].set(jnp.iinfo(jnp.int32).max, mode="drop")
    winner = winner.at[jnp.where(best, texel, nearest.shape[0])].min(triangle[owner], mode="drop")
    return nearest, winner
