"""A room of planar and curved mirrors with many small things close to them.

Chairs around a table on a polished floor, a tall wall mirror with things in front of it, a round concave mirror, a
convex one in the corner, a chrome vase and balls among cups and blocks. The legs stand on the floor that reflects them:
parallax at distance zero, where an environment map is wrong by as much as it can be. One unit = 1 m.
"""

import math

import numpy as np

from jaxrefl._types import Camera, Size
from jaxrefl.scene.description import Description, Material, Part, glossy, matte, mirror
from scenes._check import Real, in_range
from scenes.orbits import loop
from scenes.patterns import checker, planks
from scenes.profiles import arc, chain, line
from scenes.rooms import ceiling_light, room
from scenes.shapes import Geometry, box, cylinder, lathe, merge, rectangle, sphere, sweep, torus
from scenes.tessellation import segments, tessellate

STRESSES = "small objects that touch planar and curved mirrors: parallax that environment mapping gets wrong"

LOWER, UPPER = (-3.2, 0.0, -2.6), (3.2, 3.0, 3.4)
TABLE = (0.1, 0.0, -0.35)


def build(*, triangles: int = 40_000, floor_alpha: Real = 0.0, mirror_alpha: Real = 0.0) -> Description:
    """The scene.

    Args:
        triangles: Wanted number of triangles; they go into the round objects.
        floor_alpha: GGX width of the polished floor, in [0, 1].
        mirror_alpha: GGX width of all mirrors, in [0, 1].
    Returns:
        The description.
    Raises:
        ValueError: If a parameter is out of range.
    """
    wood = planks("planks", (0.17, 0.085, 0.04))
    floor = Material("floor", base_colour_texture=wood, alpha=in_range("floor_alpha", floor_alpha, 0, 1), eta=1.7)
    silver = mirror("silver").replace(alpha=in_range("mirror_alpha", mirror_alpha, 0, 1))
    chrome = silver.replace(name="chrome", base_colour=(0.9, 0.91, 0.93))
    plaster = matte("plaster", (0.68, 0.66, 0.6))
    blue, ochre = matte("blue wall", (0.12, 0.24, 0.36)), matte("ochre wall", (0.6, 0.4, 0.16))
    rug = Material("rug", base_colour_texture=checker("weave", (0.5, 0.08, 0.06), (0.65, 0.55, 0.38), tiles=8), eta=1.0)

    def make(detail: Real) -> list[Part]:
        around = segments(detail, 24, least=6)
        return [
            *room(LOWER, UPPER, tile=1.6, floor=floor, walls=plaster, left=blue, right=ochre),
            ceiling_light("main light", (0.2, 2.98, 0.3), (2.8, 2.0), (6.5, 6.1, 5.5)),
            *_furniture(around),
            *_on_the_table(around, chrome),
            *_wall_mirror(silver),
            *_round_mirrors(around, chrome, silver),
            *_on_the_floor(around, chrome),
            box((-3.19, 0.9, 0.5), (-3.16, 2.1, 2.1)).part("tapestry", rug),
            box((-1.6, 0.6, 3.36), (0.0, 2.2, 3.39)).part("hanging", rug),
            box((0.9, 0.0, 3.35), (1.9, 2.1, 3.39)).part("door", matte("door", (0.08, 0.25, 0.2))),
        ]

    parts = tessellate(triangles, make)
    return Description("mirror_room", parts, ambient=(0.2, 0.2, 0.205), cameras={"front": path(1)[0]})


def path(frames: int, *, size: Size = (768, 480)) -> tuple[Camera, ...]:
    """A slow sway through the front half of the room.

    Args:
        frames: Number of cameras, >= 1.
        size: (width, height) in pixels.
    Returns:
        The cameras of a closed loop.
    Raises:
        ValueError: If `frames` or `size` is invalid.
    """
    return loop(frames, eye=(0.75, 1.5, 2.95), target=(0.1, 0.85, -1.0), sway=12, rise=5, fov_y=50, size=size)


def _furniture(around: int) -> list[Part]:
    """A round table and four chairs on thin round legs."""
    legs = max(3, around // 3)
    oak, paint = matte("oak", (0.42, 0.25, 0.11)), matte("white paint", (0.75, 0.74, 0.7))
    top = lathe(
        *chain(
            line((0, 0.70), (0.58, 0.70)),
            arc((0.58, 0.72), 0.02, -90, 90, max(1, around // 8)),
            line((0.58, 0.74), (0, 0.74)),
        ),
        around=2 * around,
    )
    table = merge(top, *[_leg(0.43, a, 0.7, 0.025, legs) for a in range(45, 405, 90)])
    parts = [table.moved(to=TABLE).part("table", oak)]
    for i, (turn, distance) in enumerate([(35, 0.95), (128, 0.92), (215, 0.95), (305, 1.0)]):
        x, z = distance * math.sin(math.radians(turn)), distance * math.cos(math.radians(turn))
        place = (TABLE[0] + x, 0, TABLE[2] + z)
        parts.append(_chair(legs).moved(to=place, turn=turn).part(f"chair {i}", paint))
    return parts


def _leg(distance: Real, angle: Real, height: Real, radius: Real, around: int) -> Geometry:
    a = math.radians(angle)
    leg = cylinder(0.7 * radius, radius, height, around=around)
    return leg.moved(to=(distance * math.sin(a), 0, distance * math.cos(a)))


def _chair(around: int) -> Geometry:
    """A chair that faces -Z: a round seat, four legs, a bent back with three bars."""
    seat = cylinder(0.2, 0.21, 0.03, around=2 * around).moved(to=(0, 0.44, 0))
    legs = [_leg(0.2, a, 0.44, 0.018, around) for a in range(45, 405, 90)]
    bend = np.radians(np.linspace(-55, 55, max(4, around)))[:, None]
    rail = np.concatenate([0.2 * np.sin(bend), 0.86 + 0.06 * np.cos(bend), 0.2 * np.cos(bend)], -1)
    bars = []
    for a in np.radians([-50, 0, 50]):
        foot, head = (
            (0.18 * math.sin(a), 0.46, 0.18 * math.cos(a)),
            (0.2 * math.sin(a), 0.86 + 0.06 * math.cos(a), 0.2 * math.cos(a)),
        )
        bars.append(sweep(np.array([foot, head]), 0.009, around=around))
    return merge(seat, *legs, *bars, sweep(rail, 0.014, around=around))


def _on_the_table(around: int, chrome: Material) -> list[Part]:
    """A chrome vase, a chrome ball, a cup and fruit."""
    fine = max(2, around // 4)
    belly, outward = arc((0, 0.1), 0.1, -60, 70, fine)
    lip = (0.05, 0.3)
    body = chain(
        line((0, 0), (0.05, 0)),
        line((0.05, 0), belly[0]),
        (belly, outward),
        line(belly[-1], (0.028, 0.25)),
        line((0.028, 0.25), lip),
        line(lip, (0, 0.27)),
    )
    vase = lathe(*body, around=around)
    x, z = TABLE[0], TABLE[2]
    fruit = [((0.22, 0.17), 0.04, "orange", (0.75, 0.28, 0.03)), ((0.3, 0.1), 0.036, "lime", (0.3, 0.5, 0.06))]
    fruit += [((0.29, 0.2), 0.038, "apple", (0.6, 0.05, 0.04))]
    parts = [
        vase.moved(to=(x - 0.12, 0.74, z - 0.1)).part("vase", chrome),
        sphere(0.11, around=around).moved(to=(x + 0.12, 0.85, z - 0.16)).part("chrome ball", chrome),
        cylinder(0.035, 0.045, 0.09, around=around)
        .moved(to=(x - 0.1, 0.74, z + 0.22))
        .part("cup", matte("china", (0.75, 0.75, 0.78))),
    ]
    for (dx, dz), radius, name, colour in fruit:
        shape = sphere(radius, around=max(6, around // 2)).moved(to=(x + dx, 0.74 + radius, z + dz))
        parts.append(shape.part(name, glossy(name, colour, alpha=0.15)))
    return parts


def _wall_mirror(silver: Material) -> list[Part]:
    """A tall mirror on the back wall that reaches down to the floor, with a frame."""
    x0, x1, y0, y1, z = -1.5, 1.7, 0.06, 2.3, LOWER[2]
    glass = rectangle((x0, y0, z + 0.02), (x1 - x0, 0, 0), (0, y1 - y0, 0))
    w, d = 0.06, 0.05
    bars = [
        box((x0 - w, y0 - w, z + 0.001), (x1 + w, y0, z + d)),
        box((x0 - w, y1, z + 0.001), (x1 + w, y1 + w, z + d)),
        box((x0 - w, y0, z + 0.001), (x0, y1, z + d)),
        box((x1, y0, z + 0.001), (x1 + w, y1, z + d)),
    ]
    gilt = matte("gilt", (0.55, 0.36, 0.1))
    return [glass.part("wall mirror", silver), *[bar.part("frame", gilt) for bar in bars]]


def _round_mirrors(around: int, chrome: Material, silver: Material) -> list[Part]:
    """A concave mirror on the back wall and a convex one up in the left corner."""
    fine = max(2, around // 4)
    radius, curve = 0.5, 1.6  # rim radius and radius of curvature, so the focus is 0.8 in front
    edge = math.degrees(math.asin(radius / curve))
    depth = curve * (1 - math.cos(math.radians(edge)))
    hollow, inward = arc((0, curve), -curve, -90 + edge, -90, fine)  # from the rim down to the middle
    bowl = chain(
        line((0, -0.03), (radius + 0.03, -0.03)),
        line((radius + 0.03, -0.03), (radius + 0.03, depth)),
        line((radius + 0.03, depth), (radius, depth)),
    )
    back = lathe(*bowl, around=2 * around)
    face = lathe(hollow, inward, around=2 * around)
    dome = lathe(
        *chain(
            line((0, 0), (0.34, 0)),
            arc((0, -0.3), math.hypot(0.34, 0.3), math.degrees(math.atan2(0.3, 0.34)), 90, fine),
        ),
        around=2 * around,
    )
    hang = {"to": (2.5, 1.85, LOWER[2] + 0.05), "tilt": 90.0}
    return [
        face.moved(**hang).part("concave mirror", silver),
        back.moved(**hang).part("concave rim", matte("black", (0.03, 0.03, 0.03))),
        dome.moved(to=(LOWER[0] + 0.28, 2.35, LOWER[2] + 0.28), turn=45, tilt=75).part("convex mirror", chrome),
    ]


def _on_the_floor(around: int, chrome: Material) -> list[Part]:
    """Small things that stand on the floor, most of them close to the wall mirror."""
    z = LOWER[2]
    half = max(6, around // 2)

    def block(low: Real, high: Real, turn: Real) -> Geometry:
        side = 0.5 * (high - low)
        return box((-side, low, -side), (side, high, side)).moved(to=(1.25, 0, z + 0.25), turn=turn)

    things = [
        (cylinder(0.04, 0.04, 0.9, around=half).moved(to=(-1.1, 0, z + 0.12)), matte("red stick", (0.6, 0.06, 0.04))),
        (cylinder(0.16, 0.0, 0.42, around=around).moved(to=(-0.65, 0, z + 0.3)), matte("cone", (0.75, 0.4, 0.04))),
        (block(0.0, 0.2, 30), matte("green block", (0.1, 0.4, 0.12))),
        (block(0.2, 0.34, 55), matte("blue block", (0.08, 0.15, 0.5))),
        (torus(0.13, 0.04, around=around).moved(to=(1.75, 0.04, z + 0.55)), matte("ring", (0.65, 0.5, 0.06))),
        (sphere(0.18, around=around).moved(to=(-1.7, 0.18, z + 0.9)), chrome),
        (sphere(0.1, around=half).moved(to=(-1.3, 0.1, z + 0.75)), matte("ball", (0.65, 0.1, 0.3))),
        (cylinder(0.22, 0.22, 1.1, around=around).moved(to=(2.35, 0, z + 0.5)), chrome),
    ]  # fmt: skip
    return [shape.part(f"thing {i}", material) for i, (shape, material) in enumerate(things)]
