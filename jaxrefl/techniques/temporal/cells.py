"""What lies between the pixels of a key frame: where they show one smooth thing, and how far colours bend there.

Bilinear values are right where the surface and its colour are nearly linear over a pixel. Where they are not, the
expected error follows from second differences; where neighbours show different things, there is no value between them.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Mesh
from jaxrefl.core import cross, dot, largest
from jaxrefl.core.safe import norm, normalise

STEEPEST = 0.5
"""Sine of the angle between a chord and the surface at its ends above which it leads over an edge or a gap."""


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
    corners = mesh.vertices[mesh.faces[jnp.maximum(triangle, 0)]]
    normal = normalise(cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]))
    thing = jnp.where(triangle >= 0, mesh.object[jnp.maximum(triangle, 0)], -1)
    point, w = reflected[..., :3], reflected[..., 3]

    def joined(axis: int) -> Bool[Array, "h w"]:
        def after(x: Array) -> Array:
            return jnp.roll(x, -1, axis)

        chord = after(point) - point
        steep = jnp.maximum(jnp.abs(dot(chord, normal)), jnp.abs(dot(chord, after(normal))))
        on_surface = (w == 0) | (steep <= STEEPEST * norm(chord))
        same = (thing == after(thing)) & (w == after(w)) & on_surface
        inner = jnp.arange(valid.shape[axis]) < valid.shape[axis] - 1
        return valid & after(valid) & same & (inner[None, :] if axis == 1 else inner[:, None])

    right, down = joined(1), joined(0)
    return right, down, right & down & jnp.roll(right, -1, 0) & jnp.roll(down, -1, 1)


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
    brightness = largest(colour)
    mean = jnp.where(valid, brightness, 0).sum() / jnp.maximum(valid.sum(), 1).astype(jnp.float32)
    scale = brightness + mean
    found = jnp.full(valid.shape, -1.0)
    for joined, axis in ((right, 1), (down, 0)):
        change = largest(jnp.abs(jnp.roll(colour, -1, axis) - colour))
        length = norm(jnp.roll(reflected[..., :3], -1, axis) - reflected[..., :3])
        rate = jnp.where(joined, change / jnp.where(length > 0, length, 1), -1)
        found = jnp.maximum(found, jnp.maximum(rate, jnp.roll(rate, 1, axis)))
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
    brightness = largest(colour)
    mean = jnp.where(valid, brightness, 0).sum() / jnp.maximum(valid.sum(), 1).astype(jnp.float32)

    def four(x: Array) -> Array:
        """The largest value at the corners of each cell."""
        pair = jnp.maximum(x, jnp.roll(x, -1, 1))
        return jnp.maximum(pair, jnp.roll(pair, -1, 0))

    scale = four(brightness) + mean
    scale = jnp.where(scale > 0, scale, 1)

    def bend(joined: Bool[Array, "h w"], axis: int) -> Float[Array, "h w"]:
        after, before = jnp.roll(colour, -1, axis), jnp.roll(colour, 1, axis)
        known = joined & jnp.roll(joined, 1, axis)
        second = jnp.where(known, largest(jnp.abs(before - 2 * colour + after)), -1)
        first = largest(jnp.abs(after - colour))
        first = jnp.maximum(first, jnp.roll(first, -1, 1 - axis))
        found = four(second)
        return jnp.where(found < 0, first, found) / scale

    return bend(right, 1), bend(down, 0)
