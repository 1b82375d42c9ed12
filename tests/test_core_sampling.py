"""Point sets and maps: strata, uniform densities, and tables of probabilities."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, kstest
from strategies import floats, shapes, unit_vectors

from jaxrefl import core

FALSE_ALARM = 1e-4
"""Probability with which a statistical test would fail on correct code; the seeds are fixed."""
COUNT = 20_000


def uniforms(key) -> jax.Array:
    return jax.random.uniform(key, (COUNT, 2))


def assert_uniform(values) -> None:
    """The values are spread uniformly over [0, 1]."""
    assert kstest(np.asarray(values, np.float64), "uniform").pvalue > FALSE_ALARM


@pytest.mark.parametrize("count", [1, 3, 12, 31])
def test_one_point_in_each_stratum(count, key):
    """The rows and cells of the docstring, rebuilt with a loop."""
    points = np.asarray(core.stratified(key, count, shape=(50,)), np.float64)
    assert points.shape == (50, count, 2)
    rows, first = round(count**0.5), 0
    for row in range(rows):
        end = (row + 1) * count // rows
        for column in range(end - first):
            x, y = points[:, first + column].T
            assert ((x >= column / (end - first) - 1e-7) & (x <= (column + 1) / (end - first) + 1e-7)).all()
            assert ((y >= first / count - 1e-7) & (y <= end / count + 1e-7)).all()
        first = end
    assert first == count


def test_strata_of_a_square_count_are_the_square_grid(key):
    points = np.asarray(core.stratified(key, 16, shape=(20,)))
    cells = np.floor(points * 4).astype(int)
    assert (cells[..., 0] == np.tile(np.arange(4), 4)).all()
    assert (cells[..., 1] == np.repeat(np.arange(4), 4)).all()


@pytest.mark.parametrize("count", [4, 5])
def test_stratified_points_are_uniform_and_below_one(count, key):
    points = np.asarray(core.stratified(key, count, shape=(4000,)))
    assert (points >= 0).all() and (points < 1).all()
    for axis in range(2):
        # one point per element, so that the points are independent
        chosen = np.arange(4000) % count
        assert_uniform(points[np.arange(4000), chosen, axis])


def test_stratified_refuses_no_points(key):
    with pytest.raises(ValueError, match="count: expected at least 1 point, got 0"):
        core.stratified(key, 0)


def test_stratified_elements_are_independent(key):
    points = core.stratified(key, 4, shape=(2, 3))
    assert len(np.unique(np.asarray(points).reshape(-1))) == 2 * 3 * 4 * 2


def test_disk_is_uniform(key):
    x, y = np.asarray(core.disk(uniforms(key)), np.float64).T
    assert_uniform(x * x + y * y)
    assert_uniform(np.arctan2(y, x) / (2 * np.pi) + 0.5)


def test_disk_keeps_rings():
    """The square of half width r goes to the circle of radius r."""
    u = jnp.asarray([[0.75, 0.5], [0.5, 0.25], [0.75, 0.75], [0.25, 0.6], [0.5, 0.5], [1.0, 1.0]])
    np.testing.assert_allclose(np.linalg.norm(core.disk(u), axis=-1), [0.5, 0.5, 0.5, 0.5, 0, 1], atol=1e-6)


def test_cosine_hemisphere_follows_the_cosine(key):
    n = core.safe.normalise(jnp.asarray([1.0, -2.0, -0.5]))
    d = core.cosine_hemisphere(uniforms(key), jnp.broadcast_to(n, (COUNT, 3)))
    cos = np.asarray(d @ n, np.float64)
    assert cos.min() >= -1e-6
    assert_uniform(np.clip(cos, 0, 1) ** 2)
    np.testing.assert_allclose(core.safe.norm(d), 1, atol=1e-6)


def test_cone_is_uniform_in_solid_angle(key):
    axis = core.safe.normalise(jnp.asarray([0.3, 0.1, -1.0]))
    for cos_max in (0.5, -1.0):
        d = core.cone(uniforms(key), jnp.broadcast_to(axis, (COUNT, 3)), jnp.full(COUNT, cos_max))
        assert_uniform((1 - np.asarray(d @ axis, np.float64)) / (1 - cos_max))
        np.testing.assert_allclose(core.safe.norm(d), 1, atol=1e-6)


def test_a_narrow_cone_keeps_its_angle(key):
    """The sun: 0.27 degrees, whose cosine is 1 - 1.1e-5. Its float32 rounding moves the rim by 0.3 %."""
    angle = np.radians(0.27)
    axis = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0]), (COUNT, 3))
    d = np.asarray(core.cone(uniforms(key), axis, jnp.full(COUNT, np.cos(angle), jnp.float32)), np.float64)
    off_axis = np.arcsin(np.hypot(d[:, 0], d[:, 1]))
    assert off_axis.max() == pytest.approx(angle, rel=4e-3)
    assert np.mean(off_axis**2) == pytest.approx(angle**2 / 2, rel=0.02)


@given(shapes().flatmap(lambda s: st.tuples(unit_vectors(s), floats(0.0, 1.0, (*s, 2)), floats(-1.0, 1.0, s))))
def test_directions_stay_inside_their_cone(case):
    axis, u, cos_max = case
    assert (core.dot(core.cone(u, axis, cos_max), axis) >= cos_max - 2e-6).all()
    assert (core.dot(core.cosine_hemisphere(u, axis), axis) >= -1e-6).all()


def test_triangle_is_uniform(key):
    u = uniforms(key)
    b = np.asarray(core.triangle(u), np.float64)
    assert (b >= 0).all() and (b.sum(-1) <= 1 + 1e-6).all()
    # the share of the triangle with a weight above x is (1 - x)^2, for each of the three vertices
    for weight in (b[:, 0], b[:, 1], 1 - b.sum(-1)):
        assert_uniform((1 - np.clip(weight, 0, 1)) ** 2)


def test_table_is_sampled_with_its_probabilities(key):
    probability = np.array([0.0, 0.5, 0.0, 0.2, 0.05, 0.25, 0.0])
    cdf = jnp.asarray(np.cumsum(probability), jnp.float32)
    index = np.asarray(core.sample_cdf(cdf, jax.random.uniform(key, (COUNT,))))
    counts = np.bincount(index, minlength=7)
    positive = probability > 0
    assert counts[~positive].sum() == 0
    expected = COUNT * probability[positive]
    assert ((counts[positive] - expected) ** 2 / expected).sum() < chi2.isf(FALSE_ALARM, 3)


@given(floats(0.0, 1.0, (6,)), shapes().flatmap(lambda s: floats(0.0, 1.0, s)))
def test_table_never_gives_an_impossible_element(weights, u):
    weights = np.where(np.asarray(weights) < 0.5, 0, weights)
    total = weights.sum()
    cdf = jnp.asarray(np.cumsum(weights) / total if total > 0 else weights, jnp.float32)
    index = np.asarray(core.sample_cdf(cdf, u))
    probability = np.diff(np.asarray(cdf), prepend=np.float32(0))
    assert index.dtype == np.int32
    assert (probability[index] > 0).all() if total > 0 else (index == 5).all()
    lower, upper = np.asarray(cdf)[index] - probability[index], np.asarray(cdf)[index]
    if total > 0:
        assert ((np.asarray(u) >= lower - 1e-6) & (np.asarray(u) <= upper + 1e-6)).all()
