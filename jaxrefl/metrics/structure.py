"""Structural similarity of the picture as displayed, by scikit-image, averaged over a mask.

The window is the original one: Gaussian of 1.5 pixels, cut off at 11 x 11, weights that sum to 1. Like scikit-image's
own mean, the average leaves out the `BORDER` pixels along each edge of the frame, where the window would reach beyond
the picture. scikit-image is imported on first use, so that `import jaxrefl` stays fast.
"""

import numpy as np
from jax import Array

from jaxrefl.metrics._pair import Pair, checked_pair, displayed, nonempty_pair

BORDER = 5
"""Pixels along each edge of the frame that the average leaves out: the radius of the window."""


def ssim_map(image: Array | np.ndarray, reference: Array | np.ndarray, *, exposure: float = 0.0) -> np.ndarray:
    """Structural similarity around each pixel of the displayed pictures, averaged over R, G and B.

    Args:
        image: [h w 3] linear radiance, at least 11 pixels on each side.
        reference: [h w 3] linear radiance, the same shape.
        exposure: Stops by which to brighten both images before clipping, as in `composite.tone_map`.
    Returns:
        [h w] float32, at most 1; within `BORDER` pixels of the frame's edge the picture is continued by reflection.
    Raises:
        ValueError: If shapes differ, a side is below 11 pixels, values are not finite, or the exposure is out of range.
    Edge cases: 1 where the windows are equal, black ones included.
    """
    return similarity_of(displayed(checked_pair(image, reference, None), exposure))


def ssim(
    image: Array | np.ndarray,
    reference: Array | np.ndarray,
    mask: Array | np.ndarray | None,
    *,
    exposure: float = 0.0,
) -> float:
    """Mean structural similarity of the displayed pictures over a mask.

    Args:
        image: [h w 3] linear radiance, at least 11 pixels on each side.
        reference: [h w 3] linear radiance, the same shape.
        mask: [h w] bool, pixels to average over; None: all. Pixels within `BORDER` of the frame's edge are left out.
        exposure: Stops by which to brighten both images before clipping, as in `composite.tone_map`.
    Returns:
        The similarity in [-1, 1]; more is better.
    Raises:
        ValueError: As `ssim_map`, or if the mask selects no pixel away from the frame's edge.
    Edge cases: with `mask` None it is scikit-image's own mean; windows of masked pixels also see their neighbours
        outside the mask.
    """
    return ssim_of(displayed(nonempty_pair(image, reference, mask), exposure))


def dssim(
    image: Array | np.ndarray,
    reference: Array | np.ndarray,
    mask: Array | np.ndarray | None,
    *,
    exposure: float = 0.0,
) -> float:
    r"""Structural dissimilarity \((1 - \mathrm{SSIM}) / 2\) of the displayed pictures over a mask.

    Args:
        image: [h w 3] linear radiance, at least 11 pixels on each side.
        reference: [h w 3] linear radiance, the same shape.
        mask: [h w] bool, pixels to average over; None: all. Pixels within `BORDER` of the frame's edge are left out.
        exposure: Stops by which to brighten both images before clipping, as in `composite.tone_map`.
    Returns:
        The dissimilarity in [0, 1]; less is better.
    Raises:
        ValueError: As `ssim`.
    Edge cases: 0 for equal pictures.
    Source: [RLPWSD20] §7.3.3, Table 1, there over the glossy layer.
    """
    return (1 - ssim(image, reference, mask, exposure=exposure)) / 2


def inside_border(shape: tuple[int, ...]) -> np.ndarray:
    """Pixels whose whole window lies inside the frame.

    Args:
        shape: (height, width) in pixels.
    Returns:
        [h w] bool; all False if a side is below 11 pixels.
    """
    inside = np.zeros(shape, bool)
    inside[BORDER : shape[0] - BORDER, BORDER : shape[1] - BORDER] = True
    return inside


def similarity_of(shown: Pair) -> np.ndarray:
    """`ssim_map` of a checked pair in display values."""
    from skimage.metrics import structural_similarity

    if min(shown.mask.shape) < 2 * BORDER + 1:
        raise ValueError(
            f"image: expected at least {2 * BORDER + 1} pixels on each side, got shape {shown.image.shape}"
        )
    similarity = structural_similarity(
        shown.reference,
        shown.image,
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )[1]
    return np.asarray(similarity.mean(-1), np.float32)


def ssim_of(shown: Pair) -> float:
    """`ssim` of a checked pair in display values."""
    similarity = similarity_of(shown)
    inner = shown.mask & inside_border(shown.mask.shape)
    if not inner.any():
        raise ValueError(f"mask: expected a True pixel more than {BORDER} pixels from the frame's edge, got none")
    return float(np.mean(similarity[inner], dtype=np.float64))
