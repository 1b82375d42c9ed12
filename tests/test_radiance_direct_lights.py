"""Direct light of each kind of light, against closed forms and brute-force integrals; shadows."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lit_points import GREY, UNIT, Clear, grid, half_shadow, irradiance_of, points, scene_of, square
from reference import direct as reference
from reference import lookup
from tolerances import assert_close

from jaxrefl.radiance.direct import DirectOptions, direct_light
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import Image, PunctualLight, Sky, constant_sky, emitter


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
