"""Random points where they are needed: strata, disks, hemispheres, cones, triangles, tables.

All but `stratified` are deterministic maps from uniform numbers `u` in [0, 1), so that any point set can drive them.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrefl.core.frames import to_world
from jaxrefl.core.safe import divide, sqrt

BELOW_ONE = float(np.nextafter(np.float32(1), np.float32(0)))
"""The largest float32 below 1."""


def stratified(key: Array, count: int, *, shape: tuple[int, ...] = ()) -> Float[Array, "*shape count 2"]:
    """One jittered point in each of `count` strata of equal area, for each element of `shape`.

    The unit square is cut into round(sqrt(count)) rows, and each row into cells so that every cell has the area
    1 / count; with a square count this is the square grid. Works for any count, primes included.

    Args:
        key: Random key.
        count: Points per element, >= 1.
        shape: Batch shape; all elements are independent.
    Returns:
        Points in [0, 1)^2, row by row: neighbours in the list are neighbours in the square, so pair two such sets only
        after shuffling one.
    Raises:
        ValueError: If `count` is less than 1.
    """
    lower, size = (jnp.broadcast_to(x, (*shape, count, 2)) for x in _strata(count))
    # The same numbers as with the shape itself, in a third of the time: short trailing axes are slow to fill.
    jitter = jax.random.uniform(key, (lower.size,), jnp.float32).reshape(lower.shape)
    return jnp.minimum(lower + size * jitter, BELOW_ONE)


def disk(u: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
    """Point of the unit disk; uniform numbers give the uniform density 1 / pi.

    Args:
        u: Two numbers in [0, 1]; neighbours stay neighbours.
    Returns:
        (x, y) with x^2 + y^2 <= 1; the middle of the square goes to the middle of the disk.
    Edge cases: the gradient at the middle is 0 (the map has none there).
    Source: [SC97] Shirley and Chiu, "A Low Distortion Map Between Disk and Square", JGT 2(3), 1997.
    """
    x, y = 2 * u[..., 0] - 1, 2 * u[..., 1] - 1
    wide = jnp.abs(x) > jnp.abs(y)
    radius = jnp.where(wide, x, y)
    quarter = jnp.pi / 4
    angle = jnp.where(wide, quarter * divide(y, x), 2 * quarter - quarter * divide(x, y))
    return jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle)], -1)


def cosine_hemisphere(u: Float[Array, "*b 2"], n: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Direction above a surface; uniform numbers give the density (direction . n) / pi.

    Args:
        u: Two numbers in [0, 1].
        n: Unit normals, world space.
    Returns:
        Unit directions, world space, on the side of n.
    Source: Malley's method, [PJH23] Pharr et al., "Physically Based Rendering", 4th ed., §A.5.3.
    """
    point = disk(u)
    x, y = point[..., 0], point[..., 1]
    return to_world(jnp.stack([x, y, sqrt(1 - x * x - y * y)], -1), n)


def triangle(u: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
    """Barycentric coordinates of a point of a triangle; uniform numbers give a uniform density.

    Args:
        u: Two numbers in [0, 1]; neighbours stay neighbours.
    Returns:
        Weights of the triangle's second and third vertex, >= 0 and with a sum <= 1, as in `Hits.barycentric`.
    Source: [Hei19] Heitz, "A Low-Distortion Map Between Triangle and Square", 2019.
    """
    x, y = u[..., 0], u[..., 1]
    upper = y > x
    return jnp.stack([jnp.where(upper, 0.5 * x, x - 0.5 * y), jnp.where(upper, y - 0.5 * x, 0.5 * y)], -1)


def cone(u: Float[Array, "*b 2"], axis: Float[Array, "*b 3"], cos_max: Float[Array, "*b"]) -> Float[Array, "*b 3"]:
    """Direction in a cone; uniform numbers give the uniform density 1 / (2 pi (1 - cos_max)).

    Args:
        u: Two numbers in [0, 1].
        axis: Unit directions in the middle of the cone, world space.
        cos_max: Cosine of the half angle, in [-1, 1]; 1 is the axis alone, -1 the whole sphere.
    Returns:
        Unit directions, world space.
    """
    drop = u[..., 0] * (1 - cos_max)  # 1 - cos, kept as it is for the sine of narrow cones
    sin = sqrt(drop * (2 - drop))
    azimuth = 2 * jnp.pi * u[..., 1]
    return to_world(jnp.stack([sin * jnp.cos(azimuth), sin * jnp.sin(azimuth), 1 - drop], -1), axis)


def sample_cdf(cdf: Float[Array, "n"], u: Float[Array, "*b"]) -> Int[Array, "*b"]:
    """Index drawn from a table of cumulative probabilities: the first whose entry exceeds u.

    Args:
        cdf: Cumulative probabilities, not decreasing; the last is 1, up to rounding.
        u: Uniform numbers in [0, 1].
    Returns:
        Indices into the table, int32.
    Edge cases: never an element of probability 0, not even for u = 1; in a table of zeros the last.
    """
    below_last = jnp.minimum(u, jnp.nextafter(cdf[-1], jnp.zeros_like(cdf[-1])))
    index = jnp.searchsorted(cdf, below_last, side="right")
    return jnp.minimum(index, cdf.shape[0] - 1).astype(jnp.int32)


def _strata(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower corners and sizes [count 2] of cells of area 1 / count that tile the unit square."""
    if count < 1:
        raise ValueError(f"count: expected at least 1 point, got {count}")
    rows = round(count**0.5)
    first = np.arange(rows + 1) * count // rows  # first cell of each row
    per_row = np.diff(first)
    row = np.repeat(np.arange(rows), per_row)
    columns = per_row[row]
    size = np.stack([1 / columns, columns / count], -1)
    lower = np.stack([(np.arange(count) - first[row]) / columns, first[row] / count], -1)
    return lower.astype(np.float32), size.astype(np.float32)
