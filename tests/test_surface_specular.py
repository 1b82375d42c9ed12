"""Specular weights and lobe sampling: energy, limits, and the extremes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from strategies import floats, unit_vectors

from jaxrefl._types import GBuffer
from jaxrefl.core import dot, fresnel_dielectric
from jaxrefl.surface import (
    keep_above,
    mirror_direction,
    reflective,
    sample_reflection,
    sample_refraction,
    specular_colour,
    specular_weight,
    transmission_weight,
)

N = 64


def surface(*, alpha, metallic=0.0, eta=1.5, colour=1.0, cosine=None, transmission=0.0, outside=True) -> GBuffer:
    """Points with normal +Z seen under the given cosines."""
    cosine = jnp.linspace(0.02, 1, N) if cosine is None else jnp.broadcast_to(jnp.asarray(cosine, jnp.float32), (N,))
    full = lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float32), (N,))  # noqa: E731
    up = jnp.broadcast_to(jnp.array([0.0, 0, 1]), (N, 3))
    zero, index = jnp.zeros(N), jnp.zeros(N, jnp.int32)
    return GBuffer(
        valid=jnp.ones(N, bool),
        p=jnp.zeros((N, 3)),
        p_error=zero,
        n=up,
        ns=up,
        wo=jnp.stack([jnp.sqrt(jnp.maximum(1 - cosine**2, 0)), zero, cosine], -1),
        t=zero + 1,
        z_camera=None,
        base_colour=jnp.full((N, 3), colour, jnp.float32),
        metallic=full(metallic),
        alpha=full(alpha),
        eta=full(eta),
        outside=jnp.full(N, outside),
        object=index,
        material=index,
        triangle=index,
        transmission=full(transmission),
    )


@pytest.mark.parametrize("alpha", [0.0, 1e-4, 0.05, 0.3, 0.7, 1.0])
def test_a_white_metal_loses_nothing(alpha: float):
    """With multiple scattering the directional albedo of F0 = 1 is 1 at every angle and roughness."""
    weight = specular_weight(surface(alpha=alpha, metallic=1.0))
    np.testing.assert_allclose(weight, 1, atol=5e-3)


@pytest.mark.parametrize("alpha", [0.05, 0.5, 1.0])
def test_single_scattering_loses_what_the_microfacets_mask(alpha: float):
    """Without compensation the weight is the mean of G2 / G1 over visible normals, here by quadrature with samples."""
    points = surface(alpha=alpha, metallic=1.0)
    u = jax.random.uniform(jax.random.key(3), (4096, N, 2))
    _, ratio = jax.vmap(lambda u: sample_reflection(points, u))(u)
    weight = specular_weight(points, multiple_scattering=False)
    np.testing.assert_allclose(weight[:, 0], ratio.mean(0), atol=1.5e-2)  # noise of 4096 samples: measured 8e-3


def test_a_smooth_dielectric_is_fresnel_exactly():
    points = surface(alpha=0.0, eta=1.7)
    expected = fresnel_dielectric(points.wo[:, 2], jnp.full(N, 1.7))
    np.testing.assert_allclose(specular_weight(points)[:, 1], expected, atol=1e-4)


def test_beyond_the_critical_angle_all_is_reflected():
    weight = specular_weight(surface(alpha=0.0, eta=1.5, cosine=0.5, outside=False))
    np.testing.assert_allclose(weight, 1, atol=1e-5)


@given(floats(0, 1, (N,)), floats(0, 1, (N,)), floats(1, 3, (N,)), floats(0, 1), floats(0, 1, (N,)))
def test_weights_are_shares(alpha, metallic, eta, colour, transmission):
    points = surface(alpha=alpha, metallic=metallic, eta=eta, colour=float(colour), transmission=transmission)
    for fresnel in ("exact", "schlick"):
        specular = specular_weight(points, fresnel=fresnel)
        through = transmission_weight(points, specular)
        assert bool(((specular >= 0) & (specular <= 1)).all())
        assert bool(((through >= 0) & (specular + through <= 1 + 1e-6)).all())


@given(floats(0, 1, (N,)), floats(0, 1, (N, 2)), floats(0, 1, (N,)))
def test_sampled_directions_leave_the_surface(alpha, u, cosine):
    points = surface(alpha=alpha, cosine=cosine)
    wi, weight = sample_reflection(points, u)
    np.testing.assert_allclose(jnp.linalg.norm(wi, axis=-1), 1, atol=1e-4)
    assert bool((jnp.where(weight > 0, wi[:, 2], 1) > 0).all())
    assert bool(((weight >= 0) & (weight <= 1 + 1e-5)).all())


@given(floats(1.0, 2.5, (N,)), floats(0, 1, (N,)), floats(0, 1, (N, 2)))
def test_refracted_directions_cross_the_surface(eta, alpha, u):
    points = surface(alpha=alpha * 0.3, eta=eta, transmission=1.0)
    wi = sample_refraction(points, jnp.zeros(N, bool), u)
    np.testing.assert_allclose(jnp.linalg.norm(wi, axis=-1), 1, atol=1e-4)
    assert bool((wi[:, 2] < 0).all())
    thin = sample_refraction(points, jnp.ones(N, bool), u)
    np.testing.assert_allclose(thin, -points.wo)


def test_index_one_lets_rays_straight_through():
    points = surface(alpha=0.0, eta=1.0, transmission=1.0)
    wi = sample_refraction(points, jnp.zeros(N, bool), jnp.full((N, 2), 0.5))
    np.testing.assert_allclose(wi, -points.wo, atol=2e-3)  # kept a grazing sine of 1e-3 off the surface


def test_mirrors_mirror():
    points = surface(alpha=0.0, metallic=1.0)
    wi = mirror_direction(points)
    np.testing.assert_allclose(wi * jnp.array([[-1.0, -1, 1]]), points.wo, atol=2e-3)
    sampled, weight = sample_reflection(points, jnp.full((N, 2), 0.3))
    np.testing.assert_array_equal(sampled, wi)
    assert bool((weight == 1).all())


@given(unit_vectors((5,)), unit_vectors((5,)))
def test_bent_directions_stay_above(wi, n):
    bent = keep_above(wi, n)
    assert bool((dot(bent, n) > 5e-4).all())
    above = dot(wi, n) > 2e-3
    np.testing.assert_allclose(jnp.where(above[:, None], bent - wi, 0), 0, atol=1e-6)


def test_matte_and_mirror_are_told_apart():
    assert not bool(reflective(surface(alpha=1.0, eta=1.0)).any())
    assert bool(reflective(surface(alpha=1.0, eta=1.5)).all())
    assert bool(reflective(surface(alpha=0.0, eta=1.0, metallic=1.0)).all())
    assert float(specular_weight(surface(alpha=1.0, eta=1.0)).max()) == 0
    np.testing.assert_allclose(specular_colour(surface(alpha=0.2, eta=1.5)), 0.04, rtol=1e-5)


def test_an_unknown_fresnel_is_refused():
    with pytest.raises(ValueError, match="fresnel: expected 'exact' or 'schlick', got 'magic'"):
        specular_weight(surface(alpha=0.1), fresnel="magic")


@pytest.mark.parametrize("alpha", [0.0, 1e-6, 0.5, 1.0])
@pytest.mark.parametrize("cosine", [0.0, 1e-6, 1.0])
@pytest.mark.parametrize("eta", [1.0, 1.5])
def test_gradients_are_finite_at_the_extremes(alpha: float, cosine: float, eta: float):
    def total(alpha, eta, colour):
        points = surface(alpha=alpha, eta=eta, colour=0.5, cosine=cosine)
        points = jax.tree.map(lambda x: x, points)
        object.__setattr__(points, "base_colour", colour)
        wi, weight = sample_reflection(points, jnp.full((N, 2), 0.4))
        return specular_weight(points).sum() + wi.sum() + weight.sum()

    gradients = jax.grad(total, (0, 1, 2))(jnp.float32(alpha), jnp.float32(eta), jnp.full((N, 3), 0.5))
    assert all(bool(jnp.isfinite(g).all()) for g in gradients), gradients
