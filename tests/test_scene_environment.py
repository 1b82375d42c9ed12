"""Environment maps: where things are on the map, filtering, and sampling that agrees with its density."""

import os
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import lookup as reference
from strategies import floats, shapes, unit_vectors
from tolerances import assert_close

from jaxrefl.core import stratified
from jaxrefl.scene import (
    SceneError,
    Sky,
    build_environment,
    constant_sky,
    environment_pdf,
    environment_radiance,
    read_radiance,
    sample_environment,
)
from jaxrefl.scene.distributions import QUANTA, distribution, invert_cdf

radiance_at, sample, pdf = (eqx.filter_jit(f) for f in (environment_radiance, sample_environment, environment_pdf))

select = eqx.filter_jit(invert_cdf)
gradient_of_lookup = eqx.filter_jit(jax.jacobian(environment_radiance, argnums=1))
gradient_of_samples = eqx.filter_jit(eqx.filter_grad(lambda e, u: sample_environment(e, u)[1].sum()))

TURN = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""A rotation that takes x to y, y to z and z to x."""


def bumpy(rng: np.random.Generator, height: int = 16, width: int = 24, *, sun: float = 2000.0) -> np.ndarray:
    """A dim map with a very bright texel, a bright one next to the pole and a black region."""
    radiance = rng.random((height, width, 3)).astype(np.float32)
    radiance[3, 5] = sun
    radiance[0, 2] = 30
    radiance[8:14, 10:20] = 0
    return radiance


@pytest.mark.parametrize(
    ("direction", "row", "column"),
    [
        ((0, 0, -1), 4, 8),
        ((1, 0, 0), 4, 12),
        ((0, 0, 1), 4, 0),
        ((-1, 0, 0), 4, 4),
        ((0, 1, 0), 0, 8),
        ((0, -1, 0), 7, 8),
    ],
)
def test_the_map_is_oriented_as_documented(direction, row: int, column: int):
    """Axes lie on the corners of texels, so all four around one are lit."""
    image = np.zeros((8, 16, 3), np.float32)
    for j in (row - 1, row) if row == 4 else (row,):
        for i in (column - 1, column):
            image[j, i % 16] = 1
    seen = radiance_at(build_environment(Sky(image)), jnp.asarray(direction, jnp.float32))
    np.testing.assert_allclose(seen, 1, rtol=1e-5)


@given(unit_vectors((5,)), st.integers(0, 3))
def test_lookup_is_bilinear(direction: jax.Array, seed: int):
    image = bumpy(np.random.default_rng(seed), sun=5.0)
    seen = radiance_at(build_environment(Sky(image)), direction)
    # Coordinates err by 1e-7 of the map, which a step of 30 per texel turns into 1e-7 * 24 * 30.
    np.testing.assert_allclose(seen, reference.latlong(image, np.asarray(direction)), atol=2e-4, rtol=1e-4)


@given(unit_vectors((5,)))
def test_a_rotated_map_is_seen_in_rotated_directions(direction: jax.Array):
    image = bumpy(np.random.default_rng(0), sun=5.0)
    turned = build_environment(Sky(image, world_from_map=TURN))
    straight = build_environment(Sky(image))
    world = jnp.asarray(np.asarray(direction) @ TURN.T, jnp.float32)
    assert_close(radiance_at(turned, world), radiance_at(straight, direction), scale=20)
    assert_close(pdf(turned, world), pdf(straight, direction), scale=20)


@given(st.data(), shapes())
def test_lookup_stays_within_the_range_of_the_map(data: st.DataObject, shape: tuple[int, ...]):
    image = bumpy(np.random.default_rng(0))
    seen = np.asarray(radiance_at(build_environment(Sky(image)), data.draw(unit_vectors(shape))))
    assert (seen >= 0).all() and (seen <= image.max() * 1.00001).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 1), (16, 24)])
def test_density_integrates_to_one(size: tuple[int, int], rng: np.random.Generator):
    image = rng.random((*size, 3)).astype(np.float32)
    environment = build_environment(Sky(image, world_from_map=TURN))
    directions, solid_angle = reference.sphere(10 * size[0], 10 * size[1])
    density = pdf(environment, jnp.asarray(directions @ TURN.T, jnp.float32))
    assert float((np.asarray(density, np.float64) * solid_angle).sum()) == pytest.approx(1, abs=1e-5)


@given(floats(0.01, 0.99, (5, 2)))  # at a pole all columns meet
def test_samples_carry_their_own_density_and_radiance(u: jax.Array):
    environment = build_environment(Sky(bumpy(np.random.default_rng(0), sun=5.0), world_from_map=TURN))
    direction, radiance, density = sample(environment, u)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1, rtol=1e-5)
    np.testing.assert_allclose(radiance, radiance_at(environment, direction), atol=2e-3, rtol=1e-3)
    # A little inside the texel on all sides at least one neighbouring direction has the same density.
    around = direction[:, None] + 1e-4 * jnp.asarray(np.random.default_rng(1).normal(size=(1, 16, 3)), jnp.float32)
    others = np.asarray(pdf(environment, around / jnp.linalg.norm(around, axis=-1, keepdims=True)))
    assert np.isclose(others, np.asarray(density)[:, None], rtol=1e-5).any(-1).all()


@pytest.mark.parametrize("sun", [1.0, 1e3, 1e6])
def test_estimates_are_unbiased(sun: float, rng: np.random.Generator, key: jax.Array):
    """The mean of radiance / density is the integral over the sphere, also with a sun that takes almost all samples."""
    image = bumpy(rng, sun=sun)
    environment = build_environment(Sky(image))
    directions, solid_angle = reference.sphere(160, 240)
    # The integrals of the bilinear map over each cell, by its value at the middle: exact for bilinear u, 1e-4 in v.
    expected = (
        np.asarray(radiance_at(environment, jnp.asarray(directions, jnp.float32)), np.float64).T * solid_angle
    ).sum(1)
    _, radiance, density = sample(environment, stratified(key, 2**17))
    estimate = np.asarray(radiance / density[:, None], np.float64)
    deviation = estimate.std(0) / np.sqrt(len(estimate))  # stratification only makes it smaller
    assert (np.abs(estimate.mean(0) - expected) < 3 * deviation + 3e-4 * expected).all()


def test_sampling_follows_luminance(rng: np.random.Generator, key: jax.Array):
    """In the middle of a smooth map radiance / density is almost constant: that is what importance sampling is for."""
    grey = np.repeat(1 + rng.random((4, 8, 1)), 3, -1).repeat(8, 0).repeat(8, 1).astype(np.float32)
    _, radiance, density = sample(build_environment(Sky(grey)), stratified(key, 4096))
    ratio = np.asarray(radiance[:, 0] / density)
    assert ratio.std() < 0.1 * ratio.mean()  # 0.06: what bilinear slopes within a texel leave


def test_a_constant_sky_is_constant(key: jax.Array):
    environment = build_environment(constant_sky((1.0, 2.0, 3.0)))
    direction, radiance, density = sample(environment, stratified(key, 64))
    np.testing.assert_array_equal(radiance, np.broadcast_to([1, 2, 3], (64, 3)))
    np.testing.assert_allclose(density, 1 / (4 * np.pi), rtol=1e-6)
    np.testing.assert_array_equal(radiance_at(environment, direction), radiance)
    np.testing.assert_allclose(pdf(environment, direction), 1 / (4 * np.pi), rtol=1e-6)
    assert np.abs(direction.mean(0)).max() < 0.05  # all around


def test_a_constant_sky_costs_no_lookup():
    environment = build_environment(constant_sky((1.0, 2.0, 3.0)))
    text = str(jax.make_jaxpr(environment_radiance)(environment, jnp.ones((4, 3))))
    assert "gather" not in text and "atan2" not in text


def test_a_black_map_is_sampled_evenly(key: jax.Array):
    environment = build_environment(Sky(np.zeros((4, 8, 3), np.float32)))
    _, radiance, density = sample(environment, stratified(key, 16))
    assert (np.asarray(radiance) == 0).all()
    np.testing.assert_allclose(density, 1 / (4 * np.pi), rtol=1e-5)


@pytest.mark.parametrize("direction", [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, 0)])
def test_gradients_are_finite_at_the_poles(direction):
    environment = build_environment(Sky(bumpy(np.random.default_rng(0))))
    d = jnp.asarray(direction, jnp.float32)
    assert np.isfinite(gradient_of_lookup(environment, d)).all()
    assert np.isfinite(gradient_of_samples(environment, jnp.zeros((3, 2))).radiance).all()


@pytest.mark.parametrize(
    ("sky", "message"),
    [
        (Sky(np.ones((2, 2)), name="a.hdr"), "shape"),
        (Sky(np.ones((0, 2, 3)), name="a.hdr"), "shape"),
        (Sky(np.full((2, 2, 3), np.nan), name="a.hdr"), "finite"),
        (Sky(np.full((2, 2, 3), -1.0), name="a.hdr"), ">= 0"),
        (Sky(np.ones((2, 2, 3)), world_from_map=2 * np.eye(3), name="a.hdr"), "rotation"),
        (Sky(np.ones((2, 2, 3)), world_from_map=-np.eye(3), name="a.hdr"), "rotation"),
        (Sky(np.ones((2, 2, 3)), world_from_map=np.eye(4), name="a.hdr"), "rotation"),
    ],
)
def test_bad_skies(sky: Sky, message: str):
    with pytest.raises(SceneError, match=f"a.hdr.*{message}"):
        build_environment(sky)


WEIGHTS = {
    "even": np.ones(1000),
    "one": np.array([3.0]),
    "spike": np.where(np.arange(5000) == 4321, 1e9, 1e-6),
    "holes": np.array([0, 0, 1, 0, 2, 1e-30, 0, 5, 0, 0]),
    "tiny": np.array([1e-300, 1e-300, 3e-300]),
    "huge": np.array([1e308, 1e308, 1e308]),
    "none": np.zeros(7),
}


@pytest.mark.parametrize("name", WEIGHTS)
def test_every_random_number_lands_as_the_table_says(name: str):
    """All 2^23 float32 numbers that `jax.random.uniform` can return: the counts are exactly the probabilities."""
    cdf, probability = distribution(WEIGHTS[name])
    assert cdf[-1] == 1 and probability.sum(dtype=np.float64) == 1
    positive = WEIGHTS[name] > 0 if WEIGHTS[name].any() else np.ones_like(probability, bool)
    np.testing.assert_array_equal(probability > 0, positive)
    u = jnp.arange(QUANTA, dtype=jnp.float32) / QUANTA
    index, rest = select(jnp.asarray(cdf), u)
    counts = np.bincount(np.asarray(index), minlength=len(probability))
    np.testing.assert_array_equal(counts, probability.astype(np.float64) * QUANTA)
    assert (np.asarray(rest) >= 0).all() and (np.asarray(rest) < 1).all()


def test_probabilities_follow_the_weights(rng: np.random.Generator):
    weights = rng.random((3, 100))
    cdf, probability = distribution(weights)
    np.testing.assert_allclose(probability, weights / weights.sum(-1, keepdims=True), atol=2 / QUANTA)
    np.testing.assert_array_equal(cdf, probability.cumsum(-1, dtype=np.float64))


def test_left_over_numbers_are_uniform():
    cdf, _ = distribution(np.array([1.0, 5.0, 2.0]))
    index, rest = select(jnp.asarray(cdf), jnp.linspace(0, 1, 8001)[:-1])
    for i in range(3):
        values = np.sort(np.asarray(rest)[np.asarray(index) == i])
        np.testing.assert_allclose(values, (np.arange(len(values)) + 0.5) / len(values), atol=2e-3)


def test_numbers_outside_the_unit_interval_select_possible_entries():
    cdf, _ = distribution(np.array([0.0, 1.0, 3.0, 0.0]))
    index, _ = select(jnp.asarray(cdf), jnp.asarray([-1.0, 0.0, 1.0, 2.0]))
    np.testing.assert_array_equal(index, [1, 1, 2, 2])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["studio_small_03_1k.hdr", "venice_sunset_1k.hdr"])
def test_maps_that_people_have(name: str, key: jax.Array):
    if "JAXREFL_SCENES" not in os.environ:
        pytest.skip("JAXREFL_SCENES does not name a folder of scenes")
    image = read_radiance(Path(os.environ["JAXREFL_SCENES"], "hdri", name))
    environment = build_environment(Sky(image))
    _, radiance, density = sample(environment, stratified(key, 2**16))
    edges = np.cos(np.pi * np.arange(513) / 512)
    expected = (image.astype(np.float64).sum(1) * (edges[:-1] - edges[1:])[:, None]).sum(0) * 2 * np.pi / 1024
    estimate = np.asarray(radiance / density[:, None], np.float64)
    np.testing.assert_allclose(estimate.mean(0), expected, rtol=5e-3)
