"""Rasterisation against rays: coverage, depth, cracks, and triangles that pass the eye."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import scenes
from jaxrefl._types import Mesh
from jaxrefl.core import look_at, project, resize
from jaxrefl.rays import (
    BruteTracer,
    EmbreeTracer,
    camera_rays,
    draw_triangles,
    raster_camera,
    seen_by,
    texel_count,
    view_of,
    view_rays,
)
from jaxrefl.scene import assemble

SIZE = (48, 36)


def soup(vertices, faces) -> Mesh:
    faces = np.asarray(faces, np.int32)
    zero = np.zeros(len(faces), np.int32)
    return Mesh(jnp.asarray(vertices, jnp.float32), jnp.asarray(faces), jnp.asarray(zero), jnp.asarray(zero))


def grid(n: int, bumps: float) -> Mesh:
    """A bumpy sheet of 2 n n triangles that fills the view."""
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.linspace(-8, 8, n + 1), np.linspace(-8, 8, n + 1))
    z = bumps * rng.uniform(-1, 1, x.shape)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (i.reshape(-1) for i in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return soup(np.stack([x, y, z], -1).reshape(-1, 3), faces)


def test_a_view_of_a_camera_has_its_pixels():
    camera = look_at((1, 2, 5), (0, 0.3, 0), size=SIZE)
    views = view_of(camera)
    texel = jnp.arange(SIZE[0] * SIZE[1], dtype=jnp.int32)
    rays, view, sees = view_rays(views, texel)
    wanted = camera_rays(camera)
    assert int(texel_count(views)) == len(texel) and bool(sees.all())
    np.testing.assert_allclose(rays.direction, wanted.direction.reshape(-1, 3), atol=1e-6)
    p = rays.origin + 3 * rays.direction
    xy, _ = project(camera, p)
    column, row = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    np.testing.assert_allclose(xy, np.stack([column, row], -1).reshape(-1, 2), atol=1e-3)
    assert bool(seen_by(views, view, p).all()) and not bool(seen_by(views, view, 2 * rays.origin - p).any())


@pytest.mark.parametrize("name", ["mirror_room", "cornell"])
def test_rasterised_scenes_are_those_of_rays(name: str):
    """Coverage and triangles differ only where a pixel's centre lies on an edge: 0.1 % of the pixels at the most."""
    scene = assemble(scenes.build(name, triangles=4000))
    camera = scenes.BUILT_IN[name].path(1, size=(160, 120))[0]
    cast, drawn = EmbreeTracer(scene.mesh).closest(camera_rays(camera)), raster_camera(scene.mesh, camera)
    assert (np.asarray(cast.valid) != np.asarray(drawn.valid)).mean() <= 1e-3
    both = np.asarray(cast.valid & drawn.valid)
    same = both & (np.asarray(cast.triangle) == np.asarray(drawn.triangle))
    assert same.sum() >= 0.998 * both.sum()
    np.testing.assert_allclose(np.asarray(drawn.t)[same], np.asarray(cast.t)[same], rtol=1e-4)
    other = both & ~same
    assert (np.abs(np.asarray(drawn.t - cast.t))[other] > 1e-3 * np.asarray(cast.t)[other]).sum() <= 4  # thin edges


@given(seed=st.integers(0, 2**31 - 1))
def test_random_triangles_are_those_of_the_oracle(seed: int):
    """Triangles before, beside, behind and across the eye."""
    rng = np.random.default_rng(seed)
    mesh = soup(rng.uniform(-3, 3, (60, 3)), np.arange(60).reshape(20, 3))
    camera = look_at((0.3, 0.2, 1.0), (0, 0, -1), fov_y=70, size=SIZE)
    cast, drawn = BruteTracer(mesh).closest(camera_rays(camera)), raster_camera(mesh, camera)
    differ = np.asarray((cast.valid != drawn.valid) | (cast.triangle != drawn.triangle))
    assert differ.mean() < 0.005  # centres on edges; worst of 500 seeds: 0.0012
    agree = np.asarray(cast.valid) & ~differ
    np.testing.assert_allclose(np.asarray(drawn.t)[agree], np.asarray(cast.t)[agree], rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("eye", [(0, 0, 4), (0.5, 0.4, 2), (0, 0, 40)])
@pytest.mark.parametrize("n", [3, 40, 150])
def test_a_closed_sheet_has_no_cracks(eye, n: int):
    camera = look_at(eye, (0, 0, 0), fov_y=np.degrees(2 * np.arctan(2.0 / eye[2])), size=(96, 96))
    assert bool(raster_camera(grid(n, 0.02), camera).valid.all())


def test_of_two_at_one_depth_the_first_wins():
    corners = [[-2, -2, 0], [2, -2, 0], [0, 3, 0]]
    mesh = soup(corners * 2, [[3, 4, 5], [0, 1, 2]])
    hits = raster_camera(mesh, look_at((0, 0, 4), (0, 0, 0), size=SIZE))
    assert bool(hits.valid.any()) and int(hits.triangle.max()) == 0


def test_clipping_planes_and_unseen_sides():
    """Two walls that face the eye, belonging to objects 0 and 1, with the eye's first view cut between them."""
    wall = [[-9, -9, 0], [9, -9, 0], [0, 14, 0]]
    mesh = soup(wall + (np.asarray(wall) + [0, 0, -2]).tolist(), [[0, 1, 2], [3, 4, 5]])
    mesh = dataclasses.replace(mesh, object=jnp.array([0, 1], jnp.int32))
    views = view_of(look_at((0, 0, 4), (0, 0, 0), size=(6, 4)))

    def first_seen(begin=None, **changes) -> int:
        return int(draw_triangles(mesh, dataclasses.replace(views, **changes), room=24, begin=begin).max())

    assert first_seen() == 0
    assert first_seen(clip=jnp.array([[0, 0, -1, -1]], jnp.float32)) == 1
    assert first_seen(own=jnp.zeros(1, jnp.int32), unseen=jnp.ones(1, jnp.int32)) == 1
    assert first_seen(own=jnp.zeros(1, jnp.int32), unseen=jnp.full(1, 2, jnp.int32)) == 0
    assert first_seen(clip=jnp.array([[0, 0, -1, -3]], jnp.float32)) == -1
    assert first_seen(begin=jnp.full(24, 1 / 5, jnp.float32)) == 1 and first_seen(begin=jnp.full(24, 1 / 7)) == -1


def test_two_views_of_one_list_are_compiled_once():
    mesh, camera = grid(6, 0.1), look_at((0, 0, 4), (0, 0, 0), size=SIZE)
    raster_camera(mesh, camera)
    before = raster_camera._cache_size()
    raster_camera(mesh, look_at((1, 0, 3), (0, 0, 0), size=SIZE))
    assert raster_camera._cache_size() == before
    assert raster_camera(mesh, resize(camera, (20, 16))).valid.shape == (16, 20)


def test_rays_of_a_clipped_view_start_on_the_plane():
    views = view_of(look_at((0, 0, 4), (0, 0, 0), size=SIZE))
    clipped = dataclasses.replace(views, clip=jnp.array([[0, 0, -1, 1]], jnp.float32))
    rays, _, sees = jax.jit(view_rays)(clipped, jnp.arange(12, dtype=jnp.int32))
    np.testing.assert_allclose(rays.origin[:, 2], 1, atol=1e-6)
    assert bool(sees.all())
    behind = dataclasses.replace(views, clip=jnp.array([[0, 0, 1, -6]], jnp.float32))
    assert not bool(view_rays(behind, jnp.arange(12, dtype=jnp.int32))[2].any())
