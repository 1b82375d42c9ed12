"""Errors of linear radiance: RMSE and relMSE over a mask, as NumPy float64 sums.

Not clipped and not tone-mapped, so a single firefly outside the displayable range counts in full.
"""

import numpy as np
from jax import Array

from jaxrefl.metrics._pair import Pair, exposure_factor, nonempty_pair

RELMSE_EPSILON = 1e-2
"""Added to the squared reference in `relmse`; 1 % of the squared radiance that is displayed as white."""


def rmse(image: Array | np.ndarray, reference: Array | np.ndarray, mask: Array | np.ndarray | None) -> float:
    r"""Root mean square error of linear radiance.

    $$ \sqrt{\tfrac{1}{3|M|} \sum_{p \in M} \sum_c (x_{pc} - y_{pc})^2} $$

    Args:
        image: [h w 3] linear radiance, any range.
        reference: [h w 3] linear radiance, any range.
        mask: [h w] bool, pixels to average over; None: all.
    Returns:
        The error in units of radiance, >= 0.
    Raises:
        ValueError: If shapes differ, values are not finite, or the mask is empty.
    Edge cases: 0 for equal images; scales with the radiance.
    Source: [RLPWSD20] §7.3.3, Table 1, there over the glossy layer.
    """
    return rmse_of(nonempty_pair(image, reference, mask))


def relmse(
    image: Array | np.ndarray,
    reference: Array | np.ndarray,
    mask: Array | np.ndarray | None,
    *,
    exposure: float = 0.0,
    epsilon: float = RELMSE_EPSILON,
) -> float:
    r"""Mean square error relative to the reference's own radiance.

    $$ \tfrac{1}{3|M|} \sum_{p \in M} \sum_c \frac{(e x_{pc} - e y_{pc})^2}{(e y_{pc})^2 + \epsilon} $$

    Args:
        image: [h w 3] linear radiance, any range.
        reference: [h w 3] linear radiance, any range.
        mask: [h w] bool, pixels to average over; None: all.
        exposure: Stops by which to brighten both images, e = 2^exposure; ties `epsilon` to what is displayed as white.
        epsilon: Keeps black reference pixels from dominating, in exposed radiance squared, > 0.
    Returns:
        The error, without unit, >= 0.
    Raises:
        ValueError: If shapes differ, values are not finite, the mask is empty, or exposure or epsilon is out of range.
    Edge cases: where the reference is black, the squared error is divided by `epsilon` alone.
    """
    return relmse_of(nonempty_pair(image, reference, mask), exposure=exposure, epsilon=epsilon)


def rmse_of(pair: Pair) -> float:
    """`rmse` of a checked pair of linear images."""
    return float(np.sqrt(np.mean((pair.image - pair.reference)[pair.mask] ** 2)))


def relmse_of(pair: Pair, *, exposure: float, epsilon: float = RELMSE_EPSILON) -> float:
    """`relmse` of a checked pair of linear images."""
    if not (np.isfinite(epsilon) and epsilon > 0):
        raise ValueError(f"epsilon: expected a finite number above 0, got {epsilon}")
    x, y = (exposure_factor(exposure) * array[pair.mask] for array in (pair.image, pair.reference))
    return float(np.mean((x - y) ** 2 / (y**2 + epsilon)))
