"""The teapot room: a teapot and a reflective cup inside a ring of columns and distant walls.

The layout of [HS01] §6: near, middle and far surroundings (cup, columns, walls) at clearly different distances, which
is what layers of environment maps have to tell apart. The paper gives no dimensions or colours; those here are our own.

Source: [HS01] Z. S. Hakura, J. M. Snyder, "Realistic Reflections and Refractions on Graphics Hardware With Hybrid
Rendering and Layered Environment Maps", 2001.
"""

import math

import numpy as np

from jaxrefl._types import Camera, Size
from jaxrefl.scene.description import Description, Material, Part, glass, glossy, matte, mirror
from scenes._check import Real, one_of, whole
from scenes.orbits import orbit
from scenes.patterns import checker, stripes
from scenes.profiles import arc, chain, line
from scenes.rooms import ceiling_light, room
from scenes.shapes import Geometry, box, cylinder, lathe, merge, sweep
from scenes.teapot import teapot as newell
from scenes.tessellation import segments, tessellate

STRESSES = (
    "curved mirrors or glass with surroundings at three distances: self-reflection, parallax, multiple refraction"
)

RING = 11.0
"""Distance of the columns from the teapot."""


def build(*, triangles: int = 40_000, teapot: str = "mirror", columns: int = 12) -> Description:
    """The scene.

    Args:
        triangles: Wanted number of triangles; about two thirds go into the teapot.
        teapot: What the teapot is made of: `mirror`, `glass` (solid, slightly green) or `glossy` (copper).
        columns: Number of columns in the ring, 3 to 24.
    Returns:
        The description.
    Raises:
        ValueError: If a parameter is out of range.
    """
    whole("columns", columns, 3, 24)
    of_teapot = _TEAPOTS[one_of("teapot", teapot, tuple(_TEAPOTS))]
    tiles = checker("tiles", (0.62, 0.56, 0.46), (0.2, 0.13, 0.09), joint=0.02)
    floor = Material("floor", base_colour_texture=tiles, eta=1.0)
    cup = mirror("silver", colour=(0.97, 0.93, 0.86))
    shafts = [matte(f"column {i}", colour) for i, colour in enumerate(COLUMNS)]

    def make(detail: Real) -> list[Part]:
        column = _column(segments(detail, 16, least=4))
        parts = [
            newell(max(3, round(12 * detail))).moved(turn=25).part("teapot", of_teapot),
            _cup(detail).moved(to=(3.5, 0, 1.5), turn=205).part("cup", cup),
        ]
        for i in range(columns):
            angle = 2 * math.pi * (i + 0.5) / columns
            place = (RING * math.sin(angle), 0, RING * math.cos(angle))
            parts.append(column.moved(to=place).part(f"column {i}", shafts[i % len(shafts)]))
        banded = Material("wall", base_colour_texture=stripes("hangings", WALLS), eta=1.0)
        ceiling = matte("ceiling", (0.7, 0.7, 0.72))
        return [
            *parts,
            *room((-24, 0, -24), (24, 16, 24), tile=12, floor=floor, ceiling=ceiling, walls=banded),
            ceiling_light("main light", (0, 15.9, 0), (12, 12), (7.0, 6.6, 6.0)),
            *[
                ceiling_light(f"side light {i}", (18 * x, 15.9, 18 * z), (4, 4), (8.0, 7.0, 5.5))
                for i, (x, z) in enumerate([(-1, -1), (1, -1), (-1, 1), (1, 1)])
            ],
        ]

    parts = tessellate(triangles, make)
    return Description("teapot_room", parts, ambient=(0.16, 0.16, 0.17), cameras={"front": path(1)[0]})


COLUMNS = ((0.7, 0.66, 0.58), (0.55, 0.16, 0.1), (0.16, 0.3, 0.42))
WALLS = ((0.5, 0.42, 0.3), (0.14, 0.2, 0.33), (0.5, 0.42, 0.3), (0.33, 0.09, 0.07))
_TEAPOTS = {
    "mirror": mirror("mirror teapot", colour=(0.95, 0.95, 0.96)),
    "glass": glass("glass teapot", eta=1.5, attenuation=(0.06, 0.02, 0.04)),
    "glossy": glossy("copper teapot", (0.95, 0.64, 0.54), alpha=0.08, metallic=1.0),
}


def _column(around: int) -> Geometry:
    """A column of height 12 with a square base and top and a round shaft that narrows upwards."""
    base = box((-1.0, 0, -1.0), (1.0, 0.5, 1.0))
    shaft = cylinder(0.75, 0.6, 11.0, around=around).moved(to=(0, 0.5, 0))
    top = box((-0.9, 11.5, -0.9), (0.9, 12.0, 0.9))
    return merge(base, shaft, top)


def _cup(detail: Real) -> Geometry:
    """A cup of height 1.7 with a wall, a rounded lip and a handle towards +X."""
    around = segments(detail, 28, least=6)
    fine = max(1, round(6 * detail))
    wall, lip = 0.08, 1.62
    profile = chain(
        line((0, 0), (0.62, 0)),
        arc((0.62, 0.3), 0.3, -90, 0, fine),
        line((0.92, 0.3), (1.04, lip)),
        arc((1.04 - wall, lip), wall, 0, 180, fine),
        line((1.04 - 2 * wall, lip), (0.92 - 2 * wall, 0.3)),
        line((0.92 - 2 * wall, 0.3), (0, 2 * wall)),
    )
    angle = np.radians(np.linspace(105, -105, 2 + 3 * fine))[:, None]
    curve = np.concatenate([0.97 + 0.45 * np.cos(angle), 0.9 + 0.5 * np.sin(angle), 0 * angle], -1)
    return merge(lathe(*profile, around=around), sweep(curve, 0.08, around=max(4, around // 3)))


def path(frames: int, *, size: Size = (640, 480)) -> tuple[Camera, ...]:
    """A circle around the teapot inside the ring of columns, at most 3 degrees per frame.

    Args:
        frames: Number of cameras, >= 1; 120 or more go all the way round.
        size: (width, height) in pixels.
    Returns:
        The cameras.
    Raises:
        ValueError: If `frames` or `size` is invalid.
    """
    return orbit(frames, eye=(0.8, 3.6, 9.2), target=(0.5, 1.3, 0), step=-3, fov_y=45, size=size)
