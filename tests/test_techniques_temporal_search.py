"""Searching for reflections: against NumPy, closed forms and a root finder, on analytic mirrors."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mirror_views import MIRRORS, SIZE, camera_at, true_places, view
from reference import temporal as slow
from tolerances import assert_close

from jaxrefl._types import Frame
from jaxrefl.core import mirror_point, project
from jaxrefl.techniques._reproject import GridMesh, draw, seen_before
from jaxrefl.techniques._tracing import TraceOptions
from jaxrefl.techniques.temporal.flat import mirrors_of, pose
from jaxrefl.techniques.temporal.kept import flatten
from jaxrefl.techniques.temporal.match import search
from jaxrefl.techniques.temporal.neighbourhood import distance, match_pixels
from jaxrefl.techniques.temporal.refine import refine
from jaxrefl.techniques.temporal.shift import starts
from jaxrefl.techniques.temporal.types import Options, Params, Reason

OPTIONS = Options(stride=1, block=4096, late_steps=8)


def frame_of(gbuffer, camera) -> Frame:
    """A frame without a scene: searching needs none."""
    frame = object.__new__(Frame)
    for name, value in {"gbuffer": gbuffer, "camera": camera}.items():
        object.__setattr__(frame, name, value)
    return frame


@pytest.mark.parametrize("name", ["ball", "plane"])
def test_the_published_search_is_algorithm_2(name: str):
    _, buffer = view(MIRRORS[name], camera_at(0))
    camera, params = camera_at(1.5), Params()
    result, reason = match_pixels(buffer, None, camera, params, options=OPTIONS)
    arrays = {
        "p": np.asarray(buffer.p, np.float64),
        "n": np.asarray(buffer.ns, np.float64),
        "reflected": np.asarray(buffer.reflected, np.float64),
        "owner": np.where(np.asarray(buffer.valid), np.asarray(buffer.object), -1),
        "t": np.asarray(buffer.t, np.float64),
    }
    codes = {slow.FOUND: Reason.REUSED, slow.SILHOUETTE: Reason.SILHOUETTE,
             slow.OUTSIDE: Reason.OUTSIDE, slow.STEPS: Reason.STEPS}  # fmt: skip
    eye = np.asarray(camera.world_from_camera, np.float64)[:3, 3]
    same, pixels = 0, np.argwhere(np.asarray(buffer.valid))[::7]
    ended = set()
    for y, x in pixels:
        offset, how = slow.match(x, y, (0, 0), eye, arrays, 150, float(params.discontinuity))
        ended.add(how)
        same += bool(codes[how] == int(reason[y, x]) and tuple(np.asarray(result.place[y, x], int)) == offset)
    # Neighbours that are equally good to float32 may win in either order: 0.0 to 1.5 % of the pixels differ.
    assert same >= 0.97 * len(pixels) and {slow.FOUND, slow.SILHOUETTE} <= ended


def test_drawing_is_that_of_the_reference():
    rng, (w, h) = np.random.default_rng(3), (14, 11)
    here = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), -1)
    xy = (1.2 * here - 1.5 + rng.uniform(-0.6, 0.6, here.shape)).astype(np.float32)
    xy[3, 4] += 5  # a vertex that makes triangles too large, and some that cover many pixels
    depth, connected = rng.uniform(1, 2, (h, w)).astype(np.float32), rng.random((h, w)) < 0.9
    owner, target = rng.integers(0, 2, (h, w)).astype(np.int32), rng.integers(0, 2, (h + 2, w + 3)).astype(np.int32)
    mesh = GridMesh(jnp.asarray(xy), jnp.asarray(depth), jnp.asarray(connected), jnp.asarray(owner))
    drawn, expected = draw(mesh, jnp.asarray(target)), slow.draw(xy, depth, connected, owner, target)
    same = np.asarray(drawn.valid) == ~np.isnan(expected[..., 0])
    assert same.all() and same.size == 221 and np.asarray(drawn.valid).mean() > 0.3
    np.testing.assert_allclose(drawn.uv[drawn.valid], expected[np.asarray(drawn.valid)], atol=2e-4)
    assert int(drawn.too_wide) == 0


def test_ties_are_decided_the_same_way_every_time():
    """A mesh folded onto itself at one depth: everywhere the triangle with the smaller number."""
    h, w = 6, 12
    column, row = np.meshgrid(np.arange(w), np.arange(h))
    folded = np.minimum(column, w - 1 - column)
    xy = jnp.asarray(np.stack([folded + 0.5, row + 0.5], -1), jnp.float32)
    one, zero = jnp.ones((h, w), jnp.float32), jnp.zeros((h, w), jnp.int32)
    mesh = GridMesh(xy, one, jnp.ones((h, w), bool), zero)
    first, second = draw(mesh, zero), draw(mesh, zero)
    assert (first.uv == second.uv).all()
    covered = np.asarray(first.uv[..., 0])[np.asarray(first.valid)]
    assert covered.max() <= w / 2  # the left half is numbered before the right one, row by row


def test_no_motion_draws_each_pixel_onto_itself():
    here = np.stack(np.meshgrid(np.arange(9) + 0.5, np.arange(7) + 0.5), -1).astype(np.float32)
    one, zero = jnp.ones((7, 9), jnp.float32), jnp.zeros((7, 9), jnp.int32)
    drawn = draw(GridMesh(jnp.asarray(here), one, jnp.ones((7, 9), bool), zero), zero)
    assert bool(drawn.valid.all())
    np.testing.assert_allclose(drawn.uv, here, atol=1e-6)


def places(name: str, step: float):
    """Searched, drawn and refined places, and what they are searched in."""
    _, buffer = view(MIRRORS[name], camera_at(0))
    gbuffer, exact = view(MIRRORS[name], camera_at(step))
    frame = frame_of(gbuffer, camera_at(step))
    mirrors, smooth = mirrors_of(gbuffer, Params().sharp), gbuffer.alpha == 0
    found = search(buffer, None, mirrors, frame.camera, options=OPTIONS)
    uv, covered, _ = starts(buffer, found, frame, smooth & gbuffer.valid, options=OPTIONS)
    return buffer, exact, found, refine(flatten(buffer), mirrors.rays, smooth, uv, covered, options=OPTIONS)


def test_planar_mirrors_have_their_closed_form():
    """Forward and backward: the mirror image of the point, seen by one camera and by the other."""
    buffer, exact, found, refined = places("plane", 1.0)
    ground, up = jnp.zeros(3), jnp.array([0.0, 1.0, 0.0])

    def closed(points, camera):
        flat = points.reshape(-1, 3)
        image = mirror_point(flat, jnp.broadcast_to(ground, flat.shape), jnp.broadcast_to(up, flat.shape))
        return np.asarray(project(camera, image)[0]).reshape(*points.shape[:-1], 2)

    forward = np.abs(np.asarray(found.place) - closed(buffer.reflected[..., :3], camera_at(1.0))).max(-1)
    assert np.asarray(found.found).sum() > 800
    assert np.quantile(forward[np.asarray(found.found)], 0.99) < 0.01  # measured: 0.0004
    backward = np.abs(np.asarray(refined.uv) - closed(exact.reflected[..., :3], camera_at(0))).max(-1)
    good = np.asarray((refined.residual < 0.1) & exact.valid)
    assert good.sum() > 800
    assert np.quantile(backward[good], 0.99) < 0.5  # measured: 0.05


@pytest.mark.parametrize(
    "name", ["ball", *(pytest.param(name, marks=pytest.mark.slow) for name in ("cylinder", "bowl"))]
)
def test_curved_mirrors_show_points_where_a_root_finder_says(name: str):
    buffer, exact, found, refined = places(name, 1.0)
    chosen = np.argwhere(np.asarray(found.found))[::5]
    points = buffer.reflected[chosen[:, 0], chosen[:, 1], :3]
    start = found.place[chosen[:, 0], chosen[:, 1]]
    truth, solved = true_places(MIRRORS[name], camera_at(1.0), points, start)
    assert int(solved.sum()) > 40
    error = np.abs(np.asarray(truth - start)).max(-1)[np.asarray(solved)]
    assert np.median(error) < 0.5  # measured: 0.02 (ball), 0.01 (cylinder), 0.001 (bowl)
    chosen = np.argwhere(np.asarray((refined.residual < 0.1) & exact.valid))[::5]
    points = exact.reflected[chosen[:, 0], chosen[:, 1], :3]
    start = refined.uv[chosen[:, 0], chosen[:, 1]]
    truth, solved = true_places(MIRRORS[name], camera_at(0), points, start)
    assert int(solved.sum()) > 40
    error = np.abs(np.asarray(truth - start)).max(-1)[np.asarray(solved)]
    assert np.median(error) < 0.5  # measured: below 0.02


def test_a_search_is_never_worse_than_its_start():
    """The published search: the distance of what it finds is at most that of the pixel itself."""
    _, buffer = view(MIRRORS["ball"], camera_at(0))
    camera = camera_at(1.5)
    result, _ = match_pixels(buffer, None, camera, Params(), options=OPTIONS)
    eye = tuple(camera.world_from_camera[:3, 3])
    y, x = np.nonzero(np.asarray(result.found))
    to = np.asarray(result.place[y, x], int)

    def of(rows, columns):
        split = [tuple(a[rows, columns, i] for i in range(3)) for a in (buffer.p, buffer.ns)]
        point = tuple(buffer.reflected[y, x, i] for i in range(3))
        return np.asarray(distance(eye, point, buffer.reflected[y, x, 3], *split))

    assert (of(y + to[:, 1], x + to[:, 0]) <= of(y, x)).all()


def test_gradients_of_the_distance_are_finite():
    """With respect to the camera, degenerate cases included: a point on its mirror, an eye on the line."""
    zero, one = jnp.zeros(4), jnp.ones(4)
    point = (jnp.array([0.0, 1.0, 0.0, 0.0]), jnp.array([0.0, 1.0, 2.0, 2.0]), zero)

    def total(eye):
        return distance(tuple(eye), point, one, (zero, zero, zero), (zero, one, zero)).sum()

    for eye in ([0.0, 2.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]):
        value, gradient = jax.value_and_grad(total)(jnp.array(eye))
        assert np.isfinite(value) and np.isfinite(np.asarray(gradient)).all()


@pytest.mark.slow
def test_the_matched_place_is_differentiable_in_the_camera():
    from jaxrefl.techniques.temporal.flat import surfaces
    from jaxrefl.techniques.temporal.match import newton

    gbuffer, exact = view(MIRRORS["ball"], camera_at(1.0))
    now = surfaces(gbuffer.p, gbuffer.ns, gbuffer.object)
    _, buffer = view(MIRRORS["ball"], camera_at(0))
    y, x = np.argwhere(np.asarray(buffer.valid))[::40].T
    point = tuple(buffer.reflected[y, x, i] for i in range(3))
    start = jnp.asarray(np.stack([x, y], -1) + 0.5, jnp.float32)

    @jax.jit
    @jax.grad
    def gradient(matrix):
        camera = pose(dataclasses.replace(camera_at(1.0), world_from_camera=matrix))
        u, v, _ = newton(now, camera, point, jnp.ones(len(x)), jnp.zeros(len(x), jnp.int32), start, steps=3)
        return (u + v).sum()

    found = np.asarray(gradient(camera_at(1.0).world_from_camera))
    assert np.isfinite(found).all() and np.abs(found).max() > 0
    assert exact.valid.any()


def test_depth_warping_is_that_of_the_reference():
    _, buffer = view(MIRRORS["ball"], camera_at(0))
    gbuffer, _ = view(MIRRORS["ball"], camera_at(1.0))
    key, params = camera_at(0), Params()
    xy, valid = seen_before(gbuffer, key, buffer.p, buffer.object, params.surface)
    pose64 = tuple(np.asarray(a, np.float64) for a in (key.world_from_camera, key.focal, key.centre))
    arrays = {"p": np.asarray(buffer.p, np.float64), "owner": np.asarray(buffer.object)}
    differ, pixels = 0, np.argwhere(np.asarray(gbuffer.valid))[::3]
    for y, x in pixels:
        p, n = np.asarray(gbuffer.p[y, x], np.float64), np.asarray(gbuffer.n[y, x], np.float64)
        expected = slow.seen_before(p, n, float(gbuffer.t[y, x]), 0, pose64, arrays, float(params.surface))
        if (expected is not None) != bool(valid[y, x]):
            differ += 1
        elif expected is not None:
            assert_close(xy[y, x], np.array(expected), scale=20)
    assert differ <= 0.01 * len(pixels) and bool(valid.any())


def test_options_are_those_of_tracing_and_more():
    names = {field.name for field in dataclasses.fields(TraceOptions)}
    assert names < {field.name for field in dataclasses.fields(Options)}
    with pytest.raises(ValueError, match="keys: 2 needs policy 'interval'"):
        Options(keys=2)
    assert Options(policy="interval", interval=10, batch=48).in_order == 40 and Options().in_order == 48
    assert SIZE == (64, 48)
