"""Which cluster each pixel belongs to: Mirrors -> labels.

By bins of normals per reflector, compacted by segment operations without any sorting. Bins with one normal but several
parallel planes (the steps of a stair) are split by the planes' distance.

Source: [WXKP14] §3.2.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrefl.core import dot
from jaxrefl.core.safe import normalise
from jaxrefl.techniques.clusters.bins import MOST, fineness, octahedral_bin, octahedral_cell, spherical_bin
from jaxrefl.techniques.clusters.cluster import FLAT, LEVEL, Mirrors
from jaxrefl.techniques.clusters.segments import first_pixel, largest, smallest, sums
from jaxrefl.techniques.clusters.split import split_labels
from jaxrefl.techniques.clusters.types import Options, Params

_SMALL = 4096
"""A plane that fills less than this fraction of the image is not told from the rest of its reflector."""
_SIDE, _CELLS = 64, 1 << 22
"""Cells along the map of normals that tells planes apart, 2.5 degrees each; with many objects fewer, all together."""
_TURN = np.linalg.qr(np.array([[3.0, 1.0, 2.0], [-1.0, 4.0, 1.0], [1.0, -2.0, 5.0]]))[0].astype(np.float32)
"""Turned by this, normals along the axes of a scene do not fall on the limits of cells."""
_PLANES = 16
"""Most groups of parallel planes that a bin, or such a group, is split into."""
_APART = 0.2
"""Cosine of the angle to the mean of its cluster's rays from which a ray is set apart, 78 degrees."""
_FLAT_SHARE = 75
"""Percent of the clusters that planes may take; the others are for what is curved."""
_TWICE = 2
"""How often: 256 evenly spaced planes, or fewer that are not, are told apart."""


def label_pixels(
    mirrors: Mirrors, eye: Float[Array, "3"], params: Params, *, objects: int, options: Options
) -> tuple[Int[Array, "n"], Int[Array, ""]]:
    """Cluster of each pixel.

    Args:
        mirrors: Mirror rays.
        eye: Position of the viewer, world space.
        params: `exponent`, `least`, `disparity`.
        objects: How many objects the scene has.
        options: `clusters`, `capacity`.
    Returns:
        Labels, -1 where there is no mirror ray; and how many clusters there would be without a limit.
    Edge cases: what comes after the last cluster there is room for is merged into it. Rays that turn away from those of
        their cluster, which would have no camera for them, are in the last cluster of all; it seldom has one.
    """
    room = max(options.capacity - 1, 1)
    if options.clusters != "split":
        label, wanted = by_normals(mirrors, params, objects=objects, bins=options.clusters, capacity=room)
    else:
        label, count = by_reflector(mirrors, objects=objects, capacity=max(room * _FLAT_SHARE // 100, 1))
        label, wanted = split_labels(mirrors, label, eye, params, capacity=room)
        wanted = jnp.maximum(count, wanted)
    return set_apart(mirrors, label, capacity=options.capacity), wanted


@functools.partial(jax.jit, static_argnames="capacity")
def set_apart(mirrors: Mirrors, label: Int[Array, "n"], *, capacity: int) -> Int[Array, "n"]:
    """Move rays that turn away from those of their cluster into the last cluster.

    Args:
        mirrors: Mirror rays.
        label: Clusters below the last one; -1 for none.
        capacity: How many clusters there are room for.
    Returns:
        Labels; those given, if there is room for one cluster alone.
    """
    for _ in range(2):  # once more with the means of those that are left
        mean = normalise(sums(label, mirrors.wi, capacity))
        away = (label >= 0) & (dot(mirrors.wi, mean[label]) < _APART)
        label = jnp.where(away, capacity - 1, label)
    return label


@functools.partial(jax.jit, static_argnames=("objects", "capacity"))
def by_reflector(mirrors: Mirrors, *, objects: int, capacity: int) -> tuple[Int[Array, "n"], Int[Array, ""]]:
    """One cluster for the curved part of each reflector, and one for each of its planes.

    Args:
        mirrors: Mirror rays.
        objects: How many objects the scene has.
        capacity: Most clusters.
    Returns:
        Labels, and how many there would be without a limit.
    Edge cases: flat pixels that are few, or fewer than others with about their normal, count as curved: so do the
        middles of a sphere's triangles, and planes there is no room for.
    """
    side = max(min(_SIDE, math.isqrt(_CELLS // objects)), 1)
    column, row = octahedral_cell(mirrors.normal @ _TURN, side)
    plane, planes = (mirrors.object * side + row) * side + column, objects * side * side
    flat = mirrors.valid & mirrors.flat
    pixels, all_of_them = (jax.ops.segment_sum(m.astype(jnp.int32), plane, planes) for m in (flat, mirrors.valid))
    least = jax.lax.top_k(pixels, min(capacity, planes))[0][-1]
    many = (pixels >= least) & (pixels * _SMALL > mirrors.t.shape[0]) & (2 * pixels > all_of_them)
    key = jnp.where(flat & many[plane], plane + objects, mirrors.object)
    label, count = _compact(key, mirrors.valid, planes + objects)
    return _by_plane(mirrors, jnp.minimum(label, capacity - 1), count, capacity)


@functools.partial(jax.jit, static_argnames=("objects", "bins", "capacity"))
def by_normals(
    mirrors: Mirrors, params: Params, *, objects: int, bins: str, capacity: int
) -> tuple[Int[Array, "n"], Int[Array, ""]]:
    """Clusters by bins of normals per reflector.

    Args:
        mirrors: Mirror rays.
        params: `exponent`, `least`.
        objects: How many objects the scene has.
        bins: `octahedral` or `spherical`.
        capacity: Most clusters; the last one takes all that come after it.
    Returns:
        Labels, -1 where there is no mirror ray; and how many clusters there would be without a limit.
    """
    pixels = jax.ops.segment_sum(mirrors.valid.astype(jnp.int32), mirrors.object, objects)
    fine = fineness(pixels / mirrors.valid.shape[0], (pixels > 0).sum(), params.exponent, params.least)
    binned = (octahedral_bin if bins == "octahedral" else spherical_bin)(mirrors.normal, fine[mirrors.object])
    label, count = _compact(mirrors.object * MOST + binned, mirrors.valid, objects * MOST)
    return _by_plane(mirrors, jnp.minimum(label, capacity - 1), count, capacity)


def _compact(key: Int[Array, "n"], valid: Bool[Array, "n"], keys: int) -> tuple[Int[Array, "n"], Int[Array, ""]]:
    """Keys that occur, numbered from 0 in their order; -1 where not valid."""
    used = jnp.zeros(keys, jnp.int32).at[jnp.where(valid, key, keys)].max(1, mode="drop")
    rank = jax.lax.associative_scan(jnp.add, used)
    return jnp.where(valid, rank[jnp.where(valid, key, 0)] - 1, -1), rank[-1]


def _by_plane(
    mirrors: Mirrors, label: Int[Array, "n"], count: Int[Array, ""], capacity: int
) -> tuple[Int[Array, "n"], Int[Array, ""]]:
    """Labels in which flat clusters in several parallel planes have become several."""
    for _ in range(_TWICE):
        label, count = _split_levels(mirrors, label, count, capacity)
    return label, count


def _split_levels(
    mirrors: Mirrors, label: Int[Array, "n"], count: Int[Array, ""], capacity: int
) -> tuple[Int[Array, "n"], Int[Array, ""]]:
    """One cut of flat clusters into `_PLANES` levels along their normal."""
    normal = normalise(sums(label, mirrors.normal, capacity))
    own = normal[label]
    away = mirrors.normal - own
    flat = largest(label, dot(away, away), capacity) < FLAT
    height = dot(own, mirrors.p - mirrors.p[first_pixel(label, capacity)][label])
    low, high = smallest(label, height, capacity), largest(label, height, capacity)
    split = flat & (high - low > LEVEL * largest(label, mirrors.t, capacity))
    share = (height - low[label]) / jnp.where(split, high - low, 1)[label]
    # Limits at odd places: evenly spaced planes, the first and last of which are at 0 and 1, do not fall on them.
    level = (share * (_PLANES - 0.73) + 0.39).astype(jnp.int32)
    level = jnp.where(split[label], jnp.clip(level, 0, _PLANES - 1), 0)
    label, more = _compact(label * _PLANES + level, label >= 0, capacity * _PLANES)
    # The largest come first, so that it is the smallest that are merged.
    pixels = sums(label, jnp.ones_like(label), capacity * _PLANES)
    rank = jnp.argsort(jnp.argsort(-pixels)).astype(jnp.int32)
    label = jnp.where(label >= 0, jnp.minimum(rank[jnp.maximum(label, 0)], capacity - 1), -1)
    return label, jnp.maximum(count, more)
