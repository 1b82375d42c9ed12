"""A key frame as flat arrays of single components: what gathers on a CPU read fastest.

ReflectionBuffer -> Kept, once per frame, for all stages that read it between its pixels.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl.techniques._reproject import Footprint, components
from jaxrefl.techniques.temporal.types import ReflectionBuffer

KNOWN, SMOOTH, STEADY, CONNECTED = 1, 2, 4, 8
"""Bits of `Kept.flags`: there is a reflection; its reflector is a mirror; what is reflected looks the same from
elsewhere; the four pixels with this upper left corner show one smooth piece of one thing."""


class Kept(eqx.Module):
    """The key frame, flattened; fields as in `ReflectionBuffer`."""

    flags: Int[Array, "m"]
    p: tuple[Float[Array, "m"], ...]
    reflected: tuple[Float[Array, "m"], ...]
    radiance: tuple[Float[Array, "m"], ...]
    seen: tuple[Float[Array, "m"], ...]
    triangle: Int[Array, "m"]
    error: Float[Array, "m"]
    steepness: Float[Array, "m"]
    bend_x: Float[Array, "m"]
    bend_y: Float[Array, "m"]
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the key frame."""
        return self.height, self.width


@jax.jit
def flatten(buffer: ReflectionBuffer) -> Kept:
    """A key frame as flat arrays.

    Args:
        buffer: The key frame.
    Returns:
        Its components.
    """
    masks = ((buffer.valid, KNOWN), (buffer.smooth, SMOOTH), (~buffer.changing, STEADY), (buffer.connected, CONNECTED))
    flags = jnp.zeros(buffer.valid.shape, jnp.int32)
    for mask, bit in masks:
        flags = flags | jnp.where(mask, bit, 0)
    h, w = buffer.valid.shape
    return Kept(
        flags=flags.reshape(-1),
        p=components(buffer.p),
        reflected=components(buffer.reflected),
        radiance=components(buffer.radiance),
        seen=components(buffer.seen),
        triangle=buffer.triangle.reshape(-1),
        error=buffer.error.reshape(-1),
        steepness=buffer.steepness.reshape(-1),
        bend_x=buffer.bend_x.reshape(-1),
        bend_y=buffer.bend_y.reshape(-1),
        width=w,
        height=h,
    )


def flags_at(kept: Kept, at: Footprint) -> Int[Array, "n"]:
    """The flags that all pixels of a footprint have.

    Args:
        kept: The key frame.
        at: Where to read.
    Returns:
        Their bitwise and, over the pixels with a weight above 0; `CONNECTED` is that of the upper left pixel alone.
    """
    found = jnp.full(at.cell.shape, KNOWN | SMOOTH | STEADY, jnp.int32)
    for index, weight in zip(at.corners, at.weights, strict=True):
        found = found & (kept.flags[index] | jnp.where(weight == 0, -1, 0))
    return found | (kept.flags[at.cell] & CONNECTED)


def has(flags: Int[Array, "n"], *bits: int) -> Bool[Array, "n"]:
    """Whether flags have all of some bits.

    Args:
        flags: From `flags_at`, or `Kept.flags`.
        bits: The bits.
    Returns:
        True where all are set.
    """
    wanted = sum(bits)
    return (flags & wanted) == wanted
