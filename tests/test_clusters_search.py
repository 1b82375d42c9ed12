"""Rays through depth images: the walk, its pyramid, what need not be rendered, and hits in mid air."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cluster_rooms import clusters_of, room, run
from reference import clusters as slow
from shapes import QUAD

from jaxrefl._types import Frame, Mesh, Rays
from jaxrefl.core.safe import norm
from jaxrefl.rays import seen_by
from jaxrefl.rays.views import Views, texel_count
from jaxrefl.techniques import clusters
from jaxrefl.techniques.clusters import Found
from jaxrefl.techniques.clusters.confirm import confirmed
from jaxrefl.techniques.clusters.depth_images import DepthImages, make_depth_images
from jaxrefl.techniques.clusters.hierarchy import follow_levels, pyramid_of
from jaxrefl.techniques.clusters.needed import needed_texels
from jaxrefl.techniques.clusters.traverse import follow, project_rays


def depth_image(seed: int, *, smooth: bool):
    """A view along +z from the origin, of random planes far and near, or of one rising plane."""
    rng = np.random.default_rng(seed)
    h, w = 12, 16
    image = np.zeros((h, w, 3))
    image[..., 0] = 0.1 if smooth else rng.choice([0.08, 0.1, 0.25], (h, w))
    if not smooth:
        image[..., 0] = np.kron(image[::4, ::4, 0], np.ones((4, 4)))
        image[..., 1:] = np.kron(rng.uniform(-2e-3, 2e-3, (3, 4, 2)), np.ones((4, 4, 1)))
        column, row = np.meshgrid(np.arange(w) % 4 - 1.5, np.arange(h) % 4 - 1.5)
        image[..., 0] += image[..., 1] * column + image[..., 2] * row
    low, pitch = np.array([-0.8, -0.6]), np.array([0.1, 0.1])
    views = Views(
        eye=jnp.zeros((1, 3)),
        axes=jnp.eye(3)[None],
        low=jnp.asarray(low[None], jnp.float32),
        pitch=jnp.asarray(pitch[None], jnp.float32),
        size=jnp.array([[w, h]], jnp.int32),
        offset=jnp.zeros(1, jnp.int32),
        clip=jnp.array([[0, 0, 0, 1]], jnp.float32),
        own=jnp.full(1, -1, jnp.int32),
        unseen=jnp.zeros(1, jnp.int32),
    )
    return image, views, low, pitch


def random_rays(seed: int, count: int) -> Rays:
    rng = np.random.default_rng(seed + 1)
    origin = np.stack([rng.uniform(-0.5, 0.5, count), rng.uniform(-0.4, 0.4, count), np.full(count, 1.0)], -1)
    toward = np.stack([rng.uniform(-9, 9, count), rng.uniform(-7, 7, count), np.full(count, 18.0)], -1) - origin
    toward = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
    return Rays(jnp.asarray(origin, jnp.float32), jnp.asarray(toward, jnp.float32))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_plane_is_met_exactly(seed: int):
    image, views, *_ = depth_image(seed, smooth=True)
    rays, view = random_rays(seed, 200), jnp.zeros(200, jnp.int32)
    reach = jnp.full(200, 16.0)
    lines, ahead = project_rays(views, view, rays, reach)
    found = follow(jnp.asarray(image.reshape(-1, 3), jnp.float32), lines, ahead, steps=64)
    inside = np.asarray(seen_by(views, view, rays.origin + rays.direction * reach[:, None]))
    assert (np.asarray(found.found)[inside] == Found.SURFACE).all() and inside.sum() > 100
    depth = lines.start_z + (lines.end_z - lines.start_z) * found.share
    np.testing.assert_allclose(depth[inside], 0.1, rtol=1e-5)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_walk_is_that_of_the_slow_reference(seed: int):
    """Over disconnected planes: where both find a crossing it is the same, for all but a few thin ones."""
    image, views, low, pitch = depth_image(seed, smooth=False)
    count = 60
    rays, view = random_rays(seed, count), jnp.zeros(count, jnp.int32)
    lines, ahead = project_rays(views, view, rays, jnp.full(count, 16.0))
    crossing = follow(jnp.asarray(image.reshape(-1, 3), jnp.float32), lines, ahead, steps=256)
    depth = lines.start_z + (lines.end_z - lines.start_z) * crossing.share
    t = np.asarray(16.0 * crossing.share * lines.end_z / depth)
    same, both = 0, 0
    for i in range(count):
        ray = (np.asarray(rays.origin, np.float64)[i], np.asarray(rays.direction, np.float64)[i])
        expected = slow.intersect(image, np.zeros(3), *ray, 16.0, low=low, pitch=pitch, steps=4000)
        hit = int(crossing.found[i]) in (Found.SURFACE, Found.PASSED) and float(crossing.share[i]) < 1
        if expected is not None and hit:
            both, same = both + 1, same + (abs(t[i] - expected) < 0.02)
    assert both >= 15 and same >= 0.95 * both, (same, both)  # steps of a texel may pass the corner of one


def test_what_is_crossed_just_before_its_edge_is_met():
    """Beside a wall the image shows the sky: a ray that goes through the wall within its last texel meets it."""
    image, views, *_ = depth_image(0, smooth=True)
    image[:, 8:] = 0  # nothing to the right of the axis; the wall is at z = 10
    start = np.linspace(-2.0, -0.5, 40)
    origin = np.stack([start, 0 * start, 0 * start + 4], -1)
    target = np.stack([np.linspace(0.05, 0.6, 40), 0 * start, np.linspace(10.2, 15, 40)], -1)
    crossing = origin + (target - origin) * ((10 - 4) / (target[:, 2] - 4))[:, None]
    toward = jnp.asarray(target - origin, jnp.float32)
    rays = Rays(jnp.asarray(origin, jnp.float32), toward / norm(toward)[:, None])
    lines, ahead = project_rays(views, jnp.zeros(40, jnp.int32), rays, norm(toward))
    found = follow(jnp.asarray(image.reshape(-1, 3), jnp.float32), lines, ahead, steps=64)
    through = crossing[:, 0] < -0.01
    assert 10 < through.sum() < 40
    assert (np.asarray(found.found)[through] == Found.SURFACE).all()
    np.testing.assert_allclose((lines.start_z + (lines.end_z - lines.start_z) * found.share)[through], 0.1, rtol=1e-4)


def test_going_behind_an_edge_is_hidden_and_coming_out_is_passed():
    image, views, *_ = depth_image(0, smooth=True)
    image[:, 8:12, 0] = 0.5  # a wall before the plane, at z = 2
    origin = jnp.array([[0.0, 0.0, 4.0], [-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    target = jnp.array([[1.2, 0.0, 6.0], [1.5, 0.0, 6.0], [7.0, 0.0, 11.0]])
    rays = Rays(origin, (target - origin) / norm(target - origin)[:, None])
    view = jnp.zeros(3, jnp.int32)
    lines, ahead = project_rays(views, view, rays, norm(target - origin))
    found = follow(jnp.asarray(image.reshape(-1, 3), jnp.float32), lines, ahead, steps=64).found
    assert int(found[0]) == Found.HIDDEN  # starts behind the wall and stays there
    assert int(found[1]) == Found.HIDDEN and int(found[2]) == Found.PASSED


def test_nearer_than_where_an_image_begins_nothing_is_known():
    """A ray that is there on its way is not taken at its word, whatever it meets after that."""
    image, views, *_ = depth_image(0, smooth=True)
    origin, target = jnp.array([[-1.0, 0.0, 2.0]]), jnp.array([[7.0, 0.0, 11.0]])
    rays, view = Rays(origin, (target - origin) / norm(target - origin)[:, None]), jnp.zeros(1, jnp.int32)
    lines, ahead = project_rays(views, view, rays, norm(target - origin))
    plane = jnp.asarray(image.reshape(-1, 3), jnp.float32)
    begin = np.full(image.shape[:2], np.inf, np.float32)
    ends = []
    for depth in (1.5, 20.0):
        begin[:, 5:9] = 1 / depth
        ends.append(int(follow(plane, lines, ahead, steps=64, begin=jnp.asarray(begin.reshape(-1))).found[0]))
    assert ends == [Found.SURFACE, Found.PASSED]


def view_of_blocks(seed: int, size: tuple[int, int]) -> tuple[jax.Array, Views]:
    """A view like that of `depth_image`, of so many texels, with gaps through which nothing is seen."""
    image, views, *_ = depth_image(seed, smooth=False)
    (w, h), rng = size, np.random.default_rng(seed)
    large = np.kron(image[:, :, :], np.ones((-(-h // 12), -(-w // 16), 1)))[:h, :w].copy()
    large[..., 1:] *= 0.3
    large[rng.random((h, w)) < 0.02] = 0
    views = dataclasses.replace(views, size=jnp.array([size], jnp.int32), pitch=jnp.array([[1.6 / w, 1.2 / h]]))
    return jnp.asarray(large.reshape(-1, 3), jnp.float32), views


def limits(seed: int, size: tuple[int, int]) -> jax.Array:
    """1 / z at which images begin: nearer than most rays are, and in some texels farther."""
    rng = np.random.default_rng(seed + 7)
    begin = np.where(rng.random(size[0] * size[1]) < 0.05, 0.15, 2.0)
    return jnp.asarray(begin, jnp.float32)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
@pytest.mark.parametrize("size", [(128, 96), (61, 5)])
@pytest.mark.parametrize("limited", [False, True])
def test_the_pyramid_finds_the_same_crossings(seed: int, size: tuple[int, int], limited: bool):
    """The same crossings as step by step, in fewer steps where lines are long."""
    plane, views = view_of_blocks(seed, size)
    begin = limits(seed, size) if limited else None
    count = 300
    rays, view = random_rays(seed, count), jnp.zeros(count, jnp.int32)
    lines, ahead = project_rays(views, view, rays, jnp.full(count, 16.0))
    one = follow(plane, lines, ahead, steps=512, begin=begin)
    two = follow_levels(plane, pyramid_of(plane, views, begin), lines, view, ahead, steps=512, begin=begin)
    for name in ("found", "texel"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), name)
    np.testing.assert_allclose(one.share, two.share, rtol=1e-5)
    assert limited or size[0] < 100 or int(two.steps.sum()) < 0.7 * int(one.steps.sum())


def test_the_pyramid_changes_no_picture(ball_room: Frame):
    one, _ = run(clusters, ball_room, repair="none", capacity=6)
    two, _ = run(clusters, ball_room, repair="none", capacity=6, search="pyramid")
    np.testing.assert_allclose(one.radiance, two.radiance, atol=1e-5)


@pytest.mark.parametrize("capacity", [4, 64])
def test_texels_that_are_not_rendered_are_not_missed(capacity: int, ball_room: Frame):
    """Every ray finds what it finds when all texels are rendered."""
    mirrors, found, cameras, _ = clusters_of(ball_room, capacity=capacity)
    options = clusters.Options(capacity=capacity)
    room_for = options.room(mirrors.valid.size)
    some = needed_texels(cameras, found, mirrors, room=room_for, block=1024)
    everything = jnp.arange(room_for) < texel_count(cameras.views)
    assert some.sum() <= everything.sum() and not (some & ~everything).any()
    label = jnp.maximum(found.label, 0)
    lines, ahead = project_rays(cameras.views, label, Rays(mirrors.p, mirrors.wi), cameras.reach[label])
    active = ahead & (found.label >= 0) & cameras.usable[label]
    ends = []
    for needed in (some, everything):
        images = make_depth_images(ball_room, cameras.views, needed, options=options)
        ends.append(follow(images.plane, lines, active, steps=1024))
    for name in ("found", "share", "texel"):
        np.testing.assert_array_equal(getattr(ends[0], name), getattr(ends[1], name), name)


def test_hits_in_mid_air_are_taken_back():
    """A shelf seen nearly edge on: its plane is met well before the shelf itself begins, one texel away."""
    corners = jnp.array([[-9.0, 0.225, 4.4], [9.0, 0.225, 4.4], [9.0, 0.225, 4.6], [-9.0, 0.225, 4.6]])
    mesh = Mesh(corners, jnp.asarray(QUAD, jnp.int32), jnp.zeros(2, jnp.int32), jnp.zeros(2, jnp.int32))
    _, views, *_ = depth_image(0, smooth=True)
    views = dataclasses.replace(
        views,
        low=jnp.array([[-0.02, -0.02]], jnp.float32),
        pitch=jnp.array([[0.02, 0.02]], jnp.float32),
        size=jnp.array([[2, 8]], jnp.int32),
    )
    row = np.arange(16) // 2
    shelf, level = row == 3, 0.05 / 0.225  # the row of slopes 0.04 to 0.06 shows it; far away is a wall
    plane = np.where(shelf[:, None], [level, 0, 0.02 / 0.225], [0.02, 0, 0]).astype(np.float32)
    triangle = jnp.asarray(np.where(shelf, 0, -1), jnp.int32)
    images = DepthImages(jnp.asarray(plane), jnp.zeros((16, 3), jnp.float32), triangle)
    origin = jnp.array([[0.001, 0.0, 1.0], [0.001, 0.1, 3.5]], jnp.float32)
    target = jnp.array([[0.001, 0.298, 5.09], [0.001, 0.275, 4.9]], jnp.float32)
    reach, view = norm(target - origin), jnp.zeros(2, jnp.int32)
    rays = Rays(origin, (target - origin) / reach[:, None])
    lines, ahead = project_rays(views, view, rays, reach)
    crossing = follow(images.plane, lines, ahead, steps=64)
    assert (np.asarray(crossing.found) == Found.SURFACE).all()
    after = confirmed(mesh, images, views, view, lines, crossing, rays, reach)
    assert after.found.tolist() == [Found.HIDDEN, Found.SURFACE]


@pytest.fixture(scope="module")
def ball_room() -> Frame:
    return room()
