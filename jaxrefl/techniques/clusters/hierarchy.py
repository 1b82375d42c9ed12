"""Rays through depth images by their min-max pyramid: stretches in which nothing can be met are passed at once.

A cell of the pyramid holds the least and the largest 1 / z of its own planes and of those of the eight cells around it,
so one cell answers for all places that a ray from it reaches within as many texels as the cell is wide. Same crossings
as step by step; worth its cost where rays take many steps.

Source: [WXKP14] §3.4 has steps alone; [TIS08] Tevs, Ihrke, Seidel, "Maximum Mipmaps for Fast, Accurate, and Scalable
Dynamic Height Field Rendering", I3D 2008, has the pyramid.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl.rays.views import Views, place_texels
from jaxrefl.techniques.clusters.traverse import (
    TOUCH,
    Crossing,
    Lines,
    Texels,
    Walk,
    begin_walk,
    finish_walk,
    is_unknown,
    meet,
    place_on,
    plane_at,
    share_at,
    steps_of,
    texels_of,
)

_LEVELS = 6
"""Levels above the texels; a cell of the last is 64 texels wide."""
_REACH = 1.5
"""Texels from its centre up to which a texel's plane may be asked."""
_BLOCK = 4096
"""Rays that are followed together, until the last of them has ended."""


class Pyramid(eqx.Module):
    """Bounds of 1 / z, all levels of all views in one list."""

    low: Float[Array, "k"]
    """Least 1 / z of each cell and its neighbours."""
    high: Float[Array, "k"]
    """Largest."""
    begin: Float[Array, "k"] | None
    """Least 1 / z at which their images begin; None: at the clipping plane."""
    first: Int[Array, "l c"]
    """First cell of each level and view."""
    size: Int[Array, "l c 2"]
    """Cells (across, down)."""


@jax.jit
def pyramid_of(plane: Float[Array, "m 3"], views: Views, begin: Float[Array, "m"] | None = None) -> Pyramid:
    """Bounds of the planes of depth images.

    Args:
        plane: Of `DepthImages`.
        views: Their views.
        begin: Of `DepthImages`.
    Returns:
        The pyramid.
    """
    start_of = plane[:, 0] if begin is None else begin
    rise = _REACH * (jnp.abs(plane[:, 1]) + jnp.abs(plane[:, 2]))
    low, high = plane[:, 0] - rise, plane[:, 0] + rise
    level, lows, highs, begins, firsts, sizes, start = views, [], [], [], [], [], 0
    for number in range(1, _LEVELS + 1):
        size = (level.size + 1) // 2
        count = size[:, 0] * size[:, 1]
        coarse = dataclasses.replace(level, size=size, offset=jnp.cumsum(count) - count)
        # Views are at least 4 texels wide, which bounds what rounding up adds.
        cells = (plane.shape[0] >> number) + views.offset.shape[0]
        low, high = _halved(level, coarse, low, high, cells)
        wide_low, wide_high = _widened(coarse, low, high)
        start_of, _ = _halved(level, coarse, start_of, start_of, cells)
        begins.append(_widened(coarse, start_of, start_of)[0])
        lows.append(wide_low)
        highs.append(wide_high)
        firsts.append(coarse.offset + start)
        sizes.append(size)
        level, start = coarse, start + cells
    begins = None if begin is None else jnp.concatenate(begins)
    return Pyramid(jnp.concatenate(lows), jnp.concatenate(highs), begins, jnp.stack(firsts), jnp.stack(sizes))


def _cell(level: Views, view: Array, column: Array, row: Array) -> Array:
    """Number of a cell; the nearest one inside its view."""
    most = jnp.maximum(level.size[view] - 1, 0)
    column, row = jnp.clip(column, 0, most[:, 0]), jnp.clip(row, 0, most[:, 1])
    return level.offset[view] + row * level.size[view, 0] + column


def _halved(fine: Views, coarse: Views, low: Array, high: Array, cells: int) -> tuple[Array, Array]:
    view, column, row = place_texels(coarse, jnp.arange(cells, dtype=jnp.int32))
    children = [_cell(fine, view, 2 * column + x, 2 * row + y) for x in (0, 1) for y in (0, 1)]
    least = functools.reduce(jnp.minimum, [low[i] for i in children])
    return least, functools.reduce(jnp.maximum, [high[i] for i in children])


def _widened(level: Views, low: Array, high: Array) -> tuple[Array, Array]:
    """Bounds of each cell with its neighbours, first those beside it and then those above and below."""
    view, column, row = place_texels(level, jnp.arange(low.shape[0], dtype=jnp.int32))
    for dx, dy in ((1, 0), (0, 1)):
        beside = [_cell(level, view, column + s * dx, row + s * dy) for s in (-1, 1)]
        low = functools.reduce(jnp.minimum, [low, *(low[i] for i in beside)])
        high = functools.reduce(jnp.maximum, [high, *(high[i] for i in beside)])
    return low, high


@functools.partial(jax.jit, static_argnames="steps")
def follow_levels(
    plane: Float[Array, "m 3"], pyramid: Pyramid, lines: Lines, view: Int[Array, "n"], active: Bool[Array, "n"], *,
    steps: int, begin: Float[Array, "m"] | None = None,
) -> Crossing:  # fmt: skip
    """Follow rays through their depth images, as `follow` does.

    Args:
        plane: Of `DepthImages`.
        pyramid: Its bounds.
        lines: Images of the rays.
        view: View of each ray.
        active: Which rays to follow; the others are `NO_CAMERA`.
        steps: Most steps of a ray that passes nothing; longer lines take longer ones.
        begin: Of `DepthImages`.
    Returns:
        Crossings; `steps` counts single steps and tests of cells alike.
    """
    n = active.shape[0]
    padding = -n % _BLOCK

    def blocks(x: Array) -> Array:
        return jnp.pad(x, ((0, padding), *((0, 0),) * (x.ndim - 1))).reshape(-1, _BLOCK, *x.shape[1:])

    planes = texels_of(plane, begin)
    parts = jax.tree.map(blocks, (lines, view, active))
    ended = jax.lax.map(lambda part: _follow_block(planes, pyramid, part[0], part[1], part[2], steps), parts)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:n], ended)


def _follow_block(planes: Texels, pyramid: Pyramid, lines: Lines, view: Array, active: Array, steps: int) -> Crossing:
    number = steps_of(lines, active, steps)
    length = jnp.abs(lines.end - lines.start).max(-1)
    per_texel = number.astype(jnp.float32) / jnp.maximum(length, number.astype(jnp.float32))
    zero = jnp.zeros_like(number)

    def body(state: tuple[Walk, Array, Array, Array]) -> tuple[Walk, Array, Array, Array]:
        walk, at, level, count = state
        going = ~walk.done
        jump = jnp.floor(jnp.exp2(level.astype(jnp.float32)) * per_texel).astype(jnp.int32)
        passes = (level > 0) & (jump > 0) & _nothing_met(pyramid, lines, view, number, at, level, jump, walk)
        now_at, was_at = share_at(number, at + 1), share_at(number, at)
        before, ahead = plane_at(planes, lines, number, at), plane_at(planes, lines, number, at + 1)
        met = meet(lines, ahead, before, was_at, now_at, walk.front)
        single = going & (level == 0)
        hit = single & met.hit
        moved = jnp.where(passes, jump, jnp.where(level == 0, 1, 0))
        there = at + moved
        over = (moved > 0) & (share_at(number, there) >= lines.within)
        walk = Walk(
            plane=walk.plane,
            plane_before=walk.plane_before,
            unknown=walk.unknown,
            front=jnp.where(single, met.front, walk.front),
            hidden=walk.hidden | (single & (met.lost | (~met.hit & is_unknown(planes, lines, number, at + 1)))),
            done=walk.done | hit | over,
            share=jnp.where(hit, met.place, walk.share),
            last=jnp.where(hit, at + 1 - met.before.astype(jnp.int32), walk.last),
        )
        up = jnp.where(passes | (level == 0), jnp.minimum(level + 1, _LEVELS), level - 1)
        return walk, jnp.where(going, there, at), up, count + going.astype(jnp.int32)

    start = (begin_walk(planes, lines, number), zero, zero, zero)
    walk, _, _, count = jax.lax.while_loop(lambda state: ~state[0].done.all(), body, start)
    ended = finish_walk(lines, number, walk, active)
    return Crossing(ended.found, ended.share, ended.texel, count)


def _nothing_met(
    pyramid: Pyramid, lines: Lines, view: Array, number: Array, at: Array, level: Array, jump: Array, walk: Walk
) -> Bool[Array, "n"]:
    """Whether rays stay before, or behind, everything for the next steps."""
    share, then = share_at(number, at), share_at(number, at + jump)
    column, row = place_on(lines, share)
    row_of_level = jnp.maximum(level - 1, 0)
    cell = (row >> level) * pyramid.size[row_of_level, view, 0] + (column >> level)
    cell = pyramid.first[row_of_level, view] + cell
    change = lines.end_z - lines.start_z
    here, there = lines.start_z + change * share, lines.start_z + change * then
    before = jnp.minimum(here, there) > pyramid.high[cell]
    behind = jnp.maximum(here, there) < pyramid.low[cell]
    clear = jnp.where(walk.front, before, behind)
    if pyramid.begin is None:
        return clear
    return clear & (walk.hidden | (jnp.maximum(here, there) <= pyramid.begin[cell] * (1 + TOUCH)))
