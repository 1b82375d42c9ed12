r"""Smoothing baked light where that brings it closer to the truth: two noisy halves of a texture -> one smooth texture.

Both halves are smoothed with a row of ever wider filters. How far each is from the truth shows in the other half, whose
noise is independent,

$$ \mathrm E\,\lVert F_l A - B \rVert^2 = \lVert F_l A - \text{truth} \rVert^2 + \text{noise of } B, $$

and the last term is the same for all filters. Each texel takes the filter that does best around it. The filters do not
look past edges of the surface, only along it.

Sources: [RKZ12] Rousselle, Knaus and Zwicker, "Adaptive rendering with non-local means filtering", SIGGRAPH Asia 2012,
for two halves; [DSHL10] Dammertz et al., "Edge-avoiding à-trous wavelet transform", HPG 2010, for the filters.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

LEVELS = 5
"""Filters; number l averages over about 2^l texels in each direction."""
_FLAT = 0.9
"""Least cosine between the normals of two texels that are averaged."""
_FAR = 1.6
"""Most distance between two texels that are averaged, relative to that in the texture."""
_OUTLIER = 4.0
"""A texel's noise counts at the most as so many times the light around it when filters are judged: fireflies must not
decide alone."""


class Surface(NamedTuple):
    """The surface under a texture."""

    p: Float[np.ndarray, "h w 3"]
    """Positions, in texels."""
    n: Float[np.ndarray, "h w 3"]
    """Unit normals."""
    weight: Float[np.ndarray, "h w"]
    """How much each texel counts; 0: unknown."""


def smoothed(halves: Float[np.ndarray, "2 h w 3"], surface: Surface) -> Float[np.ndarray, "h w 3"]:
    """One texture from two halves of its samples.

    Args:
        halves: Two estimates with independent noise.
        surface: What lies where.
    Returns:
        Their mean, smoothed; unchanged where no filter does better than none.
    """
    weight = surface.weight[..., None].astype(np.float32)
    levels = [halves.astype(np.float32)]
    for level in range(LEVELS):
        levels.append(_blurred(levels[-1], surface, 1 << level))
    bound = _OUTLIER * levels[-1].mean(0)
    errors = []
    for estimate in levels:
        misses = [(estimate[i] - np.minimum(halves[1 - i], bound)) ** 2 for i in (0, 1)]
        # Relative to the light: noise is, and what is dark matters as much.
        relative = sum(misses) / (bound**2 + 1e-12)
        errors.append(_window(relative.sum(-1, keepdims=True) * weight, surface) / _window(weight, surface))
    best = np.stack(errors).argmin(0)[..., 0]
    # The choice itself is noisy; a little blending hides its steps.
    chosen = np.zeros(halves.shape[1:], np.float32)
    for level, estimate in enumerate(levels):
        share = _blurred((best == level).astype(np.float32)[None, ..., None], surface, 1)[0]
        chosen += share * estimate.mean(0)
    return chosen


def _blurred(images: Float[np.ndarray, "k h w c"], surface: Surface, step: int) -> Float[np.ndarray, "k h w c"]:
    """A 3 by 3 binomial filter with holes, over texels of the same stretch of surface."""
    total = np.zeros_like(images)
    norm = np.zeros(images.shape[1:3], np.float32)
    for (dy, dx), here, there in _shifts(surface.weight.shape, step):
        factor = (2 - abs(dy)) * (2 - abs(dx))
        near = np.square(surface.p[here] - surface.p[there]).sum(-1) <= (_FAR * step) ** 2 * max(dx * dx + dy * dy, 1)
        flat = (surface.n[here] * surface.n[there]).sum(-1) >= _FLAT
        weight = (factor * surface.weight[there] * (near & flat)).astype(np.float32)
        total[(slice(None), *here)] += weight[None, ..., None] * images[(slice(None), *there)]
        norm[here] += weight
    return np.where(norm[None, ..., None] > 0, total / np.maximum(norm, 1e-6)[None, ..., None], images)


def _shifts(
    shape: tuple[int, ...], step: int
) -> Iterator[tuple[tuple[int, int], tuple[slice, slice], tuple[slice, slice]]]:
    """Each of nine neighbours: its offset, where it exists, and where it lies."""
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            y, x = dy * step, dx * step
            if abs(y) < shape[0] and abs(x) < shape[1]:
                here = (slice(max(-y, 0), shape[0] - max(y, 0)), slice(max(-x, 0), shape[1] - max(x, 0)))
                there = (slice(max(y, 0), shape[0] + min(y, 0)), slice(max(x, 0), shape[1] + min(x, 0)))
                yield (dy, dx), here, there


def _window(image: Float[np.ndarray, "h w 1"], surface: Surface) -> Float[np.ndarray, "h w 1"]:
    """Means over about 9 by 9 texels."""
    found = image[None]
    for level in range(3):
        found = _blurred(found, surface, 1 << level)
    return np.maximum(found[0], 1e-12)


def scattered(values: Float[np.ndarray, "n c"], texel: Int[np.ndarray, "n"], shape: tuple[int, int]) -> np.ndarray:
    """Values of some texels as an image.

    Args:
        values: One row per texel.
        texel: Flat indices.
        shape: (height, width).
    Returns:
        [h w c], 0 elsewhere.
    """
    image = np.zeros((shape[0] * shape[1], values.shape[-1]), np.float32)
    image[texel] = values
    return image.reshape(*shape, -1)
