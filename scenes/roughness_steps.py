"""Objects that touch a floor whose roughness grows in steps.

A reflection on a glossy floor is sharp where an object touches it and blurs with the height above it (contact
hardening): on every strip of the floor stand the same post, ball, block and ring. The floor's alpha goes from 0 in the
left strip to `alpha` in the right one.
"""

import numpy as np

from jaxrefl._types import Camera, Size
from jaxrefl.scene.description import Description, Material, Part, emitter, glossy, matte
from scenes._check import Real, in_range, whole
from scenes.orbits import fitted_fov, loop
from scenes.patterns import checker, stripes
from scenes.shapes import Geometry, box, cylinder, merge, rectangle, sphere, torus
from scenes.tessellation import segments, tessellate

STRESSES = "contact hardening: reflections that are sharp at the contact and blur with distance and with alpha"

STRIP, FRONT, BACK = 2.0, 9.0, -3.5
"""Width of a strip of the floor, where the strips begin and end along Z."""
POST = 2.6
"""Height of the posts."""
WALL = ((0.05, 0.065, 0.08), (0.13, 0.15, 0.17), (0.05, 0.065, 0.08), (0.3, 0.09, 0.035))


def build(*, triangles: int = 20_000, strips: int = 6, alpha: Real = 0.5, metallic: bool = True) -> Description:
    """The scene.

    Args:
        triangles: Wanted number of triangles; they go into the round objects.
        strips: Number of strips, 2 to 12.
        alpha: GGX width of the last strip, in (0, 1]; the first one is a mirror, those between are evenly spaced.
        metallic: True: a metal floor; False: dark polished stone.
    Returns:
        The description: floor objects `floor 0.00` ... from left to right.
    Raises:
        ValueError: If a parameter is out of range.
    """
    widths = np.linspace(0, in_range("alpha", alpha, 1e-3, 1), whole("strips", strips, 2, 12))
    half = STRIP * strips / 2
    red, blue = matte("red", (0.62, 0.07, 0.05)), matte("blue", (0.06, 0.16, 0.5))
    yellow = matte("yellow", (0.75, 0.5, 0.05))
    colour = (0.82, 0.82, 0.84) if metallic else (0.04, 0.04, 0.045)
    wall = Material("wall", base_colour_texture=stripes("stripes", WALL), eta=1.0)
    post = Material("post", base_colour_texture=checker("bands", (0.85, 0.82, 0.75), (0.75, 0.28, 0.04)), eta=1.0)

    def make(detail: float) -> list[Part]:
        around = segments(detail, 24, least=6)
        pillar = _banded(cylinder(0.15, 0.15, POST, around=around))
        parts = []
        for i, a in enumerate(widths):
            x = STRIP * (i + 0.5) - half
            floor = glossy(f"floor {a:.2f}", colour, alpha=float(a), metallic=float(metallic), eta=1.9)
            strip = rectangle((x - STRIP / 2, 0, FRONT), (STRIP, 0, 0), (0, 0, BACK - FRONT))
            cube = box((-0.27, 0, -0.27), (0.27, 0.54, 0.27)).moved(to=(x + 0.45, 0, 0.2), turn=25)
            ball = sphere(0.3, around=around).moved(to=(x - 0.02, 0.3, 1.2))
            ring = torus(0.5, 0.07, around=around).moved(tilt=90).moved(to=(x + 0.2, 0.57, -1.6), turn=15)
            parts += [
                strip.part(floor.name, floor),
                pillar.moved(to=(x - 0.6, 0, 0.4)).part(f"post {i}", post),
                cube.part(f"block {i}", blue),
                ball.part(f"ball {i}", red),
                ring.part(f"ring {i}", yellow),
            ]
        side = half + 6  # so that wide images see no end
        lamp = rectangle((half + 14, 1, 18), (-2 * half - 28, 0, 0), (0, 16, 5))
        apron = rectangle((half, 0, FRONT), (6, 0, 0), (0, 0, BACK - FRONT))
        parts += [
            rectangle((-side, 0, BACK), (2 * side, 0, 0), (0, 6, 0), tiles=(side / STRIP / 2, 1)).part("wall", wall),
            merge(apron, apron.moved(to=(-2 * half - 6, 0, 0))).part("apron", matte("apron", (0.08, 0.08, 0.085))),
            lamp.part("main light", emitter("main light", (2.7, 2.6, 2.4))),
        ]
        return parts

    parts = tessellate(triangles, make)
    return Description("roughness_steps", parts, ambient=(0.1, 0.1, 0.11), cameras={"front": path(1)[0]})


def _banded(shape: Geometry) -> Geometry:
    """A shape whose texture becomes rings: the pattern repeats with the height and not around the axis."""
    uv = np.stack([np.full(len(shape.uv), 0.25), 3 * shape.vertices[:, 1] / POST], -1)
    return Geometry(shape.vertices, shape.faces, shape.normals, uv)


def path(frames: int, *, size: Size = (960, 400)) -> tuple[Camera, ...]:
    """A slow sway in front of the strips, looking down on the floor.

    Args:
        frames: Number of cameras, >= 1.
        size: (width, height) in pixels.
    Returns:
        The cameras of a closed loop.
    Raises:
        ValueError: If `frames` or `size` is invalid.
    """
    fov_y = fitted_fov(53, size)
    return loop(frames, eye=(0, 3.0, 12.5), target=(0, 0.55, 0), sway=14, rise=6, fov_y=fov_y, size=size)
