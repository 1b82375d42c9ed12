"""The albedo table and the effective Fresnel cosine, against Monte Carlo with another sampling method in float64."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.core import fresnel, lobe
from strategies import floats, shapes

from jaxrefl import core

ALPHAS = (1e-4, 0.004, 0.03, 0.1, 0.17, 0.3, 0.55, 0.8, 1.0)
COSINES = (1e-3, 0.01, 0.04, 0.15, 0.4, 0.75, 1.0)
PAIRS = [(cos, alpha) for alpha in ALPHAS for cos in COSINES]


@functools.cache
def samples(cos: float, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """65,536 stratified samples of the lobe."""
    return lobe(cos, alpha, np.random.default_rng(7))


def test_albedo_against_monte_carlo():
    cos, alpha = (jnp.asarray(column, jnp.float32) for column in zip(*PAIRS, strict=True))
    scale, bias = (np.asarray(x, np.float64) for x in core.ggx_albedo(cos, alpha))
    expected = []
    for pair in PAIRS:
        cos_d, weight = samples(*pair)
        schlick = (1 - cos_d) ** 5
        expected.append((np.mean(weight * (1 - schlick)), np.mean(weight * schlick)))
    expected_scale, expected_bias = np.array(expected).T
    # What the docstring claims, plus 0.0002 for the samples.
    assert np.abs(scale - expected_scale).max() < 0.0008 + 0.0002
    assert np.abs(bias - expected_bias).max() < 0.001 + 0.0002
    assert np.abs(scale + bias - expected_scale - expected_bias).max() < 0.0006 + 0.0002


@pytest.mark.parametrize(("eta", "worst"), [(1.33, 0.023), (1.5, 0.016), (2.0, 0.019), (2.5, 0.031)])
def test_effective_cosine_gives_the_average_fresnel_term(eta, worst):
    """The figures in the docstring, plus 0.001 for the samples."""
    errors = []
    for cos, alpha in PAIRS:
        cos_d, weight = samples(cos, alpha)
        expected = np.sum(weight * fresnel(cos_d, np.array(eta))) / np.sum(weight)
        effective = core.lobe_fresnel_cosine(jnp.asarray(cos), jnp.asarray(alpha))
        errors.append(float(core.fresnel_dielectric(effective, jnp.asarray(eta))) - expected)
    assert np.abs(errors).max() < worst + 0.001


@given(shapes().flatmap(lambda s: st.tuples(floats(0.0, 1.0, s), floats(0.0, 1.0, s))))
def test_it_is_exact_for_schlick_and_never_gains_energy(case):
    cos, alpha = case
    scale, bias = core.ggx_albedo(cos, alpha)
    assert ((scale >= 0) & (bias >= 0) & (scale + bias <= 1 + 1e-6)).all()
    effective = core.lobe_fresnel_cosine(cos, alpha)
    assert ((effective >= 0) & (effective <= 1)).all()
    np.testing.assert_allclose((1 - effective) ** 5, bias / (scale + bias), atol=2e-6)


@given(shapes().flatmap(lambda s: floats(0.0, 1.0, s)))
def test_a_mirror_is_exact(cos):
    zero = jnp.zeros_like(cos)
    scale, bias = core.ggx_albedo(cos, zero)
    np.testing.assert_allclose(bias, (1 - np.asarray(cos, np.float64)) ** 5, atol=1e-6)
    np.testing.assert_allclose(scale + bias, 1, atol=1e-6)
    np.testing.assert_allclose(core.lobe_fresnel_cosine(cos, zero), cos, atol=2e-6)


def test_it_is_continuous_towards_the_mirror():
    cos = jnp.linspace(0.01, 1, 50)
    scale, bias = core.ggx_albedo(cos, jnp.full(50, 1e-6))
    mirror_scale, mirror_bias = core.ggx_albedo(cos, jnp.zeros(50))
    np.testing.assert_allclose(scale, mirror_scale, atol=1e-3)
    np.testing.assert_allclose(bias, mirror_bias, atol=1e-3)


def test_gradients_follow_the_values():
    """The gradient of an interpolated table jumps from cell to cell: compare its mean over several of them."""

    def total(alpha, cos):
        return sum(core.ggx_albedo(cos, alpha))

    gradients = jax.jit(jax.vmap(jax.grad(total), (0, None)))
    for cos, alpha in ((0.3, 0.2), (0.8, 0.5), (0.1, 0.05)):
        points = jnp.asarray(alpha * np.linspace(0.95, 1.05, 41), jnp.float32)
        low, high = total(points[jnp.asarray([0, -1])], jnp.full(2, cos))
        difference = float(high - low) / (0.1 * alpha)
        assert np.mean(gradients(points, jnp.asarray(cos))) == pytest.approx(difference, rel=0.05)
