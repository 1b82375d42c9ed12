"""Backward search: the sub-pixel place in the key frame whose reflected point lies on a pixel's mirror ray.

Mirror rays of now + start coordinates + key frame -> coordinates, and how far they are off. With the surface point W',
the mirror direction w and the bilinear reflected point R(u, v) of the key frame,

    r(u, v) = ((R - W') . a, (R - W') . b) / ((R - W') . w) = 0,

a and b perpendicular to w: the tangent of the angle between the ray and the point. Gauss-Newton, 2 x 2 by hand. The
last step that would still follow is the residual, in key-frame pixels.

Beyond [XWD17], which takes what its mesh shows: there the interpolated offsets decide, here the law of reflection does.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import GBuffer
from jaxrefl.core import frame_from_normal
from jaxrefl.rays import block_size, blocks_of, put_block, take_block
from jaxrefl.surface import mirror_direction
from jaxrefl.techniques._reproject import SNAP, components, footprint
from jaxrefl.techniques.temporal.flat import Triple, along, dot3
from jaxrefl.techniques.temporal.types import Options, ReflectionBuffer

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
    buffer: ReflectionBuffer,
    gbuffer: GBuffer,
    uv: Float[Array, "h w 2"],
    wanted: Bool[Array, "h w"],
    *,
    options: Options,
) -> Refined:
    """Places in the key frame whose reflected points lie on the mirror rays of pixels.

    Args:
        buffer: The key frame.
        gbuffer: What is seen now.
        uv: Coordinates to start from.
        wanted: Pixels to refine; mirrors move, rough surfaces are only evaluated where they are.
        options: `refine_steps`, `block`.
    Returns:
        Coordinates [h w]; elsewhere `uv` with an infinite residual.
    """
    image = _flat(buffer.reflected)
    infinite = jnp.full(wanted.shape, jnp.inf, jnp.float32)
    result = Refined(jnp.copy(uv), infinite, jnp.copy(infinite))
    for index in blocks_of(wanted, size=block_size(wanted.size, options.block)):
        result = put_block(
            index, result, _refine_block(image, buffer.t.shape, gbuffer, uv, index, options.refine_steps)
        )
    return result


_flat = jax.jit(components)


@functools.partial(jax.jit, static_argnums=(1, 5))
def _refine_block(
    image: tuple[Array, ...], shape: tuple[int, ...], gbuffer: GBuffer, uv: Array, index: Array, steps: int
) -> Refined:
    points = take_block(gbuffer, index)
    return gauss_newton(image, shape, points, take_block(uv, index), steps=steps)


def gauss_newton(
    image: tuple[Array, ...], shape: tuple[int, ...], points: GBuffer, start: Float[Array, "n 2"], *, steps: int
) -> Refined:
    """Places in the key frame whose reflected points lie on mirror rays.

    Args:
        image: Reflected points of the key frame as flat components (x, y, z, 1), or directions (x, y, z, 0).
        shape: Its (height, width).
        points: Surface points of now.
        start: Coordinates to start from.
        steps: Gauss-Newton steps; rough points take none.
    Returns:
        Coordinates and residuals.
    Edge cases: between a point and the environment, or between two things, the residual means nothing: the caller
        must look at `connected`.
    """
    wi = mirror_direction(points)
    tangent, bitangent = frame_from_normal(wi)
    axes = tuple(_split(x) for x in (tangent, bitangent, wi))
    p = _split(points.p)
    moving = points.alpha == 0

    def at(u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        return _step(image, shape, p, axes, u, v)  # pyright: ignore[reportArgumentType]

    def move(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        u, v = carry
        du, dv, _, _ = at(u, v)
        length = jnp.sqrt(du * du + dv * dv)
        shorten = jnp.where(moving, jnp.minimum(1, _LONGEST / jnp.maximum(length, 1e-6)), 0)
        return u + shorten * du, v + shorten * dv

    u, v = jax.lax.fori_loop(0, steps, move, (start[:, 0], start[:, 1]))
    du, dv, angle, usable = at(u, v)
    residual = jnp.where(usable, jnp.sqrt(du * du + dv * dv), jnp.inf)
    return Refined(jnp.stack([u, v], -1), residual, angle)


def _split(x: Float[Array, "n 3"]) -> Triple:
    return x[:, 0], x[:, 1], x[:, 2]


def _step(
    image: tuple[Array, ...], shape: tuple[int, ...], p: Triple, axes: tuple[Triple, Triple, Triple], u: Array, v: Array
) -> tuple[Array, Array, Array, Array]:
    """The Gauss-Newton step from (u, v), the tangent of the angle there, and whether the step is defined."""
    at = footprint(jnp.stack([u, v], -1), shape=shape, snap=SNAP)
    c00, c10, c01, c11 = (tuple(x[i] for x in image) for i in at.corners)
    fx, fy = at.fx, at.fy

    def mix(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array, Array]:
        upper, lower = a + fx * (b - a), c + fx * (d - c)
        return upper + fy * (lower - upper), (b - a) + fy * ((d - c) - (b - a)), lower - upper

    mixed = [mix(*values) for values in zip(c00, c10, c01, c11, strict=True)]
    point, along_u, along_v = ((mixed[0][i], mixed[1][i], mixed[2][i]) for i in range(3))
    offset = along(point, -mixed[3][0], p)
    a, b, w = axes
    ahead = dot3(offset, w)
    inverse = jnp.where(ahead > 0, 1 / jnp.where(ahead > 0, ahead, 1), 0)
    ra, rb = dot3(offset, a) * inverse, dot3(offset, b) * inverse
    wu, wv = dot3(along_u, w), dot3(along_v, w)
    au, av = (dot3(along_u, a) - ra * wu) * inverse, (dot3(along_v, a) - ra * wv) * inverse
    bu, bv = (dot3(along_u, b) - rb * wu) * inverse, (dot3(along_v, b) - rb * wv) * inverse
    det = au * bv - av * bu
    usable = (ahead > 0) & (jnp.abs(det) > 1e-20)
    scale = jnp.where(usable, 1 / jnp.where(usable, det, 1), 0)
    du, dv = -(bv * ra - av * rb) * scale, -(au * rb - bu * ra) * scale
    angle = jnp.where(ahead > 0, jnp.sqrt(ra * ra + rb * rb), jnp.inf)
    return du, dv, angle, usable & at.inside
