r"""Low-discrepancy points without tables or state: Owen-scrambled Sobol points from hashes.

Each pixel has a sequence of its own, and each pair of dimensions of it is a (0, 2)-sequence: the first $2^m$ points
put exactly one into every elementary interval of area $2^{-m}$, so that errors fall faster than $1 / \sqrt n$ where the
integrand allows it, and never slower. Pairs are shuffled against each other by scrambling the index.

Everything is integer arithmetic on uint32, the same bits on every machine.

Sources: [Bur20] Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020; [LK11] Laine and Karras, "Stratified
Sampling for Stochastic Transparency", EGSR 2011, with the constants of N. Vegdahl (2021).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

_SHIFTS_AND_MASKS = ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF))


def hash_words(*words: UInt32[Array, "*#b"] | int) -> UInt32[Array, "*b"]:
    """A well-mixed word from several.

    Args:
        words: Unsigned 32-bit words; their order matters.
    Returns:
        A hash; every bit of every word changes each of its bits with probability 1/2.
    Source: the finaliser "lowbias32" of C. Wellons' hash prospector, chained.
    """
    state = jnp.asarray(0x9E3779B9, jnp.uint32)
    for word in words:
        state = state ^ jnp.asarray(word, jnp.uint32)
        state = (state ^ (state >> 16)) * np.uint32(0x7FEB352D)
        state = (state ^ (state >> 15)) * np.uint32(0x846CA68B)
        state = state ^ (state >> 16)
    return state


def owen_sobol(
    sequence: UInt32[Array, "*b"], number: UInt32[Array, "*b"], pair: UInt32[Array, "*b"]
) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """One pair of dimensions of a point of an Owen-scrambled Sobol sequence.

    Args:
        sequence: Which sequence; sequences are independent of each other.
        number: Number of the point within its sequence.
        pair: Number of the pair of dimensions.
    Returns:
        Two coordinates in [0, 1), multiples of 2^-24.
    Edge cases: a sequence repeats after 2^32 points; beyond 2^24 points coordinates start to coincide.
    Source: [Bur20] listings 1 to 4, with one reversal of bits per coordinate, since those within cancel.
    """
    seed = hash_words(sequence, pair)
    shuffled = _scramble(reverse_bits(number), seed)  # bits of the shuffled number, the lowest on top
    index = reverse_bits(shuffled)
    x = reverse_bits(_scramble(index, hash_words(seed, 1)))
    y = reverse_bits(_scramble(_pascal(index), hash_words(seed, 2)))
    return _unit(x), _unit(y)


def uniform(
    sequence: UInt32[Array, "*b"], number: UInt32[Array, "*b"], pair: UInt32[Array, "*b"]
) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Two independent uniform numbers, in the place of `owen_sobol`.

    Args:
        sequence: As for `owen_sobol`.
        number: As for `owen_sobol`.
        pair: As for `owen_sobol`.
    Returns:
        Two numbers in [0, 1), multiples of 2^-24.
    """
    seed = hash_words(sequence, pair, number)
    return _unit(seed), _unit(hash_words(seed, 1))


def seed_of(key: Array) -> UInt32[Array, ""]:
    """A seed for `hash_words` from a `jax.random.key`.

    Args:
        key: Random key.
    Returns:
        One word.
    """
    return jax.random.bits(key, (), jnp.uint32)


def reverse_bits(x: UInt32[Array, "*b"]) -> UInt32[Array, "*b"]:
    """The word read backwards.

    Args:
        x: Words.
    Returns:
        Words whose bit i is bit 31 - i of x.
    """
    for shift, mask in _SHIFTS_AND_MASKS:
        x = ((x >> shift) & np.uint32(mask)) | ((x & np.uint32(mask)) << shift)
    return x


def _scramble(x: UInt32[Array, "*b"], seed: UInt32[Array, "*b"]) -> UInt32[Array, "*b"]:
    """Owen scrambling of a number whose digits run from the lowest bit up: each bit is flipped by those below it."""
    x = x ^ (x * np.uint32(0x3D20ADEA))
    x = x + seed
    x = x * ((seed >> 16) | np.uint32(1))
    x = x ^ (x * np.uint32(0x05526C56))
    return x ^ (x * np.uint32(0x53A22864))


def _pascal(x: UInt32[Array, "*b"]) -> UInt32[Array, "*b"]:
    """Sobol's second dimension: the index times Pascal's triangle modulo 2, digits from the lowest bit up.

    Digit i is the parity of the bits j with C(j, i) odd, which are the supersets of i: a sum over them in 5 steps.
    """
    for shift, mask in _SHIFTS_AND_MASKS:
        x = x ^ ((x >> shift) & np.uint32(mask))
    return x


def _unit(x: UInt32[Array, "*b"]) -> Float[Array, "*b"]:
    return (x >> 8).astype(jnp.int32).astype(jnp.float32) * np.float32(2**-24)


def pixel_sequences(seed: UInt32[Array, ""], element: Int[Array, "*b"]) -> UInt32[Array, "*b"]:
    """A sequence for each pixel or ray.

    Args:
        seed: Seed of the image.
        element: Numbers of the pixels.
    Returns:
        Sequence numbers for `owen_sobol`.
    """
    return hash_words(jnp.broadcast_to(seed, element.shape), element.astype(jnp.uint32))
