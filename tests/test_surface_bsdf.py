"""Scattering functions: samples, values and densities agree; energy is kept; extremes stay finite."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrefl._types import Conductors, GBuffer
from jaxrefl.core import dot
from jaxrefl.core.safe import normalise
from jaxrefl.surface import lobe_albedo, specular_weight
from jaxrefl.surface.bsdf import DIFFUSE, REFLECTED, REFRACTED, Scattering, draw_directions, lobes_of, respond, scatter
from jaxrefl.surface.coupling import coupling, interface_albedo, mean_interface_albedo

COUNT = 2**16
MODELS = {"ours": Scattering(), "Mitsuba's": Scattering(masking="separable", multiple_scattering=False)}
SURFACES = {
    "matte": {"eta": 1.0, "alpha": 1.0},
    "glossy": {"eta": 1.5, "alpha": 0.3},
    "metal": {"metallic": 1.0, "alpha": 0.4},
    "copper": {"metallic": 1.0, "alpha": 0.2, "conductor": ((0.2, 0.92, 1.1), (3.9, 2.45, 2.14))},
    "half metal": {"metallic": 0.5, "alpha": 0.5, "eta": 1.5},
    "plastic": {"eta": 1.5, "alpha": 0.15, "coupled": True},
}


def surface(
    n: int = COUNT, *, cos: float = 0.7, conductor=None, coupled: bool | None = None, transmission=None, **values
) -> GBuffer:
    """The same point n times, seen under an angle."""
    given = {"base_colour": (0.8, 0.5, 0.2), "metallic": 0.0, "alpha": 0.3, "eta": 1.5, "outside": True} | values
    flat = lambda x, dtype=jnp.float32: jnp.broadcast_to(jnp.asarray(x, dtype), (n, *np.shape(x)))  # noqa: E731
    up, zero = flat((0, 0, 1)), flat(0)
    index = flat(0, jnp.int32)
    return GBuffer(
        valid=flat(True, bool),
        p=flat((0, 0, 0)),
        p_error=zero,
        n=up,
        ns=up,
        wo=flat((np.sqrt(1 - cos * cos), 0, cos)),
        t=zero + 1,
        z_camera=None,
        base_colour=flat(given["base_colour"]),
        metallic=flat(given["metallic"]),
        alpha=flat(given["alpha"]),
        eta=flat(given["eta"]),
        outside=flat(given["outside"], bool),
        object=index,
        material=index,
        triangle=index,
        transmission=None if transmission is None else flat(transmission),
        conductor=None if conductor is None else Conductors(flat(True, bool), flat(conductor[0]), flat(conductor[1])),
        coupled=None if coupled is None else flat(coupled, bool),
    )


def sampled(points: GBuffer, model: Scattering, thin=None):
    lobes = lobes_of(points, lobe_albedo(points), model)
    u, choice = (jax.random.uniform(jax.random.key(k), (points.t.shape[0], 2)) for k in (1, 2))
    if points.transmission is not None and thin is None:
        thin = jnp.zeros_like(points.valid)
    return lobes, scatter(points, lobes, draw_directions(points, lobes, u), thin, choice, model)


def sphere(n: int) -> jnp.ndarray:
    v = np.random.default_rng(5).normal(size=(n, 3))
    return jnp.asarray(v / np.linalg.norm(v, axis=1, keepdims=True), jnp.float32)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", SURFACES)
def test_samples_estimate_the_integral_of_the_value(name: str, model: str):
    """Per lobe: the mean weight of samples equals the integral of the response over the sphere."""
    points = surface(**SURFACES[name])
    lobes, found = sampled(points, MODELS[model])
    wi = sphere(COUNT)
    response = respond(points, lobes, wi, MODELS[model])
    for lobe, value, factor in (
        (DIFFUSE, response.diffuse, 1 - lobes.specular),
        (REFLECTED, response.reflected, response.fresnel),
    ):
        integral = np.asarray(4 * np.pi * (value * factor).mean(0))
        mine = np.asarray(found.lobe == lobe)[:, None]
        estimate = np.asarray(jnp.where(mine, found.weight * found.fresnel, 0).mean(0))
        np.testing.assert_allclose(estimate, integral, rtol=0.05, atol=0.004)  # 65,536 samples: three standard errors


@pytest.mark.parametrize("name", SURFACES)
def test_densities_integrate_to_the_chance_of_their_lobe(name: str):
    points = surface(**SURFACES[name])
    model = Scattering()
    lobes, found = sampled(points, model)
    response = respond(points, lobes, sphere(COUNT), model)
    chance = float(lobes.p_diffuse[0])
    np.testing.assert_allclose(4 * np.pi * float(response.diffuse_density.mean()), chance, rtol=0.02, atol=1e-6)
    # Samples below the surface are bent to graze it and marked by the density 0.
    below = float(((found.lobe == REFLECTED) & (found.density == 0)).mean())
    reflected = 4 * np.pi * float(response.reflected_density.mean())
    np.testing.assert_allclose(reflected + below, 1 - chance, rtol=0.05, atol=0.01)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", SURFACES)
def test_the_density_of_a_sample_is_that_of_its_direction(name: str, model: str):
    points = surface(4096, **SURFACES[name])
    lobes, found = sampled(points, MODELS[model])
    response = respond(points, lobes, found.wi, MODELS[model])
    same = jnp.where(found.lobe == DIFFUSE, response.diffuse_density, response.reflected_density)
    use = np.asarray((found.density > 0) & (dot(found.wi, points.n) > 1e-3) & (found.weight[:, 0] > 0))
    assert use.sum() > 2000
    # The half vector is found from rounded directions: at worst 0.4 % where the lobe is narrowest (alpha 0.15).
    np.testing.assert_allclose(np.asarray(found.density)[use], np.asarray(same)[use], rtol=0.005)


@pytest.mark.parametrize("alpha", [0.0, 0.01, 0.1, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("cos", [0.05, 0.4, 1.0])
def test_white_surfaces_return_all_light(alpha: float, metallic: float, cos: float):
    """A white furnace, one point: the mean weight is 1."""
    points = surface(cos=cos, alpha=alpha, metallic=metallic, base_colour=(1, 1, 1))
    _, found = sampled(points, Scattering())
    mean = float((found.weight * found.fresnel).mean())
    assert abs(mean - 1) < 0.02  # exact Fresnel per sample against its average over the lobe: 0.013 at worst


@pytest.mark.parametrize("alpha", [0.0, 0.2, 0.7])
@pytest.mark.parametrize("cos", [0.2, 0.6, 1.0])
def test_glass_reflects_or_refracts_all_light(alpha: float, cos: float):
    points = surface(cos=cos, alpha=alpha, transmission=1.0, base_colour=(1, 1, 1))
    _, found = sampled(points, Scattering())
    weight = np.asarray(found.weight * found.fresnel)[:, 0] * np.asarray(found.eta_scale)
    assert abs(weight.mean() - 1) < 0.025
    assert set(np.unique(found.lobe)) == {REFLECTED, REFRACTED}
    through = np.asarray(found.lobe) == REFRACTED
    assert (np.asarray(found.wi)[through, 2] < 0).all() and (np.asarray(found.wi)[~through, 2] > 0).all()


def test_refraction_compresses_radiance_and_gives_it_back():
    into = sampled(surface(transmission=1.0), Scattering())[1]
    out = sampled(surface(transmission=1.0, outside=False), Scattering())[1]
    np.testing.assert_allclose(float(into.eta_scale.max()), 2.25, rtol=1e-5)
    np.testing.assert_allclose(float(out.eta_scale.min()), 1 / 2.25, rtol=1e-5)


def test_the_lobe_agrees_with_the_composite():
    """The integral of the specular lobe over a white world is `specular_weight`, up to the average of F."""
    for name, values in SURFACES.items():
        points = surface(**values)
        _, found = sampled(points, Scattering())
        mine = jnp.where((found.lobe == REFLECTED)[:, None], found.weight * found.fresnel, 0).mean(0)
        np.testing.assert_allclose(np.asarray(mine), np.asarray(specular_weight(points)[0]), atol=0.015, err_msg=name)


def test_coupled_diffuse_light_is_reciprocal():
    """f(a, b) = f(b, a): swap viewer and light."""
    cosines = (0.9, 0.3)
    values = []
    for cos_o, cos_i in (cosines, cosines[::-1]):
        points = surface(1, cos=cos_o, alpha=0.2, coupled=True)
        lobes = lobes_of(points, lobe_albedo(points), Scattering())
        wi = jnp.asarray([[-np.sqrt(1 - cos_i**2), 0, cos_i]], jnp.float32)
        diffuse = respond(points, lobes, wi, Scattering()).diffuse * (1 - lobes.specular) / cos_i
        values.append(np.asarray(diffuse))
    np.testing.assert_allclose(values[0], values[1], rtol=1e-3)


@pytest.mark.parametrize("alpha", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("eta", [1.2, 1.5, 2.5])
def test_the_coupling_is_one_on_average(alpha: float, eta: float):
    points = surface(4000, alpha=alpha, eta=eta, coupled=True)
    mu = jnp.sqrt((jnp.arange(4000, dtype=jnp.float32) + 0.5) / 4000)  # cosine-weighted
    assert abs(float(coupling(points, mu).mean()) - 1) < 2e-3
    mean = mean_interface_albedo(points.alpha[:1], points.eta[:1])
    direct = interface_albedo(mu, points.alpha, points.eta).mean()
    assert abs(float(mean[0] - direct)) < 1e-3


def test_single_scattering_loses_light_that_multiple_scattering_keeps():
    for alpha in (0.1, 0.5, 0.9):
        points = surface(alpha=alpha, base_colour=(1, 1, 1), coupled=True)
        kept, lost = (float((s.weight * s.fresnel).mean()) for s in (sampled(points, m)[1] for m in MODELS.values()))
        assert abs(kept - 1) < 0.02 and lost < kept - 0.005


def test_directions_below_the_surface_bring_nothing():
    points = surface(256)
    lobes = lobes_of(points, lobe_albedo(points), Scattering())
    down = jnp.broadcast_to(jnp.asarray([0.3, 0.1, -0.95], jnp.float32), (256, 3))
    response = respond(points, lobes, normalise(down), Scattering())
    assert float(response.diffuse.max()) == 0 and float(response.reflected.max()) == 0


@pytest.mark.parametrize("alpha", [0.0, 1e-8, 1.0])
@pytest.mark.parametrize("cos", [0.0, 1e-7, 1.0])
@pytest.mark.parametrize("transmission", [None, 1.0])
def test_values_and_gradients_stay_finite_at_the_extremes(alpha: float, cos: float, transmission):
    points = surface(64, cos=cos, alpha=alpha, transmission=transmission)

    def total(alpha: jax.Array, colour: jax.Array) -> jax.Array:
        changed = dataclasses.replace(points, alpha=alpha, base_colour=colour)
        lobes, found = sampled(changed, Scattering())
        response = respond(changed, lobes, sphere(64), Scattering())
        parts = (found.weight, found.fresnel, found.wi, response.diffuse, response.reflected)
        return sum((x.sum() for x in parts), jnp.zeros(()))

    value, gradient = jax.value_and_grad(total, (0, 1))(points.alpha, points.base_colour)
    assert np.isfinite(value) and all(np.isfinite(g).all() for g in gradient)


def test_bad_masking_is_named():
    with pytest.raises(ValueError, match="masking: expected 'correlated' or 'separable', got 'none'"):
        Scattering(masking="none")
