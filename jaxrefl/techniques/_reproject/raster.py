"""Moved images: a grid mesh whose vertices are the pixels of one image, drawn into another with a depth test.

Vertex positions [h w] -> for each target pixel the source coordinate it shows. Two scatters per pass, first the
smallest depth, then the smallest triangle number among those at that depth: ties are decided the same way in every
run. Triangles that cover a few pixels go in one pass over whole blocks of cells, the larger ones are compacted into a
second one, and those wider than `WIDEST` are dropped and counted. Loops run as often as there is something to draw.

Source: [XWD17] §3.2.2, the grid method.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float, Int

from jaxrefl.core import apart, together

WIDEST = 8
"""Most pixels that a triangle's box may span in x or y."""
_NARROW = 2
_BLOCK = 2048
"""Cells in a block of consecutive ones."""
_FEW = 2048
"""Cells in a block of compacted ones."""
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
    """The mesh as flat arrays, padded so that every vertex has neighbours; those of drawn cells are real ones."""

    x: Float[Array, "n"]
    y: Float[Array, "n"]
    depth: Float[Array, "n"]
    object: Int[Array, "n"]
    drawable: Bool[Array, "n"]
    largest: Float[Array, ""]
    """Largest area of a triangle, square pixels."""
    width: int = eqx.field(static=True)


class _Target(eqx.Module):
    """The image that is drawn into."""

    object: Int[Array, "m"]
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)


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
    flat = _flatten(mesh, largest * stride * stride)
    image = _Target(target.reshape(-1), target.shape[1], target.shape[0])
    none = 2 * mesh.depth.size
    wide = _widths(flat, mesh.depth.size)
    tiers = (_whole_blocks((wide > 0) & (wide <= _NARROW)), _gathered((wide > _NARROW) & (wide <= WIDEST)))
    nearest = jnp.full(target.size, _FAR, jnp.float32)
    for cells in tiers:
        nearest = _scatter(flat, cells, image, nearest, None)
    winner = jnp.full(target.size, none, jnp.int32)
    for cells in tiers:
        winner = _scatter(flat, cells, image, winner, nearest)
    valid = winner < none
    uv = apart(valid, functools.partial(_resolve, stride=stride), flat, winner, valid, image)
    uv = jnp.where(valid[:, None], jnp.stack([jnp.real(uv), jnp.imag(uv)], -1), 0)
    return Drawn(uv.reshape(*target.shape, 2), valid.reshape(target.shape), (wide > WIDEST).sum().astype(jnp.int32))


def _flatten(mesh: GridMesh, largest: float) -> _Flat:
    h, w = mesh.depth.shape
    inner = (jnp.arange(h) < h - 1)[:, None] & (jnp.arange(w) < w - 1)[None, :]
    padding = w + 1 + -(h * w) % _BLOCK

    def flat(x: Array) -> Array:
        return jnp.pad(x.reshape(-1), (0, padding))

    return _Flat(flat(mesh.xy[..., 0]), flat(mesh.xy[..., 1]), flat(mesh.depth), flat(mesh.object),
                 flat(mesh.connected & inner), jnp.asarray(largest, jnp.float32), w)  # fmt: skip


class _Cells(NamedTuple):
    """Which cells to draw."""

    window: int
    """Pixels that their triangles span."""
    size: int
    """Cells per block."""
    first: Int[Array, "b"] | None
    """First cells of blocks of consecutive ones, or None:"""
    order: Int[Array, "n"] | None
    """the numbers of the cells, -1 for none."""
    blocks: Int[Array, ""]
    """How many blocks there are."""


def _whole_blocks(triangles: Bool[Array, "n 2"]) -> _Cells:
    """Blocks of consecutive cells that have such triangles: they are read without gathers."""
    cells = triangles.any(-1)
    cells = jnp.pad(cells, (0, -cells.shape[0] % _BLOCK)).reshape(-1, _BLOCK).any(-1)
    first = jnp.nonzero(cells, size=cells.shape[0], fill_value=0)[0].astype(jnp.int32) * _BLOCK
    return _Cells(_NARROW, _BLOCK, first, None, cells.sum())


def _gathered(triangles: Bool[Array, "n 2"]) -> _Cells:
    """Single cells that have such triangles."""
    cells = triangles.any(-1)
    n = cells.shape[0]
    rank = jax.lax.associative_scan(jnp.add, cells.astype(jnp.int32))  # several times as fast as cumsum or nonzero
    place = jnp.where(cells, rank - 1, n + _FEW)
    order = jnp.full(n + _FEW, -1, jnp.int32).at[place].set(jnp.arange(n, dtype=jnp.int32), mode="drop")
    return _Cells(WIDEST, _FEW, None, order, (rank[-1] + _FEW - 1) // _FEW)


class _Triangles(NamedTuple):
    """The upper left or the lower right halves of some cells."""

    x: tuple[Array, Array, Array]
    y: tuple[Array, Array, Array]
    near: Array
    """Smallest depth of the three vertices."""
    object: Array
    width: Array
    """How many pixel centres it spans in x or y; 0 for what is not drawn."""


def _triangles(flat: _Flat, at: Callable[[Array, int], Array], *, lower: Array | bool) -> _Triangles:
    """Triangles of cells, from a function that reads an array at their vertices: 0, 1, width, width + 1 further on."""

    def corners(of: Array) -> tuple[Array, Array, Array]:
        return jnp.where(lower, at(of, flat.width + 1), at(of, 0)), at(of, 1), at(of, flat.width)

    x, y, depth = corners(flat.x), corners(flat.y), corners(flat.depth)
    area = jnp.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))
    shown = at(flat.drawable, 0) & (area <= flat.largest) & (area > 0)
    width = jnp.where(shown, jnp.maximum(jnp.maximum(_span(x), _span(y)), 0), 0)
    return _Triangles(x, y, jnp.minimum(jnp.minimum(depth[0], depth[1]), depth[2]), at(flat.object, 0), width)


def _widths(flat: _Flat, count: int) -> Int[Array, "n 2"]:
    def at(of: Array, offset: int) -> Array:
        return of[offset : offset + count]

    return jnp.stack([_triangles(flat, at, lower=lower).width for lower in (False, True)], -1)


def _span(x: tuple[Array, ...]) -> Int[Array, "n"]:
    """How many pixel centres lie between the smallest and the largest of three coordinates."""
    low, high = jnp.minimum(jnp.minimum(x[0], x[1]), x[2]), jnp.maximum(jnp.maximum(x[0], x[1]), x[2])
    low, high = jnp.clip(low, -1e6, 1e6), jnp.clip(high, -1e6, 1e6)
    return (jnp.floor(high - 0.5) - jnp.ceil(low - 0.5) + 1).astype(jnp.int32)


def _first(x: tuple[Array, ...]) -> Int[Array, "n"]:
    low = jnp.minimum(jnp.minimum(x[0], x[1]), x[2])
    return jnp.ceil(jnp.clip(low, -1e6, 1e6) - 0.5).astype(jnp.int32)


def _scatter(flat: _Flat, cells: _Cells, target: _Target, image: Array, nearest: Array | None) -> Array:
    """One scatter over all triangles: depths into an image, or (with `nearest`) numbers of the winners."""
    window, least = cells.window, 0 if cells.window == _NARROW else _NARROW

    def block(number: Array, image: Array) -> Array:
        if cells.order is None:
            start = cells.first[number]  # pyright: ignore[reportOptionalSubscript]
            index = start + jnp.arange(cells.size, dtype=jnp.int32)

            def at(of: Array, offset: int) -> Array:
                return jax.lax.dynamic_slice_in_dim(of, start + offset, cells.size)
        else:
            index = jax.lax.dynamic_slice_in_dim(cells.order, number * cells.size, cells.size)

            def at(of: Array, offset: int) -> Array:
                return of[jnp.maximum(index, 0) + offset]

        def half(lower: Array, image: Array) -> Array:
            triangle = _triangles(flat, at, lower=lower == 1)
            real = (index >= 0) & (triangle.width > least) & (triangle.width <= window)
            left, top = _first(triangle.x), _first(triangle.y)

            def step(i: Array, image: Array) -> Array:
                column, row = left + i % window, top + i // window
                px, py = column.astype(jnp.float32) + 0.5, row.astype(jnp.float32) + 0.5
                inside = (column >= 0) & (column < target.width) & (row >= 0) & (row < target.height)
                inside = real & inside & _inside(triangle.x, triangle.y, px, py)
                pixel = jnp.where(inside, row * target.width + column, 0)
                inside = inside & (target.object[pixel] == triangle.object)
                if nearest is None:
                    return image.at[jnp.where(inside, pixel, image.shape[0])].min(triangle.near, mode="drop")
                inside = inside & (triangle.near == nearest[pixel])
                return image.at[jnp.where(inside, pixel, image.shape[0])].min(2 * index + lower, mode="drop")

            return jax.lax.fori_loop(0, window * window, step, image)

        return jax.lax.fori_loop(0, 2, half, image)

    return jax.lax.fori_loop(0, cells.blocks, block, image)


def _inside(x: tuple[Array, ...], y: tuple[Array, ...], px: Array, py: Array) -> Bool[Array, "n"]:
    """Whether a point lies in a triangle of either orientation, edges included whatever their rounding."""
    e = [(x[j] - x[i]) * (py - y[i]) - (y[j] - y[i]) * (px - x[i]) for i, j in ((0, 1), (1, 2), (2, 0))]
    low, high = jnp.minimum(jnp.minimum(e[0], e[1]), e[2]), jnp.maximum(jnp.maximum(e[0], e[1]), e[2])
    slack = 1e-5 * jnp.abs(e[0] + e[1] + e[2])
    return (low >= -slack) | (high <= slack)


def _resolve(flat: _Flat, winner: Array, valid: Array, target: _Target, *, stride: int) -> Complex[Array, "m"]:
    """Source coordinates from the winning triangles, by their barycentric weights."""
    number = jnp.where(valid, winner, 0)
    cell, lower = number // 2, number % 2 == 1
    (x0, x1, x2), (y0, y1, y2), *_ = _triangles(flat, lambda of, offset: of[cell + offset], lower=lower)
    pixel = jnp.arange(winner.shape[0], dtype=jnp.int32)
    px = (pixel % target.width).astype(jnp.float32) + 0.5
    py = (pixel // target.width).astype(jnp.float32) + 0.5
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    inverse = jnp.where(area == 0, 0, 1 / jnp.where(area == 0, 1, area))
    b = ((px - x0) * (y2 - y0) - (x2 - x0) * (py - y0)) * inverse
    c = ((x1 - x0) * (py - y0) - (px - x0) * (y1 - y0)) * inverse
    # The first vertex of the lower half is the corner across.
    across = jnp.where(lower, 1 - b - c, 0)
    column, row = (cell % flat.width).astype(jnp.float32), (cell // flat.width).astype(jnp.float32)
    return together((column + across + b) * stride + 0.5, (row + across + c) * stride + 0.5)
