"""Profiles for the lathe: straight lines and arcs in the half plane (r, y), each with its outward normals.

numbers -> `Piece` (points, normals). Profiles run from the bottom to the top; the outside lies on their right.
"""

import math

import numpy as np
from jaxtyping import Float

from scenes._check import Real

Profile = Float[np.ndarray, "k 2"]
Piece = tuple[Float[np.ndarray, "_ 2"], Float[np.ndarray, "_ 2"]]


def line(start, stop) -> Piece:
    """Piece of a lathe profile: a straight line, with the outside on its right.

    Args:
        start: (r, y) of the first point.
        stop: (r, y) of the last point, different from `start`.
    Returns:
        Points and unit normals.
    """
    points = np.array([start, stop], np.float64)
    r, y = points[1] - points[0]
    return points, np.broadcast_to(np.array([y, -r]) / math.hypot(r, y), (2, 2)).copy()


def arc(centre, radius: Real, start: Real, stop: Real, segments: int) -> Piece:
    """Piece of a lathe profile: a circular arc and its normals.

    Args:
        centre: (r, y) of the centre.
        radius: Radius; negative for a hollow arc, whose normals point to the centre.
        start: Angle of the first point, degrees from +r towards +y.
        stop: Angle of the last point, degrees.
        segments: Number of segments, >= 1.
    Returns:
        Points and unit normals.
    """
    angle = np.radians(np.linspace(start, stop, segments + 1))
    outward = np.stack([np.cos(angle), np.sin(angle)], -1)
    points = np.asarray(centre, np.float64) + abs(radius) * outward
    points[np.abs(points) < 1e-12 * abs(radius)] = 0  # so that poles lie on the axis
    return points, math.copysign(1, radius) * outward


def chain(*pieces: Piece) -> Piece:
    """Pieces of a lathe profile one after another, with a crease or a doubled point where they meet.

    Args:
        *pieces: Points and normals, each piece starting where the one before ends.
    Returns:
        Points and normals; points where pieces meet agree to the last bit.
    Raises:
        ValueError: If two pieces do not meet.
    """
    points = [pieces[0][0]]
    for piece, _ in pieces[1:]:
        if np.abs(piece[0] - points[-1][-1]).max() > 1e-9 * np.abs(piece).max():
            raise ValueError(f"chain: expected a piece that starts at {points[-1][-1]}, got one from {piece[0]}")
        points.append(np.concatenate([points[-1][-1:], piece[1:]]))
    return np.concatenate(points), np.concatenate([normals for _, normals in pieces])
