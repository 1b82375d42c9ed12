"""What lies between the pixels of a key frame: where they show one smooth thing, and how far colours bend there.

Bilinear values are right where the surface and its colour are nearly linear over a pixel. Where they are not, the
expected error follows from second differences; where neighbours show different things, there is no value between them.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Mesh
from jaxrefl.core import apart, cross, together
from jaxrefl.core.safe import normalise
from jaxrefl.techniques.temporal.flat import Triple, along, dot3, split

STEEPEST = 0.5
"""Sine of the angle between a chord and the surface at its ends above which it leads over an edge or a gap."""


def normals_of(mesh: Mesh, triangle: Int[Array, "*b"]) -> Float[Array, "*b 3"]:
    """Geometric normals of triangles.

    Args:
        mesh: The mesh.
        triangle: Rows in `Mesh.faces`.
    Returns:
        Unit normals; the edge case of a degenerate triangle is that of `core.safe.normalise`.
    """
    a, b, c = (mesh.vertices[mesh.faces[triangle, i]] for i in range(3))
    return normalise(cross(b - a, c - a))


def connections(
    mesh: Mesh, reflected: Float[Array, "h w 4"], triangle: Int[Array, "h w"], valid: Bool[Array, "h w"]
) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"], Bool[Array, "h w"]]:
    """Which neighbouring pixels show one smooth piece of the same thing.

    Args:
        mesh: The triangles.
        reflected: Reflected points (x, y, z, 1), or directions (x, y, z, 0).
        triangle: Reflected triangles, -1 for the environment.
        valid: Where there is a reflection.
    Returns:
        Whether each pixel is connected to its right neighbour, to the one below, and whether the four pixels of which
            it is the upper left corner are all connected. False in the last column or row.
    """
    known = jnp.maximum(triangle, 0)
    # Both apart, or XLA reads the triangles, and compares the neighbours, again for each that looks at them.
    normal = split(apart(triangle >= 0, normals_of, mesh, known))
    thing = jnp.where(triangle >= 0, apart(triangle >= 0, lambda of, i: of[i], mesh.object, known), -1)

    def joined() -> Int[Array, "h w"]:
        return jnp.where(_joined(reflected, normal, thing, valid, 1), 1, 0) + jnp.where(
            _joined(reflected, normal, thing, valid, 0), 2, 0
        )

    found = apart(valid, joined)
    right, down = (found & 1) == 1, (found & 2) == 2
    return right, down, right & down & _after(right, 0) & _after(down, 1)


def _joined(
    reflected: Float[Array, "h w 4"], normal: Triple, thing: Int[Array, "h w"], valid: Bool[Array, "h w"], axis: int
) -> Bool[Array, "h w"]:
    *point, w = (reflected[..., i] for i in range(4))
    chord = tuple(_after(x, axis) - x for x in point)
    steep = jnp.maximum(jnp.abs(dot3(chord, normal)), jnp.abs(dot3(chord, tuple(_after(n, axis) for n in normal))))  # pyright: ignore[reportArgumentType]
    on_surface = (w == 0) | (steep <= STEEPEST * _length(chord))  # pyright: ignore[reportArgumentType]
    same = (thing == _after(thing, axis)) & (w == _after(w, axis)) & on_surface
    return valid & _after(valid, axis) & same


def _after(x: Array, axis: int, fill: float | bool = 0) -> Array:
    """The neighbour to the right (axis 1) or below (axis 0); `fill` beyond the border."""
    return _moved(x, axis, (-1, 1), fill)


def _before(x: Array, axis: int, fill: float | bool = 0) -> Array:
    """The neighbour to the left (axis 1) or above (axis 0)."""
    return _moved(x, axis, (1, -1), fill)


def _moved(x: Array, axis: int, by: tuple[int, int], fill: float | bool) -> Array:
    # A pad, which XLA fuses well; a roll is a concatenation.
    return jax.lax.pad(x, jnp.asarray(fill, x.dtype), [(*by, 0) if i == axis else (0, 0, 0) for i in (0, 1)])


def _length(of: Triple) -> Array:
    squared = dot3(of, of)
    return jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1)), 0)


def _largest(of: Triple) -> Array:
    return jnp.maximum(jnp.maximum(of[0], of[1]), of[2])


def _difference(a: Triple, b: Triple) -> Array:
    """Largest difference of two colours over their channels."""
    x, y, z = along(a, -1.0, b)
    return _largest((jnp.abs(x), jnp.abs(y), jnp.abs(z)))


def _neighbour(of: Triple, axis: int) -> Triple:
    x, y, z = (_after(c, axis) for c in of)
    return x, y, z


def _scale(colour: Triple, valid: Bool[Array, "h w"]) -> tuple[Array, Array]:
    """How bright each pixel is, and the mean of the image."""
    brightness = _largest(colour)
    return brightness, jnp.where(valid, brightness, 0).sum() / jnp.maximum(valid.sum(), 1).astype(jnp.float32)


def steepness(
    colour: Float[Array, "h w 3"],
    reflected: Float[Array, "h w 4"],
    right: Bool[Array, "h w"],
    down: Bool[Array, "h w"],
    valid: Bool[Array, "h w"],
) -> Float[Array, "h w"]:
    r"""How steeply a colour changes with the place on what is reflected, at most.

    $$ \max_n \frac{|c - c_n|}{|R - R_n|\,(c + \bar c)} $$

    over the connected neighbours n.

    Args:
        colour: Radiance, or base colours.
        reflected: Reflected points.
        right: Pixels connected to their right neighbour.
        down: Pixels connected to the one below.
        valid: Where the colour counts towards the mean.
    Returns:
        Relative change per world unit; infinite where no neighbour is connected.
    """
    c, point = split(colour), split(reflected[..., :3])
    brightness, mean = _scale(c, valid)
    scale = brightness + mean
    found = jnp.full(valid.shape, -1.0)
    for joined, axis in ((right, 1), (down, 0)):
        length = _length(along(_neighbour(point, axis), -1.0, point))
        rate = jnp.where(joined, _difference(_neighbour(c, axis), c) / jnp.where(length > 0, length, 1), -1)
        found = jnp.maximum(found, jnp.maximum(rate, _before(rate, axis, -1)))
    return jnp.where(found < 0, jnp.inf, found / jnp.where(scale > 0, scale, 1))


def bends(
    colour: Float[Array, "h w 3"], right: Bool[Array, "h w"], down: Bool[Array, "h w"], valid: Bool[Array, "h w"]
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    r"""Largest second differences of a colour at the corners of each cell, relative to the colours there.

    $$ b = \frac{\max |c_{-1} - 2 c_0 + c_{+1}|}{c + \bar c} $$

    Args:
        colour: Radiance, or base colours.
        right: Pixels connected to their right neighbour.
        down: Pixels connected to the one below.
        valid: Where the colour counts towards the mean.
    Returns:
        Bend along x and along y of the cell with this upper left corner. Differences across what is not connected do
            not count; where none is left, the first difference stands in.
    """
    c = split(colour)
    brightness, mean = _scale(c, valid)

    def four(x: Array) -> Array:
        """The largest value at the corners of each cell."""
        pair = jnp.maximum(x, _after(x, 1))
        return jnp.maximum(pair, _after(pair, 0))

    def second(joined: Bool[Array, "h w"], axis: int) -> Array:
        known = joined & _before(joined, axis)
        x, y, z = (_before(i, axis) - 2 * i + _after(i, axis) for i in c)
        return jnp.where(known, _largest((jnp.abs(x), jnp.abs(y), jnp.abs(z))), -1)

    def first(axis: int) -> Array:
        change = _difference(_neighbour(c, axis), c)
        return jnp.maximum(change, _after(change, 1 - axis))

    # Apart, or each corner of a cell has its differences taken again.
    differences = apart(valid, lambda: together(second(right, 1), second(down, 0)))
    scale = four(brightness) + mean
    scale = jnp.where(scale > 0, scale, 1)

    def bend(found: Float[Array, "h w"], axis: int) -> Float[Array, "h w"]:
        return jnp.where(found < 0, first(axis), found) / scale

    return bend(four(jnp.real(differences)), 1), bend(four(jnp.imag(differences)), 0)
