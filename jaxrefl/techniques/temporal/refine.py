"""Backward search: the sub-pixel place in the key frame whose reflected point lies on a pixel's mirror ray.

Mirror rays of now + start coordinates + key frame -> coordinates, and how far they are off. With the surface point W',
the mirror direction w and the bilinear reflected point R(u, v) of the key frame,

    R(u, v) - W' = s w                 for some s > 0.

Newton's step solves R - W' + du R_u + dv R_v = s w by Cramer's rule: it is exact where what is reflected is flat. The
last step that would still follow is the residual, in key-frame pixels.

Beyond [XWD17], which takes what its mesh shows: there the interpolated offsets decide, here the law of reflection does.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Rays
from jaxrefl.core import apart, together
from jaxrefl.rays import block_size, blocks_of, put_block, take_block
from jaxrefl.techniques._reproject import SNAP, footprint
from jaxrefl.techniques.temporal.flat import Triple, along, cross3, dot3, split
from jaxrefl.techniques.temporal.kept import Kept
from jaxrefl.techniques.temporal.types import Options

_LONGEST = 4.0
"""Longest step in key-frame pixels."""


class Refined(eqx.Module):
    """Places in the key frame."""

    uv: Float[Array, "*b 2"]
    """Coordinates, pixels."""
    residual: Float[Array, "*b"]
    """Length of the step that would still follow, pixels; infinite where there is none."""
    tangent: Float[Array, "*b"]
    """Tangent of the angle between mirror ray and reflected point; infinite where it lies behind."""


def refine(
    kept: Kept,
    mirrors: Rays,
    smooth: Bool[Array, "h w"],
    uv: Float[Array, "h w 2"],
    wanted: Bool[Array, "h w"],
    *,
    options: Options,
) -> Refined:
    """Places in the key frame whose reflected points lie on the mirror rays of pixels.

    Args:
        kept: The key frame.
        mirrors: Surface points and mirror directions of now [h w].
        smooth: Pixels whose place moves; the others are only evaluated where they are.
        uv: Coordinates to start from.
        wanted: Pixels to refine.
        options: `refine_steps`, `block`.
    Returns:
        Coordinates [h w]; elsewhere `uv` with an infinite residual.
    Edge cases: between a point and the environment, or between two things, the residual means nothing: the caller
        must look at `CONNECTED`.
    """
    infinite = jnp.full(wanted.shape, jnp.inf, jnp.float32)
    result = Refined(jnp.copy(uv), infinite, jnp.copy(infinite))
    for index in blocks_of(wanted, size=block_size(wanted.size, options.block)):
        block = _refine_block(kept, (mirrors, smooth, uv), index, options.refine_steps)
        result = put_block(index, result, block)
    return result


@functools.partial(jax.jit, static_argnums=3)
def _refine_block(
    kept: Kept,
    pixels: tuple[Rays, Bool[Array, "h w"], Float[Array, "h w 2"]],
    index: Int[Array, "n"],
    steps: int,
) -> Refined:
    mirrors, smooth, start = take_block(pixels, index)
    p, w = split(mirrors.origin), split(mirrors.direction)

    def move(_: Array, place: Array) -> Array:
        u, v = jnp.real(place), jnp.imag(place)
        du, dv, _, _ = _step(kept, p, w, u, v)
        length = jnp.sqrt(du * du + dv * dv)
        shorten = jnp.where(smooth, jnp.minimum(1, _LONGEST / jnp.maximum(length, 1e-6)), 0)
        return together(u + shorten * du, v + shorten * dv)

    place = jax.lax.fori_loop(0, steps, move, together(start[:, 0], start[:, 1]))
    u, v = jnp.real(place), jnp.imag(place)

    def judge(u: Array, v: Array) -> Array:
        du, dv, usable, angle = _step(kept, p, w, u, v)
        return together(jnp.where(usable, jnp.sqrt(du * du + dv * dv), jnp.inf), angle)

    off = apart(index >= 0, judge, u, v)
    return Refined(jnp.stack([u, v], -1), jnp.real(off), jnp.imag(off))


def _step(kept: Kept, p: Triple, w: Triple, u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
    """Newton's step from (u, v), 0 where there is none; whether (u, v) lies in the image and has one; and the tangent
    of the angle between ray and point there, infinite behind."""
    at = footprint(jnp.stack([u, v], -1), shape=kept.shape, snap=SNAP)
    c00, c10, c01, c11 = (tuple(x[i] for x in kept.reflected) for i in at.corners)
    fx, fy = at.fx, at.fy

    def mix(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array, Array]:
        upper, lower = a + fx * (b - a), c + fx * (d - c)
        return upper + fy * (lower - upper), (b - a) + fy * ((d - c) - (b - a)), lower - upper

    mixed = [mix(*values) for values in zip(c00, c10, c01, c11, strict=True)]
    point, along_u, along_v = ((mixed[0][i], mixed[1][i], mixed[2][i]) for i in range(3))
    offset = along(point, -mixed[3][0], p)
    across_u, across_v = cross3(along_v, w), cross3(w, along_u)
    det, ahead = dot3(along_u, across_u), dot3(offset, w)
    in_front = ahead > 0
    near = jnp.where(in_front, 1 / jnp.where(in_front, ahead, 1), 0)
    usable = in_front & (jnp.abs(det * near * near) > 1e-20)
    inverse = jnp.where(usable, 1 / jnp.where(usable, det, 1), 0)
    aside = along(offset, -ahead, w)
    angle = jnp.where(in_front, jnp.sqrt(dot3(aside, aside)) * near, jnp.inf)
    return -dot3(offset, across_u) * inverse, -dot3(offset, across_v) * inverse, usable & at.inside, angle
