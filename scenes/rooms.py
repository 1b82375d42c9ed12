"""What the built-in rooms are made of: walls and ceiling lights.

numbers and materials -> `Part`s of the scene description. Rooms are seen from the inside.
"""

from jaxrefl.scene.description import Material, Part, emitter
from scenes._check import Real
from scenes.shapes import Geometry, rectangle

Corner = tuple[Real, Real, Real]


def walls(lower: Corner, upper: Corner, *, tile: Real = 1.0) -> dict[str, Geometry]:
    """The six inner faces of a box.

    Args:
        lower: [3] Smallest coordinates.
        upper: [3] Largest coordinates.
        tile: Side of one repetition of a texture, world units.
    Returns:
        Rectangles that face inwards: `floor`, `ceiling`, `left` (-X), `right` (+X), `back` (-Z), `front` (+Z). Their
        texture coordinates are upright for someone who stands inside.
    """
    (x0, y0, z0), (x1, y1, z1) = lower, upper
    w, h, d = x1 - x0, y1 - y0, z1 - z0
    return {
        "floor": rectangle((x0, y0, z1), (w, 0, 0), (0, 0, -d), tiles=(w / tile, d / tile)),
        "ceiling": rectangle((x0, y1, z0), (w, 0, 0), (0, 0, d), tiles=(w / tile, d / tile)),
        "left": rectangle((x0, y0, z1), (0, 0, -d), (0, h, 0), tiles=(d / tile, h / tile)),
        "right": rectangle((x1, y0, z0), (0, 0, d), (0, h, 0), tiles=(d / tile, h / tile)),
        "back": rectangle((x0, y0, z0), (w, 0, 0), (0, h, 0), tiles=(w / tile, h / tile)),
        "front": rectangle((x1, y0, z1), (-w, 0, 0), (0, h, 0), tiles=(w / tile, h / tile)),
    }


def room(lower: Corner, upper: Corner, *, tile: Real = 1.0, **materials: Material) -> list[Part]:
    """A closed room.

    Args:
        lower: [3] Smallest coordinates.
        upper: [3] Largest coordinates.
        tile: Side of one repetition of a texture, world units.
        **materials: `floor`, `ceiling`, `left`, `right`, `back`, `front`, or `walls` for those of the last four that
            are not named.
    Returns:
        One part per face.
    """
    shapes = walls(lower, upper, tile=tile)
    return [shape.part(name, materials.get(name) or materials["walls"]) for name, shape in shapes.items()]


def ceiling_light(name: str, centre: Corner, size: tuple[Real, Real], radiance) -> Part:
    """A rectangular light that faces downwards.

    Args:
        name: Object name.
        centre: [3] Its middle, a little below the ceiling.
        size: Lengths along X and Z.
        radiance: [3] Emitted radiance.
    Returns:
        The part.
    """
    (x, y, z), (w, d) = centre, size
    return rectangle((x - w / 2, y, z - d / 2), (w, 0, 0), (0, 0, d)).part(
        name, emitter(name, tuple(float(c) for c in radiance))
    )
