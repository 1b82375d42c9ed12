"""The blend against its formula, and the furnace: a constant world gives a constant image."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shapes import ball, floor

from jaxrefl._types import Frame, Reflection
from jaxrefl.composite import Options, blend, tone_map
from jaxrefl.core import look_at
from jaxrefl.radiance import DirectOptions, direct_light
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, constant_sky, emitter, glass, glossy, mirror
from jaxrefl.surface import look, specular_weight, transmission_weight
from jaxrefl.techniques import envmap, raytrace

ENERGY = 5e-3
"""What the furnace may lose or gain: half a percent."""


def one_ball(alpha: float, metallic: float):
    """One white ball in a world of radiance 1."""
    white = glossy("m", (1, 1, 1), alpha=alpha, metallic=metallic)
    return assemble(Description("furnace", [ball("ball", white, subdivisions=5)], sky=constant_sky((1.0, 1.0, 1.0))))


def assert_constant(image) -> None:
    """All but the few pixels at the outline where shading normals look past the facets they lie on."""
    error = np.abs(np.asarray(image) - 1)
    assert error.mean() < ENERGY and (error < ENERGY).mean() > 0.998, (error.mean(), error.max())


def render(scene, technique, *, options, size=(48, 48), composite=None, light=None):
    camera = look_at((0, 0, 4), (0, 0, 0), fov_y=32, size=size)
    tracer = EmbreeTracer(scene.mesh)
    gbuffer = look(scene, tracer, camera)
    diffuse = direct_light(scene, tracer, gbuffer, jax.random.key(0), options=light or DirectOptions())
    frame = Frame(scene, camera, gbuffer, jax.random.key(1), tracer)
    state = technique.init(scene, tracer, options=options)
    _, reflection, info = technique.step(state, frame, technique.Params(), options=options)
    return gbuffer, diffuse, reflection, blend(gbuffer, diffuse, reflection, options=composite or Options()), info


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("alpha", [0.0, 0.1, 0.5, 1.0])
def test_a_white_ball_vanishes_in_a_white_world(alpha: float, metallic: float):
    *_, image, _ = render(one_ball(alpha, metallic), raytrace, options=raytrace.Options(samples=4))
    assert_constant(image)


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0])
def test_an_environment_map_keeps_the_energy_too(alpha: float):
    options = envmap.Options(height=32, rough_height=16)
    *_, image, _ = render(one_ball(alpha, 1.0), envmap, options=options)
    assert_constant(image)


def test_single_scattering_darkens_rough_metal():
    """The documented exception: without compensation a white metal at alpha 1 loses light, as in other renderers."""
    options = Options(multiple_scattering=False)
    gbuffer, *_, image, _ = render(one_ball(1.0, 1.0), raytrace, options=raytrace.Options(), composite=options)
    centre = image[24, 24, 0]
    assert 0.3 < float(centre) < 0.75
    assert bool((image <= 1 + ENERGY).all())


@pytest.fixture(scope="module")
def layers():
    """A small frame with everything in it: emission, diffuse, mirror, gloss, glass, background."""
    parts = [
        floor("floor", glossy("varnish", (0.8, 0.5, 0.3), alpha=0.1)),
        ball("glass", glass("glass", eta=1.5), centre=(-1.2, 1, 0)),
        ball("mirror", mirror("mirror"), centre=(1.2, 1, 0)),
        floor("lamp", emitter("lamp", (4.0, 3.0, 2.0)), size=0.7, height=1.9),
    ]
    scene = assemble(Description("everything", parts, sky=constant_sky((0.5, 0.6, 0.7))))
    camera = look_at((0, 2.5, 6), (0, 1, 0), size=(32, 20))
    tracer = EmbreeTracer(scene.mesh)
    gbuffer = look(scene, tracer, camera)
    diffuse = direct_light(scene, tracer, gbuffer, jax.random.key(0), options=DirectOptions())
    frame = Frame(scene, camera, gbuffer, jax.random.key(1), tracer)
    _, reflection, _ = raytrace.step(raytrace.State(), frame, raytrace.Params())
    return gbuffer, diffuse, reflection


def test_the_blend_is_its_formula(layers):
    gbuffer, diffuse, reflection = layers
    image = np.asarray(blend(gbuffer, diffuse, reflection), np.float64)
    e = np.asarray(specular_weight(gbuffer), np.float64)
    t = np.asarray(transmission_weight(gbuffer, specular_weight(gbuffer)), np.float64)
    emission = 0 if gbuffer.emission is None else np.asarray(gbuffer.emission, np.float64)
    expected = emission + (1 - e) * (np.asarray(diffuse, np.float64) - emission)
    expected += np.where(np.asarray(reflection.valid)[..., None], e * np.asarray(reflection.radiance), 0)
    assert reflection.transmitted is not None and t.max() > 0.3
    # Every term has pixels in which leaving it out, or its weight, would show.
    weighed = (e * np.asarray(diffuse)).max(-1)
    assert weighed.max() > 0.02 and np.max(emission) > 1 and not np.asarray(gbuffer.valid).all()
    expected += t * np.asarray(reflection.transmitted)
    expected = np.where(np.asarray(gbuffer.valid)[..., None], expected, np.asarray(diffuse))
    np.testing.assert_allclose(image, expected, rtol=1e-4, atol=1e-5)


def test_invalid_reflections_are_never_blended(layers):
    gbuffer, diffuse, reflection = layers
    poisoned = Reflection(
        radiance=jnp.full_like(reflection.radiance, 1e6),
        valid=jnp.zeros_like(reflection.valid),
        source=reflection.source,
        confidence=reflection.confidence,
        p=reflection.p,
        t=reflection.t,
        transmitted=reflection.transmitted,
    )
    assert float(blend(gbuffer, diffuse, poisoned).max()) < 1e4


def test_tone_mapping_clips_and_codes():
    image = jnp.array([[0.0, 0.0031308, 0.5], [1.0, 7.0, -1.0]])
    np.testing.assert_allclose(tone_map(image), [[0, 0.04045, 0.735357], [1, 1, 0]], atol=1e-4)
    np.testing.assert_allclose(tone_map(image, exposure=1.0)[0, 2], 1, atol=1e-6)


def test_an_unknown_fresnel_is_refused():
    with pytest.raises(ValueError, match="composite.fresnel"):
        Options(fresnel="cook")
