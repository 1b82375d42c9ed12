"""Symmetric 2x2 matrices as (xx, xy, yy): principal axes, and the nearest one that is a covariance."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core.safe import divide, sqrt


class Axes(NamedTuple):
    """Principal axes of a covariance."""

    major: Float[Array, "*b"]
    """Larger standard deviation, >= 0."""
    minor: Float[Array, "*b"]
    """Smaller one, >= 0."""
    cos: Float[Array, "*b"]
    """The major axis is (cos, sin), with cos >= 0."""
    sin: Float[Array, "*b"]


def _eigen(c: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b"], ...]:
    """Both eigenvalues, larger first, and cosine and sine of twice the major axis's angle."""
    middle, half = (c[..., 0] + c[..., 2]) / 2, (c[..., 0] - c[..., 2]) / 2
    radius = sqrt(half * half + c[..., 1] * c[..., 1])
    return middle + radius, middle - radius, divide(half, radius, fill=1.0), divide(c[..., 1], radius)


def principal_axes(covariance: Float[Array, "*b 3"]) -> Axes:
    """Principal axes of covariances.

    Args:
        covariance: (xx, xy, yy).
    Returns:
        Standard deviations and the direction of the larger one.
    Edge cases: round ones have the axis (1, 0); negative eigenvalues count as 0. Values and gradients stay finite for
    any condition number.
    """
    large, small, cos2, sin2 = _eigen(covariance)
    cos = sqrt((1 + cos2) / 2)
    sin = jnp.where(sin2 < 0, -1, 1) * sqrt((1 - cos2) / 2)
    return Axes(sqrt(large), sqrt(small), cos, sin)


def nearest_covariance(matrix: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The positive semidefinite matrix that is nearest in the Frobenius norm: negative eigenvalues become 0.

    Args:
        matrix: (xx, xy, yy), any symmetric matrix.
    Returns:
        (xx, xy, yy); what is positive semidefinite comes back as it is.
    """
    large, small, cos2, sin2 = _eigen(matrix)
    large, clipped = jnp.maximum(large, 0), jnp.maximum(small, 0)
    middle, radius = (large + clipped) / 2, (large - clipped) / 2
    projected = jnp.stack([middle + radius * cos2, radius * sin2, middle - radius * cos2], -1)
    return jnp.where((small >= 0)[..., None], matrix, projected)
