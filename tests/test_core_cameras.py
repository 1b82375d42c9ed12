"""Pinhole cameras: the -Z, +Y up convention, pixel centres, resizing, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import floats
from tolerances import assert_close

from jaxrefl.core import look_at, perspective, project, resize


def camera(size=(8, 6)):
    return look_at((1.0, 2.0, 3.0), (0.0, 0.5, -1.0), fov_y=50, size=size)


def test_axes_are_right_up_and_backwards():
    matrix = np.asarray(look_at((0, 0, 5), (0, 0, 0)).world_from_camera)
    assert_close(matrix[:3, :3], np.eye(3))
    assert_close(matrix[:3, 3], np.array([0, 0, 5.0]))
    sideways = np.asarray(look_at((0, 0, 0), (1, 0, 0)).world_from_camera)
    assert_close(sideways[:3, :3], np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0.0]]))


def test_the_target_is_in_the_middle_and_up_is_up():
    view = camera()
    target = jnp.asarray([0.0, 0.5, -1.0])
    xy, depth = project(view, target)
    np.testing.assert_allclose(xy, [4, 3], atol=1e-5)
    np.testing.assert_allclose(depth, np.sqrt(1 + 1.5**2 + 16), rtol=1e-6)
    above, _ = project(view, target + jnp.asarray([0.0, 0.1, 0.0]))
    assert above[1] < 3
    right = view.world_from_camera[:3, 0]
    assert project(view, target + 0.1 * right)[0][0] > 4


def test_field_of_view_ends_at_the_image_edge():
    view = perspective(np.eye(4), fov_y=60, size=(40, 20))
    edge = jnp.asarray([0.0, np.tan(np.radians(30)), -1.0], jnp.float32)
    np.testing.assert_allclose(project(view, edge)[0], [20, 0], atol=1e-5)
    assert view.focal[0] == view.focal[1]


def test_points_behind_are_marked_by_their_depth():
    xy, depth = project(perspective(np.eye(4), fov_y=60, size=(4, 4)), jnp.asarray([[1.0, 1, 2], [1.0, 1, 0]]))
    assert (depth <= 0).all()
    assert_close(xy, np.full((2, 2), 2.0))


@given(floats(0.0, 8.0, (5,)), floats(0.0, 6.0, (5,)), floats(0.5, 20.0, (5,)))
def test_pixels_round_trip(x, y, depth):
    """Points built from pixels by the definition of the camera come back to their pixels."""
    view = camera()
    local = np.stack([(x - view.centre[0]) / view.focal[0], (view.centre[1] - y) / view.focal[1], -jnp.ones(5)], -1)
    matrix = np.asarray(view.world_from_camera, np.float64)
    p = (local * np.asarray(depth)[:, None]) @ matrix[:3, :3].T + matrix[:3, 3]
    xy, z = project(view, jnp.asarray(p, jnp.float32))
    np.testing.assert_allclose(xy, np.stack([x, y], -1), atol=2e-4)
    np.testing.assert_allclose(z, depth, rtol=1e-5)


@given(st.integers(1, 50), st.integers(1, 50))
def test_resizing_keeps_what_is_seen(width, height):
    view, p = camera(), jnp.asarray([0.3, 0.2, -1.0])
    other = resize(view, (width, height))
    before, after = (np.asarray(project(c, p)[0], np.float64) for c in (view, other))
    np.testing.assert_allclose((after - [width / 2, height / 2]) / height, (before - [4, 3]) / 6, atol=1e-5)
    assert (other.width, other.height) == (width, height)


def test_scale_in_the_matrix_is_removed():
    matrix = np.diag([2.0, 3.0, 0.5, 1.0])
    assert_close(perspective(matrix, fov_y=60, size=(4, 4)).world_from_camera, np.eye(4))


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: perspective(np.eye(4), fov_y=60, size=(0, 4)), "size: expected .* got \\(0, 4\\)"),
        (lambda: perspective(np.eye(4), fov_y=0, size=(4, 4)), "fov_y: .* got 0"),
        (lambda: perspective(np.eye(4), fov_y=180, size=(4, 4)), "fov_y: .* got 180"),
        (lambda: perspective(np.eye(4), fov_y=np.nan, size=(4, 4)), "fov_y: .* got nan"),
        (lambda: perspective(np.eye(3), fov_y=60, size=(4, 4)), "world_from_camera: expected a finite 4x4"),
        (lambda: perspective(np.full((4, 4), np.inf), fov_y=60, size=(4, 4)), "world_from_camera: expected a finite"),
        (lambda: perspective(np.zeros((4, 4)), fov_y=60, size=(4, 4)), "world_from_camera: singular"),
        (lambda: perspective(np.diag([1.0, 1, 0, 1]), fov_y=60, size=(4, 4)), "world_from_camera: singular"),
        (lambda: look_at((1, 2, 3), (1, 2, 3)), "coincide"),
        (lambda: look_at((0, 0, 0), (0, 1, 0)), "span no camera frame"),
        (lambda: look_at((0, 0, np.nan), (0, 1, 0)), "span no camera frame"),
        (lambda: resize(camera(), (4, 0)), "size: expected"),
    ],
)
def test_refuses(build, words):
    with pytest.raises(ValueError, match=words):
        build()
