"""Ray tracing and environment mapping: right answers on analytic scenes, and the promises of every technique."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shapes import QUAD, ball, floor

import scenes
from jaxrefl._status import Source
from jaxrefl._types import Frame
from jaxrefl.core import direction_from_latlong, look_at
from jaxrefl.radiance import DirectOptions, direct_light
from jaxrefl.rays import BruteTracer, EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, Part, Sky, glass, glossy, matte, mirror
from jaxrefl.surface import look, mirror_direction, reflective
from jaxrefl.techniques import TECHNIQUES, envmap, raytrace
from jaxrefl.techniques.envmap.prefilter import level_alphas, prefilter


def gradient_sky(h: int = 32) -> Sky:
    """A smooth world without symmetry."""
    v, u = np.meshgrid((np.arange(h) + 0.5) / h, (np.arange(2 * h) + 0.5) / (2 * h), indexing="ij")
    direction = np.asarray(direction_from_latlong(jnp.asarray(np.stack([u, v], -1), jnp.float32)))
    return Sky((1.5 + direction).astype(np.float32))


def frame_of(scene, camera, tracer=None) -> Frame:
    tracer = tracer or EmbreeTracer(scene.mesh)
    return Frame(scene, camera, look(scene, tracer, camera), jax.random.key(1), tracer)


def run(technique, frame, *, options=None):
    options = options or technique.Options()
    state = technique.init(frame.scene, frame.tracer, options=options)
    _, reflection, info = technique.step(state, frame, technique.Params(), options=options)
    return reflection, info


@pytest.fixture(scope="module")
def mirror_floor():
    """A mirror floor, a red ball above it, a world that is brighter to the right."""
    red = ball("ball", matte("red", (0.8, 0.1, 0.1)), centre=(0, 1, 0), radius=0.5)
    scene = assemble(Description("floor", [floor("floor", mirror("mirror")), red], sky=gradient_sky()))
    return frame_of(scene, look_at((0, 1.2, 4), (0, 0.6, 0), size=(40, 30)))


def test_a_plane_mirror_shows_the_mirrored_world(mirror_floor):
    """Every reflected point is where a camera below the floor would see it: the exact, closed form."""
    reflection, info = run(raytrace, mirror_floor)
    g = mirror_floor.gbuffer
    hit = np.asarray(reflection.source) == Source.TRACED
    assert hit.sum() > 20
    eye = np.asarray(mirror_floor.camera.world_from_camera)[:3, 3].astype(np.float64)
    below = eye * [1, -1, 1]
    toward = np.asarray(reflection.p, np.float64)[hit] - below
    pixel = np.asarray(g.p, np.float64)[hit] - below
    cosine = (toward * pixel).sum(-1) / np.linalg.norm(toward, axis=-1) / np.linalg.norm(pixel, axis=-1)
    assert cosine.min() > 1 - 1e-9
    distance = np.linalg.norm(np.asarray(reflection.p - g.p, np.float64)[hit], axis=-1)
    np.testing.assert_allclose(np.asarray(reflection.t)[hit], distance, rtol=1e-4, atol=1e-5)
    assert info.rays > 0 and info.counts["mirror_pixels"] == int(reflective(g).sum())


def test_rays_that_leave_show_the_environment(mirror_floor):
    reflection, _ = run(raytrace, mirror_floor)
    sky = np.asarray(reflection.source) == Source.ENVIRONMENT
    wi = np.asarray(mirror_direction(mirror_floor.gbuffer))
    np.testing.assert_allclose(np.asarray(reflection.radiance)[sky], 1.5 + wi[sky], atol=0.06)  # 32 rows bilinear
    assert (np.asarray(reflection.t)[sky] == 0).all() and (np.asarray(reflection.p)[sky] == 0).all()


@pytest.mark.parametrize("name", list(TECHNIQUES))
def test_every_technique_keeps_the_promises_of_reflections(name: str, mirror_floor):
    technique = TECHNIQUES[name]
    reflection, info = run(technique, mirror_floor)
    shape = mirror_floor.gbuffer.t.shape
    assert reflection.radiance.shape == (*shape, 3) and reflection.valid.shape == shape
    assert all(bool(jnp.isfinite(x).all()) for x in jax.tree.leaves(reflection))
    invalid = ~np.asarray(reflection.valid)
    assert invalid.any() and not np.asarray(reflection.valid & ~reflective(mirror_floor.gbuffer)).any()
    for field in ("radiance", "source", "confidence", "p", "t"):
        assert (np.asarray(getattr(reflection, field))[invalid] == 0).all(), field
    assert bool(((reflection.confidence >= 0) & (reflection.confidence <= 1)).all())
    assert reflection.source.dtype == jnp.int32 and info.rays >= 0 and info.seconds and dict(info.counts)
    assert set(np.unique(reflection.source)) <= {int(s) for s in Source}


@pytest.mark.parametrize("name", list(TECHNIQUES))
def test_every_technique_is_reproducible_bit_for_bit(name: str, mirror_floor):
    first, _ = run(TECHNIQUES[name], mirror_floor)
    second, _ = run(TECHNIQUES[name], mirror_floor)
    assert jax.tree.all(jax.tree.map(lambda x, y: bool((x == y).all()), first, second))


@pytest.mark.parametrize("name", list(TECHNIQUES))
def test_every_technique_does_without_reflectors(name: str):
    scene = assemble(Description("matte", [floor("floor", matte("m", (1, 1, 1)))]))
    reflection, _ = run(TECHNIQUES[name], frame_of(scene, look_at((0, 2, 4), (0, 0, 0), size=(12, 9))))
    assert not bool(reflection.valid.any())


@pytest.mark.parametrize("name", list(TECHNIQUES))
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scaling_the_scene_changes_nothing(name: str, scale: float):

    def build(scale: float) -> Frame:
        shiny = ball("b", mirror("m"), centre=(0, scale, 0), radius=0.5 * scale)
        parts = [floor("floor", matte("floor", (0.5, 0.4, 0.3)), size=4 * scale), shiny]
        scene = assemble(Description("scaled", parts, sky=gradient_sky()))
        eye, target = scale * np.array([0, 1.2, 4]), scale * np.array([0, 0.6, 0])
        return frame_of(scene, look_at(eye, target, size=(24, 18)))

    one, _ = run(TECHNIQUES[name], build(1.0))
    other, _ = run(TECHNIQUES[name], build(scale))
    same = np.asarray(one.valid) == np.asarray(other.valid)
    assert same.mean() > 0.99
    difference = np.abs(np.asarray(one.radiance - other.radiance)).max(-1)[same]
    assert np.quantile(difference, 0.97) < 0.02  # single samples may fall on the other side of a shadow's edge


def test_two_tracers_one_picture():
    """The whole technique on the brute-force oracle gives the picture that Embree gives."""
    scene = assemble(scenes.build("cornell", triangles=1000))
    camera = scenes.BUILT_IN["cornell"].path(1, size=(16, 12))[0]
    fast, _ = run(raytrace, frame_of(scene, camera))
    slow, _ = run(raytrace, frame_of(scene, camera, BruteTracer(scene.mesh)))
    difference = np.abs(np.asarray(fast.radiance - slow.radiance)).max(-1)
    assert (difference < 1e-3).mean() > 0.97


def test_more_samples_converge():
    """Glossy reflections: 16 times the samples, a quarter of the error or less."""
    parts = [
        floor("floor", glossy("gloss", (1, 1, 1), alpha=0.3, metallic=1.0)),
        ball("ball", matte("red", (0.8, 0.1, 0.1)), centre=(0, 1, 0), radius=0.8),
    ]
    scene = assemble(Description("gloss", parts, sky=gradient_sky()))
    frame = frame_of(scene, look_at((0, 1.2, 4), (0, 0.6, 0), size=(24, 16)))

    def image(samples: int) -> np.ndarray:
        return np.asarray(run(raytrace, frame, options=raytrace.Options(samples=samples))[0].radiance)

    reference = image(512)
    few, many = (np.sqrt(np.mean((image(n) - reference) ** 2)) for n in (2, 32))
    assert many < few / 3.5


def test_glass_bends_what_is_behind_it():
    """A slab of index 1.5 shifts a ray by the closed form and leaves its direction as it was."""
    thickness, eta = 0.4, 1.5
    clear = glass("glass", eta=eta)
    top, bottom = floor("slab", clear, height=thickness).vertices, floor("slab", clear).vertices[::-1]
    slab = Part("slab", np.concatenate([top, bottom]), np.concatenate([QUAD, QUAD + 4]), clear)
    scene = assemble(Description("slab", [slab], sky=gradient_sky(64)))
    camera = look_at((0, 3, 1.5), (0, 0, 0), fov_y=20, size=(9, 9))
    reflection, _ = run(raytrace, frame_of(scene, camera))
    expected = 1.5 - np.asarray(look(scene, EmbreeTracer(scene.mesh), camera).wo)
    # Fresnel takes its share at the second interface.
    from jaxrefl.core import fresnel_dielectric

    cos_inside = np.sqrt(1 - (1 - np.asarray(frame_of(scene, camera).gbuffer.wo)[..., 1] ** 2) / eta**2)
    leaving = 1 - np.asarray(fresnel_dielectric(jnp.asarray(cos_inside, jnp.float32), jnp.full((9, 9), 1 / eta)))
    np.testing.assert_allclose(reflection.transmitted, expected * leaving[..., None], rtol=2e-2)


def test_a_map_of_a_far_world_is_right():
    """Environment mapping is exact when everything reflected is infinitely far away."""
    scene = assemble(Description("far", [ball("ball", mirror("m"))], sky=gradient_sky()))
    frame = frame_of(scene, look_at((0, 0, 4), (0, 0, 0), size=(24, 24)))
    mapped, _ = run(envmap, frame)
    traced, _ = run(raytrace, frame)
    both = np.asarray(mapped.valid & traced.valid)
    np.testing.assert_allclose(np.asarray(mapped.radiance)[both], np.asarray(traced.radiance)[both], atol=0.02)
    assert (np.asarray(mapped.confidence)[both] == 1).all()


def test_a_map_of_a_near_world_is_wrong_and_says_so(mirror_floor):
    """Below the ball the map shows it at the wrong place; the confidence is lowest where the error is largest."""
    mapped, _ = run(envmap, mirror_floor)
    traced, _ = run(raytrace, mirror_floor)
    valid = np.asarray(mapped.valid)
    error = np.abs(np.asarray(mapped.radiance - traced.radiance)).max(-1)[valid]
    confidence = np.asarray(mapped.confidence)[valid]
    assert confidence.min() < 0.8
    doubted = confidence < np.median(confidence)
    assert error[doubted].mean() > 2 * error[~doubted].mean()


def test_prefiltering_against_plain_quadrature():
    """One texel of a rough level, summed in float64 from the formula."""
    h = 16
    sharp = jnp.asarray(gradient_sky(h).radiance)[None]
    alpha = level_alphas(3)
    rough = prefilter(sharp, alpha, h)
    v, u = np.meshgrid((np.arange(h) + 0.5) / h, (np.arange(2 * h) + 0.5) / (2 * h), indexing="ij")
    d = np.asarray(direction_from_latlong(jnp.asarray(np.stack([u, v], -1), jnp.float32)), np.float64).reshape(-1, 3)
    axis = d[5 * 2 * h + 7]
    half = d + axis
    cos_h = (half @ axis) / np.maximum(np.linalg.norm(half, axis=1), 1e-9)
    a2 = float(alpha[1]) ** 2
    kernel = a2 / (np.pi * (cos_h**2 * (a2 - 1) + 1) ** 2) * np.maximum(d @ axis, 0) * np.sin(np.pi * v).reshape(-1)
    expected = kernel @ np.asarray(sharp, np.float64).reshape(-1, 3) / kernel.sum()
    np.testing.assert_allclose(rough[0, 1, 5, 7], expected, rtol=1e-4)


def test_overflow_is_counted_never_silent():
    balls = [ball(f"b{i}", mirror("m"), centre=(i, 0, 0), radius=0.3, subdivisions=2) for i in range(3)]
    scene = assemble(Description("balls", balls, sky=gradient_sky()))
    frame = frame_of(scene, look_at((1, 0, 5), (1, 0, 0), size=(16, 8)))
    options = envmap.Options(reflectors=2, height=16, rough_height=8)
    reflection, info = run(envmap, frame, options=options)
    assert info.counts["overflow"] == 1 and info.counts["maps"] == 3
    assert bool((reflection.valid == reflective(frame.gbuffer)).all())


@pytest.mark.parametrize("name", list(TECHNIQUES))
def test_knobs_are_checked(name: str):
    options = TECHNIQUES[name].Options
    for field in dataclasses.fields(options):
        assert field.metadata["help"], field.name
        if field.metadata["high"] is not None:
            with pytest.raises(ValueError, match=f"{field.name}: expected a value from"):
                options(**{field.name: field.metadata["high"] + 1})
        if field.metadata["choices"]:
            with pytest.raises(ValueError, match=f"{field.name}: expected one of"):
                options(**{field.name: "nothing"})


def test_shadows_and_light_are_those_of_direct_light(mirror_floor):
    """What a mirror shows of a matte ball is what the ball looks like: the same function shades both."""
    reflection, _ = run(raytrace, mirror_floor, options=raytrace.Options(environment_samples=64))
    hit = np.asarray(reflection.source) == Source.TRACED
    red = np.asarray(reflection.radiance)[hit]
    assert (red[:, 0] > 3 * red[:, 1]).mean() > 0.9
    direct = direct_light(
        mirror_floor.scene, mirror_floor.tracer, mirror_floor.gbuffer, jax.random.key(5), options=DirectOptions()
    )
    assert red[:, 0].max() < 1.5 * float(direct[..., 0].max())
