"""Direct light: background and emission, noise, blocks and counts, gradients, degenerate points, options."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lit_points import Clear, grid, half_shadow, points, sample, scene_of, square
from tolerances import assert_close

from jaxrefl import Scene
from jaxrefl.radiance import direct, light_samples
from jaxrefl.radiance.direct import DirectOptions, arriving_light, background, direct_light, outgoing_light
from jaxrefl.radiance.light_samples import FAR, Receivers, receivers_of, sample_lights
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import PunctualLight, Sky, constant_sky, emitter


def test_invalid_points_show_the_background(key: jax.Array):
    scene = scene_of(sky=constant_sky((1, 2, 3)), ambient=(0.1, 0.1, 0.1))
    gbuffer = eqx.tree_at(lambda g: g.valid, points(np.zeros((2, 2, 3))), jnp.zeros((2, 2), bool))
    tracer = Clear()
    seen = direct_light(scene, tracer, gbuffer, key)
    assert tracer.rays == 0
    np.testing.assert_allclose(seen, np.broadcast_to([1.1, 2.1, 3.1], (2, 2, 3)), rtol=1e-6)
    np.testing.assert_array_equal(background(scene.lights, -gbuffer.wo), seen)


def test_background_looks_away_from_the_viewer(key: jax.Array):
    image = np.zeros((2, 1, 3), np.float32)
    image[0] = 1  # the upper half of the world is bright
    gbuffer = points(np.zeros((2, 3)), [(0, 1, 0), (0, -1, 0)])
    gbuffer = eqx.tree_at(lambda g: g.valid, gbuffer, jnp.zeros(2, bool))
    seen = direct_light(scene_of(sky=Sky(image)), Clear(), gbuffer, key)
    np.testing.assert_array_equal(seen[:, 0], [0, 1])


def test_emission_and_ambient(key: jax.Array):
    """Neither needs a ray; metal and glass have no diffuse share of the ambient light."""
    scene = scene_of(ambient=(1.0, 2.0, 3.0))
    gbuffer = eqx.tree_at(
        lambda g: (g.metallic, g.transmission, g.emission),
        points(np.zeros((3, 3)), albedo=0.5),
        (jnp.asarray([0.0, 1, 0]), jnp.asarray([0.0, 0, 0.75]), jnp.full((3, 3), 7.0)),
        is_leaf=lambda x: x is None,
    )
    tracer = Clear()
    seen = direct_light(scene, tracer, gbuffer, key)
    assert tracer.rays == 0
    np.testing.assert_allclose(seen, 7 + np.outer([0.5, 0, 0.125], [1, 2, 3]), rtol=1e-6)


def test_the_key_is_the_noise(key: jax.Array):
    scene, _ = half_shadow(1.0)
    gbuffer = points(grid())
    first = np.asarray(direct_light(scene, Clear(), gbuffer, key))
    np.testing.assert_array_equal(direct_light(scene, Clear(), gbuffer, key), first)
    assert (np.asarray(direct_light(scene, Clear(), gbuffer, jax.random.key(1))) != first).any()


def test_blocks_and_batch_shape_change_nothing(key: jax.Array, monkeypatch: pytest.MonkeyPatch):
    scene = scene_of(lights=[PunctualLight("lamp", (1, 1, 1), (0.1, 1.0, 0.2))])
    p = grid(30).reshape(30, 30, 3)
    gbuffer = eqx.tree_at(lambda g: g.valid, points(p), jnp.asarray(p[..., 0] + p[..., 2] < 1))
    whole = np.asarray(direct_light(scene, Clear(), gbuffer, key))
    flat = jax.tree.map(lambda x: x.reshape(900, *x.shape[2:]), gbuffer)
    np.testing.assert_array_equal(direct_light(scene, Clear(), flat, key), whole.reshape(-1, 3))
    monkeypatch.setattr(direct, "_POINTS_PER_BLOCK", 256)
    np.testing.assert_array_equal(direct_light(scene, Clear(), gbuffer, key), whole)


def test_counts_and_values_compile_once(key: jax.Array):
    def compiled() -> tuple[int, ...]:
        stages = (direct._light_points, direct._shadow_rays, direct.arriving_light, direct.outgoing_light)
        return tuple(stage._cache_size() for stage in stages)

    options, counts = DirectOptions(punctual_samples=3), []
    for valid in (900, 5, 300):
        scene = scene_of(lights=[PunctualLight("lamp", (1, 1, valid), (0.1, 1.0, 0.2))])
        gbuffer = eqx.tree_at(lambda g: g.valid, points(grid(30) * valid), jnp.arange(900) < valid)
        direct_light(scene, Clear(), gbuffer, jax.random.key(valid), options=options)
        counts.append(compiled())
    assert counts[0] == counts[1] == counts[2]


def test_absent_lights_cost_nothing(key: jax.Array):
    receivers = receivers_of(points(grid()))
    assert sample_lights(scene_of(), receivers, key, options=DirectOptions()) is None

    def operations(scene: Scene) -> set[str]:
        jaxpr = eqx.filter_make_jaxpr(lambda s, r, k: sample_lights(s, r, k, options=DirectOptions()))
        text = str(jaxpr(scene, receivers, key)[0])
        return {word for word in ("atan2", "while", "scan", "gather") if f"= {word}[" in text}

    assert not operations(scene_of(lights=[PunctualLight("lamp", (1, 1, 1))]))
    assert not operations(scene_of(sky=constant_sky((1, 1, 1))))
    assert "gather" in operations(scene_of(square("lamp", emitter("lamp", (1, 1, 1)))))


def test_gradients_go_through_materials(key: jax.Array):
    """The light a surface reflects is linear in its albedo and in 1 - metallic; shadow rays do not stand in the way."""
    scene, gbuffer = half_shadow(1.0)
    tracer = EmbreeTracer(scene.mesh)

    def total(values: tuple[jax.Array, jax.Array]) -> jax.Array:
        g = eqx.tree_at(lambda g: (g.base_colour, g.metallic), gbuffer, values)
        return direct_light(scene, tracer, g, key).sum()

    by_albedo, by_metallic = jax.grad(total)((gbuffer.base_colour, gbuffer.metallic))
    seen = np.asarray(direct_light(scene, tracer, gbuffer, key))
    assert_close(by_albedo, seen / 0.5)
    assert_close(by_metallic, -seen.sum(-1), scale=3)


@pytest.mark.parametrize("parameter", ["position", "intensity"])
def test_gradients_go_through_lights(parameter: str, key: jax.Array):
    """The jitted halves compose under `grad`; against the derivative of I cos / d^2 at a point below the lamp."""
    scene = scene_of(lights=[PunctualLight("lamp", (1, 1, 1), (0.0, 2.0, 0.0))])
    receivers = receivers_of(points([[0.0, 0.0, 0.0]]))

    def red(value: jax.Array) -> jax.Array:
        moved = eqx.tree_at(lambda s: getattr(s.lights.punctual, parameter), scene, value)
        samples = sample_lights(moved, receivers, key, options=DirectOptions())
        return arriving_light(samples, jnp.zeros(samples.t_max.shape, bool))[0, 0]

    slope = eqx.filter_jit(jax.grad(red))(getattr(scene.lights.punctual, parameter))[0]
    expected = [0, -2 / 2**3, 0] if parameter == "position" else [1 / 4, 0, 0]
    np.testing.assert_allclose(slope, expected, atol=1e-6)


@eqx.filter_jit
@eqx.filter_value_and_grad
def total_and_slope(receivers: Receivers, scene: Scene, key: jax.Array) -> jax.Array:
    samples = sample_lights(scene, receivers, key, options=DirectOptions())
    assert samples is not None
    return samples.irradiance.sum() + jnp.minimum(samples.t_max, 1).sum()


def test_degenerate_points_stay_finite(key: jax.Array):
    """A point at a lamp, on an area light, in its plane, facing away, and one without a normal."""
    lamp = square("lamp", emitter("lamp", (1, 1, 1)))
    point = PunctualLight("lamp", (1, 1, 1), (0.0, 0.0, 0.0), cos_inner=0.9, cos_outer=0.9)
    scene = scene_of(lamp, lights=[point], sky=Sky(np.ones((2, 4, 3), np.float32)))
    p = np.array([(0, 0, 0), (0.3, 0, 0.3), (3, 0, 0), (0, 1, 0), (0, 1, 0)], np.float64)
    n = np.array([(0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 0, 0)])
    value, slope = total_and_slope(receivers_of(points(p, n)), scene, key)
    assert np.isfinite(value)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(slope))


def test_outgoing_light_is_zero_where_nothing_is_seen():
    gbuffer = eqx.tree_at(lambda g: g.valid, points(np.zeros((2, 3))), jnp.asarray([True, False]))
    seen = outgoing_light(scene_of(ambient=(1, 1, 1)).lights, gbuffer, jnp.full((2, 3), jnp.pi))
    np.testing.assert_allclose(seen, [[2, 2, 2], [0, 0, 0]], rtol=1e-6)


def test_shadow_rays_end_at_their_light(key: jax.Array):
    sun = PunctualLight("sun", (1, 1, 1), directional=True)
    lamp = PunctualLight("lamp", (1, 1, 1), (0.0, 3.0, 0.0))
    scene, receivers = scene_of(lights=[sun, lamp]), receivers_of(points([[0, 0, 0]]))
    samples = sample(scene, receivers, key, options=DirectOptions())
    assert samples is not None
    np.testing.assert_allclose(samples.t_max[:, 0], [FAR, 3], rtol=2e-5)  # less the rounding errors of both ends
    np.testing.assert_allclose(samples.rays.direction[:, 0], [(0, 1, 0), (0, 1, 0)], atol=1e-7)


@pytest.mark.parametrize("options", [{"area_samples": 0}, {"environment_samples": -1}, {"punctual_samples": 1000}])
def test_bad_options_are_named(options: dict):
    with pytest.raises(ValueError, match=f"{next(iter(options))}.*whole number from 1"):
        DirectOptions(**options)


def test_every_option_has_a_range_and_a_sentence():
    for field in dataclasses.fields(DirectOptions):
        assert field.metadata["low"] <= field.default <= field.metadata["high"]
        assert field.metadata["help"].endswith(".")
    assert light_samples.DirectOptions is direct.DirectOptions
