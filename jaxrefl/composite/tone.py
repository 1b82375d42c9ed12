"""From linear radiance to a picture for a screen; figures on linear values never pass through here."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core import srgb_from_linear


@jax.jit
def tone_map(image: Float[Array, "*b 3"], *, exposure: float | Float[Array, ""] = 0.0) -> Float[Array, "*b 3"]:
    """sRGB picture of a linear image: exposure, clipping, sRGB curve.

    Args:
        image: Linear radiance.
        exposure: Stops by which to brighten.
    Returns:
        sRGB-coded values in [0, 1].
    Edge cases: radiance above 1 after exposure is clipped, as is anything negative.
    """
    return srgb_from_linear(jnp.clip(image * 2.0**exposure, 0, 1))
