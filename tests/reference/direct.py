"""Irradiance in closed form or by brute-force quadrature, float64, without shadows."""

from collections.abc import Callable

import numpy as np


def polygon(corners: np.ndarray, p: np.ndarray, n: np.ndarray) -> float:
    """Irradiance at p from a polygon of radiance 1 that lies wholly above the horizon: Lambert's sum over its edges.

    E = 1/2 sum_i angle_i (normal of the plane through p and edge i) . n
    """
    d = corners - p
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    total = 0.0
    for a, b in zip(d, np.roll(d, -1, axis=0), strict=True):
        normal = np.cross(a, b)
        total += np.arccos(np.clip(a @ b, -1, 1)) * (normal / np.linalg.norm(normal)) @ n
    return abs(total) / 2


def parallelogram(
    corner: np.ndarray,
    edges: tuple[np.ndarray, np.ndarray],
    radiance: Callable,
    p: np.ndarray,
    n: np.ndarray,
    *,
    count: int,
) -> np.ndarray:
    """Irradiance at p from both sides of corner + u edges[0] + v edges[1], with radiance(u, v) -> [3], by midpoints."""
    area_normal = np.cross(*edges)
    total = np.zeros(3)
    for u in (np.arange(count) + 0.5) / count:
        for v in (np.arange(count) + 0.5) / count:
            to_light = corner + u * edges[0] + v * edges[1] - p
            r2 = to_light @ to_light
            projected = max(to_light @ n, 0) * abs(to_light @ area_normal) / r2**2
            total += radiance(u, v) * projected / count**2
    return total


def sky(radiance: np.ndarray, directions: np.ndarray, solid_angle: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Irradiance on a surface with normal n from radiance [d 3] seen in directions [d 3]."""
    return (radiance * (np.maximum(directions @ n, 0) * solid_angle)[:, None]).sum(0)
