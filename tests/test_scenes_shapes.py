"""Shapes of the built-in scenes: closed, oriented outwards, with the normals of the surface they approximate."""

import numpy as np
import pytest

from scenes.orbits import loop, orbit
from scenes.patterns import checker, planks, stripes
from scenes.profiles import arc, chain, line
from scenes.rooms import walls
from scenes.shapes import Geometry, box, cylinder, lathe, merge, rectangle, sphere, sweep, torus
from scenes.tessellation import segments, tessellate


def welded(shape) -> np.ndarray:
    """Faces [f 3] over vertices merged by float32 position."""
    positions = np.asarray(shape.vertices, np.float32) + np.float32(0)  # no negative zeros
    index = np.unique(positions, axis=0, return_inverse=True)[1].reshape(-1)
    return index[shape.faces]


def is_closed(shape) -> bool:
    """True if every edge is used once in each direction."""
    faces = welded(shape)
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges, counts = np.unique(directed, axis=0, return_counts=True)
    return bool((counts == 1).all()) and {tuple(e) for e in edges} == {tuple(e[::-1]) for e in edges}


def volume(shape) -> float:
    """Signed volume of a closed shape."""
    a, b, c = np.moveaxis(np.asarray(shape.vertices, np.float64)[shape.faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6)


def euler_number(shape) -> int:
    """V - E + F: 2 for a ball, 0 for a ring."""
    faces = welded(shape)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return len(np.unique(faces)) - len(np.unique(edges, axis=0)) + len(faces)


def least_agreement(shape) -> float:
    """Smallest cosine between a face's normal and the shading normals at its corners."""
    a, b, c = np.moveaxis(np.asarray(shape.vertices, np.float64)[shape.faces], 1, 0)
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return float(np.einsum("fc,fkc->fk", across, shape.normals[shape.faces]).min())


BEND = np.linspace(0, 3, 40)
CLOSED = {
    "box": (box((0, -1, 2), (1, 2, 4)), 6.0, 2),
    "sphere": (sphere(1.5, around=64), 4 / 3 * np.pi * 1.5**3, 2),
    "cylinder": (cylinder(1, 1, 2, around=64), 2 * np.pi, 2),
    "frustum": (cylinder(1, 0.5, 3, around=64), np.pi * (1 + 0.5 + 0.25), 2),
    "cone": (cylinder(1, 0, 3, around=64), np.pi, 2),
    "torus": (torus(2, 0.5, around=128), 2 * np.pi**2 * 2 * 0.25, 0),
    "bent tube": (
        sweep(np.stack([2 * np.cos(BEND), 2 * np.sin(BEND), 0 * BEND], -1), 0.2, around=64),
        2 * 3 * np.pi * 0.04,
        2,
    ),
}


@pytest.mark.parametrize("name", CLOSED)
def test_closed_shapes_are_watertight_and_have_their_volume(name):
    shape, expected, euler = CLOSED[name]
    assert is_closed(shape)
    assert euler_number(shape) == euler
    np.testing.assert_allclose(volume(shape), expected, rtol=0.006)  # inscribed polyhedra; worst: sphere, 0.4 %
    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=-1), 1, atol=1e-12)
    assert least_agreement(shape) > 0.99


@pytest.mark.parametrize("name", CLOSED)
def test_moving_keeps_a_shape_closed_and_flipping_turns_it_inside_out(name):
    shape = CLOSED[name][0]
    moved = shape.moved(to=(3, -2, 5), turn=37, tilt=-20, scale=2)
    assert is_closed(moved)
    np.testing.assert_allclose(volume(moved), 8 * volume(shape), rtol=1e-9)
    np.testing.assert_allclose(least_agreement(moved), least_agreement(shape), atol=1e-9)
    np.testing.assert_allclose(volume(shape.flipped()), -volume(shape))
    np.testing.assert_allclose(least_agreement(shape.flipped()), least_agreement(shape))


@pytest.mark.parametrize(
    ("move", "expected"),
    [({"turn": 90.0}, (1, 0, 0)), ({"tilt": 90.0}, (0, -1, 0)), ({"tilt": 90.0, "turn": 90.0}, (0, -1, 0))],
)
def test_moved_turns_as_documented(move, expected):
    forward = Geometry(np.array([[0.0, 0, 1]]), np.zeros((0, 3), int), np.array([[0.0, 0, 1]]), np.zeros((1, 2)))
    moved = forward.moved(**move)
    np.testing.assert_allclose(moved.vertices[0], expected, atol=1e-15)
    np.testing.assert_allclose(moved.normals[0], expected, atol=1e-15)


def test_a_sphere_has_radial_normals():
    shape = sphere(2.0, around=24)
    np.testing.assert_allclose(2 * shape.normals, shape.vertices, atol=1e-12)


def test_a_hollow_arc_makes_normals_point_to_its_centre():
    points, normals = arc((0, 3), -2.0, -60, -90, 8)
    np.testing.assert_allclose(points + 2 * normals, np.broadcast_to([0.0, 3.0], points.shape), atol=1e-12)
    face = lathe(points, normals, around=16)
    assert least_agreement(face) > 0.95


def test_a_crease_keeps_both_normals_and_makes_no_faces():
    shape = lathe(*chain(line((0, 0), (1, 0)), line((1, 0), (0, 1))), around=8)
    rim = np.isclose(shape.vertices[:, 1], 0) & np.isclose(np.linalg.norm(shape.vertices, axis=-1), 1)
    assert len(np.unique(shape.normals[rim][:, 1].round(9))) == 2
    assert len(shape.faces) == 16


def test_a_profile_with_a_gap_is_refused():
    with pytest.raises(ValueError, match="chain: expected a piece that starts at"):
        chain(line((0, 0), (1, 0)), line((1.01, 0), (0, 1)))


def test_a_rectangle_faces_right_cross_up_with_the_image_upright():
    shape = rectangle((0, 0, 0), (2, 0, 0), (0, 3, 0), tiles=(4, 5))
    np.testing.assert_array_equal(shape.normals, np.broadcast_to([0.0, 0.0, 1.0], (4, 3)))
    assert least_agreement(shape) == 1
    upper_left = np.argmin(shape.vertices @ np.array([1.0, -1.0, 0.0]))
    np.testing.assert_array_equal(shape.uv[upper_left], [0, 0])
    np.testing.assert_array_equal(shape.uv.max(0), [4, 5])


def test_walls_face_into_the_room():
    shapes = walls((-1, 0, -2), (3, 4, 5))
    room = merge(*shapes.values())
    assert is_closed(room)
    np.testing.assert_allclose(volume(room), -4 * 4 * 7)
    assert least_agreement(room) == 1
    assert shapes["back"].vertices[:, 2].max() == -2
    assert shapes["left"].vertices[:, 0].max() == -1


def test_a_box_without_volume_is_refused():
    with pytest.raises(ValueError, match="box: expected lower < upper"):
        box((0, 0, 0), (1, 0, 1))


@pytest.mark.parametrize("image", [checker("a", (1, 0, 0), (0, 0, 1)), stripes("b", ((0.2, 0.4, 0.6), (1, 1, 1)))])
def test_patterns_are_coded_in_srgb_and_opaque(image):
    assert image.rgba.dtype == np.uint8
    assert (image.rgba[..., 3] == 255).all()
    assert len(np.unique(image.rgba.reshape(-1, 4), axis=0)) == 2


def test_a_linear_colour_is_coded_by_the_srgb_curve():
    # 0.2, 0.4, 0.6 linear by the sRGB standard's curve, rounded to 8 bits
    assert stripes("b", ((0.2, 0.4, 0.6),)).rgba[0, 0].tolist() == [124, 170, 203, 255]


def test_planks_repeat_without_a_seam_between_boards():
    rgba = planks("p", (0.3, 0.2, 0.1), rows=4, texels=64).rgba.astype(int)
    inside = np.abs(np.diff(rgba[8], axis=0)).max()  # along the middle of a board, its end included
    assert np.abs(rgba[8, 0] - rgba[8, -1]).max() <= inside


def test_segments_are_even_and_at_least_the_least():
    assert [segments(d, 10, least=5) for d in (0, 0.5, 1, 1.8, 3)] == [6, 6, 10, 18, 30]


@pytest.mark.parametrize("triangles", [999, 2_000_000, True])
def test_tessellate_refuses_counts_out_of_range(triangles):
    with pytest.raises(ValueError, match=f"triangles: .* got {triangles}"):
        tessellate(triangles, lambda detail: [])


def test_loops_and_orbits_start_at_the_eye_and_keep_their_distance():
    for cameras in (
        loop(8, eye=(1, 2, 5), target=(0, 1, 0), size=(8, 6)),
        orbit(8, eye=(1, 2, 5), target=(0, 1, 0), size=(8, 6)),
    ):
        eyes = np.stack([np.asarray(c.world_from_camera[:3, 3]) for c in cameras])
        np.testing.assert_allclose(eyes[0], (1, 2, 5), atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(eyes - [0, 1, 0], axis=-1), np.sqrt(27), rtol=1e-6)


def test_an_orbit_closes_when_it_is_long_enough():
    eyes = np.stack(
        [np.asarray(c.world_from_camera[:3, 3]) for c in orbit(240, eye=(0, 1, 2), target=(0, 0, 0), size=(4, 4))]
    )
    steps = np.linalg.norm(np.roll(eyes, -1, axis=0) - eyes, axis=-1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-3)


@pytest.mark.parametrize("frames", [0, -3, True])
def test_paths_refuse_a_bad_number_of_frames(frames):
    with pytest.raises(ValueError, match=f"frames: .* got {frames}"):
        orbit(frames, eye=(0, 1, 2), target=(0, 0, 0), size=(4, 4))
