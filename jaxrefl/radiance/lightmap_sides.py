"""Which sides of a scene's triangles can see light: Scene -> the inner sides of solid objects, and the sides to bake.

An object is *closed* if each of its edges joins two triangles with opposite directions, and *solid* if it is closed and
opaque and nothing is in it: no whole other object, no camera of the scene and no light. Nobody ever sees the inner side
of a solid object, so only its outer side is baked. All else (walls without thickness, leaves, open meshes, rooms) is
baked on both sides.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxrefl._types import Scene

_PROBES = 8
"""Vertices of an object that are tested for being inside another one."""


class Sides(NamedTuple):
    """What is known about the two sides of each triangle: [0] that which it faces, [1] the other."""

    baked: Bool[np.ndarray, "2 f"]
    """Sides that somebody may see."""
    inner: Bool[np.ndarray, "2 f"]
    """Inner sides of solid objects: a ray that meets one started inside the object."""


def sides_of(scene: Scene) -> Sides:
    """The sides of a scene's triangles.

    Args:
        scene: The scene.
    Returns:
        Sides to bake, and inner sides of solid objects.
    """
    owner = np.asarray(scene.mesh.object)
    corners = np.asarray(scene.mesh.vertices, np.float64)[np.asarray(scene.mesh.faces)]
    count = len(scene.names.objects)
    closed = _closed(scene, count) & ~_see_through(scene, count)
    lower, upper = (np.full((count, 3), fill) for fill in (np.inf, -np.inf))
    np.minimum.at(lower, owner, corners.min(1))
    np.maximum.at(upper, owner, corners.max(1))
    eyes = _points_inside_count(scene)
    inner = np.zeros((2, len(owner)), bool)
    for number in np.flatnonzero(closed):
        rows = np.flatnonzero(owner == number)
        within = (lower >= lower[number]).all(-1) & (upper <= upper[number]).all(-1)
        within[number] = False
        own = corners[rows]
        others = [corners[owner == k].reshape(-1, 3) for k in np.flatnonzero(within)]
        others = [points[:: max(1, len(points) // _PROBES)][:_PROBES] for points in others]
        if any((_winding(own, points) > 0.5).all() for points in others):
            continue
        near = eyes[((eyes >= lower[number]) & (eyes <= upper[number])).all(-1)]
        if len(near) and (_winding(own, near) > 0.5).any():
            continue
        local = own - own.mean((0, 1))
        volume = (local[:, 0] * np.cross(local[:, 1], local[:, 2])).sum()
        inner[1 if volume > 0 else 0, rows] = True
    return Sides(~inner, inner)


def _closed(scene: Scene, count: int) -> Bool[np.ndarray, "o"]:
    """Objects each edge of which joins two triangles, in opposite directions; corners at one place are one corner."""
    owner, faces = np.asarray(scene.mesh.object), np.asarray(scene.mesh.faces)
    _, place = np.unique(np.asarray(scene.mesh.vertices), axis=0, return_inverse=True)
    faces = place.reshape(-1)[faces].astype(np.int64)
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    pair = np.stack([np.repeat(owner, 3).astype(np.int64), np.minimum(start, end), np.maximum(start, end)], -1)
    _, edge = np.unique(pair, axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    uses = np.bincount(edge)
    forward = np.bincount(edge, weights=start < end)
    fits = (uses[edge] == 2) & (forward[edge] == 1)
    open_edges = np.bincount(np.repeat(owner, 3), weights=~fits, minlength=count)
    return (open_edges == 0) & (np.bincount(owner, minlength=count) > 0)


def _see_through(scene: Scene, count: int) -> Bool[np.ndarray, "o"]:
    """Objects with a material that lets light in."""
    clear = np.asarray(scene.materials.transmission) > 0
    if scene.materials.opacity is not None and scene.materials.opacity_texture is not None:
        clear = clear | (np.asarray(scene.materials.opacity) < 1) | (np.asarray(scene.materials.opacity_texture) >= 0)
    found = np.zeros(count, bool)
    np.logical_or.at(found, np.asarray(scene.mesh.object), clear[np.asarray(scene.mesh.material)])
    return found


def _points_inside_count(scene: Scene) -> Float[np.ndarray, "k 3"]:
    """Points that make an object hollow if they are inside it: cameras and lights with a position."""
    points = [np.asarray(camera.world_from_camera)[:3, 3] for camera in scene.cameras]
    if (punctual := scene.lights.punctual) is not None:
        points += list(np.asarray(punctual.position)[~np.asarray(punctual.directional)])
    return np.asarray(points, np.float64).reshape(-1, 3)


def _winding(corners: Float[np.ndarray, "t 3 3"], points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k"]:
    """How often a closed surface winds around points, without sign: 1 inside, 0 outside.

    Source: [VOS83] Van Oosterom and Strackee, "The solid angle of a plane triangle", 1983, Eq. 8.
    """
    total = np.zeros(len(points))
    for number, point in enumerate(points):
        a, b, c = (corners[:, i] - point for i in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
        numerator = (a * np.cross(b, c)).sum(-1)
        denominator = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
        total[number] = np.abs(np.arctan2(numerator, denominator).sum()) / (2 * np.pi)
    return total
