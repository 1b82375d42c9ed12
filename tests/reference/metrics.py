"""Slow float64 figures, pixel by pixel, written from the definitions and not from `jaxrefl.metrics`."""

import math

import numpy as np


def displayed(image: np.ndarray, exposure: float) -> np.ndarray:
    """Exposed, clipped and sRGB-coded by IEC 61966-2-1."""
    out = np.zeros(image.shape)
    for index, value in np.ndenumerate(np.asarray(image, np.float64)):
        x = min(max(value * 2.0**exposure, 0.0), 1.0)
        out[index] = 12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055
    return out


def figures(image: np.ndarray, reference: np.ndarray, mask: np.ndarray, exposure: float) -> dict[str, float]:
    """All five figures over a mask."""
    x, y = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    shown, expected = displayed(x, exposure), displayed(y, exposure)
    absolute, squares, relative, coded = [], [], [], []
    for row, column in zip(*np.nonzero(mask), strict=True):
        for c in range(3):
            a, b = x[row, column, c], y[row, column, c]
            e = 2.0**exposure
            absolute.append(abs(shown[row, column, c] - expected[row, column, c]))
            coded.append((shown[row, column, c] - expected[row, column, c]) ** 2)
            squares.append((a - b) ** 2)
            relative.append((e * a - e * b) ** 2 / ((e * b) ** 2 + 0.01))
    return {
        "mae255": 255 * math.fsum(absolute) / len(absolute),
        "rmse": math.sqrt(math.fsum(squares) / len(squares)),
        "relmse": math.fsum(relative) / len(relative),
        "psnr": 10 * math.log10(len(coded) / math.fsum(coded)),
        "dssim": (1 - _ssim(shown, expected, mask)) / 2,
    }


def _ssim(x: np.ndarray, y: np.ndarray, mask: np.ndarray) -> float:
    offsets = np.arange(-5, 6)
    weights = np.exp(-(offsets[:, None] ** 2 + offsets[None, :] ** 2) / (2 * 1.5**2))
    weights /= weights.sum()
    height, width = mask.shape
    values = []
    for row in range(5, height - 5):
        for column in range(5, width - 5):
            if not mask[row, column]:
                continue
            for c in range(3):
                a = x[row - 5 : row + 6, column - 5 : column + 6, c]
                b = y[row - 5 : row + 6, column - 5 : column + 6, c]
                mean_a, mean_b = (weights * a).sum(), (weights * b).sum()
                variance_a = (weights * (a - mean_a) ** 2).sum()
                variance_b = (weights * (b - mean_b) ** 2).sum()
                covariance = (weights * (a - mean_a) * (b - mean_b)).sum()
                luminance = (2 * mean_a * mean_b + 0.01**2) / (mean_a**2 + mean_b**2 + 0.01**2)
                structure = (2 * covariance + 0.03**2) / (variance_a + variance_b + 0.03**2)
                values.append(luminance * structure)
    return math.fsum(values) / len(values)
