r"""Glossy layers against a truth with noise: two independent halves in place of one image.

A product of two differences has the noise of neither half in its mean:

$$ E[(X - A)(X - B)] = (X - T)^2 \quad\text{for independent } A, B \text{ with mean } T $$

Structural similarity takes the truth's variance from $\operatorname{cov}(A, B)$ for the same reason.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from jaxrefl.core import srgb_from_linear
from jaxrefl.metrics.structure import inside_border


class Truth(NamedTuple):
    """Two independent images of the same thing."""

    first: np.ndarray
    """[h w 3] linear."""
    second: np.ndarray
    """[h w 3] linear."""

    @property
    def mean(self) -> np.ndarray:
        """Of both."""
        return (self.first + self.second) / 2


def displayed(image: np.ndarray) -> np.ndarray:
    """An image as shown: clipped to [0, 1] and sRGB-coded.

    Args:
        image: Linear.
    Returns:
        Display values.
    """
    return np.asarray(srgb_from_linear(jnp.asarray(np.clip(image, 0, 1), jnp.float32)), np.float64)


def errors_of(
    image: np.ndarray, truth: Truth, mask: np.ndarray, *, again: np.ndarray | None = None
) -> dict[str, float]:
    """RMSE and DSSIM without the truth's noise.

    Args:
        image: [h w 3] linear.
        truth: Two halves, independent of the image.
        mask: Pixels to average over.
        again: The image a second time with independent noise: then its own noise does not count either.
    Returns:
        `RMSE` of linear values; `RMSE shown` and `DSSIM` of the picture as displayed. 0 where noise outweighs the rest.
    """
    other = image if again is None else again
    x, y, a, b = (displayed(v) for v in (image, other, truth.first, truth.second))
    linear = np.mean(((image - truth.first) * (other - truth.second))[mask], dtype=np.float64)
    shown = np.mean(((x - a) * (y - b))[mask])
    return {
        "RMSE": float(np.sqrt(max(linear, 0.0))),
        "RMSE shown": float(np.sqrt(max(shown, 0.0))),
        "DSSIM": _dssim(x, y, a, b, mask),
    }


def noise_of(truth: Truth, mask: np.ndarray) -> float:
    """Standard error of the mean of both halves, linear.

    Args:
        truth: Two halves.
        mask: Pixels to average over.
    Returns:
        RMSE of the truth itself.
    """
    return float(np.sqrt(np.mean((truth.first - truth.second)[mask] ** 2, dtype=np.float64)) / 2)


def _dssim(x: np.ndarray, y: np.ndarray, a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> float:
    def mean(v: np.ndarray) -> np.ndarray:
        return gaussian_filter(v, (1.5, 1.5, 0), truncate=3.5)

    ux, uy, ua, ub = mean(x), mean(y), mean(a), mean(b)
    image, truth = np.maximum(mean(x * y) - ux * uy, 0), np.maximum(mean(a * b) - ua * ub, 0)
    both = mean((x + y) * (a + b)) / 4 - (ux + uy) * (ua + ub) / 4
    c1, c2 = 0.01**2, 0.03**2
    similar = ((ux + uy) * (ua + ub) / 2 + c1) * (2 * both + c2) / ((ux * uy + ua * ub + c1) * (image + truth + c2))
    inner = mask & inside_border(mask.shape)
    return float((1 - np.clip(similar, -1, 1)[inner].mean()) / 2)
