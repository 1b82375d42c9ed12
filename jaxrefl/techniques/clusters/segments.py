"""Sums and extremes over the pixels of each cluster: labels [n] and values [n ...] -> values [c ...].

A label of -1 belongs to no cluster. The extreme of a cluster without pixels is 0.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Num


def sums(label: Int[Array, "n"], x: Num[Array, "n ..."], capacity: int) -> Num[Array, "c ..."]:
    """Sum over each cluster.

    Args:
        label: Cluster of each pixel.
        x: Values.
        capacity: How many clusters there are room for.
    Returns:
        One sum per cluster.
    """
    return jax.ops.segment_sum(x, _within(label, capacity), capacity)


def largest(label: Int[Array, "n"], x: Num[Array, "n ..."], capacity: int) -> Num[Array, "c ..."]:
    """Largest value in each cluster.

    Args:
        label: Cluster of each pixel.
        x: Values.
        capacity: How many clusters there are room for.
    Returns:
        One value per cluster; 0 where it has no pixels.
    """
    return _filled(label, jax.ops.segment_max(x, _within(label, capacity), capacity), capacity)


def smallest(label: Int[Array, "n"], x: Num[Array, "n ..."], capacity: int) -> Num[Array, "c ..."]:
    """Smallest value in each cluster.

    Args:
        label: Cluster of each pixel.
        x: Values.
        capacity: How many clusters there are room for.
    Returns:
        One value per cluster; 0 where it has no pixels.
    """
    return _filled(label, jax.ops.segment_min(x, _within(label, capacity), capacity), capacity)


def first_pixel(label: Int[Array, "n"], capacity: int) -> Int[Array, "c"]:
    """The first pixel of each cluster.

    Args:
        label: Cluster of each pixel.
        capacity: How many clusters there are room for.
    Returns:
        Numbers of pixels; 0 where a cluster has none.
    """
    return smallest(label, jnp.arange(label.shape[0], dtype=jnp.int32), capacity)


def _within(label: Int[Array, "n"], capacity: int) -> Int[Array, "n"]:
    """Segment operations leave out what lies behind the last segment."""
    return jnp.where(label < 0, capacity, label)


def _filled(label: Int[Array, "n"], x: Array, capacity: int) -> Array:
    used = jnp.zeros(capacity, bool).at[_within(label, capacity)].set(True, mode="drop")
    return jnp.where(used.reshape(used.shape + (1,) * (x.ndim - 1)), x, 0)
