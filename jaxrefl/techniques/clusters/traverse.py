"""Rays through depth images: Rays + Views + DepthImages -> where each ray first meets what its depth image shows.

A ray is seen as a line in the image, along which its 1 / z is linear; so is that of a texel's plane. The line is
followed from its near to its far end in steps of one texel. Where the ray goes from before to behind a texel's plane
within one step, it meets the surface. Where it is suddenly behind what the texel shows, it has gone behind the edge of
something: what it meets there the image does not know, until it comes out again.

Source: [WXKP14] §3.4.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Rays
from jaxrefl.core import together
from jaxrefl.rays.views import Views, dot_axis, in_view
from jaxrefl.techniques.clusters.types import Found

_BLOCK = 1024
"""Rays that are followed together, until the last of them has ended."""
_ROUND = 16
"""Steps after which the rays that have ended are put aside."""
_AT_ONCE = 2
"""First steps, that all rays take together; those of planar clusters need one."""
TOUCH = 1e-3
"""How far behind a surface a ray may start, as a share of its 1 / z, and still count as lying on it."""


class Crossing(eqx.Module):
    """How each ray ended [n]."""

    found: Int[Array, "n"]
    """A `Found` code."""
    share: Float[Array, "n"]
    """Where the hit is on the ray's image, from 0 at its near end to 1 at its far end."""
    texel: Int[Array, "n"]
    """The texel whose plane was hit, in the list of all; 0 where none was."""
    steps: Int[Array, "n"]
    """Steps from the first texel to the one whose plane was hit; all that were taken where none was."""


class Lines(eqx.Module):
    """Images of rays [n]."""

    start: Float[Array, "n 2"]
    """Near end in the view's image, texels."""
    end: Float[Array, "n 2"]
    """Far end."""
    start_z: Float[Array, "n"]
    """1 / z of the near end."""
    end_z: Float[Array, "n"]
    """1 / z of the far end."""
    size: Int[Array, "n 2"]
    """Texels of the view (width, height)."""
    offset: Int[Array, "n"]
    """First texel of the view."""
    within: Float[Array, "n"]
    """Share of the line, from its start on, that lies in the image."""


@jax.jit
def project_rays(
    views: Views, view: Int[Array, "n"], rays: Rays, reach: Float[Array, "n"]
) -> tuple[Lines, Bool[Array, "n"]]:
    """Images of rays in their views.

    Args:
        views: The views.
        view: View of each ray.
        rays: The rays.
        reach: Their lengths, world units.
    Returns:
        Lines, and which rays begin and end in the half space ahead of their view.
    """
    near, near_z = in_view(views, view, rays.origin)
    along = jnp.stack([dot_axis(views, view, rays.direction, i) for i in range(3)], -1) * reach[:, None]
    far, far_z = near + along[:, :2], near_z + along[:, 2]
    ahead = (near_z > 0) & (far_z > 0)
    inverse = [1 / jnp.where(ahead, z, 1) for z in (near_z, far_z)]
    low, pitch = views.low[view], views.pitch[view]
    ends = [(x * i[:, None] - low) / pitch for x, i in zip((near, far), inverse, strict=True)]
    size = views.size[view]
    limit = jnp.where(ends[1] > ends[0], size.astype(jnp.float32), 0)
    leaves = (ends[1] < 0) | (ends[1] > size.astype(jnp.float32))
    share = jnp.where(leaves, (limit - ends[0]) / jnp.where(leaves, ends[1] - ends[0], 1), 1)
    within = jnp.clip(share.min(-1), 0, 1)
    return Lines(ends[0], ends[1], inverse[0], inverse[1], size, views.offset[view], within), ahead


def distance_along(lines: Lines, share: Float[Array, "n"], reach: Float[Array, "n"]) -> Float[Array, "n"]:
    """How far along their rays points on their images lie.

    Args:
        lines: Images of the rays.
        share: Where the points are, from 0 at the near end to 1 at the far end.
        reach: Lengths of the rays, world units.
    Returns:
        World units.
    """
    depth = lines.start_z + (lines.end_z - lines.start_z) * share
    return reach * share * lines.end_z / jnp.where(depth > 0, depth, 1)


class Texels(NamedTuple):
    """What a walk reads of depth images, each [m]."""

    level: Array
    """1 / z at texels' centres."""
    slope_x: Array
    slope_y: Array
    """Its change from texel to texel."""
    begin: Array | None
    """1 / z beyond which nothing is known; None: there is no such limit."""


def texels_of(plane: Float[Array, "m 3"], begin: Float[Array, "m"] | None) -> Texels:
    """Depth images, component by component: XLA gathers single numbers faster than rows."""
    return Texels(plane[:, 0], plane[:, 1], plane[:, 2], begin)


class Walk(NamedTuple):
    """Rays on their way."""

    plane: Array
    """How far the ray is before the plane of the last step's texel, a + b share of its length, as a + i b."""
    plane_before: Array
    """The same of the step before."""
    unknown: Array
    """True: nearer than where the image of the last step's texel begins."""
    front: Array
    """True: before what the texel shows."""
    hidden: Array
    """True: has been behind something, or where nothing is known."""
    done: Array
    share: Array
    """Where it ended, 1 at the far end."""
    last: Array
    """Step whose texel's plane was hit; -1 for none."""


@functools.partial(jax.jit, static_argnames="steps")
def follow(
    plane: Float[Array, "m 3"], lines: Lines, active: Bool[Array, "n"], *, steps: int,
    begin: Float[Array, "m"] | None = None,
) -> Crossing:  # fmt: skip
    """Follow rays through their depth images.

    Args:
        plane: Of `DepthImages`.
        lines: Images of the rays.
        active: Which rays to follow; the others are `NO_CAMERA`.
        steps: Most steps; longer lines take longer ones.
        begin: Of `DepthImages`.
    Returns:
        Crossings.
    Edge cases: a ray whose image is a point, as those of planar clusters are, takes one step. A ray that starts
        behind what is seen, further than rounding explains, starts hidden.
    Source: [WXKP14] §3.4.
    Differs from the source: it takes any crossing of the two polylines for a hit, that of the step from the
        background to an object before it too; here both texels' planes are asked first, and a crossing within the
        texel that shows the plane counts though the next texel shows what is far behind it.
    """
    planes = texels_of(plane, begin)
    n = active.shape[0]
    number = steps_of(lines, active, steps)
    # What all rays do first needs no blocks; those of planar clusters have ended after that.
    walk = _advance(planes, lines, number, begin_walk(planes, lines, number), jnp.full((), 2, jnp.int32), _AT_ONCE)

    def unfinished(state: tuple[Walk, Array]) -> Array:
        return ~state[0].done.all()

    def one_round(state: tuple[Walk, Array]) -> tuple[Walk, Array]:
        """A few steps for all rays that are still on their way, block by block of those alone."""
        walk, step = state
        rank = jax.lax.associative_scan(jnp.add, (~walk.done).astype(jnp.int32))
        order = jnp.full(n + _BLOCK, n, jnp.int32)
        place = jnp.where(walk.done, n + _BLOCK, rank - 1)
        order = order.at[place].set(jnp.arange(n, dtype=jnp.int32), mode="drop")

        def block(i: Array, walk: Walk) -> Walk:
            index = jax.lax.dynamic_slice_in_dim(order, i * _BLOCK, _BLOCK)
            safe = jnp.minimum(index, n - 1)
            some, part, many = jax.tree.map(lambda x: x[safe], (lines, walk, number))
            part = part._replace(done=part.done | (index >= n))
            part = _advance(planes, some, many, part, step, _ROUND)
            return jax.tree.map(lambda x, y: x.at[index].set(y, mode="drop"), walk, part)

        return jax.lax.fori_loop(0, (rank[-1] + _BLOCK - 1) // _BLOCK, block, walk), step + _ROUND

    start = (walk, jnp.full((), 2 + _AT_ONCE, jnp.int32))
    return finish_walk(lines, number, jax.lax.while_loop(unfinished, one_round, start)[0], active)


def steps_of(lines: Lines, active: Array, most: int) -> Int[Array, "n"]:
    """Steps of a texel or less that each line takes; longer ones where that would be more than `most`."""
    length = jnp.ceil(jnp.abs(lines.end - lines.start).max(-1))
    return jnp.where(active, jnp.clip(length, 1, most), 0).astype(jnp.int32)


def place_on(lines: Lines, share: Array) -> tuple[Array, Array]:
    """Column and row of the texel at a share of each ray's length."""
    at = lines.start + (lines.end - lines.start) * share[:, None]
    column, row = jnp.floor(at[:, 0]).astype(jnp.int32), jnp.floor(at[:, 1]).astype(jnp.int32)
    most = jnp.maximum(lines.size - 1, 0)
    return jnp.clip(column, 0, most[:, 0]), jnp.clip(row, 0, most[:, 1])


def begin_walk(planes: Texels, lines: Lines, number: Array) -> Walk:
    """Rays at their near ends, for `number` steps each."""
    zero = jnp.zeros_like(lines.start_z)
    first, second = (plane_at(planes, lines, number, jnp.full((), i, jnp.int32)) for i in range(2))
    touching = jnp.real(first) > -TOUCH * lines.start_z
    unknown = is_unknown(planes, lines, number, jnp.full((), 1, jnp.int32))
    return Walk(second, first, unknown, touching, ~touching, number <= 0, zero + 1, jnp.full(zero.shape, -1, jnp.int32))


def share_at(number: Array, step: Array) -> Array:
    """Share of each ray's length after some steps."""
    return jnp.minimum(step.astype(jnp.float32) / jnp.maximum(number, 1).astype(jnp.float32), 1)


def plane_at(planes: Texels, lines: Lines, number: Array, step: Array) -> Array:
    """How far each ray is before the plane of its texel at a step: a + b share, as a + i b."""
    at, column, row = _texel_at(lines, number, step)
    z, gx, gy = planes.level[at], planes.slope_x[at], planes.slope_y[at]
    u = lines.start[:, 0] - column.astype(jnp.float32) - 0.5
    v = lines.start[:, 1] - row.astype(jnp.float32) - 0.5
    dx, dy = lines.end[:, 0] - lines.start[:, 0], lines.end[:, 1] - lines.start[:, 1]
    ahead = lines.start_z - (z + gx * u + gy * v)
    change = lines.end_z - lines.start_z - (gx * dx + gy * dy)
    return together(ahead, change)


def is_unknown(planes: Texels, lines: Lines, number: Array, step: Array) -> Bool[Array, "n"]:
    """Whether rays are, at a step, nearer than where the image of their texel begins."""
    if planes.begin is None:
        return jnp.zeros(number.shape, bool)
    at, _, _ = _texel_at(lines, number, step)
    z = lines.start_z + (lines.end_z - lines.start_z) * share_at(number, step)
    return z > planes.begin[at] * (1 + TOUCH)


def _texel_at(lines: Lines, number: Array, step: Array) -> tuple[Array, Array, Array]:
    column, row = place_on(lines, share_at(number, step))
    return lines.offset + row * jnp.maximum(lines.size[:, 0], 1) + column, column, row


class Meeting(NamedTuple):
    """One step of a ray over the planes of two texels [n]."""

    hit: Array
    """It went through one of them."""
    before: Array
    """That of the texel it came from."""
    place: Array
    """Where, as a share of its length."""
    front: Array
    """It is before the plane of the texel it came to."""
    lost: Array
    """It was before all that is shown and is now behind it, and went through neither plane."""


def meet(
    lines: Lines, plane: Array, plane_before: Array, was_at: Array, now_at: Array, front: Array
) -> Meeting:  # fmt: skip
    """What happens in one step.

    Args:
        lines: Images of the rays.
        plane: Of the texel the ray comes to, as `plane_at` has it.
        plane_before: Of the texel it comes from.
        was_at: Share of the ray's length before the step.
        now_at: And after it.
        front: Whether it was before what is shown.
    Returns:
        The meeting.
    """
    a, b = jnp.real(plane), jnp.imag(plane)
    c, d = jnp.real(plane_before), jnp.imag(plane_before)
    now, was, old_now, old_was = a + b * now_at, a + b * was_at, c + d * now_at, c + d * was_at
    through = front & (old_now <= 0)  # what is before all that is shown begins the step before this plane too
    part_before = old_was / jnp.where(through & (old_was > old_now), old_was - old_now, 1)
    place_before = was_at + (now_at - was_at) * jnp.clip(part_before, 0, 1)
    # Within the texel that shows the plane there is nothing beyond it, whatever the next texel shows.
    within = through & _same_texel(lines, was_at, place_before)
    crossed = front & (now <= 0)
    here = crossed & (was > 0) & ~within
    there = within | (crossed & ~here & through)
    part = was / jnp.where(here, was - now, 1)
    place = jnp.where(here, was_at + (now_at - was_at) * part, place_before)
    hit = here | there
    return Meeting(hit, there, place, now > 0, crossed & ~hit)


def _same_texel(lines: Lines, a: Array, b: Array) -> Bool[Array, "n"]:
    """Whether two places on rays' images are in one texel."""
    (xa, ya), (xb, yb) = place_on(lines, a), place_on(lines, b)
    return (xa == xb) & (ya == yb)


def _advance(planes: Texels, lines: Lines, number: Array, walk: Walk, step: Array, count: int) -> Walk:
    """Take `count` steps, of which `step` is the first whose plane has not been read.

    A step reads the plane of its texel and does no more; it is tested in the next one. So what is gathered has one
    consumer, and XLA, which computes a fusion anew for each, gathers it once.
    """
    last = step + count

    def body(state: tuple[Array, Walk]) -> tuple[Array, Walk]:
        ahead, walk = state
        step = ahead - 1
        now_at, was_at = share_at(number, step), share_at(number, step - 1)
        going = ~walk.done
        met = meet(lines, walk.plane, walk.plane_before, was_at, now_at, walk.front)
        hit = going & met.hit
        return ahead + 1, Walk(
            plane=plane_at(planes, lines, number, ahead),
            plane_before=walk.plane,
            unknown=is_unknown(planes, lines, number, ahead),
            front=jnp.where(going, met.front, walk.front),
            hidden=walk.hidden | (going & (met.lost | (~met.hit & walk.unknown))),
            done=walk.done | hit | (now_at >= lines.within),
            share=jnp.where(hit, met.place, walk.share),
            last=jnp.where(hit, step - met.before.astype(jnp.int32), walk.last),
        )

    def on_the_way(state: tuple[Array, Walk]) -> Array:
        return (state[0] < last) & ~state[1].done.all()

    return jax.lax.while_loop(on_the_way, body, (step, walk))[1]


def finish_walk(lines: Lines, number: Array, walk: Walk, active: Array) -> Crossing:
    """How rays ended."""
    hit = active & (walk.last >= 0)
    seen = jnp.where(hit, int(Found.SURFACE), jnp.where(walk.front, int(Found.SKY), int(Found.HIDDEN)))
    seen = jnp.where(~hit & walk.front & (lines.within < 1), int(Found.OUTSIDE), seen)
    passed = walk.hidden & (hit | (walk.front & (lines.within >= 1)))
    found = jnp.where(active, jnp.where(passed, int(Found.PASSED), seen), int(Found.NO_CAMERA))
    at = jnp.minimum(walk.last.astype(jnp.float32) / jnp.maximum(number, 1).astype(jnp.float32), 1)
    column, row = place_on(lines, at)
    texel = jnp.where(hit, lines.offset + row * lines.size[:, 0] + column, 0)
    return Crossing(found.astype(jnp.int32), walk.share, texel, jnp.where(hit, walk.last, number))
