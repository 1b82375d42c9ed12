"""Owen-scrambled Sobol points: nets, independence, reproducibility."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxrefl.core import hash_words, owen_sobol, pixel_sequences, seed_of, uniform
from jaxrefl.core.sequences import reverse_bits

WORD = st.integers(0, 2**32 - 1)


def points(draw, sequence: int, pair: int, count: int, first: int = 0) -> np.ndarray:
    number = jnp.arange(first, first + count, dtype=jnp.uint32)
    full = lambda x: jnp.full((count,), x, jnp.uint32)  # noqa: E731
    return np.stack([np.asarray(x) for x in draw(full(sequence), number, full(pair))], -1)


@given(WORD, st.integers(0, 400))
def test_every_elementary_interval_holds_one_point(sequence: int, pair: int):
    """The first 2^m points of a (0, 2)-sequence form a (0, m, 2)-net."""
    x = points(owen_sobol, sequence, pair, 256)
    assert (x >= 0).all() and (x < 1).all()
    for m in (2, 5, 8):
        for columns in range(m + 1):
            cells = np.floor(x[: 2**m] * (2**columns, 2 ** (m - columns)))
            assert len(np.unique(cells, axis=0)) == 2**m


@given(WORD)
def test_later_blocks_of_a_sequence_are_nets_too(sequence: int):
    x = points(owen_sobol, sequence, 0, 64, first=7 * 64)
    for columns in range(7):
        assert len(np.unique(np.floor(x * (2**columns, 2 ** (6 - columns))), axis=0)) == 64


def test_sequences_and_pairs_are_independent_of_each_other():
    """Correlations between the coordinates of different pairs, sequences and of one pair, over 4096 points each."""
    first = [points(owen_sobol, 3, pair, 4096) for pair in range(4)]
    other = points(owen_sobol, 4, 0, 4096)
    columns = np.concatenate([*first, other], 1).T
    correlation = np.corrcoef(columns) - np.eye(len(columns))
    assert np.abs(correlation).max() < 0.06  # four standard errors of 1 / sqrt(4096)


def test_errors_fall_faster_than_those_of_random_points():
    """Integral of a smooth function over the square: error of 1024 points, root mean square over 64 sequences."""

    def error(draw) -> float:
        estimates = []
        for sequence in range(64):
            x = points(draw, sequence, 5, 1024)
            estimates.append(np.mean(np.exp(x[:, 0]) * np.sin(np.pi * x[:, 1])))
        return float(np.sqrt(np.mean((np.array(estimates) - (np.e - 1) * 2 / np.pi) ** 2)))

    assert error(owen_sobol) < error(uniform) / 50  # measured: 1 / 240


@given(WORD)
def test_reversing_bits(word: int):
    assert int(reverse_bits(jnp.uint32(word))) == int(f"{word:032b}"[::-1], 2)


def test_hashes_depend_on_every_word_and_its_place():
    words = {int(hash_words(jnp.uint32(a), b)) for a in range(32) for b in range(32)}
    assert len(words) == 1024
    assert int(hash_words(1, 2)) != int(hash_words(2, 1))


def test_flipping_any_bit_flips_half_of_the_hash():
    base = np.arange(2000, dtype=np.uint32)
    for bit in (0, 13, 31):
        flipped = np.asarray(hash_words(jnp.asarray(base)) ^ hash_words(jnp.asarray(base ^ np.uint32(1 << bit))))
        share = np.unpackbits(flipped.view(np.uint8)).mean()
        assert abs(share - 0.5) < 0.01  # 64,000 bits: five standard errors


@pytest.mark.parametrize("draw", [owen_sobol, uniform])
def test_numbers_are_uniform(draw):
    x = points(draw, 9, 2, 2**14)
    assert np.abs(np.histogram(x, 16, (0, 1))[0] / x.size - 1 / 16).max() < 0.004
    assert x.min() >= 0 and x.max() < 1


def test_pixels_have_sequences_of_their_own(key: jax.Array):
    sequences = np.asarray(pixel_sequences(seed_of(key), jnp.arange(5000)))
    assert len(np.unique(sequences)) == 5000
    again = np.asarray(pixel_sequences(seed_of(key), jnp.arange(5000)))
    assert (sequences == again).all()
    assert (np.asarray(pixel_sequences(jnp.uint32(1), jnp.arange(5000))) != sequences).all()
