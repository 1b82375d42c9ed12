"""Tiles of the gloss filter in which no pair of pixels has to be asked whether it agrees."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxrefl.filters import Footprint, GlossOptions, GlossParams, Guides, gloss, gloss_window
from jaxrefl.filters.gloss_layers import Layer, Limits, agree
from jaxrefl.filters.gloss_window import all_agree

ROWS, WIDE, RADIUS = 7, 9, 2
LIMITS = Limits(jnp.float32(0.8), jnp.float32(0.1))


def tile(rng: np.random.Generator, bump: float, tilt: float, bend: float, holes: float) -> Layer:
    """A slanted plane with bumps of the depth, of its slope and of the normals, and with pixels that show nothing."""
    y, x = np.mgrid[:ROWS, :WIDE].reshape(2, -1)
    slope = np.array([0.03, -0.02])[:, None] + tilt * rng.uniform(-1, 1, (2, x.size))
    inverse = 1 + 0.03 * x - 0.02 * y + bump * rng.uniform(-1, 1, x.size)
    normal = np.array([0.6, 0, 0.8])[:, None] + bend * rng.uniform(-1, 1, (3, x.size))
    normal /= np.linalg.norm(normal, axis=0)
    planes = [*normal, inverse, *slope, *np.ones((5, x.size))]
    ids = np.where(rng.random(x.size) < holes, -1, 4)
    return Layer(jnp.asarray(ids, jnp.int32), tuple(jnp.asarray(p, jnp.float32) for p in planes))


@jax.jit
def answers(found: Layer) -> tuple[jax.Array, jax.Array]:
    """What is said of the whole tile, and whether all pairs agree that a window brings together."""
    y, x = (jnp.asarray(i, jnp.int32) for i in np.mgrid[:ROWS, :WIDE].reshape(2, -1))
    n = x.size
    a, b = np.repeat(np.arange(n), n), np.tile(np.arange(n), n)
    first, second = jax.tree.map(lambda p: p[a], found), jax.tree.map(lambda p: p[b], found)
    dx, dy = x[b] - x[a], y[b] - y[a]
    asked = (jnp.abs(dx) <= RADIUS) & (jnp.abs(dy) <= RADIUS) & (first.id >= 0) & (second.id >= 0)
    good = agree(first, second, dx.astype(jnp.float32), dy.astype(jnp.float32), LIMITS)
    return all_agree(found, WIDE, RADIUS, LIMITS), (good | ~asked).all()


sizes = st.floats(-4, 0).map(lambda e: 10.0**e)


@given(seed=st.integers(0, 2**16), bump=sizes, tilt=sizes, bend=sizes, holes=st.floats(0, 1))
def test_a_tile_counts_as_one_plane_only_if_all_pairs_agree(seed, bump, tilt, bend, holes):
    said, true = answers(tile(np.random.default_rng(seed), bump, tilt, bend, holes))
    assert bool(true) or not bool(said)


def test_planes_are_found_and_edges_are(rng):
    plane = tile(rng, 0.0, 0.0, 0.0, 0.3)
    assert bool(answers(plane)[0]), "also with pixels that show nothing"
    # What is measured to be let through: about half of what the limits would allow.
    assert bool(answers(tile(rng, 0.02, 0.005, 0.1, 0.0))[0])
    beyond = {"bumps": (0.2, 0, 0), "slopes": (0, 0.05, 0), "normals": (0, 0, 1.0)}
    for name, sizes_of in beyond.items():
        assert not bool(answers(tile(rng, *sizes_of, 0.0))[0]), name
    assert not bool(answers(plane._replace(id=plane.id.at[20].set(5)))[0]), "another surface"
    strict = Limits(jnp.float32(1.1), jnp.float32(0.1))  # not even a pixel agrees with itself
    assert not bool(all_agree(plane, WIDE, RADIUS, strict))


@pytest.mark.slow
def test_results_are_the_same_without_the_short_cut(rng, monkeypatch):
    """A plane with an edge in one of its tiles, on the pyramid: values, holes and gradients."""
    h, w = 48, 300
    y, x = np.mgrid[:h, :w]
    ids = np.where((x > 40) & (x < 60), 1, 0)
    ids[20:24, 200:] = -1
    guides = Guides(
        jnp.asarray(ids, jnp.int32),
        jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0]), (h, w, 3)),
        jnp.asarray(1 / (1 + 0.01 * x), jnp.float32),
        jnp.broadcast_to(jnp.asarray([0.01, 0.0]), (h, w, 2)),
    )
    image = jnp.asarray(rng.random((h, w, 3)), jnp.float32)
    confidence = jnp.asarray(rng.random((h, w)) > 0.2, jnp.float32)
    tau = jnp.asarray(rng.uniform(0.3, 0.9, (h, w)), jnp.float32)

    def total(variance):
        covariance = jnp.broadcast_to(jnp.stack([variance, 0.3 * variance, 0.5 * variance]), (h, w, 1, 3))
        shape = Footprint(jnp.ones((h, w, 1)), jnp.zeros((h, w, 1, 2)), covariance)
        options = GlossOptions("window", 4, 3)
        found = gloss.__wrapped__(image, confidence, tau, guides, shape, GlossParams(), options=options)[0]
        return (found**2).sum(), found

    def both() -> tuple:
        return jax.jit(jax.value_and_grad(total, has_aux=True))(jnp.float32(4.0))

    (_, short), change = both()
    said: list = []

    def never(*args):
        said.append(args)
        return jnp.asarray(False)

    monkeypatch.setattr(gloss_window, "all_agree", never)
    (_, whole), expected = both()
    assert said, "the tiles were asked"
    np.testing.assert_allclose(short, whole, atol=1e-5)
    assert float(change) == pytest.approx(float(expected), rel=1e-3)
