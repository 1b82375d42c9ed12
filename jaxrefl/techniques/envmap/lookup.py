"""Reading captured and prefiltered maps along the axes of lobes."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrefl.core import lerp
from jaxrefl.techniques._captured import read_stack
from jaxrefl.techniques.envmap.types import State


def read_lobe(
    state: State, row: Int[Array, "*b"], direction: Float[Array, "*b 3"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b 3"]:
    """Mean radiance of a lobe: between the sharp map and the prefiltered levels, linear in perceptual roughness.

    Args:
        state: The maps.
        row: Which capture, per element.
        direction: Unit axis of the lobe.
        alpha: Width of the lobe, in [0, 1].
    Returns:
        Linear radiance.
    """
    captures, levels = state.rough.shape[:2]
    roughness = jnp.sqrt(jnp.concatenate([jnp.zeros(1, jnp.float32), state.alpha]))
    wanted = jnp.sqrt(alpha)
    upper = jnp.clip(jnp.searchsorted(roughness, wanted).astype(jnp.int32), 1, levels)
    low, high = roughness[upper - 1], roughness[upper]
    share = jnp.clip((wanted - low) / (high - low), 0, 1)
    rough = state.rough.reshape(captures * levels, *state.rough.shape[2:])
    above = read_stack(rough, row * levels + upper - 1, direction)
    below = read_stack(rough, row * levels + jnp.maximum(upper - 2, 0), direction)
    sharp = read_stack(state.sharp, row, direction)
    return lerp(jnp.where((upper == 1)[..., None], sharp, below), above, share)
