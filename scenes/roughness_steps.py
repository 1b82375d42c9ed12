"""Objects that touch a floor whose roughness grows in steps.

A reflection on a glossy floor is sharp where an object touches it and blurs with the height above it (contact
hardening): on every strip of the floor stand the same post, ball, block and ring. The floor's alpha goes from 0 in the
left strip to `alpha` in the right one.
"""

import numpy as np

from jaxrefl._types import Camera, Size
from jaxrefl.scene.description import Description, Material, Part, glossy, matte
from scenes._check import Real, in_range, whole
from scenes.orbits import loop
from scenes.patterns import checker, stripes
from scenes.rooms import ceiling_light
from scenes.shapes import box, cylinder, rectangle, sphere, torus
from scenes.tessellation import segments, tessellate

STRESSES = "contact hardening: reflections that are sharp at the contact and blur with distance and with alpha"

STRIP = 2.0
"""Width of a strip of the floor."""


def build(*, triangles: int = 20_000, strips: int = 6, alpha: Real = 0.5, metallic: bool = False) -> Description:
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
    colour = (0.9, 0.9, 0.9) if metallic else (0.05, 0.05, 0.055)
    wall = Material("wall", base_colour_texture=stripes("stripes", WALL), eta=1.0)
    post = Material("post", base_colour_texture=checker("bands", (0.85, 0.82, 0.75), (0.12, 0.13, 0.15)), eta=1.0)

    def make(detail: Real) -> list[Part]:
        around = segments(detail, 24, least=6)
        parts = []
        for i, a in enumerate(widths):
            x = STRIP * (i + 0.5) - half
            floor = glossy(f"floor {a:.2f}", colour, alpha=float(a), metallic=float(metallic), eta=1.9)
            strip = rectangle((x - STRIP / 2, 0, 4), (STRIP, 0, 0), (0, 0, -7.5))
            pillar = _banded(cylinder(0.16, 0.16, 2.6, around=around))
            cube = box((-0.28, 0, -0.28), (0.28, 0.56, 0.28)).moved(to=(x + 0.38, 0, 0.55), turn=25)
            ball = sphere(0.32, around=around).moved(to=(x - 0.4, 0.32, 0.75))
            ring = torus(0.5, 0.07, around=around).moved(tilt=90).moved(to=(x, 0.57, -1.1), turn=15)
            parts += [
                strip.part(floor.name, floor),
                pillar.moved(to=(x, 0, -0.3)).part(f"post {i}", post),
                cube.part(f"block {i}", matte("blue", (0.06, 0.16, 0.5))),
                ball.part(f"ball {i}", matte("red", (0.62, 0.07, 0.05))),
                ring.part(f"ring {i}", matte("yellow", (0.75, 0.5, 0.05))),
            ]
        parts += [
            rectangle((-half, 0, -3.5), (2 * half, 0, 0), (0, 4.5, 0), tiles=(strips / 2, 1)).part("wall", wall),
            ceiling_light("front light", (0, 7, 3), (2 * half, 1.5), (9, 8.6, 8)),
            ceiling_light("back light", (0, 6, -1.5), (2 * half, 0.6), (7, 7.5, 8)),
        ]
        return parts

    parts = tessellate(triangles, make)
    return Description("roughness_steps", parts, ambient=(0.08, 0.08, 0.09), cameras={"front": path(1)[0]})


WALL = ((0.62, 0.6, 0.55), (0.3, 0.42, 0.45), (0.62, 0.6, 0.55), (0.5, 0.2, 0.12))


def _banded(shape):
    """A shape whose texture becomes rings: the pattern repeats with the height and not around the axis."""
    uv = np.stack([np.full(len(shape.uv), 0.25), 3 * shape.vertices[:, 1] / 2.6], -1)
    return type(shape)(shape.vertices, shape.faces, shape.normals, uv)


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
    return loop(frames, eye=(0, 3.0, 12.5), target=(0, 0.65, 0), sway=14, rise=6, fov_y=24, size=size)
