"""Direct light against closed forms and brute-force integrals, shadows, and what must not change the picture."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import direct as reference
from reference import lookup
from tolerances import assert_close

from jaxrefl import GBuffer, Rays, Scene
from jaxrefl.radiance import direct, light_samples
from jaxrefl.radiance.direct import DirectOptions, arriving_light, background, direct_light, outgoing_light
from jaxrefl.radiance.light_samples import FAR, Receivers, receivers_of, sample_lights
from jaxrefl.rays import EmbreeTracer
from jaxrefl.rays.offset import ERROR_PER_COORDINATE
from jaxrefl.scene import (
    Description,
    Image,
    Part,
    PunctualLight,
    Sky,
    assemble,
    constant_sky,
    emitter,
    matte,
)

UNIT = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], np.float64)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
GREY = matte("grey", (0.5, 0.5, 0.5))


sample = eqx.filter_jit(sample_lights)


class Clear:
    """A tracer that finds nothing in the way and counts the rays it is given."""

    def __init__(self):
        self.rays = 0

    def closest(self, rays, *, active=None):
        raise NotImplementedError

    closest_rows = closest

    def occluded(self, rays: Rays, t_max: jax.Array) -> jax.Array:
        self.rays += int((t_max > 0).sum())
        return jnp.zeros(t_max.shape, bool)


def square(name: str, material, *, size: float = 1.0, centre=(0.0, 0.0, 0.0), uv: np.ndarray | None = None) -> Part:
    """A horizontal square, facing down."""
    return Part(name, (UNIT - [0.5, 0, 0.5]) * size + np.asarray(centre), FACES, material, uv=uv)


FAR_AWAY = square("far away", GREY, centre=(0.0, -1e3, 0.0))
"""A scene needs a triangle."""


def scene_of(*parts: Part, **fields) -> Scene:
    return assemble(Description("test", list(parts or [FAR_AWAY]), **fields))


def points(p, n=(0.0, 1.0, 0.0), *, albedo: float = 1.0, largest: float = 1.0) -> GBuffer:
    """A G-buffer of matte points on triangles with coordinates up to `largest`."""
    p = np.asarray(p, np.float32)
    n = np.broadcast_to(np.asarray(n, np.float32), p.shape)
    one, shape = np.ones(p.shape[:-1], np.float32), p.shape[:-1]
    return GBuffer(
        valid=jnp.ones(shape, bool),
        p=jnp.asarray(p),
        p_error=jnp.asarray(ERROR_PER_COORDINATE * largest * one),
        n=jnp.asarray(n),
        ns=jnp.asarray(n),
        wo=jnp.asarray(n),
        t=jnp.asarray(one),
        z_camera=None,
        base_colour=jnp.full(p.shape, albedo),
        metallic=jnp.asarray(0 * one),
        alpha=jnp.asarray(one),
        eta=jnp.asarray(one),
        outside=jnp.ones(shape, bool),
        object=jnp.zeros(shape, jnp.int32),
        material=jnp.zeros(shape, jnp.int32),
        triangle=jnp.zeros(shape, jnp.int32),
    )


def grid(count: int = 5, *, extent: float = 2.0) -> np.ndarray:
    x, z = np.meshgrid(*2 * [np.linspace(-extent, extent, count)], indexing="ij")
    return np.stack([x, 0 * x, z], -1).reshape(-1, 3)


def irradiance_of(scene: Scene, gbuffer: GBuffer, key: jax.Array, **options) -> np.ndarray:
    """Unoccluded irradiance: pi times the radiance of a white surface."""
    return np.pi * np.asarray(direct_light(scene, Clear(), gbuffer, key, options=DirectOptions(**options)))


def test_point_light_falls_off_with_the_squared_distance(key: jax.Array):
    scene = scene_of(lights=[PunctualLight("lamp", (3.0, 2.0, 1.0), (0.3, 1.5, -0.2))])
    p = grid()
    to_light = np.array([0.3, 1.5, -0.2]) - p
    r2 = (to_light**2).sum(-1, keepdims=True)
    expected = np.array([3.0, 2.0, 1.0]) * to_light[:, 1:2] / np.sqrt(r2) / r2
    assert_close(irradiance_of(scene, points(p), key), expected.astype(np.float32))


def test_many_punctual_lights_add_up(key: jax.Array):
    lamps = [PunctualLight(f"lamp {i}", (i, 1.0, 0.0), (i, 2.0, 0.0)) for i in range(3)]
    lamps.append(PunctualLight("sun", (0.0, 0.0, 2.0), direction=(1.0, -1.0, 0.0), directional=True))
    gbuffer = points(grid())
    total = irradiance_of(scene_of(lights=lamps), gbuffer, key)
    assert_close(total, sum(irradiance_of(scene_of(lights=[lamp]), gbuffer, key) for lamp in lamps), scale=5)


@pytest.mark.parametrize(("angle", "share"), [(0, 1), (19.9, 1), (25, None), (30.1, 0), (90, 0), (180, 0)])
def test_spot_cone(angle: float, share: float | None, key: jax.Array):
    """Full inside 20 degrees, dark outside 30, in between the square of the linear ramp in the cosine."""
    inner, outer = np.cos(np.radians([20, 30]))
    spot = PunctualLight("spot", (1, 1, 1), (0, 0, 0), (1, 0, 0), cos_inner=inner, cos_outer=outer)
    towards = np.array([[np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0]])
    lit = irradiance_of(scene_of(lights=[spot]), points(2 * towards, -towards), key)
    if share is None:
        share = ((np.cos(np.radians(angle)) - outer) / (inner - outer)) ** 2
        assert 0.1 < share < 0.9
    np.testing.assert_allclose(lit, share / 4, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("radius", [0.0, 0.005, 0.5])
def test_sun_brings_its_irradiance(radius: float, key: jax.Array):
    """As long as the whole disk is above the horizon, its size changes nothing but the softness of shadows."""
    direction = np.array([0.3, -1.0, 0.2])
    sun = PunctualLight("sun", (3, 2, 1), direction=tuple(direction), directional=True, angular_radius=radius)
    gbuffer = points(np.zeros((2, 3)), [-direction / np.linalg.norm(direction), (0, 1, 0)])
    lit = irradiance_of(scene_of(lights=[sun]), gbuffer, key, punctual_samples=256)
    expected = np.array([[1.0], [1 / np.linalg.norm(direction)]]) * [3, 2, 1]
    np.testing.assert_allclose(lit, expected, rtol=1e-5 if radius < 0.1 else 3e-3)  # 256 samples of cosines


def test_constant_sky_is_exact(key: jax.Array, rng: np.random.Generator):
    """Every single sample of an unoccluded surface brings exactly albedo times the sky's radiance."""
    n = rng.normal(size=(50, 3))
    gbuffer = points(np.zeros((50, 3)), n / np.linalg.norm(n, axis=-1, keepdims=True), albedo=0.25)
    scene = scene_of(sky=constant_sky((1, 2, 4)))
    seen = direct_light(scene, Clear(), gbuffer, key, options=DirectOptions(environment_samples=1))
    np.testing.assert_allclose(seen, np.broadcast_to([0.25, 0.5, 1], (50, 3)), rtol=1e-5)


@pytest.mark.parametrize("flip", [False, True])
def test_area_light_agrees_with_lamberts_formula(flip: bool, key: jax.Array):
    lamp = square("lamp", emitter("lamp", (1, 2, 3)), size=1.5, centre=(0.2, 1.0, 0.1))
    if flip:  # both sides shine
        lamp = dataclasses.replace(lamp, faces=lamp.faces[:, ::-1])
    gbuffer = points(grid())
    lit = irradiance_of(scene_of(lamp), gbuffer, key, area_samples=1024)
    expected = [reference.polygon(lamp.vertices, p, np.array([0, 1.0, 0])) for p in grid()]
    np.testing.assert_allclose(lit, np.array(expected)[:, None] * [1, 2, 3], rtol=5e-3)  # 1.7e-3 at 1024 samples


def test_one_area_sample_is_unbiased(key: jax.Array):
    """Many points at one place with one sample each: stratification within a point cannot hide a bias."""
    lamp = square("lamp", emitter("lamp", (1, 1, 1)), centre=(0.0, 1.0, 0.0))
    other = square("other", emitter("other", (4, 4, 4)), size=0.3, centre=(1.0, 0.5, 0.0))
    lit = irradiance_of(scene_of(lamp, other), points(np.zeros((20000, 3))), key, area_samples=1)
    up = np.array([0, 1.0, 0])
    expected = reference.polygon(lamp.vertices, np.zeros(3), up) + 4 * reference.polygon(
        other.vertices, np.zeros(3), up
    )
    deviation = lit[:, 0].std() / np.sqrt(len(lit))
    assert deviation < 0.01 * expected
    assert abs(lit[:, 0].mean() - expected) < 3 * deviation


def test_textured_area_light(key: jax.Array, rng: np.random.Generator):
    picture = Image("lamp.png", rng.integers(0, 256, (3, 4, 4), dtype=np.uint8), (False, False))
    material = dataclasses.replace(emitter("lamp", (2, 2, 2)), emission_texture=picture)
    lamp = square("lamp", material, centre=(0.0, 0.7, 0.0), uv=UNIT[:, [0, 2]])
    lit = irradiance_of(scene_of(lamp), points(grid(2, extent=0.7)), key, area_samples=1024)

    def radiance(u: float, v: float) -> np.ndarray:
        return 2 * lookup.texture(picture.rgba, u, v, srgb=True, repeat=(False, False))[:3]

    corner, edges = lamp.vertices[0], (np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    expected = [
        reference.parallelogram(corner, edges, radiance, p, np.array([0, 1.0, 0]), count=32)
        for p in grid(2, extent=0.7)
    ]
    np.testing.assert_allclose(lit, expected, rtol=2e-2)  # 0.9e-2 at 1024 samples


@pytest.mark.parametrize(("sun", "count"), [(1.0, 1), (500.0, 3), (500.0, 16)])
def test_environment_agrees_with_quadrature(sun: float, count: int, key: jax.Array, rng: np.random.Generator):
    image = rng.random((8, 16, 3)).astype(np.float32)
    image[2, 11] = sun
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    n = rng.normal(size=(6, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    repeats = 3200 // count
    gbuffer = points(np.zeros((6 * repeats, 3)), n.repeat(repeats, 0))
    lit = irradiance_of(scene_of(sky=Sky(image, world_from_map=turn)), gbuffer, key, environment_samples=count)
    lit = lit.reshape(6, repeats, 3)
    directions, solid_angle = lookup.sphere(128, 256)
    radiance = lookup.latlong(image, directions)
    expected = np.array([reference.sky(radiance, directions @ turn.T, solid_angle, normal) for normal in n])
    deviation = lit.std(1) / np.sqrt(repeats)
    assert (deviation < 0.05 * expected).all()
    assert (np.abs(lit.mean(1) - expected) < 4 * deviation).all()


def test_light_below_the_horizon_is_not_cast(key: jax.Array):
    lamp = PunctualLight("lamp", (1, 1, 1), (0.0, 1.0, 0.0))
    gbuffer = points([[0, 0, 0], [0, 2, 0], [0, 3, 0], [5, 0, 0]], [(0, 1, 0), (0, 1, 0), (0, -1, 0), (0, 1, 0)])
    gbuffer = eqx.tree_at(lambda g: g.valid, gbuffer, jnp.asarray([True, True, True, False]))
    tracer = Clear()
    seen = np.asarray(direct_light(scene_of(lights=[lamp]), tracer, gbuffer, key))
    assert tracer.rays == 2
    np.testing.assert_array_equal(seen[:, 0] > 0, [True, False, True, False])


def test_a_shading_normal_lets_no_light_through(key: jax.Array):
    """Light above the shading normal but below the surface itself counts as 0."""
    gbuffer = points([[0.0, 0.0, 0.0]], (0, 1, 0))
    tilted = np.array([[0.8, 0.6, 0.0]])
    gbuffer = eqx.tree_at(lambda g: g.ns, gbuffer, jnp.asarray(tilted, jnp.float32))
    for y, lit in ((-0.1, False), (0.1, True)):
        lamp = PunctualLight("lamp", (1, 1, 1), (2.0, y, 0.0))
        assert (irradiance_of(scene_of(lights=[lamp]), gbuffer, key) > 0).any() == lit


def half_shadow(scale: float, shift: float = 0.0) -> tuple[Scene, GBuffer]:
    """A floor in the light of a small square lamp, half of it in the shadow of a blind; and points on the floor."""
    at = lambda *x: tuple(scale * np.array(x) + shift)  # noqa: E731
    lamp = square("lamp", emitter("lamp", (1, 1, 1)), size=0.2 * scale, centre=at(0, 2, 0))
    blind = square("blind", GREY, size=4 * scale, centre=at(-2, 1, 0))
    floor = square("floor", GREY, size=9 * scale, centre=at(0, 0, 0))
    p = np.array([at(x, 0, 0.3) for x in (-1.5, -0.5, -0.2, 0.2, 0.5, 1.5)])
    return scene_of(floor, blind, lamp), points(p, albedo=0.5, largest=4.5 * scale + shift)


def test_half_of_the_plane_is_in_shadow(key: jax.Array):
    """The edge of the shadow lies below the blind's edge; the lamp of width 0.2 blurs it over 0.2."""
    scene, gbuffer = half_shadow(1.0)
    seen = np.asarray(direct_light(scene, EmbreeTracer(scene.mesh), gbuffer, key))[:, 0]
    free = np.asarray(direct_light(scene, Clear(), gbuffer, key))[:, 0]
    np.testing.assert_array_equal(seen[:3], 0)
    np.testing.assert_array_equal(seen[3:], free[3:])
    assert (free > 0).all()


def test_penumbra(key: jax.Array):
    """Right below the edge half of the lamp is hidden."""
    scene, _ = half_shadow(1.0)
    gbuffer = points(np.zeros((400, 3)), largest=4.5)
    seen = np.asarray(direct_light(scene, EmbreeTracer(scene.mesh), gbuffer, key))[:, 0]
    free = np.asarray(direct_light(scene, Clear(), gbuffer, key))[:, 0]
    assert seen.mean() / free.mean() == pytest.approx(0.5, abs=0.05)  # 1600 rays: 3 standard deviations are 0.04


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6])
def test_scale_changes_nothing(scale: float, key: jax.Array):
    scene, gbuffer = half_shadow(1.0)
    scaled, scaled_gbuffer = half_shadow(scale)
    seen = direct_light(scene, EmbreeTracer(scene.mesh), gbuffer, key)
    assert_close(direct_light(scaled, EmbreeTracer(scaled.mesh), scaled_gbuffer, key), seen, scale=5)


def test_far_from_the_origin_light_still_arrives(key: jax.Array):
    """At coordinates of 1000 the rounding error is 6e-5: neither floor nor lamp may shadow itself."""
    scene, gbuffer = half_shadow(1.0)
    moved, moved_gbuffer = half_shadow(1.0, 1000.0)
    seen = np.asarray(direct_light(scene, EmbreeTracer(scene.mesh), gbuffer, key))
    shifted = np.asarray(direct_light(moved, EmbreeTracer(moved.mesh), moved_gbuffer, key))
    np.testing.assert_allclose(shifted, seen, rtol=1e-3)  # coordinates are rounded by 6e-5


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_lamp_on_the_ceiling_is_not_hidden_by_it(scale: float, key: jax.Array):
    lamp = PunctualLight("lamp", (1, 1, 1), (0.3 * scale, 2.7 * scale, 0.1 * scale))
    scene = scene_of(square("ceiling", GREY, size=5 * scale, centre=(0, 2.7 * scale, 0)), lights=[lamp])
    gbuffer = points(grid(20) * scale, largest=2.7 * scale)
    assert (np.asarray(direct_light(scene, EmbreeTracer(scene.mesh), gbuffer, key)) > 0).all()


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
