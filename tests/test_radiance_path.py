"""The path tracer: closed forms, layers, reproducibility, both tracers, scale; Mitsuba has a file of its own."""

import dataclasses

import jax
import jax.monitoring
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from shapes import ball, floor

import scenes
from jaxrefl._types import Camera, Frame, Rays, Scene
from jaxrefl.composite import blend
from jaxrefl.core import look_at, pixel_sequences
from jaxrefl.radiance import (
    DirectOptions,
    PathLight,
    PathOptions,
    camera_samples,
    direct_light,
    path,
    path_light,
    path_radiance,
)
from jaxrefl.radiance.path_step import drain
from jaxrefl.rays import BruteTracer, EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import (
    Description,
    Image,
    Material,
    Part,
    PunctualLight,
    constant_sky,
    emitter,
    glass,
    glossy,
    matte,
    mirror,
)
from jaxrefl.surface import look
from jaxrefl.techniques import raytrace

SMALL = PathOptions(block=4096)


def image(scene: Scene, camera: Camera, samples: int, *, options: PathOptions = SMALL, tracer=None, seed: int = 0):
    """Mean radiance [h w 3] of some samples per pixel."""
    tracer = tracer or EmbreeTracer(scene.mesh)
    number = jnp.arange(samples, dtype=jnp.uint32)
    rays = camera_samples(camera, jnp.full_like(number, seed), number, sampler=options.sampler)
    return np.asarray(path_radiance(scene, tracer, *rays, options=options)).mean(0)


def layers(scene: Scene, camera: Camera, samples: int, *, options: PathOptions = SMALL) -> PathLight:
    number = jnp.arange(samples, dtype=jnp.uint32)
    rays = camera_samples(camera, jnp.zeros_like(number), number)
    light = path_light(scene, EmbreeTracer(scene.mesh), *rays, options=options)
    return jax.tree.map(lambda x: x.mean(0), light)


def inside_of_a_ball(material: Material) -> Part:
    shape = trimesh.creation.icosphere(subdivisions=3)
    return Part("shell", np.asarray(shape.vertices), np.asarray(shape.faces)[:, ::-1], material)


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
def test_a_glowing_shell_is_a_geometric_series(sampler: str):
    """Inside a closed surface that emits L_e and reflects rho, radiance is L_e / (1 - rho) everywhere: all bounces,
    and the roulette."""
    glowing = matte("glow", (0.8, 0.5, 0.2)).replace(emission=(1.0, 2.0, 3.0))
    scene = assemble(Description("shell", [inside_of_a_ball(glowing)]))
    camera = look_at((0.1, 0.2, 0.0), (1, 0, 0), size=(24, 18))
    found = image(scene, camera, 64, options=dataclasses.replace(SMALL, bounces=200, sampler=sampler)).mean((0, 1))
    np.testing.assert_allclose(found, [5, 4, 3.75], rtol=0.01)  # measured: 0.2 %


@pytest.mark.parametrize(
    "material",
    [
        matte("white", (1, 1, 1)),
        glossy("metal", (1, 1, 1), alpha=0.0, metallic=1.0),
        glossy("rough metal", (1, 1, 1), alpha=0.5, metallic=1.0),
        glossy("glossy", (1, 1, 1), alpha=0.2),
        glossy("plastic", (1, 1, 1), alpha=0.1).replace(coupled=True),
        glass("glass", alpha=0.0),
    ],
    ids=lambda m: m.name,
)
def test_a_white_ball_vanishes_in_a_white_world(material: Material):
    """The furnace: radiance 1 everywhere, whatever the surface does with it."""
    scene = assemble(Description("furnace", [ball("ball", material)], sky=constant_sky((1, 1, 1))))
    camera = look_at((0, 0, 5), (0, 0, 0), fov_y=25, size=(24, 24))
    found = image(scene, camera, 64, options=dataclasses.replace(SMALL, bounces=64))
    assert abs(found.mean() - 1) < 0.005


def test_direct_light_alone_is_what_direct_light_computes():
    """One bounce on matte surfaces: two estimators, one expected value."""
    lamp = floor("lamp", emitter("lamp", (5, 4, 3)), size=0.5, height=2.0)
    lights = [PunctualLight("point", (3, 3, 3), position=(1, 1.5, 1))]
    parts = [floor("floor", matte("m", (0.6, 0.5, 0.4))), lamp, ball("b", matte("b", (0.9, 0.1, 0.1)), radius=0.4)]
    scene = assemble(Description("direct", parts, lights=lights, ambient=(0.1, 0.2, 0.3)))
    camera = look_at((0, 2.5, 4), (0, 0, 0), size=(32, 24))
    tracer = EmbreeTracer(scene.mesh)
    gbuffer = look(scene, tracer, camera)
    options = DirectOptions(area_samples=256, environment_samples=1)
    expected = np.asarray(direct_light(scene, tracer, gbuffer, jax.random.key(0), options=options))
    found = image(scene, camera, 256, options=dataclasses.replace(SMALL, bounces=1))
    assert abs(found.mean() / expected.mean() - 1) < 0.01  # the path tracer is anti-aliased, direct light is not
    inner = np.abs(found - expected).max(-1) < 0.05
    assert inner.mean() > 0.9


def test_layers_add_up_and_are_those_of_the_composite():
    """All layers together are the radiance; composited like a technique's they give the same image."""
    shiny = ball("shiny", glossy("g", (0.8, 0.3, 0.2), alpha=0.2), centre=(-0.8, 0.6, 0), radius=0.6)
    clear = ball("clear", glass("glass"), centre=(0.8, 0.6, 0), radius=0.6)
    lamp = ball("lamp", emitter("lamp", (9, 9, 9)), centre=(0, 1.5, -0.5), radius=0.4)
    scene = assemble(Description("layers", [floor("floor", matte("m", (0.6, 0.5, 0.4))), lamp, shiny, clear]))
    camera = look_at((0, 2, 4), (0, 0.5, 0), size=(32, 24))
    found = layers(scene, camera, 64)
    whole = image(scene, camera, 64)
    np.testing.assert_allclose(np.asarray(found.radiance), whole, rtol=1e-3, atol=1e-4)
    for name in ("emitted", "diffuse", "reflected", "refracted"):
        assert float(getattr(found, name).max()) > 0.05, name
    gbuffer = look(scene, EmbreeTracer(scene.mesh), camera)
    from jaxrefl.techniques._shape import no_reflection

    reflection = dataclasses.replace(
        no_reflection(gbuffer), radiance=found.reflected, valid=gbuffer.valid, transmitted=found.refracted
    )
    composed = np.asarray(blend(gbuffer, found.emitted + found.diffuse, reflection))
    off = np.abs(composed - whole).max(-1) / (whole.max(-1) + 0.05)
    assert np.median(off) < 0.01 and (off < 0.1).mean() > 0.9  # the G-buffer is not anti-aliased: outlines differ


def test_the_reflected_layer_is_what_ray_tracing_shows():
    """A mirror over a matte floor under a sky: paths of two bounces, and a mirror ray with direct light at its end."""
    parts = [floor("floor", matte("m", (0.7, 0.5, 0.3))), ball("b", mirror("mirror"), centre=(0, 0.6, 0), radius=0.5)]
    scene = assemble(Description("mirror", parts, sky=constant_sky((1, 0.9, 0.8))))
    camera = look_at((0, 1.5, 3), (0, 0.5, 0), size=(48, 36))
    found = layers(scene, camera, 64, options=dataclasses.replace(SMALL, bounces=2))
    tracer = EmbreeTracer(scene.mesh)
    gbuffer = look(scene, tracer, camera)
    frame = Frame(scene, camera, gbuffer, jax.random.key(3), tracer)
    _, reflection, _ = raytrace.step(
        raytrace.State(), frame, raytrace.Params(), options=raytrace.Options(environment_samples=256)
    )
    inner = np.asarray(reflection.valid) & (np.asarray(gbuffer.n)[..., 2] > 0.3)
    difference = np.abs(np.asarray(found.reflected) - np.asarray(reflection.radiance)).max(-1)[inner]
    assert inner.sum() > 50 and np.median(difference) < 0.02


def test_absorption_follows_beer_and_lambert():
    """A thick slab of index close to 1 in front of a white world."""
    dark = glass("dark", eta=1.0001, attenuation=(0.5, 1.0, 2.0))
    box = trimesh.creation.box(extents=(10, 10, 1.0))
    slab = Part("slab", np.asarray(box.vertices), np.asarray(box.faces), dark)
    scene = assemble(Description("slab", [slab], sky=constant_sky((1, 1, 1))))
    found = image(scene, look_at((0, 0, 5), (0, 0, 0), fov_y=1, size=(8, 8)), 4).mean((0, 1))
    np.testing.assert_allclose(found, np.exp([-0.5, -1, -2]), rtol=2e-3)


def test_a_cut_out_lets_the_light_through_that_its_opacity_leaves():
    grey = np.full((4, 4, 4), 255, np.uint8)
    grey[..., 3] = 102  # an opacity of 0.4
    leaf = emitter("leaf", (1, 1, 1)).replace(opacity_texture=Image("leaf", grey), opacity=0.5)
    quad = dataclasses.replace(floor("leaf", leaf), uv=np.array([[0, 0], [0, 1], [1, 1], [1, 0]], float))
    behind = floor("behind", emitter("behind", (0, 3, 0)), height=-1.0, size=20.0)
    scene = assemble(Description("cut out", [quad, behind]))
    camera = look_at((0, 3, 0.01), (0, 0, 0), fov_y=20, size=(16, 16))
    found = image(scene, camera, 64).mean((0, 1))
    np.testing.assert_allclose(found, [0.2, 0.2 + 0.8 * 3, 0.2], rtol=0.03)


def test_lights_that_shine_to_one_side_only():
    lamp = floor("lamp", emitter("lamp", (4, 4, 4)).replace(emits_back=False), size=1.0)
    screens = [floor(str(y), matte("white", (1, 1, 1)), height=y, size=3.0) for y in (2.0, -2.0)]
    scene = assemble(Description("one side", [lamp, *screens]))
    tracer = EmbreeTracer(scene.mesh)
    options = dataclasses.replace(SMALL, bounces=1)
    down = Rays(jnp.asarray([[1.5, -1.0, 1.5]] * 64), jnp.asarray([[0.0, -1.0, 0.0]] * 64))
    up = Rays(jnp.asarray([[1.5, 1.0, 1.5]] * 64), jnp.asarray([[0.0, 1.0, 0.0]] * 64))
    number = jnp.arange(64, dtype=jnp.uint32)
    lit, dark = (
        float(path_radiance(scene, tracer, rays, jnp.zeros_like(number), number, options=options).mean())
        for rays in (up, down)
    )
    assert lit > 0.05 and dark == 0


def test_a_run_is_reproducible_whatever_the_block(monkeypatch: pytest.MonkeyPatch):
    """Bit for bit: what a path draws depends on its ray alone, and each ray has sums of its own. The larger block
    ends as one of the smaller size."""
    drained = []
    monkeypatch.setattr(path, "_LEAST", 128)
    monkeypatch.setattr(path, "drain", lambda *args, count: drained.append(count) or drain(*args, count=count))
    scene = assemble(scenes.build("cornell", triangles=1000))
    camera = scenes.BUILT_IN["cornell"].path(1, size=(20, 15))[0]
    blocks = [dataclasses.replace(SMALL, block=size) for size in (128, 128, 1024)]
    first, again, other = (image(scene, camera, 4, options=options) for options in blocks)
    assert (first == again).all()
    assert (first == other).all()
    assert drained == [128, 128]
    assert (first != image(scene, camera, 4, seed=1)).any()


def test_two_tracers_one_image():
    scene = assemble(scenes.build("cornell", triangles=1000))
    camera = scenes.BUILT_IN["cornell"].path(1, size=(12, 12))[0]
    fast = image(scene, camera, 2)
    slow = image(scene, camera, 2, tracer=BruteTracer(scene.mesh))
    assert (np.abs(fast - slow).max(-1) < 1e-3).mean() > 0.95  # a rounding may turn a path at an edge


@pytest.mark.parametrize("move", [0.0, 1.0])
@pytest.mark.parametrize("scale", [2.0**-10, 2.0**10])
def test_scale_and_place_do_not_matter(scale: float, move: float):
    """Scaled by a thousandth and a thousand, moved by a diameter: the same image within noise."""

    def build(scale: float, move: float) -> tuple[Scene, Camera]:
        centre = scale * move * np.array([8.0, 8.0, 8.0])
        shiny = glossy("gloss", (0.9, 0.8, 0.7), alpha=0.2, metallic=1.0)
        parts = [floor("floor", matte("floor", (0.5, 0.5, 0.5))), ball("ball", shiny, centre=(0, 0.7, 0), radius=0.6)]
        parts.append(floor("lamp", emitter("lamp", (8, 8, 8)), size=0.5, height=3.0))
        parts = [dataclasses.replace(p, vertices=scale * p.vertices + centre) for p in parts]
        eye, target = (scale * np.array(x) + centre for x in ((0, 1.5, 4), (0, 0.5, 0)))
        return assemble(Description("moved", parts)), look_at(eye, target, size=(24, 18))

    one, other = (image(*build(*p), 32) for p in ((1.0, 0.0), (scale, move)))
    assert abs(other.mean() / one.mean() - 1) < 0.005
    assert np.median(np.abs(one - other)) < 1e-3 * one.mean()


def test_nothing_is_compiled_again():
    """Another seed, another sample, more bounces taken: the same compiled stages."""
    scene = assemble(scenes.build("cornell", triangles=1000))
    camera = scenes.BUILT_IN["cornell"].path(1, size=(16, 16))[0]
    tracer = EmbreeTracer(scene.mesh)
    image(scene, camera, 2, tracer=tracer)
    compiled = []
    listen = lambda event, duration, **_: compiled.append(event) if "backend_compile" in event else None  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        image(scene, camera, 2, tracer=tracer, seed=5)
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert not compiled


def test_any_batch_of_rays_will_do():
    """Rays of any shape, some of which see nothing; a batch of one."""
    scene = assemble(Description("floor", [floor("floor", emitter("e", (2, 2, 2)))]))
    tracer = EmbreeTracer(scene.mesh)
    direction = jnp.asarray([[[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]] * 3)
    rays = Rays(jnp.broadcast_to(jnp.asarray([0.0, 1.0, 0.0]), direction.shape), direction)
    sequence = pixel_sequences(jnp.uint32(0), jnp.arange(6)).reshape(3, 2)
    found = path_radiance(scene, tracer, rays, sequence, jnp.zeros_like(sequence))
    np.testing.assert_allclose(np.asarray(found[..., 0]), [[2, 0]] * 3)
    one = jax.tree.map(lambda x: x[:1, 0], (rays, sequence))
    assert path_radiance(scene, tracer, one[0], one[1], jnp.zeros((1,), jnp.uint32)).shape == (1, 3)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"bounces": -1}, "bounces: expected a whole number from 0 to 1000, got -1"),
        ({"block": 1}, "block: expected a whole number from 64"),
        ({"sampler": "halton"}, "sampler: expected 'sobol' or 'independent', got 'halton'"),
    ],
)
def test_bad_options_are_named(change: dict, message: str):
    with pytest.raises(ValueError, match=message):
        PathOptions(**change)
