"""Reading stacks of latitude-longitude maps along directions."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrefl.core import latlong_from_direction, lerp
from jaxrefl.techniques.envmap.types import State


def read_stack(maps: Float[Array, "r h w c"], row: Int[Array, "*b"], direction: Float[Array, "*b 3"]) -> Array:
    """Bilinear value of one map of a stack, wrapping around the horizon and clamping at the poles.

    Args:
        maps: Stack of maps.
        row: Which map, per element.
        direction: Unit directions.
    Returns:
        Values [*b c].
    """
    _, h, w, c = maps.shape
    uv = latlong_from_direction(direction)
    x, y = uv[..., 0] * w - 0.5, uv[..., 1] * h - 0.5
    x0, y0 = jnp.floor(x), jnp.floor(y)
    fx, fy = x - x0, y - y0
    column, line = x0.astype(jnp.int32), y0.astype(jnp.int32)
    flat = maps.reshape(-1, c)

    def texel(dx: int, dy: int) -> Array:
        index = (row * h + jnp.clip(line + dy, 0, h - 1)) * w + (column + dx) % w
        return flat[index]

    return lerp(lerp(texel(0, 0), texel(1, 0), fx), lerp(texel(0, 1), texel(1, 1), fx), fy)


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
