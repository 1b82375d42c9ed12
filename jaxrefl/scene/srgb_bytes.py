"""Linear values <-> sRGB-coded values and bytes, on the host.

Input and output: NumPy arrays of any shape. Source of the curve: IEC 61966-2-1 (sRGB).
"""

import numpy as np


def srgb_from_linear(values: np.ndarray) -> np.ndarray:
    """sRGB-coded values of linear ones.

    Args:
        values: Linear values; those outside [0, 1] are clamped.
    Returns:
        Coded values in [0, 1], float64.
    """
    x = np.clip(np.asarray(values, np.float64), 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def linear_from_srgb(values: np.ndarray) -> np.ndarray:
    """Linear values of sRGB-coded ones; the inverse of `srgb_from_linear`.

    Args:
        values: Coded values; those outside [0, 1] are clamped.
    Returns:
        Linear values in [0, 1], float64.
    """
    x = np.clip(np.asarray(values, np.float64), 0, 1)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def as_bytes(values: np.ndarray) -> np.ndarray:
    """The nearest bytes.

    Args:
        values: Values from 0 to 1; others are clamped.
    Returns:
        uint8 array of the same shape.
    """
    return np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)


def opaque(rgb: np.ndarray) -> np.ndarray:
    """Texels with an alpha channel of 255.

    Args:
        rgb: [h w 3] uint8.
    Returns:
        [h w 4] uint8.
    """
    return np.concatenate([rgb, np.full((*rgb.shape[:2], 1), 255, np.uint8)], -1)
