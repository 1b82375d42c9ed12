"""Fresnel terms: against complex amplitudes in float64, their limits, and the energy they split.

Tolerances of the property tests are twice the worst of 2 million random cases, or more.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.core import fresnel, transmittance
from strategies import floats, shapes
from tolerances import assert_close

from jaxrefl import core


def cases(*ranges: tuple[float, float]) -> st.SearchStrategy:
    """One array per range, all of one of the three batch shapes."""
    return shapes().flatmap(lambda shape: st.tuples(*(floats(low, high, shape) for low, high in ranges)))


def float64(*arrays) -> list[np.ndarray]:
    return [np.asarray(array, np.float64) for array in arrays]


@given(cases((0.0, 1.0), (1.01, 3.0)))
def test_dielectric_from_outside_against_amplitudes(case):
    assert_close(core.fresnel_dielectric(*case), fresnel(*float64(*case)), scale=3)


@given(cases((0.01, 1.0), (0.3, 0.99)))
def test_dielectric_from_inside_against_amplitudes(share_and_eta):
    share, eta = share_and_eta
    critical = np.sqrt(1 - np.asarray(eta, np.float64) ** 2)
    # The slope is infinite at the critical angle: stay 1 % of the remaining range away from it.
    cos = jnp.asarray(critical + (1 - critical) * np.asarray(share), jnp.float32)
    np.testing.assert_allclose(core.fresnel_dielectric(cos, eta), fresnel(*float64(cos, eta)), atol=3e-5)
    below = jnp.asarray(critical * 0.999 * np.asarray(share), jnp.float32)
    assert (core.fresnel_dielectric(below, eta) == 1).all()
    np.testing.assert_allclose(fresnel(*float64(below, eta)), 1, atol=1e-12)


@given(cases((0.0, 1.0), (0.1, 4.0), (0.01, 8.0)))
def test_conductor_against_complex_amplitudes(case):
    np.testing.assert_allclose(core.fresnel_conductor(*case), fresnel(*float64(*case)), atol=3e-6)


@given(cases((0.0, 1.0), (0.4, 3.0)))
def test_conductor_without_absorption_is_a_dielectric(case):
    cos, eta = case
    squared = np.asarray(eta, np.float64) ** 2 - 1 + np.asarray(cos, np.float64) ** 2
    expected = core.fresnel_dielectric(cos, eta)
    actual = core.fresnel_conductor(cos, eta, jnp.zeros_like(eta))
    # Close to the critical angle both follow a square root of rounding errors.
    np.testing.assert_allclose(np.where(np.abs(squared) > 1e-3, actual, expected), expected, atol=2e-6)


@given(cases((0.01, 1.0), (1.01, 3.0)))
def test_reflected_and_refracted_energy_add_up_to_one(case):
    cos, eta = case
    sin = np.sqrt(1 - np.asarray(cos) ** 2)
    wo = core.safe.normalise(jnp.stack([jnp.asarray(sin), jnp.zeros_like(cos), cos], -1))
    n = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0]), wo.shape)
    wi, valid = core.refract(wo, n, eta)
    assert valid.all()
    cos_o, cos_t, eta = float64(wo[..., 2], -wi[..., 2], eta)
    reflected = np.asarray(core.fresnel_dielectric(wo[..., 2], case[1]), np.float64)
    np.testing.assert_allclose(reflected + transmittance(cos_o, cos_t, eta), 1, atol=2e-6)


@given(cases((0.05, 1.0), (1.01, 3.0)))
def test_light_takes_the_same_path_both_ways(case):
    cos, eta = case
    cos_t = jnp.sqrt(eta * eta - 1 + cos * cos) / eta
    # cos_t lies close to the critical angle for a grazing cos, where rounding weighs most: 7e-5.
    np.testing.assert_allclose(core.fresnel_dielectric(cos_t, 1 / eta), core.fresnel_dielectric(cos, eta), atol=2e-4)


@given(cases((0.2, 4.0), (0.0, 8.0)))
def test_limits(eta_and_k):
    eta, k = eta_and_k
    one, zero = jnp.ones_like(eta), jnp.zeros_like(eta)
    assert_close(core.fresnel_dielectric(one, eta), core.f0_from_eta(eta), scale=2)
    assert_close(core.f0_from_eta(eta), ((np.asarray(eta, np.float64) - 1) / (np.asarray(eta, np.float64) + 1)) ** 2)
    eta64, k64 = float64(eta, k)
    normal = ((eta64 - 1) ** 2 + k64**2) / ((eta64 + 1) ** 2 + k64**2)
    assert_close(core.fresnel_conductor(one, eta, k), normal, scale=5)
    for grazing, expected in (
        (core.fresnel_dielectric(zero, eta), np.where(eta == 1, 0.0, 1.0)),
        (core.fresnel_conductor(zero, eta, k), np.where((eta == 1) & (k == 0), 0.0, 1.0)),
        (core.fresnel_schlick(zero, core.f0_from_eta(eta)), 1.0),
    ):
        np.testing.assert_allclose(grazing, expected, atol=1e-6)


@given(cases((0.0, 1.0)))
def test_no_interface_reflects_nothing(case):
    (cos,) = case
    assert (core.fresnel_dielectric(cos, jnp.ones_like(cos)) == 0).all()
    np.testing.assert_allclose(core.fresnel_conductor(cos, jnp.ones_like(cos), jnp.zeros_like(cos)), 0, atol=1e-6)
    # As eta goes to 1 the reflectance goes to 0, at any fixed angle.
    inside = np.maximum(cos, 0.1)
    assert (core.fresnel_dielectric(jnp.asarray(inside), jnp.full_like(cos, 1.0001)) < 1e-4).all()


@given(cases((0.0, 1.0), (0.0, 1.0)))
def test_schlick_is_its_formula_and_stays_between_f0_and_one(case):
    cos, f0 = float64(*case)
    result = core.fresnel_schlick(*case)
    assert_close(result, f0 + (1 - f0) * (1 - cos) ** 5)
    assert ((result >= case[1]) & (result <= 1 + 1e-6)).all()


@pytest.mark.parametrize(("eta", "worst"), [(1.33, 0.0599), (1.5, 0.0357), (2.0, 0.0444)])
def test_schlick_is_close_to_the_exact_term(eta, worst):
    """The figures in the docstring of `fresnel_schlick`."""
    cos = jnp.linspace(0, 1, 1001)
    exact = core.fresnel_dielectric(cos, jnp.asarray(eta))
    difference = np.abs(core.fresnel_schlick(cos, core.f0_from_eta(jnp.asarray(eta))) - exact).max()
    assert difference == pytest.approx(worst, abs=1e-4)


def test_a_colour_broadcasts_against_an_image_of_cosines():
    cos = jnp.full((2, 3, 1), 0.5)
    f0 = jnp.broadcast_to(jnp.asarray([0.9, 0.6, 0.3]), (2, 3, 3))
    assert core.fresnel_schlick(cos, f0).shape == (2, 3, 3)
    assert core.fresnel_conductor(cos, f0, f0).shape == (2, 3, 3)


@pytest.mark.parametrize("cos", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("eta", [1.2, 1.8, 0.95])
def test_gradients_against_differences_of_the_reference(cos, eta):
    step = 1e-6
    by_cos, by_eta = jax.grad(core.fresnel_dielectric, argnums=(0, 1))(jnp.asarray(cos), jnp.asarray(eta))
    if eta < 1 and cos * cos < 1 - eta * eta:
        assert by_cos == 0 and by_eta == 0
        return
    expected_cos = (fresnel(cos + step, eta) - fresnel(cos - step, eta)) / (2 * step)
    expected_eta = (fresnel(cos, eta + step) - fresnel(cos, eta - step)) / (2 * step)
    np.testing.assert_allclose([by_cos, by_eta], [expected_cos, expected_eta], rtol=2e-4, atol=2e-6)
    by_all = jax.grad(core.fresnel_conductor, argnums=(0, 1, 2))(*(jnp.asarray(x) for x in (cos, eta, 2.0)))
    expected = [
        (fresnel(cos + a, eta + b, 2.0 + c) - fresnel(cos - a, eta - b, 2.0 - c)) / (2 * step)
        for a, b, c in step * np.eye(3)
    ]
    np.testing.assert_allclose(by_all, expected, rtol=2e-4, atol=2e-6)
