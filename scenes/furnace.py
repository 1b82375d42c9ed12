"""The white furnace: a ball of all roughnesses in a world of constant radiance.

Radiance 1 comes from every direction and the ball is white, so it cannot be seen as long as no energy is lost or made
up: what differs from 1 is an error of the reflection model or of a technique. A single convex ball, because several
would shade each other. It is cut into upright slices whose alpha grows from left to right; the upper half is metal, the
lower half dielectric.
"""

import math

import numpy as np

from jaxrefl._types import Camera, Size
from jaxrefl.scene.description import Description, Part, constant_sky, glossy
from scenes._check import whole
from scenes.orbits import fitted_fov, loop
from scenes.profiles import arc
from scenes.shapes import lathe
from scenes.tessellation import segments, tessellate

STRESSES = "energy: in a constant world every pixel should be 1, for metals and dielectrics of alpha 0 to 1"


def build(*, triangles: int = 20_000, columns: int = 6) -> Description:
    """The scene.

    Args:
        triangles: Wanted number of triangles.
        columns: Slices of the ball, 2 to 16; their alpha goes from 0 to 1 in equal steps from left to right.
    Returns:
        The description: objects `metal 0.00` ... in the upper half and `dielectric 0.00` ... in the lower one.
    Raises:
        ValueError: If a parameter is out of range.
    """
    alphas = np.linspace(0, 1, whole("columns", columns, 2, 16))
    cuts = [math.degrees(math.asin(min(max(2 * i / columns - 1, -1.0), 1.0))) for i in range(columns + 1)]

    def make(detail: float) -> list[Part]:
        half_turn = segments(detail, 24, least=8)
        parts = []
        for alpha, start, stop in zip(alphas, cuts[:-1], cuts[1:], strict=True):
            profile = arc((0, 0), 1.0, start, stop, max(1, round(half_turn * (stop - start) / 180)))
            for kind, metallic, first in [("metal", 1.0, 180), ("dielectric", 0.0, 0)]:
                name = f"{kind} {alpha:.2f}"
                shape = lathe(*profile, around=half_turn, angles=(first, first + 180)).moved(tilt=90, turn=90)
                material = glossy(name, (1.0, 1.0, 1.0), alpha=float(alpha), metallic=metallic)
                parts.append(shape.part(name, material))
        return parts

    parts = tessellate(triangles, make)
    return Description("furnace", parts, sky=constant_sky((1.0, 1.0, 1.0)), cameras={"front": path(1)[0]})


def path(frames: int, *, size: Size = (480, 480)) -> tuple[Camera, ...]:
    """A slow sway in front of the ball; frame 0 looks at it straight on.

    Args:
        frames: Number of cameras, >= 1.
        size: (width, height) in pixels.
    Returns:
        The cameras of a closed loop.
    Raises:
        ValueError: If `frames` or `size` is invalid.
    """
    fov_y = min(26.0, fitted_fov(26.0, size))
    return loop(frames, eye=(0, 0, 5), target=(0, 0, 0), sway=12, rise=10, fov_y=fov_y, size=size)
