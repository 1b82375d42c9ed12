"""Border of the metrics: two images and a mask, checked and converted once.

Every figure takes linear radiance [h w 3], NumPy or JAX, and sums in float64 on the host. Display figures see the
images as a viewer does: exposed, clipped to [0, 1] and sRGB-coded, unrounded.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxrefl.core import srgb_from_linear


class Pair(NamedTuple):
    """An image, its reference and the pixels to compare, as NumPy arrays: linear, or both as displayed."""

    image: np.ndarray
    """[h w 3] float64."""
    reference: np.ndarray
    """[h w 3] float64."""
    mask: np.ndarray
    """[h w] bool."""


def checked_pair(image: Array | np.ndarray, reference: Array | np.ndarray, mask: Array | np.ndarray | None) -> Pair:
    """The inputs of a figure as NumPy arrays; the mask may still be empty.

    Raises:
        ValueError: If a shape, dtype or value is not what a figure can be computed from.
    """
    image, reference = _radiance("image", image), _radiance("reference", reference)
    if image.shape != reference.shape:
        raise ValueError(f"reference: expected the shape of image, {image.shape}, got {reference.shape}")
    if mask is None:
        return Pair(image, reference, np.ones(image.shape[:2], bool))
    selected = np.asarray(mask)
    if selected.dtype != np.bool_ or selected.shape != image.shape[:2]:
        raise ValueError(
            f"mask: expected bool of shape {image.shape[:2]}, got {selected.dtype} of shape {selected.shape}"
        )
    return Pair(image, reference, selected)


def nonempty_pair(image: Array | np.ndarray, reference: Array | np.ndarray, mask: Array | np.ndarray | None) -> Pair:
    """As `checked_pair`, and at least one pixel is selected.

    Raises:
        ValueError: As `checked_pair`, or if the mask selects no pixel.
    """
    pair = checked_pair(image, reference, mask)
    if not pair.mask.any():
        raise ValueError("mask: expected at least one True pixel, got none; no figure is defined over nothing")
    return pair


def displayed(pair: Pair, exposure: float) -> Pair:
    """The pair in display values in [0, 1]: exposed, clipped, sRGB-coded.

    Raises:
        ValueError: If the exposure is out of range.
    """
    factor = exposure_factor(exposure)

    def tone_mapped(image: np.ndarray) -> np.ndarray:
        clipped = np.clip(image * factor, 0, 1)
        return np.asarray(srgb_from_linear(jnp.asarray(clipped, jnp.float32)), np.float64)

    return Pair(tone_mapped(pair.image), tone_mapped(pair.reference), pair.mask)


def exposure_factor(exposure: float) -> float:
    """The factor on radiance of an exposure in stops.

    Raises:
        ValueError: If the exposure is not between -60 and 60, far beyond what a picture can need.
    """
    if not -60 <= exposure <= 60:
        raise ValueError(f"exposure: expected a number of stops from -60 to 60, got {exposure}")
    return 2.0**exposure


def _radiance(name: str, image: Array | np.ndarray) -> np.ndarray:
    array = np.asarray(image)
    # kind "f" leaves out bfloat16 of ml_dtypes (kind "V"), so ask JAX.
    if not jnp.issubdtype(array.dtype, jnp.floating):
        raise ValueError(f"{name}: expected linear radiance as floats, got {array.dtype} (an sRGB-coded picture?)")
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        raise ValueError(f"{name}: expected shape (height, width, 3), got {array.shape}")
    values = array.astype(np.float64)
    bad = int(np.count_nonzero(~np.isfinite(values).all(-1)))
    if bad:
        pixels = array.shape[0] * array.shape[1]
        raise ValueError(f"{name}: expected finite radiance, got NaN or infinity in {bad} of {pixels} pixels")
    return values
