"""Texels without light of their own take it from their neighbours."""

import numpy as np
from jaxtyping import Bool, Float

_RINGS = 8
"""How far light spreads into unknown texels."""


def filled(light: Float[np.ndarray, "h w 3"], known: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Unknown texels next to known ones get the mean of those, ring by ring.

    Charts lie at least `lightmap_atlas.GUTTER` texels apart, so that the first ring, which is all that bilinear look-up
    reads, is each chart's own.

    Args:
        light: The texture.
        known: Which of its texels count.
    Returns:
        The texture; 0 where nothing known is within `_RINGS` texels.
    """
    light, known = np.where(known[..., None], light, 0), known.copy()
    for _ in range(_RINGS):
        total, count = _around(light), _around(known[..., None].astype(np.float32))
        fresh = ~known & (count[..., 0] > 0)
        light = np.where(fresh[..., None], total / np.maximum(count, 1), light)
        known |= fresh
    return light.astype(np.float32)


def _around(x: np.ndarray) -> np.ndarray:
    """Sum over the 3 by 3 neighbourhood, nothing beyond the edge."""
    padded = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    h, w = x.shape[:2]
    total = np.zeros_like(x)
    for i in range(3):
        for j in range(3):
            total += padded[i : i + h, j : j + w]
    return total
