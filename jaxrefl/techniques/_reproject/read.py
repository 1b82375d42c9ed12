"""Reading a key frame between its pixels: coordinates [n 2] -> the four pixels around, and bilinear values.

Coordinates are (x, y) in pixels with centres at +0.5. Images are read as flat arrays of single components, which is
what gathers on a CPU do fastest.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

SNAP = 2e-3
"""Coordinates this close to a pixel's centre, in pixels, count as the centre: then that pixel alone is read."""


class Footprint(eqx.Module):
    """The four pixels around a coordinate, and their bilinear weights."""

    inside: Bool[Array, "n"]
    """False where the coordinate lies outside the square of pixel centres; the pixels are then clamped to it."""
    cell: Int[Array, "n"]
    """Flat index of the upper left pixel."""
    width: int = eqx.field(static=True)
    """Width of the image."""
    fx: Float[Array, "n"]
    """Weight of the right column, in [0, 1]; exactly 0 or 1 on centres."""
    fy: Float[Array, "n"]
    """Weight of the lower row, in [0, 1]; exactly 0 or 1 on centres."""

    @property
    def corners(self) -> tuple[Array, Array, Array, Array]:
        """Flat indices: upper left, upper right, lower left, lower right."""
        return self.cell, self.cell + 1, self.cell + self.width, self.cell + self.width + 1

    @property
    def weights(self) -> tuple[Array, Array, Array, Array]:
        """Weights of `corners`; they sum to 1."""
        gx, gy = 1 - self.fx, 1 - self.fy
        return gx * gy, self.fx * gy, gx * self.fy, self.fx * self.fy


def footprint(uv: Float[Array, "n 2"], *, shape: tuple[int, ...], snap: float = 0.0) -> Footprint:
    """The pixels around coordinates.

    Args:
        uv: Coordinates, pixels.
        shape: (height, width) of the image that will be read, at least 2 x 2.
        snap: Fractions this close to 0 or 1 become 0 or 1.
    Returns:
        Pixels and weights.
    """
    height, width = shape
    x, y = uv[:, 0] - 0.5, uv[:, 1] - 0.5
    inside = (x >= -snap) & (x <= width - 1 + snap) & (y >= -snap) & (y <= height - 1 + snap)
    column = jnp.clip(jnp.floor(jnp.clip(x, -1, width)), 0, width - 2)
    row = jnp.clip(jnp.floor(jnp.clip(y, -1, height)), 0, height - 2)

    def fraction(f: Array) -> Array:
        f = jnp.clip(f, 0, 1)
        return jnp.where(f <= snap, 0, jnp.where(f >= 1 - snap, 1, f))

    cell = row.astype(jnp.int32) * width + column.astype(jnp.int32)
    return Footprint(inside, cell, width, fraction(x - column), fraction(y - row))


def read(image: Sequence[Float[Array, "m"]], at: Footprint) -> tuple[Float[Array, "n"], ...]:
    """Bilinear values.

    Args:
        image: Components of the image, flattened.
        at: Where to read.
    Returns:
        One array per component.
    """
    corners, weights = at.corners, at.weights
    return tuple(sum(component[i] * w for i, w in zip(corners, weights, strict=True)) for component in image)  # pyright: ignore[reportReturnType]


def all_of(mask: Bool[Array, "m"], at: Footprint) -> Bool[Array, "n"]:
    """Whether a mask holds at every pixel that counts.

    Args:
        mask: Mask of the image, flattened.
        at: Where to read.
    Returns:
        True where the mask is True at all pixels of the footprint with a weight above 0.
    """
    held = [mask[i] | (w == 0) for i, w in zip(at.corners, at.weights, strict=True)]
    return held[0] & held[1] & held[2] & held[3]


def pixel_centres(height: int, width: int) -> Float[Array, "h w 2"]:
    """Coordinates of all pixels of an image.

    Args:
        height: Its height.
        width: Its width.
    Returns:
        (x, y) of each pixel's centre.
    """
    x = jnp.arange(width, dtype=jnp.float32) + 0.5
    y = jnp.arange(height, dtype=jnp.float32) + 0.5
    return jnp.stack(jnp.meshgrid(x, y), -1)


def components(image: Float[Array, "h w c"]) -> tuple[Float[Array, "m"], ...]:
    """An image's components as flat arrays.

    Args:
        image: Any image.
    Returns:
        One flat array per component.
    """
    return tuple(image[..., i].reshape(-1) for i in range(image.shape[-1]))
