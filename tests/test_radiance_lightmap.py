"""Baked diffuse light: closed forms, seams, sides, textures, files, and what it refuses."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shapes import QUAD, ball, floor

import jaxrefl as jr
from jaxrefl.core import look_at
from jaxrefl.radiance import (
    LightMapOptions,
    StaleLightMap,
    bake,
    baked_light,
    load_lightmap,
    save_lightmap,
    scene_fingerprint,
)
from jaxrefl.radiance.lightmap_atlas import GRID, make_atlas, places_of
from jaxrefl.radiance.lightmap_fill import filled
from jaxrefl.radiance.lightmap_sides import sides_of
from jaxrefl.radiance.lightmap_smooth import Surface, smoothed
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import (
    Description,
    Image,
    Part,
    PunctualLight,
    constant_sky,
    emitter,
    matte,
    mirror,
)
from jaxrefl.surface import look

WHITE = matte("white", (1.0, 1.0, 1.0))
SKY = constant_sky((1.0, 1.0, 1.0))
QUICK = LightMapOptions(texels=1024, samples=16)


def box(name: str, material, *, centre=(0.0, 0.5, 0.0), size: float = 1.0) -> Part:
    """A closed cube with outward faces and a corner per vertex."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) * size / 2
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [[s[0], s[i], s[i + 1]] for s in sides for i in (1, 2)]
    return Part(name, corners + np.asarray(centre), np.array(faces), material)


def baked(*parts: Part, options: LightMapOptions = QUICK, **light):
    """A scene with its light map."""
    scene = assemble(Description("test", list(parts), **light))
    return dataclasses.replace(scene, lightmap=bake(scene, EmbreeTracer(scene.mesh), options=options))


def seen(scene, eye, target=(0.0, 0.0, 0.0), size=(48, 48)):
    """Baked light and what a camera sees, where it sees something."""
    gbuffer = look(scene, EmbreeTracer(scene.mesh), look_at(eye, target, size=size))
    return np.asarray(baked_light(scene, gbuffer)), gbuffer


def test_a_convex_object_in_a_white_world_is_white():
    scene = baked(box("box", WHITE), sky=SKY)
    light, gbuffer = seen(scene, (3, 2, 4), (0, 0.5, 0))
    assert scene.lightmap is not None and scene.lightmap.light.shape[0] == 1  # nobody sees the inside
    # The sky is sampled in proportion to the cosine, so only roundings are left: 2e-6 measured.
    np.testing.assert_allclose(light[np.asarray(gbuffer.valid)], 1, atol=2e-5)
    assert (light[~np.asarray(gbuffer.valid)] == 0).all()


@pytest.mark.parametrize("smoothing", [False, True])
def test_a_floor_under_a_lamp_has_the_light_of_the_closed_form(smoothing: bool):
    """A point light at height h: irradiance I cos / d^2, without any noise."""
    lamp = PunctualLight("lamp", (3.0, 3.0, 3.0), position=(0.0, 2.0, 0.0))
    options = LightMapOptions(texels=4096, samples=8, smoothing=smoothing)
    scene = baked(floor("floor", matte("grey", (0.5, 0.5, 0.5)), size=1.5), lights=[lamp], options=options)
    light, gbuffer = seen(scene, (0, 3, 0.1))
    ok = np.asarray(gbuffer.valid)
    p = np.asarray(gbuffer.p, np.float64)[ok] - [0, 2, 0]
    distance = np.linalg.norm(p, axis=-1)
    expected = 0.5 / np.pi * 3 * 2 / distance**3
    error = light[ok][:, 0] / expected - 1
    assert np.sqrt((error**2).mean()) < 0.001  # 0.0005 measured
    assert np.abs(error).max() < 0.003  # 0.0013 measured, smoothed; 0.0005 as baked


@pytest.mark.slow
def test_area_light_close_to_a_wall_is_not_noisy():
    """A square lamp just above the floor, against the same light from a quadrature of 512^2 points of the lamp."""
    height, half = 0.1, 0.5
    lamp = floor("lamp", emitter("glow", (1.0, 1.0, 1.0)), size=half, height=height)
    options = LightMapOptions(texels=2048, samples=64, bounces=1, smoothing=False)
    scene = baked(floor("floor", WHITE, size=1.0), lamp, options=options)
    light, gbuffer = seen(scene, (1.5, 0.05, 0.0), (0, 0.0, 0), size=(64, 32))
    ok = np.asarray(gbuffer.valid & (gbuffer.object == 0)) & (np.asarray(gbuffer.p)[..., 1] < 1e-3)
    p = np.asarray(gbuffer.p, np.float64)[ok][::7]
    x = (np.arange(512) + 0.5) / 512 * 2 * half - half
    square = (x[:, None] - p[:, 0, None, None]) ** 2 + (x[None] - p[:, 2, None, None]) ** 2 + height**2
    expected = (height**2 / square**2).sum((1, 2)) * (2 * half / 512) ** 2 / np.pi
    error = light[ok][::7, 0] - expected
    assert np.sqrt((error**2).mean()) / expected.mean() < 0.05  # 0.026 measured


@pytest.mark.slow
def test_light_is_continuous_across_seams():
    """A ball under a point light: many charts, one smooth function of the normal."""
    sun = PunctualLight("sun", (np.pi,) * 3, direction=(0.0, -1.0, 0.0), directional=True)
    options = LightMapOptions(texels=16384, samples=8)
    scene = baked(ball("ball", WHITE, subdivisions=4), lights=[sun], options=options)
    light, gbuffer = seen(scene, (0, 3, 1), size=(96, 96))
    cosine = np.asarray(gbuffer.ns)[..., 1]
    lit = np.asarray(gbuffer.valid) & (cosine > 0.2)
    assert np.abs(light[lit][:, 0] - cosine[lit]).max() < 0.02  # 0.011 measured, where charts meet


def test_both_sides_of_a_thin_wall_have_their_own_light():
    sun = PunctualLight("sun", (np.pi,) * 3, direction=(0.0, -1.0, 0.0), directional=True)
    scene = baked(floor("leaf", WHITE), lights=[sun])
    above, up = seen(scene, (0, 3, 0.1))
    below, down = seen(scene, (0, -3, 0.1))
    np.testing.assert_allclose(above[np.asarray(up.valid)], 1, atol=2e-5)
    assert (below[np.asarray(down.valid)] == 0).all() and np.asarray(down.valid).any()


@pytest.mark.slow
def test_a_room_seen_from_inside_is_baked_inside():
    """The furnace: a closed white box that contains a lamp and loses nothing but what its walls take."""
    lamp = box("lamp", emitter("glow", (1.0, 1.0, 1.0)), centre=(0, 0, 0), size=0.5)
    room = box("room", matte("half", (0.5, 0.5, 0.5)), centre=(0, 0, 0), size=4.0)
    scene = baked(room, lamp, options=LightMapOptions(texels=1024, samples=64, bounces=64))
    light, gbuffer = seen(scene, (1.5, 0.2, 0.3), (-2, 0, 0))
    ok = np.asarray(gbuffer.valid & (gbuffer.object == 0))
    # What the lamp gives out, pi per area, is what the walls and the lamp absorb: bounded from both sides.
    assert 0.001 < light[ok].mean() < 1
    assert scene.lightmap is not None and scene.lightmap.light.shape[0] == 2
    assert sides_of(scene).baked.any(0).all()


def test_textures_stay_sharp():
    """A checkerboard finer than the texels of the map."""
    checks = np.indices((16, 16)).sum(0) % 2 * 255
    rgba = np.stack([checks, checks, checks, np.full_like(checks, 255)], -1).astype(np.uint8)
    corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]], float)
    uv = np.array([[0, 0], [0, 1], [1, 1], [1, 0]], float)
    part = Part("floor", corners, QUAD, WHITE.replace(base_colour_texture=Image("checks", rgba)), uv=uv)
    scene = baked(part, sky=SKY, options=LightMapOptions(texels=64, samples=8))
    light, gbuffer = seen(scene, (0, 1.0, 0.01), size=(128, 128))
    ok = np.asarray(gbuffer.valid)
    np.testing.assert_allclose(light[ok], np.asarray(gbuffer.base_colour)[ok], atol=2e-5)
    assert light[ok].std() > 0.15  # that of a bilinear checkerboard is 1/6; blurred by the map it would be near 0


def test_no_shadow_leaks_out_from_under_a_crate():
    """The floor within the crate is black, the floor beside it is not; the crate stands in the middle of texels."""
    lamp = constant_sky((1.0, 1.0, 1.0))
    crate = box("crate", mirror("steel"), centre=(0.013, 0.45, 0.007), size=1.0)
    options = LightMapOptions(texels=4096, samples=16, smoothing=False)
    scene = baked(floor("floor", WHITE, size=2.0), crate, sky=lamp, options=options)
    gbuffer = look(scene, EmbreeTracer(scene.mesh), look_at((0, 400, 0.1), (0, 0, 0), fov_y=0.5, size=(128, 128)))
    light, p = np.asarray(baked_light(scene, gbuffer)), np.asarray(gbuffer.p)
    beside = np.asarray(gbuffer.object == 0) & (np.abs(p[..., 0] - 0.013) < 0.56) & (np.abs(p[..., 2] - 0.007) < 0.56)
    assert beside.sum() > 20
    # Beside a mirror the floor sees the sky all around, half of it mirrored: about 0.97 of the white world.
    assert light[beside].min() > 0.8  # 0.84 measured, noise included; a leak would be near 0


def test_inner_sides_are_those_of_solid_objects():
    scene = assemble(Description("x", [box("crate", WHITE), floor("floor", WHITE)], sky=SKY))
    sides = sides_of(scene)
    crate = np.asarray(scene.mesh.object) == 0
    assert sides.inner[1, crate].all() and not sides.inner[0].any() and not sides.inner[:, ~crate].any()
    turned = Part("crate", box("crate", WHITE).vertices, box("crate", WHITE).faces[:, ::-1], WHITE)
    assert sides_of(assemble(Description("x", [turned], sky=SKY))).inner[0].all()
    within = box("pea", WHITE, size=0.1)
    assert not sides_of(assemble(Description("x", [box("crate", WHITE), within], sky=SKY))).inner[:, :12].any()


def test_charts_cover_what_they_should():
    scene = assemble(Description("x", [floor("floor", WHITE, size=1.0)]))
    atlas = make_atlas(scene, 1024)
    places = places_of(atlas)
    assert atlas.placed.all() and 1000 < len(places.texel) < 1300
    assert set(np.unique(places.triangle)) == {0, 1} and places.place.max() == GRID * GRID - 1
    scaled = assemble(Description("x", [floor("floor", WHITE, size=1000.0)]))
    assert make_atlas(scaled, 1024).width == atlas.width
    nothing = assemble(Description("x", [floor("floor", mirror("m"))]))
    assert not make_atlas(nothing, 64).placed.any()


def test_scenes_without_diffuse_surfaces_are_black():
    scene = baked(floor("floor", mirror("m")), sky=SKY)
    light, _ = seen(scene, (0, 3, 0.1))
    assert (light == 0).all()


def test_filling_reaches_neighbours_and_stops():
    light = np.zeros((1, 30, 3), np.float32)
    light[0, 0] = 2
    known = np.arange(30)[None] == 0
    out = filled(light, known)
    assert (out[0, :9] == 2).all() and (out[0, 9:] == 0).all()


def test_smoothing_removes_noise_and_keeps_edges(rng):
    h, w = 64, 64
    truth = np.ones((h, w, 3), np.float32) * np.where(np.arange(w) < w // 2, 1.0, 0.1)[None, :, None].astype(np.float32)
    halves = truth * (1 + 0.3 * rng.standard_normal((2, h, w, 3)).astype(np.float32))
    y, x = np.indices((h, w))
    surface = Surface(
        np.stack([x, y, 0 * x], -1).astype(np.float32),
        np.broadcast_to(np.array([0, 0, 1], np.float32), (h, w, 3)),
        np.ones((h, w), np.float32),
    )
    before = np.sqrt(((halves.mean(0) - truth) ** 2).mean())
    after = np.sqrt(((smoothed(halves, surface) - truth) ** 2).mean())
    assert after < 0.5 * before


def test_a_map_comes_back_from_its_file_and_only_for_its_scene(tmp_path):
    scene = baked(floor("floor", WHITE), sky=SKY, options=LightMapOptions(texels=64, samples=8))
    assert scene.lightmap is not None
    path = tmp_path / "map.npz"
    save_lightmap(scene.lightmap, path)
    back = load_lightmap(path, scene)
    assert back.fingerprint == scene_fingerprint(scene) and back.options == scene.lightmap.options
    for a, b in zip(jax.tree.leaves(back), jax.tree.leaves(scene.lightmap), strict=True):
        np.testing.assert_array_equal(a, b)
    other = assemble(Description("test", [floor("floor", matte("grey", (0.4, 0.5, 0.5)))], sky=SKY))
    with pytest.raises(StaleLightMap, match="other geometry, materials or lights"):
        load_lightmap(path, other)
    (tmp_path / "text.npz").write_text("no map")
    with pytest.raises(ValueError, match="expected a light map"):
        load_lightmap(tmp_path / "text.npz", scene)


def test_what_cannot_be_baked_is_refused():
    scene = assemble(Description("x", [floor("floor", WHITE)], sky=SKY))
    moving = dataclasses.replace(scene, features=dataclasses.replace(scene.features, moving=True))
    with pytest.raises(ValueError, match="static scenes only"):
        bake(moving, EmbreeTracer(scene.mesh))
    gbuffer = look(scene, EmbreeTracer(scene.mesh), look_at((0, 3, 0.1), (0, 0, 0), size=(4, 4)))
    with pytest.raises(ValueError, match="has no light map"):
        baked_light(scene, gbuffer)
    for wrong in ({"texels": 3}, {"samples": 0}, {"bounces": 0}):
        with pytest.raises(ValueError, match="expected a whole number"):
            LightMapOptions(**wrong)


def test_look_up_is_differentiable_and_compiles_once():
    scene = baked(floor("floor", WHITE), sky=SKY, options=LightMapOptions(texels=64, samples=8))
    tracer = EmbreeTracer(scene.mesh)
    views = [look(scene, tracer, look_at((x, 3, 0.1), (0, 0, 0), size=(8, 8))) for x in (0.0, 0.5)]

    def total(p, colour, scene, gbuffer):
        return baked_light(scene, dataclasses.replace(gbuffer, p=p, base_colour=colour)).sum()

    for gbuffer in views:
        slopes = jax.grad(total, argnums=(0, 1))(gbuffer.p, gbuffer.base_colour, scene, gbuffer)
        assert all(bool(jnp.isfinite(x).all()) for x in slopes)
        assert float(jnp.abs(slopes[1]).max()) > 0
    before = baked_light._cache_size()
    for gbuffer in views:
        baked_light(scene, gbuffer)
    assert baked_light._cache_size() <= before + 1


def test_progress_ends_at_its_total():
    told = []
    scene = assemble(Description("x", [floor("floor", WHITE)], sky=SKY))
    options = LightMapOptions(texels=64, samples=16)
    bake(scene, jr.EmbreeTracer(scene.mesh), options=options, progress=lambda *x: told.append(x))
    assert told[-1][0] == told[-1][1] and [d for d, _ in told] == sorted(d for d, _ in told)
