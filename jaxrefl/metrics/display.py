"""Errors of the picture as displayed: exposed, clipped to [0, 1], sRGB-coded, then compared over a mask.

The coded values are not rounded to 8 bits, so errors below one step of a PNG still count.
"""

import math

import numpy as np
from jax import Array

from jaxrefl.metrics._pair import Pair, checked_pair, displayed, nonempty_pair


def error_map255(image: Array | np.ndarray, reference: Array | np.ndarray, *, exposure: float = 0.0) -> np.ndarray:
    """Absolute difference per pixel on the 0-255 scale of the displayed picture, averaged over R, G and B.

    Args:
        image: [h w 3] linear radiance.
        reference: [h w 3] linear radiance.
        exposure: Stops by which to brighten both images before clipping, as in `composite.tone_map`.
    Returns:
        [h w] float32 in [0, 255]; its mean over a mask is `mae255` over that mask.
    Raises:
        ValueError: If shapes differ, values are not finite, or the exposure is out of range.
    Edge cases: pixels that are clipped to white in both images differ by 0.
    """
    shown = displayed(checked_pair(image, reference, None), exposure)
    return np.asarray(255 * np.abs(shown.image - shown.reference).mean(-1), np.float32)


def mae255(
    image: Array | np.ndarray,
    reference: Array | np.ndarray,
    mask: Array | np.ndarray | None,
    *,
    exposure: float = 0.0,
) -> float:
    r"""Mean absolute difference of the displayed pictures on the 0-255 scale, the papers' L1.

    $$ \tfrac{255}{3|M|} \sum_{p \in M} \sum_c |s(x_{pc}) - s(y_{pc})| $$

    with \(s\) the exposure, the clip to [0, 1] and the sRGB curve.

    Args:
        image: [h w 3] linear radiance.
        reference: [h w 3] linear radiance.
        mask: [h w] bool, pixels to average over; None: all.
        exposure: Stops by which to brighten both images before clipping, as in `composite.tone_map`.
    Returns:
        The error in [0, 255].
    Raises:
        ValueError: If shapes differ, values are not finite, the mask is empty, or the exposure is out of range.
    Edge cases: 0 for equal images and where both are clipped.
    Source: [WXKP14] §4.1, "average absolute pixel channel differences (i.e. L1 norm)"; [XWD17] §4.2 on the same scale.
    Differs from the source: values are not rounded to 8 bits first.
    """
    return mae255_of(displayed(nonempty_pair(image, reference, mask), exposure))


def psnr(
    image: Array | np.ndarray,
    reference: Array | np.ndarray,
    mask: Array | np.ndarray | None,
    *,
    exposure: float = 0.0,
) -> float:
    r"""Peak signal-to-noise ratio of the displayed pictures, with a peak of 1.

    $$ -10 \log_{10} \tfrac{1}{3|M|} \sum_{p \in M} \sum_c (s(x_{pc}) - s(y_{pc}))^2 $$

    Args:
        image: [h w 3] linear radiance.
        reference: [h w 3] linear radiance.
        mask: [h w] bool, pixels to average over; None: all.
        exposure: Stops by which to brighten both images before clipping, as in `composite.tone_map`.
    Returns:
        The ratio in dB, >= 0; more is better.
    Raises:
        ValueError: If shapes differ, values are not finite, the mask is empty, or the exposure is out of range.
    Edge cases: infinite for pictures that are equal over the mask.
    """
    return psnr_of(displayed(nonempty_pair(image, reference, mask), exposure))


def mae255_of(shown: Pair) -> float:
    """`mae255` of a checked pair in display values."""
    return float(255 * np.mean(np.abs((shown.image - shown.reference)[shown.mask])))


def psnr_of(shown: Pair) -> float:
    """`psnr` of a checked pair in display values."""
    mean_square = float(np.mean((shown.image - shown.reference)[shown.mask] ** 2))
    return -10 * math.log10(mean_square) if mean_square > 0 else math.inf
