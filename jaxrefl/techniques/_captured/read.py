"""Reading stacks of latitude-longitude maps along directions."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrefl.core import latlong_from_direction, lerp


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
