"""GGX: distribution, masking, visible normals and their density, against float64 quadrature and counts of samples."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.core import ggx, microfacet_grid, smith_lambda
from scipy.stats import chi2
from strategies import floats, shapes, unit_vectors
from tolerances import assert_close

from jaxrefl import core

ALPHAS = (1e-3, 0.05, 0.4, 1.0)
COSINES = (0.05, 0.4, 1.0)


def direction(cos: float, azimuth: float = 0.7) -> np.ndarray:
    sin = np.sqrt(1 - cos * cos)
    return np.array([sin * np.cos(azimuth), sin * np.sin(azimuth), cos])


def like(x: np.ndarray, *batch: int) -> jnp.ndarray:
    return jnp.broadcast_to(jnp.asarray(x, jnp.float32), (*batch, *np.shape(x)))


@given(shapes().flatmap(lambda s: st.tuples(floats(0.01, 1.0, s), floats(0.01, 1.0, s), floats(0.05, 1.0, s))))
def test_distribution_and_masking_against_the_textbook(case):
    cos_o, cos_i, alpha = case
    c, i, a = (np.asarray(x, np.float64) for x in case)
    assert_close(core.ggx_distribution(cos_o, alpha), ggx(c, a), scale=20)  # the lobe's tip amplifies rounding of cos
    assert_close(core.smith_g1(cos_o, alpha), 1 / (1 + smith_lambda(c, a)), scale=2)
    assert_close(core.smith_g2(cos_o, cos_i, alpha), 1 / (1 + smith_lambda(c, a) + smith_lambda(i, a)), scale=3)
    assert_close(core.smith_g2(cos_o, cos_i, alpha), core.smith_g2(cos_i, cos_o, alpha))
    ratio = core.smith_g2(cos_o, cos_i, alpha) / core.smith_g1(cos_o, alpha)
    assert_close(core.reflection_weight(cos_o, cos_i, alpha), ratio)


@given(shapes().flatmap(lambda s: st.tuples(unit_vectors(s), floats(0.05, 1.0, s), floats(0.0, 0.99, (*s, 2)))))
def test_the_sample_weight_is_the_brdf_over_the_density(case):
    wo, alpha, u = case
    wo = core.safe.normalise(jnp.stack([wo[..., 0], wo[..., 1], jnp.abs(wo[..., 2]) + 0.05], -1))
    h = core.sample_visible_normal(wo, alpha, u)
    wi = core.reflect(wo, h)
    cos_o, cos_i, a, cos_h = (np.asarray(x, np.float64) for x in (wo[..., 2], wi[..., 2], alpha, h[..., 2]))
    above = cos_i > 1e-3
    cos_i = np.where(above, cos_i, 1)
    brdf = ggx(cos_h, a) / (1 + smith_lambda(cos_o, a) + smith_lambda(cos_i, a)) / (4 * cos_o)  # f cos_i / F
    density = core.reflection_pdf(wo, wi, alpha)
    claimed = core.reflection_weight(wo[..., 2], wi[..., 2], alpha) * density
    # Rounding of cos_h moves the reference's D by 2^-23 / alpha^2 at the most: 5e-5.
    np.testing.assert_allclose(np.where(above, claimed, brdf), brdf, rtol=5e-4)
    through_normal = core.visible_normal_pdf(wo, h, alpha) / (4 * core.dot(wo, h))
    np.testing.assert_allclose(density, through_normal, rtol=5e-4)


@pytest.mark.parametrize("alpha", ALPHAS)
def test_microfacets_cover_the_surface(alpha):
    h, solid_angle = microfacet_grid(alpha, 400)
    # projected area of all microfacets: 1
    assert np.sum(ggx(h[..., 2], np.array(alpha)) * h[..., 2] * solid_angle) == pytest.approx(1, abs=2e-3)
    density = core.visible_normal_pdf(
        like([0, 0, 1.0], *h.shape[:2]), jnp.asarray(h, jnp.float32), like(alpha, *h.shape[:2])
    )
    # seen from straight above: D cos(theta)
    np.testing.assert_allclose(density, ggx(h[..., 2], np.array(alpha)) * h[..., 2], rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("cos", COSINES)
def test_masking_keeps_the_visible_area(alpha, cos):
    """The integral in the docstring of `smith_g1`: the visible microfacets together look as large as the surface."""
    h, solid_angle = microfacet_grid(alpha, 400)
    facing = np.maximum(0, h @ direction(cos)) * ggx(h[..., 2], np.array(alpha)) * solid_angle
    assert float(core.smith_g1(jnp.asarray(cos), jnp.asarray(alpha))) * facing.sum() == pytest.approx(cos, rel=3e-3)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("cos", COSINES)
def test_densities_integrate_to_one(alpha, cos):
    h, solid_angle = microfacet_grid(alpha, 400)
    batch = h.shape[:2]
    wo, normals = like(direction(cos), *batch), jnp.asarray(h, jnp.float32)
    density = np.asarray(core.visible_normal_pdf(wo, normals, like(alpha, *batch)), np.float64)
    assert (density * solid_angle).sum() == pytest.approx(1, abs=3e-3)
    # the weak white furnace: reflections about all visible normals, with d wi = 4 (wo . h) dh
    cos_d = h @ direction(cos)
    reflected = core.reflection_pdf(wo, core.reflect(wo, normals), like(alpha, *batch))
    assert (np.asarray(reflected, np.float64) * 4 * cos_d * solid_angle)[cos_d > 0].sum() == pytest.approx(1, abs=3e-3)


def test_reflected_directions_integrate_to_one_on_a_plain_grid():
    count = 300
    z = 2 * (np.arange(count) + 0.5) / count - 1
    azimuth = np.pi * (np.arange(2 * count) + 0.5) / count
    sin = np.sqrt(1 - z * z)
    wi = np.stack([np.outer(sin, np.cos(azimuth)), np.outer(sin, np.sin(azimuth)), np.outer(z, np.ones(2 * count))], -1)
    density = core.reflection_pdf(
        like(direction(0.5), *wi.shape[:2]), jnp.asarray(wi, jnp.float32), like(0.5, *wi.shape[:2])
    )
    assert np.mean(np.asarray(density, np.float64)) * 4 * np.pi == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("cos", COSINES)
def test_samples_follow_the_density(alpha, cos, key):
    """Chi-square over 10 x 12 cells that follow the lobe; a false alarm has a probability of 1e-4 (fixed seed)."""
    samples, rings, sectors, fine = 20_000, 10, 12, 12
    h = core.sample_visible_normal(
        like(direction(cos), samples), like(alpha, samples), jax.random.uniform(key, (samples, 2))
    )
    x, y, z = (np.asarray(h, np.float64)[:, i] for i in range(3))
    tan2 = (x * x + y * y) / (z * z)
    s = alpha / np.sqrt(alpha**2 + tan2)
    sector = np.floor((np.arctan2(y, x) / (2 * np.pi) % 1) * sectors).astype(int) % sectors
    counts = np.zeros((rings, sectors))
    np.add.at(counts, (np.minimum((s * rings).astype(int), rings - 1), sector), 1)

    grid, solid_angle = microfacet_grid(alpha, rings * fine)  # [120 240]: 12 x 20 midpoints per cell
    density = core.visible_normal_pdf(
        like(direction(cos), *grid.shape[:2]), jnp.asarray(grid, jnp.float32), like(alpha, *grid.shape[:2])
    )
    mass = np.asarray(density, np.float64) * solid_angle
    mass = mass.reshape(rings, grid.shape[0] // rings, sectors, grid.shape[1] // sectors).sum((1, 3))
    expected = samples * mass / mass.sum()
    rare = expected < 8
    observed = np.append(counts[~rare], counts[rare].sum())
    expected = np.append(expected[~rare], expected[rare].sum())
    keep = expected > 0
    statistic = ((observed - expected)[keep] ** 2 / expected[keep]).sum()
    assert statistic < chi2.isf(1e-4, keep.sum() - 1)
    assert observed[~keep].sum() == 0


def test_the_chi_square_notices_a_wrong_density(key):
    """A lobe of 10 % more width must fail the test above, or it shows nothing."""
    samples = 20_000
    u = jax.random.uniform(key, (samples, 2))
    h = np.asarray(core.sample_visible_normal(like(direction(0.4), samples), like(0.44, samples), u), np.float64)
    s = 0.4 / np.sqrt(0.4**2 + (1 - h[:, 2] ** 2) / h[:, 2] ** 2)
    counts = np.histogram(s, 10, (0, 1))[0]
    h, solid_angle = microfacet_grid(0.4, 200)
    wo = like(direction(0.4), *h.shape[:2])
    density = np.asarray(core.visible_normal_pdf(wo, jnp.asarray(h, jnp.float32), like(0.4, *h.shape[:2])), np.float64)
    expected = samples * (density * solid_angle).reshape(10, -1).sum(1)
    assert ((counts - expected) ** 2 / expected).sum() > chi2.isf(1e-4, 9)


@given(shapes().flatmap(lambda s: st.tuples(unit_vectors(s), floats(0.0, 1.0, s), floats(0.0, 1.0, (*s, 2)))))
def test_sampled_normals_are_unit_above_and_visible(case):
    wo, alpha, u = case
    wo = jnp.stack([wo[..., 0], wo[..., 1], jnp.abs(wo[..., 2])], -1)
    h = core.sample_visible_normal(wo, alpha, u)
    np.testing.assert_allclose(core.safe.norm(h), 1, atol=1e-6)
    assert (h[..., 2] >= 0).all()
    assert (core.dot(wo, h) >= -1e-6).all()


@given(shapes().flatmap(lambda s: st.tuples(unit_vectors(s), floats(0.0, 1.0, (*s, 2)))))
def test_alpha_zero_is_a_perfect_mirror(case):
    wo, u = case
    wo = jnp.stack([wo[..., 0], wo[..., 1], jnp.abs(wo[..., 2])], -1)
    zero, up = jnp.zeros(wo.shape[:-1]), jnp.zeros_like(wo).at[..., 2].set(1)
    assert (core.sample_visible_normal(wo, zero, u) == up).all()
    assert (core.smith_g1(wo[..., 2], zero) == 1).all()
    assert (core.reflection_weight(wo[..., 2], wo[..., 2], zero) == 1).all()
    assert (core.visible_normal_pdf(wo, up, zero) == 0).all()
    assert (core.reflection_pdf(wo, core.reflect(wo, up), zero) == 0).all()


def test_below_the_surface_nothing_is_seen():
    below, half = jnp.asarray(-0.2), jnp.asarray(0.5)
    assert core.smith_g1(below, half) == 0
    assert core.smith_g2(half, below, half) == 0
    assert core.reflection_weight(half, below, half) == 0
    assert core.ggx_distribution(below, half) == 0


@pytest.mark.parametrize("alpha", [0.02, 0.3, 0.9])
@pytest.mark.parametrize("cos", [0.3, 0.99])
def test_gradients_against_differences_of_the_reference(alpha, cos):
    step = 1e-6
    functions = {
        core.ggx_distribution: ggx,
        core.smith_g1: lambda c, a: 1 / (1 + smith_lambda(c, a)),
        lambda c, a: core.smith_g2(c, jnp.asarray(0.4), a): lambda c, a: (
            1 / (1 + smith_lambda(c, a) + smith_lambda(np.array(0.4), a))
        ),
    }
    for function, reference in functions.items():
        actual = jax.grad(function, argnums=(0, 1))(jnp.asarray(cos), jnp.asarray(alpha))
        expected = [
            (reference(np.array(cos + a), alpha + b) - reference(np.array(cos - a), alpha - b)) / (2 * step)
            for a, b in step * np.eye(2)
        ]
        np.testing.assert_allclose(actual, expected, rtol=1e-3, atol=1e-6)
