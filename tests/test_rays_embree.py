"""Embree against the brute-force oracle: identical hits, shared edges and grazing rays included."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import scenes
from jaxrefl._types import Mesh, Rays
from jaxrefl.core import look_at
from jaxrefl.rays import BruteTracer, EmbreeTracer, camera_rays
from jaxrefl.scene import assemble

SMALL = 1000
"""Triangles of each built-in scene in these tests."""
SAME_POINT = 2e-5
"""Two hits this close, in shares of the largest coordinate, are the same point: edge-sharing triangles may swap."""
BORDER = 2e-5
"""Barycentric weight below which a hit lies on its triangle's border, where outlines may go either way in float32."""


@pytest.fixture(scope="module", params=list(scenes.BUILT_IN))
def small_scene(request):
    return request.param, assemble(scenes.build(request.param, triangles=SMALL))


def random_rays(scene, count: int, seed: int) -> Rays:
    """Rays from anywhere in the bounding box to anywhere."""
    rng = np.random.default_rng(seed)
    lower, upper = np.asarray(scene.lower), np.asarray(scene.upper)
    origin = rng.uniform(lower, upper, (count, 3))
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(jnp.asarray(origin, jnp.float32), jnp.asarray(direction, jnp.float32))


def on_border(hits) -> np.ndarray:
    u, v = np.asarray(hits.barycentric).T
    return np.minimum(np.minimum(u, v), 1 - u - v) < BORDER


def assert_same_hits(scene, rays: Rays) -> None:
    """The same points are hit; only at an outline, within `BORDER` of an edge, may the two disagree."""
    ours, oracle = EmbreeTracer(scene.mesh).closest(rays), BruteTracer(scene.mesh).closest(rays)
    hit, hit_oracle = np.asarray(ours.valid), np.asarray(oracle.valid)
    t, t_oracle = np.where(hit, ours.t, np.inf), np.where(hit_oracle, oracle.t, np.inf)
    scale = max(abs(scene.lower).max(), abs(scene.upper).max()) + np.minimum(t, t_oracle)
    both = hit & hit_oracle
    apart = np.where(both, np.abs(np.asarray(ours.t) - np.asarray(oracle.t)), 0)
    differ = (hit != hit_oracle) | (apart > SAME_POINT * np.asarray(scale))
    # A ray that starts on a surface hits it or not by rounding alone.
    differ &= np.minimum(t, t_oracle) > SAME_POINT * np.asarray(scale)
    nearer_on_border = np.where(t < t_oracle, on_border(ours), on_border(oracle))
    assert not (differ & ~nearer_on_border).any(), np.flatnonzero(differ & ~nearer_on_border)
    assert differ.mean() < 0.05
    same = both & (np.asarray(ours.triangle) == np.asarray(oracle.triangle))
    weights = np.abs(np.asarray(ours.barycentric - oracle.barycentric)).max(-1)
    assert np.quantile(weights[same], 0.99) < 1e-3


def test_random_rays_hit_the_same_points(small_scene):
    _, scene = small_scene
    assert_same_hits(scene, random_rays(scene, 2000, 1))


def test_rays_at_vertices_and_edges_never_slip_through(small_scene):
    """Rays aimed exactly at vertices and edge midpoints of closed shapes hit at that point or before it."""
    _, scene = small_scene
    faces, vertices = np.asarray(scene.mesh.faces), np.asarray(scene.mesh.vertices)
    rng = np.random.default_rng(2)
    chosen = faces[rng.integers(0, len(faces), 1000)]
    middle = (vertices[chosen[:, 0]] + vertices[chosen[:, 1]]) / 2
    eye = np.asarray(scene.lower + 0.45 * (scene.upper - scene.lower), np.float32)
    direction = (middle - eye).astype(np.float64)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    rays = Rays(jnp.broadcast_to(jnp.asarray(eye), middle.shape), jnp.asarray(direction, jnp.float32))
    assert_same_hits(scene, rays)


@pytest.mark.parametrize("tracer_of", [EmbreeTracer, BruteTracer])
@pytest.mark.parametrize("eye", [(0.0, 0.0, 0.0), (0.11, 0.07, -0.2)])
def test_closed_shapes_do_not_leak(tracer_of, eye):
    """From inside a ball every ray hits, however exactly it is aimed at a vertex or an edge."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    ends = ball.vertices[ball.edges_unique]
    targets = np.concatenate([ball.vertices, ends.mean(1), 0.3 * ends[:, 0] + 0.7 * ends[:, 1]])
    direction = targets - np.asarray(eye)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    rays = Rays(jnp.asarray(np.broadcast_to(eye, direction.shape), jnp.float32), jnp.asarray(direction, jnp.float32))
    faces = jnp.asarray(ball.faces, jnp.int32)
    zero = jnp.zeros(len(faces), jnp.int32)
    tracer = tracer_of(Mesh(jnp.asarray(ball.vertices, jnp.float32), faces, material=zero, object=zero))
    assert bool(tracer.closest(rays).valid.all())


def test_grazing_rays_agree(small_scene):
    """Rays nearly within the plane of the triangle they are aimed at."""
    _, scene = small_scene
    faces, vertices = np.asarray(scene.mesh.faces), np.asarray(scene.mesh.vertices).astype(np.float64)
    rng = np.random.default_rng(3)
    corners = vertices[faces[rng.integers(0, len(faces), 1000)]]
    centre, edge = corners.mean(1), corners[:, 1] - corners[:, 0]
    normal = np.cross(edge, corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(edge, axis=1, keepdims=True)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    origin = centre + edge + 1e-2 * length * normal
    direction = (centre - origin) / np.linalg.norm(centre - origin, axis=1, keepdims=True)
    assert_same_hits(scene, Rays(jnp.asarray(origin, jnp.float32), jnp.asarray(direction, jnp.float32)))


def test_occlusion_is_a_closest_hit_within_reach(small_scene):
    _, scene = small_scene
    rays = random_rays(scene, 1000, 4)
    tracer = EmbreeTracer(scene.mesh)
    hits = tracer.closest(rays)
    beyond = jnp.where(hits.valid, hits.t * 1.01, 1.0)
    before = jnp.where(hits.valid, hits.t * 0.99, 0.0)
    assert bool((tracer.occluded(rays, beyond)[hits.valid]).all())
    assert not bool(tracer.occluded(rays, before).any())


def triangle_scene():
    from jaxrefl.scene.description import Description, Part, matte

    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    return assemble(Description("one triangle", [Part("t", vertices, np.array([[0, 1, 2]]), matte("m", (1, 1, 1)))]))


def test_misses_are_a_mask_with_zeros():
    tracer = EmbreeTracer(triangle_scene().mesh)
    rays = Rays(jnp.array([[0.2, 0.3, 2.0], [3, 3, 2]]), jnp.array([[0.0, 0, -1], [0, 0, -1]]))
    hits = tracer.closest(rays)
    assert hits.valid.tolist() == [True, False]
    np.testing.assert_allclose(hits.t, [2, 0])
    np.testing.assert_allclose(hits.barycentric, [[0.2, 0.3], [0, 0]], atol=1e-6)
    assert tracer.rays == 2


@pytest.mark.parametrize("tracer_of", [EmbreeTracer, BruteTracer])
def test_inactive_rays_are_not_cast(tracer_of):
    tracer = tracer_of(triangle_scene().mesh)
    rays = Rays(jnp.full((4, 3), 0.25) + jnp.array([[0.0, 0, 2]] * 4), jnp.array([[0.0, 0, -1]] * 4))
    hits = tracer.closest(rays, active=jnp.array([True, False, False, True]))
    assert hits.valid.tolist() == [True, False, False, True]
    assert tracer.rays == 2
    blocked = tracer.occluded(rays, jnp.array([0.0, 9.0, 1.0, 9.0]))
    assert blocked.tolist() == [False, True, False, True]
    assert tracer.rays == 5


@pytest.mark.parametrize("tracer_of", [EmbreeTracer, BruteTracer])
def test_rows_of_an_image_are_the_rows_of_the_whole(tracer_of):
    camera = look_at((0.3, 0.3, 2), (0.3, 0.3, 0), size=(7, 6))
    rays = camera_rays(camera)
    tracer = tracer_of(triangle_scene().mesh)
    whole, part = tracer.closest(rays), tracer.closest_rows(rays, 2, 3)
    assert jax.tree.all(jax.tree.map(lambda x, y: bool((x[2:5] == y).all()), whole, part))
