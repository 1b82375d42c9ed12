"""Rays without a sure answer, traced: Missing -> Sums. Work grows with the rays, not with the pixels they are of.

A departure from [WXKP14], which has environment maps there.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrefl._types import Frame, GBuffer, Rays
from jaxrefl.radiance import IncomingOptions, incoming
from jaxrefl.rays import blocks_of, offset_origin, take_block
from jaxrefl.techniques.clusters.sums import Sums, add_traced


class Missing(eqx.Module):
    """Rays of n pixels, s each, of which some have no sure answer."""

    direction: Float[Array, "*s n 3"]
    """Unit directions of all rays."""
    weight: Float[Array, "*s n"]
    """Weights of the rays without a sure answer; 0 for the others."""


def trace_missing(
    frame: Frame, points: GBuffer, sums: Sums, missing: Missing, key: Array, *, size: int, options: IncomingOptions
) -> Sums:  # fmt: skip
    """Trace the rays that have no sure answer, and add them.

    Args:
        frame: Scene and tracer.
        points: G-buffer of the pixels [n].
        sums: Sums over the other rays.
        missing: The rays.
        key: Random key.
        size: Rays that are traced together.
        options: How they are followed.
    Returns:
        The new sums.
    """
    key = jax.random.fold_in(key, 1)
    for number, index in enumerate(blocks_of(missing.weight > 0, size=size)):
        rays, weight, pixel = _take(points, missing, index)
        own = jax.random.fold_in(key, number)
        light = incoming(frame.scene, frame.tracer, rays, weight > 0, own, options=options)
        sums = add_traced(sums, pixel, weight, light.radiance, light.hit, light.p, light.t)
    return sums


@jax.jit
def _take(points: GBuffer, missing: Missing, index: Int[Array, "m"]) -> tuple[Rays, Float[Array, "m"], Array]:
    pixel = jnp.maximum(index, 0) % missing.weight.shape[1]
    direction, weight = take_block((missing.direction, missing.weight), index)
    p, n, error = points.p[pixel], points.n[pixel], points.p_error[pixel]
    return Rays(offset_origin(p, n, error, direction), direction), jnp.where(index >= 0, weight, 0), pixel
