"""The choice of light model: each means the same everywhere, and path tracing agrees with itself."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shapes import ball, floor

from jaxrefl._types import Frame
from jaxrefl.core import look_at, pixel_sequences
from jaxrefl.radiance import (
    IncomingOptions,
    LightMapOptions,
    LightOptions,
    PathOptions,
    bake,
    diffuse_light,
    direct_light,
    incoming,
    path_light,
)
from jaxrefl.rays import EmbreeTracer, camera_rays
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, constant_sky, emitter, glossy, matte, mirror
from jaxrefl.surface import look
from jaxrefl.techniques import envmap, raytrace

SIZE = (24, 16)


@pytest.fixture(scope="module")
def stage():
    """A glossy ball and a mirror on a grey floor under a white sky, with a lamp."""
    parts = [
        floor("floor", matte("grey", (0.5, 0.5, 0.5)), size=3.0),
        ball("shiny", glossy("shiny", (0.8, 0.3, 0.2), alpha=0.3), centre=(-0.6, 0.5, 0), radius=0.5, subdivisions=2),
        ball("mirror", mirror("mirror"), centre=(0.6, 0.5, 0), radius=0.5, subdivisions=2),
        floor("lamp", emitter("lamp", (3.0, 3.0, 3.0)), size=0.5, height=3.0),
    ]
    scene = assemble(Description("stage", parts, sky=constant_sky((0.5, 0.5, 0.5))))
    tracer = EmbreeTracer(scene.mesh)
    scene = dataclasses.replace(
        scene, lightmap=bake(scene, tracer, options=LightMapOptions(texels=4096, samples=32, bounces=8))
    )
    camera = look_at((0, 1.5, 3), (0, 0.4, 0), size=SIZE)
    return Frame(scene, camera, look(scene, tracer, camera), jax.random.key(1), tracer)


@pytest.fixture(scope="module")
def truth(stage):
    """Layers of 1024 paths per pixel centre, and their standard errors."""
    rays, count = camera_rays(stage.camera), SIZE[0] * SIZE[1]
    sequence = pixel_sequences(jnp.uint32(5), jnp.arange(count, dtype=jnp.int32)).reshape(SIZE[::-1])
    found = []
    for block in range(8):
        number = jnp.arange(block * 128, (block + 1) * 128, dtype=jnp.uint32)
        shape = (128, *sequence.shape)
        many = jax.tree.map(lambda x: jnp.broadcast_to(x, (128, *x.shape)), rays)
        numbers = jnp.broadcast_to(number[:, None, None], shape)
        light = path_light(
            stage.scene, stage.tracer, many, jnp.broadcast_to(sequence, shape), numbers, options=PathOptions(bounces=8)
        )
        found.append(jax.tree.map(lambda x: np.asarray(x, np.float64).mean(0), light))
    return jax.tree.map(lambda *x: np.mean(x, 0), *found)


def test_direct_is_direct_light(stage):
    key = jax.random.key(3)
    options = LightOptions(area_samples=2, environment_samples=3)
    ours = diffuse_light(stage.scene, stage.tracer, stage.gbuffer, key, options=options)
    np.testing.assert_array_equal(
        ours, direct_light(stage.scene, stage.tracer, stage.gbuffer, key, options=options.direct)
    )


@pytest.mark.parametrize("model", ["baked", "path"])
def test_all_bounces_are_in_baked_and_path(stage, truth, model: str):
    options = LightOptions(model=model, path_samples=256, bounces=8)
    light = np.asarray(diffuse_light(stage.scene, stage.tracer, stage.gbuffer, jax.random.key(3), options=options))
    expected = truth.emitted + truth.diffuse
    assert abs(light.mean() / expected.mean() - 1) < 0.003  # 0.0007 measured (baked), 0.0003 (path)
    assert np.sqrt(((light - expected) ** 2).mean()) / expected.mean() < 0.025  # 0.012 (baked), 0.007 (path)
    away = ~np.asarray(stage.gbuffer.valid)
    np.testing.assert_allclose(light[away], 0.5, rtol=1e-5)
    direct = np.asarray(diffuse_light(stage.scene, stage.tracer, stage.gbuffer, jax.random.key(3)))
    assert light.mean() > direct.mean()


@pytest.mark.slow
def test_ray_tracing_with_paths_is_the_reflected_layer_of_path_tracing(stage, truth):
    options = raytrace.Options(samples=256, light="path", path_bounces=8)
    _, reflection, _ = raytrace.step(raytrace.State(), stage, raytrace.Params(), options=options)
    valid = np.asarray(reflection.valid)
    ours, expected = np.asarray(reflection.radiance)[valid], truth.reflected[valid]
    assert abs(ours.mean() / expected.mean() - 1) < 0.003  # 0.0003 measured
    assert np.sqrt(((ours - expected) ** 2).mean()) / expected.mean() < 0.07  # 0.034 measured: noise of 256 rays


def test_baked_reflections_are_brighter_than_direct_ones_and_darker_than_all_light(stage, truth):
    images = {}
    for light in ("direct", "baked"):
        options = raytrace.Options(samples=64, light=light)
        _, reflection, _ = raytrace.step(raytrace.State(), stage, raytrace.Params(), options=options)
        images[light] = np.asarray(reflection.radiance)[np.asarray(reflection.valid)].mean()
    everything = truth.reflected[np.asarray(stage.gbuffer.valid & (stage.gbuffer.object > 0))].mean()
    assert images["direct"] < images["baked"] < 1.02 * everything


@pytest.mark.parametrize("light", ["baked", "path"])
def test_environment_maps_take_any_light(stage, light: str):
    options = envmap.Options(height=16, rough_height=8, light=light, path_samples=4)
    state = envmap.init(stage.scene, stage.tracer, options=options)
    assert bool(jnp.isfinite(state.sharp).all()) and float(state.sharp.max()) > 0


def test_rays_that_are_not_active_bring_nothing(stage):
    rays = jax.tree.map(lambda x: x.reshape(-1, 3), camera_rays(stage.camera))
    active = jnp.arange(rays.origin.shape[0]) % 2 == 0
    options = IncomingOptions(light=LightOptions(model="path", path_samples=2))
    found = incoming(stage.scene, stage.tracer, rays, active, jax.random.key(0), options=options)
    assert (np.asarray(found.radiance)[1::2] == 0).all() and not np.asarray(found.hit)[1::2].any()
    assert np.asarray(found.radiance)[::2].max() > 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"model": "radiosity"}, "model: expected one of direct, baked, path"),
        ({"path_samples": 0}, "path_samples: expected a whole number from 1"),
        ({"bounces": True}, "bounces: expected a whole number"),
    ],
)
def test_bad_options_are_named(options, said):
    with pytest.raises(ValueError, match=said):
        LightOptions(**options)


def test_baked_light_needs_a_map(stage):
    bare = dataclasses.replace(stage.scene, lightmap=None)
    with pytest.raises(ValueError, match="has no light map"):
        diffuse_light(bare, stage.tracer, stage.gbuffer, jax.random.key(0), options=LightOptions(model="baked"))
