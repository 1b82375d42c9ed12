"""Keeping XLA from computing the same thing again and again on a CPU.

What XLA fuses with several results it computes for each of them, and optimization barriers are gone before it fuses. A
branch is where fusion ends, and one that nobody needs costs nothing. Two results that leave a branch or a loop as one
complex number are one result: a Newton step with 16 gathers ran nine times as fast for it.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

T = TypeVar("T")


def apart(wanted: Bool[Array, "*b"], compute: Callable[..., T], *args: object, fill: float = 0.0) -> T:
    """What a function makes of its arguments, computed once for all that depends on it, and only if it is wanted.

    Args:
        wanted: Elements that need the result; any of them is enough.
        compute: A pure function of arrays.
        args: Its arguments.
        fill: What all its results are where nothing is wanted.
    Returns:
        What `compute` returns.
    Edge cases: under `vmap` over `wanted` both branches are computed, and the right one is taken for each element.
    """
    shapes = jax.eval_shape(compute, *args)
    return jax.lax.cond(
        wanted.any(), compute, lambda *_: jax.tree.map(lambda s: jnp.full(s.shape, fill, s.dtype), shapes), *args
    )


def together(a: Float[Array, "*b"], b: Float[Array, "*b"]) -> Complex[Array, "*b"]:
    """Two results as one: what they share is computed once, where the pair crosses the edge of a loop or of `apart`.

    Args:
        a: The one, float32.
        b: The other.
    Returns:
        Complex numbers with `a` as real and `b` as imaginary parts; read them with `jnp.real` and `jnp.imag`.
    Edge cases: a pair that is taken apart in the same computation is no pair: XLA sees through it.
    """
    return jax.lax.complex(a, b)
