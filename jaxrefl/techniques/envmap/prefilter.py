"""Prefiltering captured maps with GGX lobes by exact convolution: each texel of the result sums all of the map."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core import direction_from_latlong, ggx_distribution

_ROWS_PER_BLOCK = 64


def level_alphas(levels: int) -> Float[Array, "l"]:
    """Alpha of each prefiltered level: evenly spaced in perceptual roughness from 0.05 to 1.

    Args:
        levels: How many, >= 2.
    Returns:
        Rising alphas.
    """
    return jnp.linspace(0.05**0.5, 1.0, levels, dtype=jnp.float32) ** 2


@functools.partial(jax.jit, static_argnames="height")
def prefilter(sharp: Float[Array, "r h w 3"], alpha: Float[Array, "l"], height: int) -> Float[Array, "r l hr wr 3"]:
    r"""Mean radiance of GGX lobes around every direction, with viewer and normal along the lobe's axis.

    $$ L_\alpha(r) = \int k\, L(l)\, dl \Big/ \int k\, dl, \qquad k = D(r \cdot h, \alpha)\, (r \cdot l) $$

    Args:
        sharp: Captured maps.
        alpha: Width of each level.
        height: Rows of the result; the maps are averaged down to it first.
    Returns:
        One map per capture and level.
    Source: [Karis13], with quadrature over all texels instead of samples.
    """
    captures = sharp.shape[0]
    base = jax.image.resize(sharp, (captures, height, 2 * height, 3), "linear", antialias=True)
    row = (jnp.arange(height, dtype=jnp.float32) + 0.5) / height
    column = (jnp.arange(2 * height, dtype=jnp.float32) + 0.5) / (2 * height)
    direction = direction_from_latlong(jnp.stack(jnp.meshgrid(column, row), -1)).reshape(-1, 3)
    solid_angle = jnp.broadcast_to(jnp.sin(jnp.pi * row)[:, None], (height, 2 * height)).reshape(-1)
    light = jnp.moveaxis(base, 0, -2).reshape(direction.shape[0], -1)

    def one_level(width: Float[Array, ""]) -> Float[Array, "t c"]:
        def one_texel(axis: Float[Array, "3"]) -> Float[Array, "c"]:
            cosine = direction @ axis
            cos_h = jnp.sqrt(jnp.clip((1 + cosine) / 2, 0, 1))
            kernel = ggx_distribution(cos_h, jnp.broadcast_to(width, cos_h.shape)) * jnp.maximum(cosine, 0)
            kernel = kernel * solid_angle
            return (kernel @ light) / jnp.maximum(kernel.sum(), 1e-20)

        return jax.lax.map(one_texel, direction, batch_size=_ROWS_PER_BLOCK)

    levels = jax.lax.map(one_level, alpha)
    return jnp.moveaxis(levels.reshape(alpha.shape[0], height, 2 * height, captures, 3), 3, 0)
