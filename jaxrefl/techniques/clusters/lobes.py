"""Rays of each pixel's lobe: the mirror direction, GGX samples, or directions spread evenly over a cone.

Source: [WXKP14] §3.5.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import GBuffer, Rays
from jaxrefl.core import cone, dot
from jaxrefl.surface import keep_above, mirror_direction
from jaxrefl.techniques._tracing.samples import lobe_sample, reflected_rays
from jaxrefl.techniques.clusters.types import Options

MIRROR = 0
"""Number of samples of pixels whose lobe is one direction."""
CONE = math.sqrt(2)
"""Tangent, in alphas, of half the half angle of the cone that stands for a lobe: as GGX has it, half of its directions
lie within the reflection of a half vector of the tangent alpha."""


def lobe_rays(
    points: GBuffer, active: Bool[Array, "n"], key: Array, number: Int[Array, ""], *, samples: int, options: Options
) -> tuple[Rays, Float[Array, "n"]]:
    """One ray of each pixel's lobe.

    Args:
        points: G-buffer of the pixels.
        active: Which pixels count.
        key: Random key.
        number: Which of the rays.
        samples: How many there are; `MIRROR` for the mirror direction.
        options: `lobes`.
    Returns:
        Rays from the pixels' own points, and their weights; 0 below the surface.
    """
    if samples == MIRROR:
        return mirror_rays(points), jnp.where(active, 1.0, 0.0)
    if options.lobes == "ggx":
        rays, weight = reflected_rays(points, active, key, number)
        return Rays(points.p, rays.direction), weight
    return cone_rays(points, active, lobe_sample(key, number, active.shape[0]))


def mirror_rays(points: GBuffer) -> Rays:
    """The mirror ray of each pixel.

    Args:
        points: G-buffer of the pixels.
    Returns:
        Rays from their own points.
    """
    return Rays(points.p, mirror_direction(points))


def cone_rays(
    points: GBuffer, active: Bool[Array, "n"], u: Float[Array, "n 2"]
) -> tuple[Rays, Float[Array, "n"]]:  # fmt: skip
    r"""Rays spread evenly over a cone around the mirror direction.

    Its half angle is $2 \arctan(\sqrt 2 \alpha)$.

    Args:
        points: G-buffer of the pixels.
        active: Which pixels count.
        u: Uniform numbers in [0, 1).
    Returns:
        Rays, and their weights: 1, or 0 below the surface.
    Source: [WXKP14] §3.5 (3); the paper does not say how its cone follows from the glossiness.
    """
    direction = cone(u, mirror_direction(points), jnp.cos(2 * jnp.arctan(CONE * points.alpha)))
    above = dot(direction, points.n) > 0
    return Rays(points.p, keep_above(direction, points.n)), jnp.where(active & above, 1.0, 0.0)
