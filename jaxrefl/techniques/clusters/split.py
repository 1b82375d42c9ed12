"""Clusters by need: reflectors are split in two, again and again, where one eye cannot stand for all their rays.

Each round finds the point nearest to the rays of every cluster and asks by what angle the rays miss it. Clusters that
miss it by too much are split across the widest of six dimensions, normal and position, and a step of k-means between
the two halves moves the cut. Planes, whatever their size, are never split; handles come off their pots.

Source: [LBG80], the splitting of code books, with a cost that knows what the clusters are for.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrefl.core import dot
from jaxrefl.core.safe import divide
from jaxrefl.techniques.clusters.cluster import Clusters, Mirrors, describe
from jaxrefl.techniques.clusters.eye import mirrored_eye, nearest_point
from jaxrefl.techniques.clusters.segments import sums
from jaxrefl.techniques.clusters.types import Params

STRIDE = 3
"""Of so many pixels one is looked at to decide where to cut; all are then put on their side."""
ROUNDS = 16
"""Most rounds; each doubles the number of clusters at the most."""
WIDEST = 0.34
"""Cosine of the widest angle between a cluster's mirror rays and their mean that is left alone, 70 degrees."""


@functools.partial(jax.jit, static_argnames="capacity")
def split_labels(
    mirrors: Mirrors, label: Int[Array, "n"], eye: Float[Array, "3"], params: Params, *, capacity: int
) -> tuple[Int[Array, "n"], Int[Array, ""]]:
    """Labels of clusters that one eye each can stand for.

    Args:
        mirrors: Mirror rays.
        label: Clusters to begin with, such as the reflectors; -1 for none.
        eye: Position of the viewer, world space.
        params: `disparity` (radians), and `smallest`, below whose double nothing is split.
        capacity: Most clusters; where there is not room for all, those with the largest sum of squared angles come
            first.
    Returns:
        New labels, and how many clusters there would have been without a limit, as far as that is known.
    """
    feature = _features(mirrors, label, capacity)
    some, some_feature = jax.tree.map(lambda x: x[::STRIDE], (mirrors, feature))
    count = jnp.max(label) + 1

    def unfinished(state: tuple) -> Array:
        number, _, _, more = state
        return (number < ROUNDS) & more

    def one_round(state: tuple) -> tuple:
        number, label, wanted, _ = state
        clusters = describe(some, label[::STRIDE], capacity=capacity)
        cost = _cost(some, clusters, eye, params)
        used = jnp.max(label) + 1
        rank = jnp.argsort(jnp.argsort(-cost))
        # Half of the room that is left goes to this round: the worst of its halves may need more.
        splits = (cost > 0) & (rank < (capacity - used + 1) // 2)
        place = used + jax.lax.associative_scan(jnp.add, splits.astype(jnp.int32)) - 1
        axis, cut = _halves(some_feature, clusters, capacity)
        upper = (label >= 0) & splits[label] & (dot_last(feature, axis[label]) > cut[label])
        wanted = jnp.maximum(wanted, used + (cost > 0).sum())
        return number + 1, jnp.where(upper, place[label], label), wanted, splits.any()

    start = (jnp.zeros((), jnp.int32), label, count, jnp.ones((), bool))
    _, label, wanted, _ = jax.lax.while_loop(unfinished, one_round, start)
    return label, wanted


def _features(mirrors: Mirrors, label: Array, capacity: int) -> Float[Array, "n 6"]:
    """Normal, and position from the reflector's centre in units of its root mean square radius."""
    clusters = describe(mirrors, label, capacity=capacity)
    offset = mirrors.p - clusters.centre[label]
    square = sums(label, dot(offset, offset), capacity) / jnp.maximum(clusters.pixels, 1).astype(offset.dtype)
    scale = divide(jnp.ones_like(square), jnp.sqrt(square))
    return jnp.concatenate([mirrors.normal, offset * scale[label][:, None]], -1)


def _cost(mirrors: Mirrors, clusters: Clusters, eye: Array, params: Params) -> Float[Array, "c"]:
    """Sum of the squared angles by which a cluster's rays miss its eye; 0 where that is good enough."""
    capacity, label = clusters.pixels.shape[0], clusters.label
    start = mirrored_eye(clusters, eye)
    from_eye = mirrors.p - jnp.where(clusters.planar[:, None], start, nearest_point(mirrors, clusters, start))[label]
    along = dot(from_eye, mirrors.wi)
    missed = from_eye - mirrors.wi * along[:, None]
    square = divide(dot(missed, missed), dot(from_eye, from_eye))
    wide = dot(mirrors.wi, clusters.forward[label]) < WIDEST
    total = sums(label, jnp.where((along > 0) & ~wide, square, 1.0), capacity)
    pixels = clusters.pixels.astype(total.dtype)
    poor = total > pixels * params.disparity**2
    return jnp.where(poor & ~clusters.planar & (STRIDE * pixels >= 2 * params.smallest), total, 0)


def _halves(feature: Array, clusters: Clusters, capacity: int) -> tuple[Float[Array, "c 6"], Float[Array, "c"]]:
    """How each cluster is cut in two: an axis, and the value along it above which a pixel is in the second half."""
    label = clusters.label
    count = jnp.maximum(clusters.pixels, 1).astype(feature.dtype)[:, None]
    mean = sums(label, feature, capacity) / count
    away = feature - mean[label]
    dimension = jnp.argmax(sums(label, away * away, capacity), -1)
    upper = jnp.take_along_axis(away, dimension[label][:, None], -1)[:, 0] > 0
    total = sums(label, jnp.where(upper[:, None], away, 0), capacity)
    above = jnp.maximum(sums(label, upper.astype(feature.dtype), capacity), 1)[:, None]
    below = jnp.maximum(count - above, 1)
    # The halves' means, relative to the whole's: k-means cuts half way between them.
    high, low = total / above, -total / below
    axis = high - low
    return axis, dot_last((high + low) / 2 + mean, axis)


def dot_last(a: Array, b: Array) -> Array:
    """Scalar product over the last axis."""
    return (a * b).sum(-1)
