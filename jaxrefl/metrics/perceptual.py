"""FLIP, the difference a viewer notices when flipping between two pictures, by the optional package flip-evaluator.

The pictures are compared as displayed (its "LDR" mode). Its "HDR" mode chooses exposures from each reference, so that
figures of two frames could not be compared, and it ends the whole process (`exit(-1)`) on a reference that is black; it
also lets NaN through without a word. Neither can happen here: values are checked and tone-mapped first.
"""

import numpy as np
from jax import Array

from jaxrefl.metrics._pair import displayed, nonempty_pair


def flip(
    image: Array | np.ndarray,
    reference: Array | np.ndarray,
    mask: Array | np.ndarray | None,
    *,
    exposure: float = 0.0,
    pixels_per_degree: float = 67.0,
) -> float:
    """Mean FLIP error of the displayed pictures over a mask.

    Args:
        image: [h w 3] linear radiance.
        reference: [h w 3] linear radiance.
        mask: [h w] bool, pixels to average over; None: all.
        exposure: Stops by which to brighten both images before clipping, as in `composite.tone_map`.
        pixels_per_degree: How large the picture is seen; 67 is a 0.7 m wide 4K monitor from 0.7 m away.
    Returns:
        The error in [0, 1]; less is better.
    Raises:
        ValueError: If shapes differ, values are not finite, the mask is empty, or a number is out of range.
        ImportError: If flip-evaluator is not installed (`pip install 'jaxrefl[flip]'`).
    Edge cases: 0 for equal pictures, black ones included.
    Source: Andersson et al., FLIP: A Difference Evaluator for Alternating Images, 2020.
    """
    shown = displayed(nonempty_pair(image, reference, mask), exposure)
    if not (np.isfinite(pixels_per_degree) and pixels_per_degree > 0):
        raise ValueError(f"pixels_per_degree: expected a finite number above 0, got {pixels_per_degree}")
    try:
        import flip_evaluator
    except ImportError as error:
        raise ImportError("flip needs the package flip-evaluator: pip install 'jaxrefl[flip]'") from error
    error_map, _, _ = flip_evaluator.evaluate(
        shown.reference.astype(np.float32),
        shown.image.astype(np.float32),
        "LDR",
        applyMagma=False,
        computeMeanError=False,
        parameters={"ppd": pixels_per_degree},
    )
    return float(np.mean(np.asarray(error_map)[shown.mask], dtype=np.float64))
