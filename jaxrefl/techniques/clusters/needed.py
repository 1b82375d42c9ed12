"""Texels that rays may pass: mirror rays and their views -> a mask over the list of texels.

A cluster may be scattered over a wide view, like the treads of a stair that lie in one plane; what no ray passes need
not be rendered. Kept by tiles of texels. Rough clusters need all of their view: their rays are not known yet.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Rays
from jaxrefl.rays import block_size, blocks_of, take_block
from jaxrefl.rays.views import Views
from jaxrefl.techniques.clusters.cameras import ClusterCameras
from jaxrefl.techniques.clusters.cluster import Clusters, Mirrors
from jaxrefl.techniques.clusters.traverse import Lines, project_rays

_TILE = 8
"""Texels along each side of a tile."""
_STEP = 4
"""Texels between the points of a line that are looked at."""
_MARGIN = 3
"""Texels around such a point that are kept: half a step, and one more for reading between texels."""


def needed_texels(
    cameras: ClusterCameras, clusters: Clusters, mirrors: Mirrors, *, room: int, block: int
) -> Bool[Array, "m"]:  # fmt: skip
    """Which texels some ray passes or reads.

    Args:
        cameras: The clusters' cameras.
        clusters: The clusters.
        mirrors: The rays.
        room: Length of the list of texels.
        block: Rays that are looked at together, at the most.
    Returns:
        The mask; all texels of views of rough clusters.
    """
    tiles, lines, points = _nearest(cameras, clusters, mirrors, room)
    for index in blocks_of(points > 1, size=block_size(points.size, block)):
        view, some, number = take_block((clusters.label, lines, points), index, batch_dims=1)
        tiles = _mark_beyond(tiles, cameras.views, view, some, jnp.where(index >= 0, number, 0))
    return _texels_of(tiles, cameras.views, clusters.alpha > 0, room)


@functools.partial(jax.jit, static_argnames="room")
def _nearest(
    cameras: ClusterCameras, clusters: Clusters, mirrors: Mirrors, room: int
) -> tuple[Bool[Array, "t"], Lines, Int[Array, "n"]]:
    """Tiles around the near ends of all rays, their lines, and how many points of each there are to look at."""
    label = jnp.maximum(clusters.label, 0)
    rays = Rays(mirrors.p, mirrors.wi)
    lines, ahead = project_rays(cameras.views, label, rays, cameras.reach[label])
    active = ahead & (clusters.label >= 0) & cameras.usable[label] & (clusters.alpha[label] == 0)
    length = jnp.abs(lines.end - lines.start).max(-1) * lines.within
    points = jnp.where(active, jnp.ceil(length / _STEP).astype(jnp.int32) + 1, 0)
    tiles = jnp.zeros(room // _TILE + clusters.pixels.shape[0], bool)
    return _mark(tiles, cameras.views, label, lines, jnp.zeros_like(length), active), lines, points


@jax.jit
def _mark_beyond(
    tiles: Bool[Array, "t"], views: Views, view: Int[Array, "n"], lines: Lines, points: Int[Array, "n"]
) -> Bool[Array, "t"]:
    """Mark the tiles around all points of lines but the first."""

    def one(number: Array, tiles: Array) -> Array:
        share = number.astype(jnp.float32) / jnp.maximum(points - 1, 1).astype(jnp.float32)
        return _mark(tiles, views, view, lines, share * lines.within, number < points)

    return jax.lax.fori_loop(1, points.max(), one, tiles)


def _mark(
    tiles: Bool[Array, "t"], views: Views, view: Int[Array, "n"], lines: Lines, share: Float[Array, "n"], active: Array
) -> Bool[Array, "t"]:
    """Mark the tiles around one point of each line."""
    at = lines.start + (lines.end - lines.start) * share[:, None]
    first = _first_tiles(views)[view]
    across = _tiles_across(views)[view]
    most = jnp.maximum(lines.size - 1, 0)
    low, high = (jnp.clip(jnp.floor(at + m).astype(jnp.int32), 0, most) // _TILE for m in (-_MARGIN, _MARGIN))
    for x, y in ((low, low), (low, high), (high, low), (high, high)):
        place = first + y[:, 1] * across[:, 0] + x[:, 0]
        tiles = tiles.at[jnp.where(active, place, tiles.shape[0])].set(True, mode="drop")
    return tiles


def _tiles_across(views: Views) -> Int[Array, "c 2"]:
    return (views.size + _TILE - 1) // _TILE


def _first_tiles(views: Views) -> Int[Array, "c"]:
    count = _tiles_across(views)
    count = count[:, 0] * count[:, 1]
    return jnp.cumsum(count) - count


@functools.partial(jax.jit, static_argnames="room")
def _texels_of(tiles: Bool[Array, "t"], views: Views, all_of: Bool[Array, "c"], room: int) -> Bool[Array, "m"]:
    texel = jnp.arange(room, dtype=jnp.int32)
    begins = jnp.zeros(room, jnp.int32).at[views.offset].add(1, mode="drop")
    view = jnp.cumsum(begins) - 1
    width = jnp.maximum(views.size[view, 0], 1)
    within = texel - views.offset[view]
    column, row = within % width, within // width
    there = row < views.size[view, 1]
    tile = _first_tiles(views)[view] + (row // _TILE) * _tiles_across(views)[view, 0] + column // _TILE
    return there & (all_of[view] | tiles[jnp.where(there, tile, 0)])
