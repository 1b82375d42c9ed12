"""Moved images: a grid mesh whose vertices are the pixels of one image, drawn into another with a depth test.

Vertex positions [h w] -> for each target pixel the source coordinate it shows. Two scatters per pass, first the
smallest depth, then the smallest triangle number among those at that depth: ties are decided the same way in every
run. Triangles that cover a few pixels go in one pass, the larger ones are compacted into a second one, and those wider
than `WIDEST` are dropped and counted. Loops go over blocks of triangles, as many as there are to draw.

Source: [XWD17] §3.2.2, the grid method.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

WIDEST = 8
"""Most pixels that a triangle's box may span in x or y."""
_NARROW = 2
_BLOCK = 8192
_FAR = 3.0e38


class GridMesh(eqx.Module):
    """A mesh over the pixels of an image, two triangles per cell of four neighbours."""

    xy: Float[Array, "h w 2"]
    """Where each vertex lies in the target image, pixels."""
    depth: Float[Array, "h w"]
    """Depth of each vertex; the smallest of a triangle's three counts."""
    connected: Bool[Array, "h w"]
    """True where the cell with this upper left corner is drawn; False in the last row and column."""
    object: Int[Array, "h w"]
    """A cell is drawn only on target pixels with the object of its upper left corner."""


class Drawn(eqx.Module):
    """What a drawn mesh shows."""

    uv: Float[Array, "th tw 2"]
    """Source coordinate (x, y) shown by each target pixel, pixels, centres at +0.5; fill 0."""
    valid: Bool[Array, "th tw"]
    """True where a triangle covers the pixel's centre."""
    too_wide: Int[Array, ""]
    """Triangles that were dropped because they span more than `WIDEST` pixels."""


class _Flat(eqx.Module):
    """The mesh as flat arrays: gathers of single numbers are what a CPU does fastest."""

    x: Float[Array, "n"]
    y: Float[Array, "n"]
    depth: Float[Array, "n"]
    object: Int[Array, "n"]
    width: int = eqx.field(static=True)


@functools.partial(jax.jit, static_argnames=("largest", "stride"))
def draw(mesh: GridMesh, target: Int[Array, "th tw"], *, largest: float = 16.0, stride: int = 1) -> Drawn:
    """Draw a grid mesh.

    Args:
        mesh: Vertices, one per source pixel, or one per `stride` pixels in each direction.
        target: Object of each target pixel; a cell covers only pixels of its own object.
        largest: Triangles whose area grew by more than this factor are dropped.
        stride: Source pixels between neighbouring vertices.
    Returns:
        Source coordinates.
    Edge cases: pixel centres on the edge between two triangles belong to both, so there are no cracks; the triangle
        that is nearer wins, then the one with the smaller number. Triangles turned over are drawn too.
    Source: [XWD17] §3.2.2 and §4.1 (16-fold area).
    Differs from the source: cells end at the outline of their reflector, which the target's G-buffer knows exactly.
    """
    h, w = mesh.depth.shape
    flat = _Flat(mesh.xy[..., 0].reshape(-1), mesh.xy[..., 1].reshape(-1), mesh.depth.reshape(-1),
                 mesh.object.reshape(-1), w)  # fmt: skip
    cells = jnp.arange(h * w, dtype=jnp.int32)
    drawable = mesh.connected.reshape(-1) & (cells % w < w - 1) & (cells // w < h - 1)
    numbers = jnp.concatenate([2 * cells, 2 * cells + 1])
    x, y = _corners(flat, numbers)
    area = jnp.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))
    wide = jnp.maximum(_span(x), _span(y))
    shown = jnp.concatenate([drawable, drawable]) & (area <= largest * stride * stride) & (area > 0) & (wide > 0)
    narrow, broad = shown & (wide <= _NARROW), shown & (wide > _NARROW) & (wide <= WIDEST)
    tiers = [(_compact(narrow), narrow.sum(), _NARROW), (_compact(broad), broad.sum(), WIDEST)]
    objects = target.reshape(-1)
    nearest = jnp.full(target.size, _FAR, jnp.float32)
    for order, count, window in tiers:
        nearest = _scatter(flat, order, count, window, objects, target.shape, nearest, None)
    winner = jnp.full(target.size, 2 * h * w, jnp.int32)
    for order, count, window in tiers:
        winner = _scatter(flat, order, count, window, objects, target.shape, winner, nearest)
    uv, valid = _resolve(flat, winner, 2 * h * w, target.shape, stride)
    return Drawn(uv, valid, (shown & (wide > WIDEST)).sum().astype(jnp.int32))


def _compact(mask: Bool[Array, "n"]) -> Int[Array, "padded"]:
    padded = mask.shape[0] + _BLOCK
    return jnp.nonzero(mask, size=padded, fill_value=0)[0].astype(jnp.int32)


def _corners(flat: _Flat, number: Int[Array, "n"]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """x and y of the three corners; even numbers are the upper left half of a cell, odd ones the lower right half."""
    index = _vertices(flat, number)
    return tuple(flat.x[i] for i in index), tuple(flat.y[i] for i in index)


def _vertices(flat: _Flat, number: Int[Array, "n"]) -> tuple[Array, Array, Array]:
    cells = flat.x.shape[0]
    cell, lower = number // 2, number % 2 == 1
    right, below = cell + 1, cell + flat.width
    last = cells - 1
    first = jnp.where(lower, below + 1, cell)
    return tuple(jnp.clip(i, 0, last) for i in (first, right, below))  # pyright: ignore[reportReturnType]


def _span(x: tuple[Array, ...]) -> Int[Array, "n"]:
    """How many pixel centres lie between the smallest and the largest of three coordinates."""
    low, high = jnp.minimum(jnp.minimum(x[0], x[1]), x[2]), jnp.maximum(jnp.maximum(x[0], x[1]), x[2])
    low, high = jnp.clip(low, -1e6, 1e6), jnp.clip(high, -1e6, 1e6)
    return (jnp.floor(high - 0.5) - jnp.ceil(low - 0.5) + 1).astype(jnp.int32)


def _first(x: tuple[Array, ...]) -> Int[Array, "n"]:
    low = jnp.minimum(jnp.minimum(x[0], x[1]), x[2])
    return jnp.ceil(jnp.clip(low, -1e6, 1e6) - 0.5).astype(jnp.int32)


def _scatter(
    flat: _Flat, order: Array, count: Array, window: int, objects: Array, shape: tuple[int, ...], image: Array,
    nearest: Array | None,
) -> Array:  # fmt: skip
    """One scatter over `count` triangles: depths into an image, or (with `nearest`) numbers of the winners."""
    height, width = shape
    total = flat.x.shape[0]

    def block(start: Array, image: Array) -> Array:
        chosen = jax.lax.dynamic_slice_in_dim(order, start * _BLOCK, _BLOCK)
        real = start * _BLOCK + jnp.arange(_BLOCK, dtype=jnp.int32) < count
        number = jnp.where(chosen < total, 2 * chosen, 2 * (chosen - total) + 1)
        index = _vertices(flat, number)
        x, y = tuple(flat.x[i] for i in index), tuple(flat.y[i] for i in index)
        near = jnp.minimum(jnp.minimum(flat.depth[index[0]], flat.depth[index[1]]), flat.depth[index[2]])
        owner, left, top = flat.object[number // 2], _first(x), _first(y)

        def at(step: Array, image: Array) -> Array:
            column, row = left + step % window, top + step // window
            px, py = column.astype(jnp.float32) + 0.5, row.astype(jnp.float32) + 0.5
            inside = real & (column >= 0) & (column < width) & (row >= 0) & (row < height) & _inside(x, y, px, py)
            pixel = jnp.where(inside, row * width + column, 0)
            inside = inside & (objects[pixel] == owner)
            if nearest is None:
                return image.at[jnp.where(inside, pixel, height * width)].min(near, mode="drop")
            inside = inside & (near == nearest[pixel])
            return image.at[jnp.where(inside, pixel, height * width)].min(number, mode="drop")

        return jax.lax.fori_loop(0, window * window, at, image)

    return jax.lax.fori_loop(0, (count + _BLOCK - 1) // _BLOCK, block, image)


def _inside(x: tuple[Array, ...], y: tuple[Array, ...], px: Array, py: Array) -> Bool[Array, "n"]:
    """Whether a point lies in a triangle of either orientation, edges included whatever their rounding."""
    e = [(x[j] - x[i]) * (py - y[i]) - (y[j] - y[i]) * (px - x[i]) for i, j in ((0, 1), (1, 2), (2, 0))]
    low, high = jnp.minimum(jnp.minimum(e[0], e[1]), e[2]), jnp.maximum(jnp.maximum(e[0], e[1]), e[2])
    slack = 1e-5 * jnp.abs(e[0] + e[1] + e[2])
    return (low >= -slack) | (high <= slack)


def _resolve(flat: _Flat, winner: Array, none: int, shape: tuple[int, ...], stride: int) -> tuple[Array, Array]:
    """Source coordinates from the winning triangles, by their barycentric weights."""
    valid = winner < none
    number = jnp.where(valid, winner, 0)
    index = _vertices(flat, number)
    (x0, x1, x2), (y0, y1, y2) = (tuple(c[i] for i in index) for c in (flat.x, flat.y))
    pixel = jnp.arange(winner.shape[0], dtype=jnp.int32)
    px = (pixel % shape[1]).astype(jnp.float32) + 0.5
    py = (pixel // shape[1]).astype(jnp.float32) + 0.5
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    inverse = jnp.where(area == 0, 0, 1 / jnp.where(area == 0, 1, area))
    b = ((px - x0) * (y2 - y0) - (x2 - x0) * (py - y0)) * inverse
    c = ((x1 - x0) * (py - y0) - (px - x0) * (y1 - y0)) * inverse

    def coordinate(of: tuple[Array, ...]) -> Array:
        a0, a1, a2 = (i.astype(jnp.float32) * stride + 0.5 for i in of)
        return a0 + b * (a1 - a0) + c * (a2 - a0)

    u = coordinate(tuple(i % flat.width for i in index))
    v = coordinate(tuple(i // flat.width for i in index))
    uv = jnp.where(valid[:, None], jnp.stack([u, v], -1), 0)
    return uv.reshape(*shape, 2), valid.reshape(shape)
