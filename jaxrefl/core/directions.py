r"""Directions and their place on a latitude-longitude map.

$$ d = (\sin\theta \sin\varphi,\ \cos\theta,\ -\sin\theta \cos\varphi),\qquad
   \varphi = 2\pi\,(u - \tfrac{1}{2}),\quad \theta = \pi v $$

The middle of the map looks along -Z, row 0 along +Y, and u grows to the right as seen from inside: u = 0.75 is +X.
A texel of an h x w map covers the solid angle 2 pi^2 sin(theta) / (h w).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core.safe import sqrt


def latlong_from_direction(d: Float[Array, "*b 3"]) -> Float[Array, "*b 2"]:
    """Map coordinates of a direction.

    Args:
        d: Directions in the map's space; their length does not matter.
    Returns:
        (u, v) in [0, 1]; u = 0 and u = 1 are the same meridian, +Z.
    Edge cases: at the poles u is 0.5, with gradient 0; the zero vector gives (0.5, 0).
    """
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    squared = x * x + z * z
    pole = squared == 0
    azimuth = jnp.arctan2(jnp.where(pole, 0, x), jnp.where(pole, 1, -z))
    zero = pole & (y == 0)
    polar = jnp.arctan2(sqrt(squared), jnp.where(zero, 1, y))
    return jnp.clip(jnp.stack([0.5 + azimuth / (2 * jnp.pi), polar / jnp.pi], -1), 0, 1)


def direction_from_latlong(uv: Float[Array, "*b 2"]) -> Float[Array, "*b 3"]:
    """Direction at map coordinates; the inverse of `latlong_from_direction`.

    Args:
        uv: Map coordinates; v in [0, 1], any u (it wraps around).
    Returns:
        Unit directions in the map's space.
    """
    azimuth, polar = 2 * jnp.pi * (uv[..., 0] - 0.5), jnp.pi * uv[..., 1]
    sin = jnp.sin(polar)
    return jnp.stack([sin * jnp.sin(azimuth), jnp.cos(polar), -sin * jnp.cos(azimuth)], -1)
