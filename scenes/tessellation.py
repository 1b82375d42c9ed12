"""How finely a built-in scene is tessellated: from a wanted number of triangles to segment counts.

Every scene is a function of one number, the detail, from which all its curved shapes take their segments; the number
of triangles grows with about the square of the detail. A few trial builds find the detail.
"""

import math
from collections.abc import Callable

from jaxrefl.scene.description import Part
from scenes._check import Real

FEWEST, MOST = 1000, 1_100_000
"""Range of `triangles` that every built-in scene accepts."""


def segments(detail: Real, share: Real, *, least: int = 4) -> int:
    """Number of segments around a shape.

    Args:
        detail: The scene's detail, >= 0.
        share: Segments per unit of detail.
        least: Smallest number that still shows what the shape is.
    Returns:
        An even number of segments, >= `least`.
    """
    return max(least + least % 2, 2 * round(0.5 * detail * share))


def tessellate(triangles: int, make: Callable[[Real], list[Part]]) -> list[Part]:
    """The parts of a scene at the detail that comes closest to a number of triangles.

    Args:
        triangles: Wanted number of triangles, `FEWEST` to `MOST`.
        make: From a detail to the scene's parts; more detail means at least as many triangles.
    Returns:
        The parts; their number of triangles is within a quarter of `triangles`.
    Raises:
        ValueError: If `triangles` is out of range.
    """
    if isinstance(triangles, bool) or int(triangles) != triangles or not FEWEST <= triangles <= MOST:
        raise ValueError(f"triangles: expected a whole number from {FEWEST} to {MOST}, got {triangles}")
    low, high, detail = 0.0, math.inf, 1.0
    chosen = parts = make(detail)
    best = math.inf
    for _ in range(10):
        count = sum(len(part.faces) for part in parts)
        error = abs(math.log(count / triangles))
        if error < best:
            best, chosen = error, parts
        low, high = (detail, high) if count < triangles else (low, detail)
        if error < 0.1 or high < 0.05 or high < 1.02 * low:
            break
        guess = detail * math.sqrt(triangles / count)
        detail = guess if low < guess < high else 0.5 * (low + high) if math.isfinite(high) else 2 * low
        parts = make(detail)
    return chosen
