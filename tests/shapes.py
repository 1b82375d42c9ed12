"""Shapes that several tests use."""

import functools

import numpy as np
import trimesh

from jaxrefl.scene.description import Material, Part


@functools.cache
def _icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(ball.vertices), np.asarray(ball.faces)


def ball(name: str, material: Material, *, centre=(0.0, 0.0, 0.0), radius: float = 1.0, subdivisions: int = 3) -> Part:
    """A smooth ball with exact normals."""
    vertices, faces = _icosphere(subdivisions)
    return Part(name, vertices * radius + np.asarray(centre), faces, material, normals=vertices)


QUAD = np.array([[0, 1, 2], [0, 2, 3]])
"""Faces of a quadrilateral."""


def floor(name: str, material: Material, *, size: float = 4.0, height: float = 0.0) -> Part:
    """A square that faces up."""
    corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]], np.float64)
    return Part(name, size * corners + [0, height, 0], QUAD, material)
