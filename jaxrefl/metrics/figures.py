"""All figures of one image against its reference: the row that the runner writes per frame and mask."""

import numpy as np
from jax import Array

from jaxrefl.metrics._pair import checked_pair, displayed
from jaxrefl.metrics.display import mae255_of, psnr_of
from jaxrefl.metrics.linear import relmse_of, rmse_of
from jaxrefl.metrics.structure import inside_border, ssim_of

FIGURES = ("mae255", "rmse", "relmse", "psnr", "dssim")
"""Keys of `compare`, in the order of its columns."""


def compare(
    image: Array | np.ndarray,
    reference: Array | np.ndarray,
    mask: Array | np.ndarray | None,
    *,
    exposure: float = 0.0,
) -> dict[str, float | None]:
    """The figures `mae255`, `rmse`, `relmse`, `psnr` and `dssim` of an image over a mask.

    Args:
        image: [h w 3] linear radiance, NumPy or JAX.
        reference: [h w 3] linear radiance, the same shape.
        mask: [h w] bool, pixels to average over, say those that show a reflection; None: the whole frame.
        exposure: Stops by which to brighten both images before clipping, as in `composite.tone_map`; `rmse` ignores it.
    Returns:
        One number per name in `FIGURES`, or None where the figure is not defined over the mask.
    Raises:
        ValueError: If shapes differ, dtypes are wrong, values are not finite, or the exposure is out of range.
    Edge cases: an empty mask (a frame without any reflection) gives None for every figure; `dssim` is None too where
        the mask keeps no pixel further than `BORDER` from the frame's edge; `psnr` is infinite for equal pictures.
        Never NaN.
    """
    pair = checked_pair(image, reference, mask)
    if not pair.mask.any():
        return dict.fromkeys(FIGURES)
    shown = displayed(pair, exposure)
    structured = bool((pair.mask & inside_border(pair.mask.shape)).any())
    return {
        "mae255": mae255_of(shown),
        "rmse": rmse_of(pair),
        "relmse": relmse_of(pair, exposure=exposure),
        "psnr": psnr_of(shown),
        "dssim": (1 - ssim_of(shown)) / 2 if structured else None,
    }
