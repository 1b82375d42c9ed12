"""Atlas of the gloss filter: all layers side by side in one image, and back from layer to layer.

The filter is compiled once for all layers, and visits only the tiles that need it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxrefl.filters.gloss_layers import DATA, Layer, Limits, Others, Values, agree, normalised

TILE = (16, 128)
"""Rows and columns of what is filtered at a time; fits the cache of a CPU."""


class Place(NamedTuple):
    """Where a layer lies in the atlas."""

    row: int
    column: int
    height: int
    width: int


def layout(h: int, w: int, count: int) -> tuple[list[Place], tuple[int, int]]:
    """Places of all layers in an atlas of whole tiles: the image, the others below each other to its right.

    Args:
        h: Rows of the image.
        w: Its columns.
        count: Layers.
    Returns:
        One place per layer, and the atlas's rows and columns.
    """

    def whole(x: int, tile: int) -> int:
        return -(-x // tile) * tile

    places, row, right = [Place(0, 0, h, w)], 0, 0
    for _ in range(1, count):
        h, w = -(-h // 2), -(-w // 2)
        places.append(Place(row, whole(places[0].width, TILE[1]), h, w))
        row, right = row + whole(h, TILE[0]), max(right, whole(w, TILE[1]))
    return places, (max(whole(places[0].height, TILE[0]), row), whole(places[0].width, TILE[1]) + right)


def pack(layers: list[Layer], places: list[Place], size: tuple[int, int], margin: int) -> Layer:
    """All layers in one image; ids tell them apart.

    Args:
        layers: From the finest to the coarsest.
        places: From `layout`.
        size: Of the atlas.
        margin: Pixels with nothing to add on all sides.
    Returns:
        The atlas.
    """
    count, (h, w) = len(places), (n + 2 * margin for n in size)
    ids, data = jnp.full((h, w), -1, jnp.int32), jnp.zeros((DATA, h, w), jnp.float32)
    for number, (layer, place) in enumerate(zip(layers, places, strict=True)):
        own = layer.id[: place.height, : place.width]
        own = jnp.where(own >= 0, own * count + number, -1)
        row, column = place.row + margin, place.column + margin
        ids = jax.lax.dynamic_update_slice(ids, own, (row, column))
        part = layer.data[:, : place.height, : place.width]
        data = jax.lax.dynamic_update_slice(data, part, (0, row, column))
    return Layer(ids, data)


def neighbours(active: Bool[Array, "ty tx"], places: list[Place]) -> Bool[Array, "ty tx"]:
    """Tiles, and those beside them in the same layer.

    Args:
        active: Some tiles of an atlas.
        places: From `layout`.
    Returns:
        These and their neighbours.
    """
    layer = np.full(active.shape, len(places))
    for number, place in enumerate(places):
        bottom, right = -(-(place.row + place.height) // TILE[0]), -(-(place.column + place.width) // TILE[1])
        layer[place.row // TILE[0] : bottom, place.column // TILE[1] : right] = number
    members = jnp.asarray(layer == np.arange(len(places) + 1)[:, None, None])
    wanted = (members & active[None]).any((1, 2), keepdims=True)
    around = jax.lax.reduce_window(active, False, jax.lax.bitwise_or, (3, 3), (1, 1), "SAME")
    return around & (members & wanted).any(0)


def cut(atlas: Others, place: Place, size: tuple[int, int]) -> Values:
    """One layer of a filtered atlas.

    Args:
        atlas: The atlas.
        place: Where the layer lies.
        size: Rows and columns of the result; what is not the layer's is 0.
    Returns:
        The layer.
    """
    part = atlas[:, place.row : place.row + place.height, place.column : place.column + place.width]
    return jnp.pad(part, ((0, 0), (0, size[0] - place.height), (0, size[1] - place.width)))


def enlarge(fine: Layer, coarse: Layer, values: Others, limits: Limits) -> Values:
    """Values of a coarse layer at the pixels of the finer one: bilinear, from the same surface only.

    Args:
        fine: The finer layer, with even rows and columns.
        coarse: The coarser one, in the top left corner.
        values: Of the coarser one.
        limits: Thresholds.
    Returns:
        Those of the finer one; the weight is 0 where there was nothing to read.
    """
    h, w = fine.id.shape[0] // 2, fine.id.shape[1] // 2
    wide = w + 2
    # Pixels with the same place within their coarse pixel read in step: slices in place of gathers.
    edge = ((0, 0), (1, 2), (1, 1))

    def local(planes: Array, fill: float) -> list[Array]:
        return list(jnp.pad(planes[:, :h, :w], edge, constant_values=fill).reshape(planes.shape[0], -1))

    def by_phase(planes: Array) -> Array:
        split = planes.reshape(-1, h, 2, w, 2).transpose(2, 4, 0, 1, 3)
        return jnp.pad(split, ((0, 0),) * 4 + ((0, 2),)).reshape(4, planes.shape[0], -1)

    (ids,) = local(coarse.id[None], -1)
    around = [*local(coarse.data[:6], 0), *local(values, 0)]

    def phase(own: tuple[Array, Array, Array]) -> Array:
        number, id_here, data = own
        here = Layer(id_here[0], tuple(data))
        py, px = number // 2, number % 2

        def add(sums: list[Array], corner: Array) -> tuple[list[Array], None]:
            # The coarse pixel that holds the fine one has the weight 3/4 on each axis, the one beside it 1/4.
            sy, sx = (corner // 2) * (2 * py - 1), (corner % 2) * (2 * px - 1)
            start = (1 + sy) * wide + 1 + sx
            cut = lambda p: jax.lax.dynamic_slice_in_dim(p, start, h * wide)  # noqa: E731
            there = tuple(cut(p) for p in around)
            dx, dy = ((2 * s - p).astype(jnp.float32) + 0.5 for s, p in ((sx, px), (sy, py)))
            good = agree(here, Layer(cut(ids), there), dx, dy, limits)
            share = jnp.where(corner // 2 == 1, 0.25, 0.75) * jnp.where(corner % 2 == 1, 0.25, 0.75)
            weight = jnp.where(good, there[9], 0) * share
            return [s + weight * v for s, v in zip(sums, (*there[6:9], jnp.ones_like(weight)), strict=True)], None

        zero = [jnp.zeros(h * wide, jnp.float32) for _ in range(4)]
        sums, _ = jax.lax.scan(add, zero, jnp.arange(4, dtype=jnp.int32))
        return normalised(sums[:3], sums[3])

    numbers = jnp.arange(4, dtype=jnp.int32)
    found = jax.lax.map(phase, (numbers, by_phase(fine.id[None]), by_phase(fine.data[:6])))
    return found.reshape(2, 2, 4, h, wide)[..., :w].transpose(2, 3, 0, 4, 1).reshape(4, 2 * h, 2 * w)
