"""Division, roots, arc cosine, length and direction that stay finite, with their gradients, on degenerate input.

Every function guards twice (a "double `where`"): once the result and once the argument, because the gradient of
`where(x > 0, sqrt(x), 0)` at 0 is NaN otherwise. On the degenerate set the result is a documented fill value and the
gradient is 0. NaN in is NaN out: these functions hide singularities of the maths, not errors of the caller.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

TINY = 2.0**-62
"""Magnitudes below this (2e-19) count as zero in a divisor: the square of the reciprocal, which the gradient needs,
is still a float32 number."""


def divide(a: Float[Array, "*#b"], b: Float[Array, "*#b"], *, fill: float = 0.0) -> Float[Array, "*#b"]:
    """Quotient a / b, or `fill` where b is zero.

    Args:
        a: Numerator, any range.
        b: Denominator, any range; broadcasts against `a`.
        fill: Result where |b| < `TINY`.
    Returns:
        The quotient.
    Edge cases: |b| < `TINY` gives `fill` with gradient 0.
    """
    small = jnp.abs(b) < TINY
    return jnp.where(small, fill, a / jnp.where(small, 1, b))


def sqrt(x: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Square root, 0 for arguments that are not positive.

    Args:
        x: Any range.
    Returns:
        The root, >= 0.
    Edge cases: x <= 0 gives 0 with gradient 0.
    """
    outside = x <= 0
    return jnp.where(outside, 0, jnp.sqrt(jnp.where(outside, 1, x)))


def arccos(x: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Arc cosine of x clipped to [-1, 1].

    Args:
        x: Cosine; rounding may have taken it a little out of range.
    Returns:
        Angle in radians, in [0, pi].
    Edge cases: |x| >= 1 gives 0 or pi with gradient 0.
    """
    outside = jnp.abs(x) >= 1
    return jnp.where(outside, jnp.where(x > 0, 0, jnp.pi), jnp.arccos(jnp.where(outside, 0, x)))


def norm(v: Float[Array, "*b 3"]) -> Float[Array, "*b"]:
    """Length of each vector, without overflow or underflow of the squares.

    Args:
        v: Vectors of any length.
    Returns:
        Lengths, >= 0, in the unit of `v`.
    Edge cases: vectors shorter than `TINY` have length 0 with gradient 0.
    """
    scaled, scale, zero = _rescale(v)
    return jnp.where(zero, 0, scale * jnp.sqrt(_sum_of_squares(scaled)))


def normalise(v: Float[Array, "*b 3"], *, fill: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Float[Array, "*b 3"]:
    """Unit vectors in the direction of v, or `fill` where v has none.

    Args:
        v: Vectors of any length.
        fill: Result for vectors shorter than `TINY`.
    Returns:
        Unit vectors.
    Edge cases: vectors shorter than `TINY` give `fill` with gradient 0.
    """
    scaled, _, zero = _rescale(v)
    unit = scaled / jnp.sqrt(_sum_of_squares(scaled))[..., None]
    return jnp.where(zero[..., None], jnp.broadcast_to(jnp.asarray(fill, v.dtype), v.shape), unit)


def _rescale(v: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b"], Bool[Array, "*b"]]:
    """v with its largest component scaled to 1, the scale, and where v is zero (there the vector is all ones)."""
    x, y, z = jnp.abs(v[..., 0]), jnp.abs(v[..., 1]), jnp.abs(v[..., 2])
    scale = lax.stop_gradient(jnp.maximum(jnp.maximum(x, y), z))  # twice as fast as a reduction over an axis of 3
    zero = scale < TINY
    scale = jnp.where(zero, 1, scale)
    return jnp.where(zero[..., None], 1, v / scale[..., None]), scale, zero


def _sum_of_squares(v: Float[Array, "*b 3"]) -> Float[Array, "*b"]:
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return x * x + y * y + z * z
