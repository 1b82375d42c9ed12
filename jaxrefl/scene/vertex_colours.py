"""Vertex colours as mesh formats store them -> linear values."""

import numpy as np


def linear_from_stored(colours: np.ndarray) -> np.ndarray:
    """Linear vertex colours from those of an OBJ or PLY file, which are taken as sRGB-coded.

    Neither format says how its colours are coded; scanners and editors write what they show on the screen. (glTF says
    linear, and its colours do not come through here.)

    Args:
        colours: [v 3] bytes from 0 to 255, or floating-point numbers from 0 to 1.
    Returns:
        [v 3] in float64, from 0 to 1.
    Edge cases: values outside the range are clamped.
    Source: IEC 61966-2-1 (sRGB).
    """
    scale = 255.0 if colours.dtype.kind in "iu" else 1.0
    value = np.clip(colours[:, :3].astype(np.float64) / scale, 0, 1)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
