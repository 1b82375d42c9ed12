"""The white furnace: spheres of all roughnesses in a world of constant radiance.

Radiance 1 comes from every direction and everything is white, so a sphere that keeps all energy cannot be seen: what
differs from 1 is an error of the reflection model or of a technique, by roughness and by row.
"""

import numpy as np

from jaxrefl._types import Camera, Size
from jaxrefl.scene.description import Description, Part, constant_sky, glossy
from scenes._check import whole
from scenes.orbits import loop
from scenes.shapes import sphere
from scenes.tessellation import segments, tessellate

STRESSES = "energy: in a constant world every pixel should be 1, for metals and dielectrics of alpha 0 to 1"

SPACING = 2.4


def build(*, triangles: int = 20_000, columns: int = 6) -> Description:
    """The scene.

    Args:
        triangles: Wanted number of triangles, shared by all spheres.
        columns: Spheres per row, 1 to 16; their alpha goes from 0 to 1 from left to right.
    Returns:
        The description: objects `metal 0.0` ... in the upper row and `dielectric 0.0` ... in the lower one.
    Raises:
        ValueError: If a parameter is out of range.
    """
    alphas = np.linspace(0, 1, whole("columns", columns, 1, 16))

    def make(detail: float) -> list[Part]:
        ball = sphere(1.0, around=segments(detail, 24, least=6))
        parts = []
        for row, (kind, metallic) in enumerate([("metal", 1.0), ("dielectric", 0.0)]):
            for column, alpha in enumerate(alphas):
                name = f"{kind} {alpha:.2f}"
                material = glossy(name, (1.0, 1.0, 1.0), alpha=float(alpha), metallic=metallic)
                place = (SPACING * (column - (columns - 1) / 2), SPACING * (0.5 - row), 0)
                parts.append(ball.moved(to=place).part(name, material))
        return parts

    parts = tessellate(triangles, make)
    return Description("furnace", parts, sky=constant_sky((1.0, 1.0, 1.0)), cameras={"front": path(1)[0]})


def path(frames: int, *, size: Size = (768, 320)) -> tuple[Camera, ...]:
    """A slow sway in front of the spheres; frame 0 looks at them straight on.

    Args:
        frames: Number of cameras, >= 1.
        size: (width, height) in pixels.
    Returns:
        The cameras of a closed loop.
    Raises:
        ValueError: If `frames` or `size` is invalid.
    """
    return loop(frames, eye=(0, 0, 18), target=(0, 0, 0), sway=20, rise=10, fov_y=19, size=size)
