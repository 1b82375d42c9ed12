"""Camera paths: files, keyframes, loops, cameras that are made up."""

import json
import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxrefl._types import Camera
from jaxrefl.core.cameras import look_at, project
from jaxrefl.rays import BruteTracer
from jaxrefl.scene import Description, Part, assemble, matte
from pipelines.camera_files import camera_file_facts, read_cameras
from pipelines.cameras import inside_notes, job_cameras, loop_around
from pipelines.framing import VIEWS, framing_camera
from pipelines.job import CameraPath, Job, Keyframe, SceneSource
from pipelines.keyframes import catmull_rom, keyframe_cameras, rotations
from pipelines.toml_tables import JobError

SIZE = (64, 48)
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_FACES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
)


def cube_scene(*, scale=1.0, shift=(0.0, 0.0, 0.0), cameras=None, faces=CUBE_FACES):
    part = Part("cube", CORNERS * scale + np.array(shift), faces, matte("grey", (0.5, 0.5, 0.5)))
    return assemble(Description("cube", [part], cameras=cameras or {}))


@pytest.fixture(scope="module")
def cube():
    return cube_scene()


def transforms(tmp_path, **changes):
    matrix = np.asarray(look_at((1, 2, 5), (0, 0, 0), size=SIZE).world_from_camera, float).tolist()
    frames = [{"file_path": "a.png", "transform_matrix": matrix}, {"transform_matrix": np.eye(4).tolist()}]
    table = {"camera_angle_x": 0.8, "frames": frames, **changes}
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({k: v for k, v in table.items() if v is not None}))
    return path


def test_transforms_keep_the_matrix_and_the_horizontal_angle(tmp_path):
    path = transforms(tmp_path)
    assert camera_file_facts(path).frames == 2 and camera_file_facts(path).size is None
    first, second = read_cameras(path, frames=2, size=SIZE)
    expected = look_at((1, 2, 5), (0, 0, 0), size=SIZE)
    np.testing.assert_allclose(first.world_from_camera, expected.world_from_camera, atol=1e-6)
    np.testing.assert_array_equal(second.world_from_camera, np.eye(4))
    assert 2 * math.atan(SIZE[0] / 2 / float(first.focal[0])) == pytest.approx(0.8, rel=1e-6)
    assert first.focal[0] == first.focal[1]


def test_a_point_on_the_edge_of_the_angle_lands_on_the_edge_of_the_image(tmp_path):
    camera = read_cameras(transforms(tmp_path), frames=2, size=SIZE)[1]
    xy, depth = project(camera, jnp.array([math.tan(0.4), 0.0, -1.0], jnp.float32))
    np.testing.assert_allclose(xy, [SIZE[0], SIZE[1] / 2], atol=1e-3)
    assert float(depth) == 1.0


def test_intrinsics_in_pixels_follow_the_size(tmp_path):
    path = transforms(tmp_path, camera_angle_x=None, fl_x=100.0, fl_y=110.0, cx=30.0, cy=26.0, w=64, h=48)
    assert camera_file_facts(path).size == (64, 48)
    same = read_cameras(path, frames=1, size=(64, 48))[0]
    np.testing.assert_allclose(same.focal, [100, 110])
    np.testing.assert_allclose(same.centre, [30, 26])
    double = read_cameras(path, frames=1, size=(128, 96))[0]
    np.testing.assert_allclose(double.focal, [200, 220])
    np.testing.assert_allclose(double.centre, [60, 52])


def test_z_up_paths_are_turned_upright(tmp_path):
    z_up = np.eye(4)
    z_up[:3, 3] = [0, 0, 7]
    path = transforms(tmp_path, frames=[{"transform_matrix": z_up.tolist()}])
    camera = read_cameras(path, frames=1, size=SIZE, up="z")[0]
    np.testing.assert_allclose(camera.world_from_camera[:3, 3], [0, 7, 0])  # above
    np.testing.assert_allclose(-camera.world_from_camera[:3, 2], [0, -1, 0], atol=1e-7)  # looking down


SINGULAR = [[1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"frames": [{"transform_matrix": SINGULAR}]}, "frame 0: transform_matrix: .*singular"),
        ({"frames": [{"transform_matrix": [[1, 2], [3, 4]]}]}, "frame 0: transform_matrix"),
        ({"frames": [{"transform_matrix": "x"}]}, "frame 0: transform_matrix"),
        ({"frames": [{"transform_matrix": [[math.nan] * 4] * 4}]}, "frame 0: transform_matrix: .*finite"),
        ({"frames": [{"file_path": "a"}]}, "frame 0: expected a table with transform_matrix"),
        ({"frames": []}, "at least one camera"),
        ({"frames": None}, "at least one camera"),
        ({"camera_angle_x": None}, "expected camera_angle_x or fl_x"),
        ({"camera_angle_x": 4.0}, "radians between 0 and pi, got 4"),
        ({"camera_angle_x": "wide"}, "expected a finite number, got 'wide'"),
        ({"fl_x": -1.0}, "pixels > 0"),
        ({"w": 0, "h": 5}, "at least 1 pixel"),
        ({"k1": 0.1}, "lens distortion"),
    ],
)
def test_broken_camera_files_are_named(tmp_path, changes, said):
    with pytest.raises(JobError, match=rf"transforms\.json.*{said}"):
        path = transforms(tmp_path, **changes)
        camera_file_facts(path)
        read_cameras(path, frames=1, size=SIZE)


def test_too_few_cameras_and_no_json(tmp_path):
    with pytest.raises(JobError, match="expected at least 3 cameras, got 2"):
        read_cameras(transforms(tmp_path), frames=3, size=SIZE)
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(JobError, match=r"broken\.json: is not valid JSON"):
        camera_file_facts(tmp_path / "broken.json")


KEYS = tuple(
    Keyframe((math.cos(a) * 3, 1.0 + a, math.sin(a) * 3), target=(0.0, a, 0.0), fov_y=30 + a) for a in (0, 1, 2, 3)
)


def eye(camera: Camera) -> np.ndarray:
    return np.asarray(camera.world_from_camera)[:3, 3]


def test_keyframes_are_passed_through():
    cameras = keyframe_cameras(KEYS, frames=7, size=SIZE)
    for keyframe, camera in zip(KEYS, cameras[::2], strict=True):
        expected = look_at(keyframe.position, keyframe.target, fov_y=keyframe.fov_y, size=SIZE)
        np.testing.assert_allclose(camera.world_from_camera, expected.world_from_camera, atol=1e-6)
        np.testing.assert_allclose(camera.focal, expected.focal, rtol=1e-6)


def test_a_closed_path_comes_back_smoothly():
    cameras = keyframe_cameras(KEYS, frames=400, size=SIZE, closed=True)
    eyes = np.array([eye(c) for c in cameras])
    steps = np.roll(eyes, -1, axis=0) - eyes
    np.testing.assert_allclose(eyes[0], KEYS[0].position, atol=1e-6)
    turns = np.linalg.norm(np.roll(steps, -1, axis=0) - steps, axis=-1) / np.linalg.norm(steps, axis=-1)
    assert turns.max() < 0.1  # measured: 0.049; a corner gives about 1


def test_keyframe_times_set_the_pace():
    keys = (
        Keyframe((0.0, 0, 0), target=(0, 0, -1), time=0.0),
        Keyframe((1.0, 0, 0), target=(1, 0, -1), time=1.0),
        Keyframe((4.0, 0, 0), target=(4, 0, -1), time=4.0),
    )
    eyes = np.array([eye(c) for c in keyframe_cameras(keys, frames=9, size=SIZE)])
    np.testing.assert_allclose(eyes[:, 0], np.linspace(0, 4, 9), atol=1e-6)


@given(st.lists(st.floats(-10, 10, width=32), min_size=2, max_size=6), st.floats(-5, 5), st.floats(-5, 5))
def test_catmull_rom_follows_straight_lines(gaps, slope, start):
    times = np.cumsum(np.abs(gaps) + 0.5)
    at = np.linspace(times[0], times[-1], 17)
    np.testing.assert_allclose(catmull_rom(times, slope * times + start, at), slope * at + start, atol=1e-9)


def test_two_rotations_give_a_turn_at_constant_speed_the_short_way():
    half = math.sqrt(0.5)
    keys = np.array([[1.0, 0, 0, 0], [-half, 0, -half, 0]])  # the second is a quarter turn about y, with the other sign
    turned = rotations(np.array([0.0, 1.0]), keys, np.array([0.0, 1 / 3, 1.0]))
    angle = math.pi / 6
    expected = [[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    np.testing.assert_allclose(turned[1], expected, atol=1e-12)


def test_rotation_keyframes_look_along_minus_z():
    half = math.sqrt(0.5)
    keys = (Keyframe((1.0, 2, 3), rotation=(1.0, 0, 0, 0)), Keyframe((1.0, 2, 3), rotation=(half, 0, half, 0)))
    first, last = keyframe_cameras(keys, frames=2, size=SIZE)
    np.testing.assert_allclose(-first.world_from_camera[:3, 2], [0, 0, -1], atol=1e-6)
    np.testing.assert_allclose(-last.world_from_camera[:3, 2], [-1, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ((), "at least one"),
        ((Keyframe((0, 0, 0)),), r"keyframes\[0\]: expected either target or rotation"),
        ((Keyframe((0, 0, 0), target=(0, 0, 0)),), "frame 0: look_at: eye"),
        ((Keyframe((0, 1, 0), target=(0, 0, 0)),), "frame 0: look_at"),
        ((Keyframe((0, 0, 1), target=(0, 0, 0), fov_y=180),), "frame 0: fov_y"),
        ((Keyframe((0, 0, 0), rotation=(0, 0, 0, 0)),), "a quaternion other than 0"),
        (
            (Keyframe((0, 0, 1), target=(0, 0, 0)), Keyframe((0, 0, 1), rotation=(1, 0, 0, 0))),
            "all keyframes need a target",
        ),
        ((Keyframe((0, 0, 1), target=(0, 0, 0), time=1), Keyframe((0, 0, 2), target=(0, 0, 0), time=1)), "increasing"),
        (
            (Keyframe((0, 0, 1), target=(0, 0, 0), time=1), Keyframe((0, 0, 2), target=(0, 0, 0))),
            "all keyframes need one",
        ),
    ],
)
def test_bad_keyframes_are_named(keys, said):
    with pytest.raises(JobError, match=said):
        keyframe_cameras(keys, frames=2, size=SIZE)


def test_the_loop_starts_at_the_camera_and_keeps_its_distance(cube):
    still = look_at((0.5, 0.5, 4), (0.5, 0.5, 0.5), size=SIZE)
    cameras, swing = loop_around(still, cube, BruteTracer(cube.mesh), frames=8, swing=10.0)
    assert swing == 10.0 and len(cameras) == 8
    np.testing.assert_array_equal(cameras[0].world_from_camera, still.world_from_camera)
    pivot = np.array([0.5, 0.5, 0.5])
    for camera in cameras:
        assert np.linalg.norm(eye(camera) - pivot) == pytest.approx(3.5, rel=1e-5)
        xy, _ = project(camera, jnp.asarray(pivot, jnp.float32))
        np.testing.assert_allclose(xy, [32, 24], atol=1e-3)
    yaw = [math.degrees(math.atan2(eye(c)[0] - 0.5, eye(c)[2] - 0.5)) for c in cameras]
    assert max(yaw) == pytest.approx(10, abs=1e-3) and min(yaw) == pytest.approx(-10, abs=1e-3)


def test_the_loop_shrinks_where_something_stands_in_its_way(cube):
    inside = look_at((0.5, 0.5, 0.98), (0.5, 0.5, 0.5), size=SIZE)  # the loop of 45 degrees would leave through a wall
    cameras, swing = loop_around(inside, cube, BruteTracer(cube.mesh), frames=8, swing=80.0)
    assert 0 < swing < 80
    assert all((eye(c) > 0).all() and (eye(c) < 1).all() for c in cameras)


def test_the_camera_that_is_made_up_sees_everything_at_any_shape_and_scale():
    for size in ((64, 48), (20, 90)):
        for scale in (1e-3, 1.0, 1e4):
            scene = cube_scene(scale=scale, shift=(scale * 5, 0, 0))
            xy, depth = project(framing_camera(scene, BruteTracer(scene.mesh), size), scene.mesh.vertices)
            assert (np.asarray(depth) > 0).all()
            assert (np.asarray(xy) >= 0).all() and (np.asarray(xy) <= np.array(size)).all()


def test_the_camera_that_is_made_up_looks_at_fronts():
    turned = CUBE_FACES[:, ::-1]
    front = (CORNERS[turned][..., 2] == 1).all(-1)  # both triangles of the +Z side
    closed, open_box, room = (cube_scene(faces=faces) for faces in (CUBE_FACES, turned[~front], turned))
    cameras = [framing_camera(scene, BruteTracer(scene.mesh), SIZE) for scene in (closed, open_box, room)]
    view = eye(cameras[0]) - 0.5
    np.testing.assert_allclose(view / view[2], VIEWS[0], atol=1e-5)
    np.testing.assert_allclose(eye(cameras[1])[:2], [0.5, 0.5], atol=1e-5)
    assert eye(cameras[1])[2] > 1 and 0.5 < eye(cameras[2])[2] < 1


def test_cameras_inside_an_object_are_counted(cube):
    outside = look_at((0.5, 0.5, 4), (0.5, 0.5, 0.5), size=SIZE)
    inside = look_at((0.5, 0.5, 0.6), (0.5, 0.5, 0.5), size=SIZE)
    tracer = BruteTracer(cube.mesh)
    assert inside_notes((outside, outside), cube, tracer) == []
    (note,) = inside_notes((outside, inside), cube, tracer)
    assert "1 of 2 cameras" in note and "frames 1" in note and "'cube'" in note


def job(**camera) -> Job:
    return Job(SceneSource("cube.obj"), frames=3, size=SIZE, camera=CameraPath(**camera))


def test_a_scene_without_a_camera_says_so(cube):
    cameras, notes = job_cameras(job(), cube, BruteTracer(cube.mesh))
    assert len(cameras) == 3 and "has no camera" in notes[0] and "loop of 5 degrees" in notes[1]


def test_a_scenes_cameras_are_found_by_name():
    authored = look_at((3, 3, 4), (0, 0, 0), size=(32, 32))
    scene = cube_scene(cameras={"front": authored, "back": look_at((0, 0, -4), (0, 0, 0), size=(32, 32))})
    cameras, _ = job_cameras(job(name="front"), scene, BruteTracer(scene.mesh))
    np.testing.assert_array_equal(cameras[0].world_from_camera, authored.world_from_camera)
    assert (cameras[0].width, cameras[0].height) == SIZE
    with pytest.raises(JobError, match="no camera 'frond'; did you mean 'front'"):
        job_cameras(job(name="frond"), scene, BruteTracer(scene.mesh))


def test_a_built_in_scene_brings_its_own_path(cube):
    from scenes import BUILT_IN

    built_in = Job(SceneSource("cornell"), frames=3, size=SIZE)
    cameras, notes = job_cameras(built_in, cube, BruteTracer(cube.mesh))
    expected = BUILT_IN["cornell"].path(3, size=SIZE)
    for camera, other in zip(cameras, expected, strict=True):
        np.testing.assert_array_equal(camera.world_from_camera, other.world_from_camera)
    assert not any("no camera" in note for note in notes)
