"""The Cornell box with a mirror sphere and a glossy block.

Dimensions, wall colours and light of the original, one unit = 100 mm, turned so that the camera looks along -Z. The box
is deepened towards the camera and closed behind it, so that nothing reflects empty space and wide images show walls.
The light is 1.6 times as bright as the original, as light that arrives by way of the walls is left to an ambient term.
"""

from jaxrefl._types import Camera, Size
from jaxrefl.scene.description import Description, Part, emitter, glossy, matte, mirror
from scenes._check import Real, in_range
from scenes.orbits import loop
from scenes.rooms import room
from scenes.shapes import box, rectangle, sphere
from scenes.tessellation import segments, tessellate

STRESSES = "a curved mirror and planar glossy faces between coloured walls: colour bleeding into reflections"

WHITE, RED, GREEN = (0.725, 0.71, 0.68), (0.63, 0.065, 0.05), (0.14, 0.45, 0.091)


def build(*, triangles: int = 20_000, block_alpha: Real = 0.1, sphere_alpha: Real = 0.0) -> Description:
    """The scene.

    Args:
        triangles: Wanted number of triangles; they go into the sphere.
        block_alpha: GGX width of the block, in [0, 1].
        sphere_alpha: GGX width of the sphere, in [0, 1].
    Returns:
        The description, with the first camera of `path` as its camera.
    Raises:
        ValueError: If a parameter is out of range.
    """
    ball = mirror("mirror sphere").replace(alpha=in_range("sphere_alpha", sphere_alpha, 0, 1))
    metal = glossy("glossy block", (0.95, 0.93, 0.88), alpha=in_range("block_alpha", block_alpha, 0, 1), metallic=1.0)
    white, lamp = matte("white", WHITE), emitter("light", (29.4, 22.4, 10.8))

    def make(detail: Real) -> list[Part]:
        around = segments(detail, 32, least=8)
        return [
            *room(
                (-2.764, 0, -5.592),
                (2.764, 5.488, 9),
                left=matte("red", RED),
                right=matte("green", GREEN),
                floor=white,
                ceiling=white,
                walls=white,
            ),
            rectangle((-0.65, 5.48, -3.32), (1.3, 0, 0), (0, 0, 1.05)).part("light", lamp),
            sphere(1.0, around=around).moved(to=(1.05, 1.0, -1.75)).part("sphere", ball),
            box((-0.825, 0, -0.825), (0.825, 3.3, 0.825)).moved(to=(-0.95, 0, -3.5), turn=17).part("block", metal),
        ]

    parts = tessellate(triangles, make)
    return Description("cornell", parts, ambient=(0.13, 0.12, 0.11), cameras={"front": path(1)[0]})


def path(frames: int, *, size: Size = (512, 512)) -> tuple[Camera, ...]:
    """A slow sway in front of the box; frame 0 is the classic view.

    Args:
        frames: Number of cameras, >= 1.
        size: (width, height) in pixels.
    Returns:
        The cameras of a closed loop.
    Raises:
        ValueError: If `frames` or `size` is invalid.
    """
    return loop(frames, eye=(0, 2.73, 8), target=(0, 2.73, -2.8), sway=9, rise=5, fov_y=39.3, size=size)
