"""Pyramid of the gloss filter: image planes -> coarser layers.

A wide Gaussian on a fine image is a narrow one on a coarse image. Every layer halves the one before: of four pixels the
one that most of them agree with is the surface of the coarse pixel, and those that agree are averaged; so nothing leaks
across edges.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl.core import apart

DATA = 16
"""Planes of a layer besides its ids."""
LEAST = 1e-18
"""Weight below which nothing was found: its inverse and the square of that are still finite."""
_COLOUR = slice(6, 9)


class Layer(NamedTuple):
    """One layer of the pyramid; planes in one stack, so that what is done to all of them is compiled once."""

    id: Int[Array, "*b"]
    """Surface; -1 for none."""
    data: Any
    """Everything else, [16 *b], or in hot loops a tuple of planes [*b]; the properties say what."""

    @property
    def normal(self) -> Any:
        """Unit normal."""
        return self.data[0:3]

    @property
    def inverse(self) -> Any:
        """Inverse depth."""
        return self.data[3]

    @property
    def slope(self) -> Any:
        """Its change per pixel of this layer, (x, y)."""
        return self.data[4:6]

    @property
    def colour(self) -> Any:
        """Radiance."""
        return self.data[_COLOUR]

    @property
    def image(self) -> Any:
        """Inverse depth of the mirror image."""
        return self.data[9]

    @property
    def trust(self) -> Any:
        """Weight of the radiance, 0 where it is not known."""
        return self.data[10]

    @property
    def mean(self) -> Any:
        """Centre of the Gaussian, pixels of this layer."""
        return self.data[11:13]

    @property
    def covariance(self) -> Any:
        """(xx, xy, yy), pixels of this layer squared."""
        return self.data[13:16]


Values = Float[Array, "4 h w"]
"""A filtered layer: colour, and the weight with which it is known (0: it is not)."""
Others = Float[Array, "4 ch cw"]
"""The same, of another size."""


class Limits(NamedTuple):
    """When two pixels show the same smooth surface."""

    normal: Float[Array, ""]
    """Least cosine between normals."""
    depth: Float[Array, ""]
    """Largest distance from the other's plane, relative to the depth."""


def agree(a: Layer, b: Layer, dx: Array | float, dy: Array | float, limits: Limits) -> Bool[Array, "*b"]:
    """Whether what lies (dx, dy) beside each pixel is the same smooth surface.

    Args:
        a: The pixels.
        b: Those beside them.
        dx: Distance to the right, pixels of `a`'s layer.
        dy: Distance down.
        limits: Thresholds.
    Returns:
        True where material, normal and depth agree: the indicator functions of Eq. 4.
    """
    cosine = a.normal[0] * b.normal[0] + a.normal[1] * b.normal[1] + a.normal[2] * b.normal[2]
    expected = a.inverse + a.slope[0] * dx + a.slope[1] * dy
    near = jnp.abs(b.inverse - expected) <= limits.depth * a.inverse
    return (a.id == b.id) & (a.id >= 0) & (cosine > limits.normal) & near


def normalised(sums: Sequence[Float[Array, "n"]], weight: Float[Array, "n"]) -> Float[Array, "4 n"]:
    """Sums over their weight, and the weight.

    Args:
        sums: One per channel.
        weight: Sum of the weights.
    Returns:
        Means and the weight; 0 where nothing was found.
    """
    known = weight > LEAST
    inverse = jnp.where(known, 1 / jnp.where(known, weight, 1), 0)
    return jnp.stack([*(s * inverse for s in sums), jnp.where(known, weight, 0)])


class Merge(NamedTuple):
    """How four pixels become one."""

    corner: Int[Array, "h w"]
    """Which of them is the surface: 0 to 3, row by row."""
    shares: Float[Array, "4 h w"]
    """Weight of each in averages; they sum to 1, or are 0 where nothing is known."""
    trust: Float[Array, "h w"]
    """Of the coarse pixel: the sum over those that are alike, over 4."""


_CORNERS = ((0, 0), (0, 1), (1, 0), (1, 1))


def _corner(x: Array, place: tuple[int, int]) -> Array:
    return x[..., place[0] :: 2, place[1] :: 2]


def _merge(fine: Layer, limits: Limits) -> Merge:
    four = [jax.tree.map(lambda x, at=at: _corner(x, at), fine) for at in _CORNERS]
    alike: dict[tuple[int, int], Array] = {}
    for i, p in enumerate(_CORNERS):
        alike[i, i] = four[i].id >= 0
        for j in range(i + 1, 4):
            dx, dy = float(_CORNERS[j][1] - p[1]), float(_CORNERS[j][0] - p[0])
            alike[i, j] = alike[j, i] = agree(four[i], four[j], dx, dy, limits)
    votes = [sum(alike[i, j].astype(jnp.float32) for j in range(4)) for i in range(4)]
    # Ties go to the nearer surface: no pixel is preferred for where it is.
    nearest = jnp.maximum(jnp.maximum(four[0].inverse, four[1].inverse), jnp.maximum(four[2].inverse, four[3].inverse))
    scores = [v + 0.5 * f.inverse / jnp.maximum(nearest, 1e-30) for v, f in zip(votes, four, strict=True)]
    corner, best = jnp.zeros(four[0].id.shape, jnp.int32), scores[0]
    for i in range(1, 4):
        corner, best = jnp.where(scores[i] > best, i, corner), jnp.maximum(best, scores[i])
    shares = []
    for j in range(4):
        member = alike[0, j]
        for i in range(1, 4):
            member = jnp.where(corner == i, alike[i, j], member)
        shares.append(jnp.where(member, four[j].trust, 0))
    total = shares[0] + shares[1] + shares[2] + shares[3]
    inverse = jnp.where(total > 0, 1 / jnp.where(total > 0, total, 1), 0)
    return Merge(corner, jnp.stack(shares) * inverse[None], total / 4)


def _merged(fine: Layer, merge: Merge) -> Layer:
    h, w = merge.corner.shape
    row = 2 * jnp.arange(h, dtype=jnp.int32)[:, None] + merge.corner // 2
    column = 2 * jnp.arange(w, dtype=jnp.int32)[None, :] + merge.corner % 2
    at = row * (2 * w) + column
    chosen = Layer(fine.id.reshape(-1)[at], fine.data.reshape(DATA, -1)[:, at])
    dx, dy = (merge.corner % 2).astype(jnp.float32) - 0.5, (merge.corner // 2).astype(jnp.float32) - 0.5
    known = fine.data[6:10]  # colour and the mirror image
    average = sum(share[None] * _corner(known, at) for share, at in zip(merge.shares, _CORNERS, strict=True))
    average = jnp.where((merge.trust > 0)[None], average, chosen.data[6:10])
    inverse = chosen.inverse - chosen.slope[0] * dx - chosen.slope[1] * dy
    parts = [chosen.normal, inverse[None], 2 * chosen.slope, average, merge.trust[None]]
    return Layer(chosen.id, jnp.concatenate([*parts, chosen.mean / 2, chosen.covariance / 4]))


def halve(fine: Layer, limits: Limits, wanted: Bool[Array, ""]) -> Layer:
    """The next coarser layer.

    Args:
        fine: A layer with even rows and columns.
        limits: Thresholds.
        wanted: False: it is not needed, and comes back empty.
    Returns:
        One of half the size.
    """
    some = (fine.id >= 0) & wanted
    return apart(some, _merged, fine, apart(some, _merge, fine, limits), fill=-1.0)


def grown(layer: Layer, size: tuple[int, int]) -> Layer:
    """A layer with nothing to its right and below.

    Args:
        layer: A layer.
        size: New rows and columns.
    Returns:
        The larger layer.
    """
    edges = [(0, n - old) for n, old in zip(size, layer.id.shape, strict=True)]
    return Layer(jnp.pad(layer.id, edges, constant_values=-1), jnp.pad(layer.data, [(0, 0), *edges]))


def pyramid(image: Layer, count: int, limits: Limits, deepest: Float[Array, ""]) -> tuple[Layer, Layer]:
    """All layers but the first.

    Args:
        image: The finest layer, with rows and columns that are multiples of 8.
        count: Layers, the finest included, >= 2.
        limits: Thresholds.
        deepest: Layers with a number above this are not needed and stay empty.
    Returns:
        The second layer, and the others [count - 2, ...], each in the top left corner of an image of the third one's
        size: one loop makes them all.
    """
    second = halve(image, limits, deepest >= 1)

    def step(fine: Layer, number: Array) -> tuple[Layer, Layer]:
        coarse = halve(fine, limits, deepest >= number)
        return grown(coarse, (fine.id.shape[0], fine.id.shape[1])), fine

    third = halve(second, limits, deepest >= 2)
    _, rest = jax.lax.scan(step, third, jnp.arange(3, count + 1).astype(jnp.float32))
    return second, rest
