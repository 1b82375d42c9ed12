"""Colour: sRGB coding and luminance. Everything inside the library is linear Rec.709; sRGB is for 8-bit images only.

Source: [IEC99] IEC 61966-2-1:1999 (sRGB); [BT709] Rec. ITU-R BT.709-6.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core.vectors import dot


def srgb_from_linear(linear: Float[Array, "*b"]) -> Float[Array, "*b"]:
    r"""sRGB-coded values of linear ones.

    $$ s = 12.92\,x \ \text{ for } x \le 0.0031308,\qquad s = 1.055\,x^{1/2.4} - 0.055 \ \text{ above} $$

    Args:
        linear: Linear values; [0, 1] is what a display shows.
    Returns:
        Coded values, not clipped.
    Edge cases: negative values stay on the straight piece.
    Source: [IEC99].
    """
    straight = linear <= 0.0031308
    return jnp.where(straight, 12.92 * linear, 1.055 * jnp.where(straight, 1, linear) ** (1 / 2.4) - 0.055)


def linear_from_srgb(srgb: Float[Array, "*b"]) -> Float[Array, "*b"]:
    r"""Linear values of sRGB-coded ones; the inverse of `srgb_from_linear`.

    $$ x = s / 12.92 \ \text{ for } s \le 0.04045,\qquad
       x = \left(\frac{s + 0.055}{1.055}\right)^{2.4} \ \text{ above} $$

    Args:
        srgb: Coded values, [0, 1] for an 8-bit image.
    Returns:
        Linear values, not clipped.
    Edge cases: negative values stay on the straight piece.
    Source: [IEC99].
    """
    straight = srgb <= 0.04045
    return jnp.where(straight, srgb / 12.92, ((jnp.where(straight, 1, srgb) + 0.055) / 1.055) ** 2.4)


def luminance(rgb: Float[Array, "*b 3"]) -> Float[Array, "*b"]:
    r"""Luminance of linear Rec.709 colours.

    $$ Y = 0.2126\,R + 0.7152\,G + 0.0722\,B $$

    Args:
        rgb: Linear colours.
    Returns:
        Luminance; 1 for white.
    Source: [BT709] item 3.2.
    """
    weights = jnp.asarray([0.2126, 0.7152, 0.0722], rgb.dtype)
    return dot(rgb, jnp.broadcast_to(weights, rgb.shape))
