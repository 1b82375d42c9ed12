"""Discrete distributions that float32 random numbers sample exactly as their table says.

`distribution` (host) makes the tables of environments and area lights, `invert_cdf` samples them inside jit. A
cumulative table in float32 cannot resolve a probability below 2^-24, so a map with a bright sun would be sampled with
other probabilities than it divides by. Here probabilities are whole multiples of 2^-23, the step of float32 random
numbers in [0, 1): table, samples and densities agree bit by bit.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrefl.core import apart

QUANTA = 2**23
"""Number of steps that the cumulative probability takes from 0 to 1."""
_BELOW_ONE = 1 - 2.0**-24


def distribution(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Discrete distributions along the last axis, rounded to multiples of 2^-23.

    Args:
        weights: [*b n] finite and >= 0, any scale.
    Returns:
        Cumulative probability [*b n] (the last element is 1) and probability [*b n], both float32 and exact.
    Raises:
        ValueError: If there are more than 2^22 entries; each must be able to get a probability of its own.
    Edge cases: a positive weight always has a positive probability and a weight of 0 has none; if all are 0, all
        entries are equally likely.
    """
    weights = np.asarray(weights, np.float64)
    if not 1 <= weights.shape[-1] <= QUANTA // 2:
        raise ValueError(f"weights: expected between 1 and {QUANTA // 2} entries, got {weights.shape[-1]}")
    rows = weights.reshape(-1, weights.shape[-1])
    rows = np.where(rows.max(-1, keepdims=True) > 0, rows, 1.0)
    relative = rows / rows.max(-1, keepdims=True)  # the sum of huge weights must not overflow
    share = relative / relative.sum(-1, keepdims=True)
    # The entries that round up to one quantum take theirs from the others, in proportion to what those have to spare.
    quanta = np.where(rows > 0, np.maximum(np.rint(share * QUANTA), 1), 0).astype(np.int64)
    excess = quanta.sum(-1, keepdims=True) - QUANTA
    spare = np.where(rows > 0, quanta - 1, 0).cumsum(-1)
    taken = excess * spare // spare[:, -1:]
    quanta -= np.diff(taken, prepend=0, axis=-1)
    cdf = quanta.cumsum(-1) / QUANTA
    shape = weights.shape
    return cdf.astype(np.float32).reshape(shape), (quanta / QUANTA).astype(np.float32).reshape(shape)


def invert_cdf(
    cdf: Float[Array, "n"], u: Float[Array, "*b"], *, start: Int[Array, "*b"] | None = None, count: int | None = None
) -> tuple[Int[Array, "*b"], Float[Array, "*b"]]:
    """Entry that a random number selects, and the random number that is left over.

    Args:
        cdf: Cumulative probabilities of one distribution, or of many of equal length, one after another.
        u: Random numbers in [0, 1).
        start: First element of the distribution to sample, for each number; None: all sample the first one.
        count: Length of each distribution; None: that of `cdf`.
    Returns:
        Index within the distribution, and where `u` lies between its two cumulative probabilities, in [0, 1): again
        uniform and independent of the index, so stratified numbers stay stratified.
    Edge cases: entries of probability 0 are never selected; u >= 1 selects the last possible entry.
    """
    count = cdf.shape[0] if count is None else count
    start = jnp.zeros(u.shape, jnp.int32) if start is None else start
    u = jnp.clip(u, 0, _BELOW_ONE)

    def halve(_: object, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = (low + high) // 2
        above = cdf[start + middle] > u
        return jnp.where(above, low, middle + 1), jnp.where(above, middle, high)

    first = jnp.zeros_like(start)
    index, _ = jax.lax.fori_loop(0, (count - 1).bit_length(), halve, (first, first + (count - 1)))
    return index, apart(index >= 0, _left_over, cdf, start, index, u)


def _left_over(
    cdf: Float[Array, "n"], start: Int[Array, "*b"], index: Int[Array, "*b"], u: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    below = jnp.where(index > 0, cdf[start + jnp.maximum(index - 1, 0)], 0)
    width = cdf[start + index] - below
    return jnp.clip((u - below) / jnp.where(width > 0, width, 1), 0, _BELOW_ONE)
