"""Scenes written for Mitsuba: geometry, cameras, lights and files; what Mitsuba sees, and what comes back."""

import os
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from mitsuba_scenes import mitsuba, rays_of, seen_by_mitsuba
from mitsuba_writing import CAMERA, QUAD, SIZE, SQUARE, exported, notes_of, picture, scene_of, square

from jaxrefl import Camera, Scene
from jaxrefl.core import look_at
from jaxrefl.rays import EmbreeTracer, camera_rays
from jaxrefl.scene import (
    Part,
    PunctualLight,
    SceneError,
    SceneWarning,
    Sky,
    constant_sky,
    describe_file,
    emitter,
    environment_radiance,
    export_mitsuba,
    load,
    matte,
    mirror,
)
from jaxrefl.surface import look
from pipelines import cli

mi = mitsuba()
pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


@pytest.mark.parametrize("smooth", [True, False])
def test_mitsuba_sees_what_we_see(tmp_path: Path, smooth: bool):
    """Positions, sides, textured albedo and emission, at the same pixels."""
    coloured = matte("a.b", (0.9, 0.6, 0.3)).replace(base_colour_texture=picture())
    normals = {"normals": np.array([[0, 0.2, 1], [0.2, 0, 1], [0, 0, 1], [0.1, 0.1, 1.0]])} if smooth else {}
    scene, path = exported(
        tmp_path,
        square(coloured, **normals),
        square(matte("blue", (0.1, 0.2, 0.9)), at=(1.2, 0.3, -1)),
        Part("lamp", SQUARE * 0.3 + (-1, 1, 0.5), QUAD, emitter("lamp", (3, 2, 1)).replace(emits_back=False)),
    )
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), CAMERA), seen_by_mitsuba(mi, path, SIZE)
    np.testing.assert_array_equal(gbuffer.valid, expected["valid"])
    np.testing.assert_allclose(gbuffer.p, expected["p"], atol=1e-5)
    np.testing.assert_array_equal(np.asarray(gbuffer.outside)[gbuffer.valid], expected["front"][gbuffer.valid])
    cosine = (np.asarray(gbuffer.ns) * expected["ns"]).sum(-1)[np.asarray(gbuffer.valid) & expected["front"]]
    assert cosine.min() > 0.9999
    # measured worst case 0.0024: the factor is baked into 8-bit sRGB
    np.testing.assert_allclose(gbuffer.base_colour, expected["albedo"], atol=5e-3)
    np.testing.assert_allclose(gbuffer.emission, expected["emission"], rtol=1e-6)


def test_cameras_come_back_and_are_mitsubas(tmp_path: Path):
    one = look_at((1, 2, 3), (0, 0.3, 0), fov_y=37, size=SIZE)
    shifted = Camera(one.world_from_camera, one.focal, one.centre + jnp.asarray([1.5, -2.0]), *SIZE)
    scene = scene_of(square(matte("m", (1, 1, 1))))
    path = export_mitsuba(scene, tmp_path / "out", camera=[one, shifted])
    found = describe_file(path).cameras
    assert list(found) == ["frame_0000", "frame_0001"]
    sensors = mi.load_file(str(path)).sensors()
    for camera, again, sensor in zip((one, shifted), found.values(), sensors, strict=True):
        assert (again.width, again.height) == SIZE
        for name in ("world_from_camera", "focal", "centre"):
            np.testing.assert_allclose(getattr(again, name), getattr(camera, name), rtol=2e-6, atol=2e-6)
        _, directions = rays_of(mi, sensor, SIZE)
        np.testing.assert_allclose(camera_rays(camera).direction, directions, atol=2e-6)  # measured 2e-7


def test_geometry_comes_back(tmp_path: Path, rng: np.random.Generator):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    ball, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces)
    scene, path = exported(
        tmp_path,
        Part("ball", ball, faces, matte("red", (1, 0, 0)), normals=ball, uv=rng.random((len(ball), 2))),
        square(matte("map", (1, 1, 1)).replace(base_colour_texture=picture())),
        square(mirror("ball"), name="ball", at=(0, 0, 2)),
    )
    again = load(path)
    assert set(again.names.materials) == {"red", "map", "ball"} and "square" in again.names.objects

    def corners(scene: Scene, name: str) -> np.ndarray:
        mesh = scene.mesh
        rows = np.flatnonzero(np.asarray(mesh.material) == scene.names.materials.index(name))
        columns = [np.asarray(a)[np.asarray(mesh.faces)[rows]] for a in (mesh.vertices, mesh.normals, mesh.uv)]
        return np.concatenate(columns, -1)

    for name in scene.names.materials:
        np.testing.assert_allclose(corners(again, name), corners(scene, name), atol=1e-6)


def test_vertex_colours(tmp_path: Path, rng: np.random.Generator):
    colours = rng.random((4, 3))
    part = square(matte("m", (0.5, 0.6, 0.7)), colours=colours)
    scene, path = exported(tmp_path, part)
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), CAMERA), seen_by_mitsuba(mi, path, SIZE)
    np.testing.assert_allclose(gbuffer.base_colour, expected["albedo"], atol=1e-5)
    (again,) = describe_file(path).parts
    assert again.colours is not None
    expected_colours = (colours * (0.5, 0.6, 0.7))[QUAD]  # flat triangles come back with vertices of their own
    np.testing.assert_allclose(again.colours[again.faces], expected_colours, atol=1e-6)


def test_ids_are_shared_by_all_that_has_one(tmp_path: Path):
    parts = [square(matte(name, (1, 1, 1)), name="sky") for name in ("sky", "camera", "sky (2)", "a.b")]
    scene, path = exported(tmp_path, *parts, sky=constant_sky((1, 1, 1)))
    assert set(describe_file(path).cameras) == {"camera (2)"}
    assert set(load(path).names.materials) == {"sky", "camera", "sky (2)", "a_b"}
    mi.load_file(str(path))  # which refuses ids that are not unique


def test_lights_come_back(tmp_path: Path):
    lights = [
        PunctualLight("p", (1, 2, 3), position=(1, 2, 3)),
        PunctualLight("s", (3, 2, 1), direction=(0.6, -0.8, 0), directional=True, angular_radius=0.01),
        PunctualLight("c", (5, 5, 5), position=(0, 3, 0), direction=(0, -0.6, 0.8), cos_inner=0.9, cos_outer=0.7),
    ]
    said = notes_of(tmp_path, square(matte("m", (1, 1, 1))), lights=lights, ambient=(0.1, 0.1, 0.1))
    for words in ("hard shadows: light 1", "fades linearly with the angle", "ambient term"):
        assert words in said
    found = describe_file(tmp_path / "out" / "scene.xml").lights
    for light, again in zip(lights, found, strict=True):
        assert again.directional == light.directional
        for field in ("intensity", "direction", "cos_inner", "cos_outer") + (("position",) * (not light.directional)):
            if light.cos_outer >= -1 or light.directional or field in ("intensity", "position"):
                np.testing.assert_allclose(getattr(again, field), getattr(light, field), rtol=1e-5, atol=1e-6)


def test_skies_come_back_and_look_as_in_mitsuba(tmp_path: Path, rng: np.random.Generator):
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(128) + 0.5) / 128, indexing="ij")
    d = np.stack([np.sin(np.pi * v) * np.cos(2 * np.pi * u), np.cos(np.pi * v), np.sin(np.pi * v)], -1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    sky = Sky((1.5 + d).astype(np.float32), turn * np.sign(np.linalg.det(turn)))
    scene, path = exported(tmp_path, square(matte("m", (1, 1, 1))), sky=sky)
    again = describe_file(path).sky
    assert again is not None and scene.lights.environment is not None
    np.testing.assert_allclose(again.world_from_map, sky.world_from_map, atol=1e-6)
    np.testing.assert_array_equal(again.radiance, sky.radiance)
    directions = rng.normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    emitter_of_mitsuba, expected = mi.load_file(str(path)).environment(), []
    for direction in directions.tolist():
        si = mi.SurfaceInteraction3f()
        si.wi = [-c for c in direction]
        expected.append(np.asarray(emitter_of_mitsuba.eval(si)))
    ours = environment_radiance(scene.lights.environment, jnp.asarray(directions, jnp.float32))
    # half a row, see the reader's test: pi / 128 = 0.025; measured worst case 0.024
    np.testing.assert_allclose(ours, np.array(expected), atol=0.026)


def test_constant_skies(tmp_path: Path):
    _, path = exported(tmp_path, square(matte("m", (1, 1, 1))), sky=constant_sky((0.1, 0.2, 0.3)))
    again = describe_file(path).sky
    assert again is not None
    np.testing.assert_allclose(again.radiance[0, 0], [0.1, 0.2, 0.3], rtol=1e-6)


def test_a_folder_of_others_is_refused_and_an_own_one_written_again(tmp_path: Path):
    scene = scene_of(square(matte("m", (1, 1, 1))))
    path = export_mitsuba(scene, tmp_path / "a" / "b", camera=CAMERA)
    first = path.read_text()
    assert export_mitsuba(scene, tmp_path / "a" / "b", camera=CAMERA) == path and path.read_text() == first
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "scene.xml").write_text("<scene version='3.0.0'/>")
    for folder, words in ((tmp_path / "c", "is not empty"), (tmp_path / "c" / "scene.xml", "got a file")):
        with pytest.raises(SceneError, match=words):
            export_mitsuba(scene, folder, camera=CAMERA)
    assert (tmp_path / "c" / "scene.xml").read_text() == "<scene version='3.0.0'/>"


@pytest.mark.parametrize("name", ["samples", "max_depth"])
@pytest.mark.parametrize("value", [0, -1, True])
def test_numbers_are_checked(tmp_path: Path, name: str, value):
    with pytest.raises(SceneError, match=f"{name}: expected a whole number"):
        export_mitsuba(scene_of(square(matte("m", (1, 1, 1)))), tmp_path, camera=CAMERA, **{name: value})


def test_a_camera_is_needed(tmp_path: Path):
    with pytest.raises(SceneError, match="expected a camera"):
        export_mitsuba(scene_of(square(matte("m", (1, 1, 1)))), tmp_path)


def test_no_mitsuba_is_needed_to_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "mitsuba", None)
    assert exported(tmp_path, square(matte("m", (1, 1, 1))))[1].is_file()


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    words = f"export cornell --to mitsuba --frames 2 --size 32 24 --samples 4 --max-depth 5 --out {out}"
    with warnings.catch_warnings():
        warnings.simplefilter("always", SceneWarning)
        assert cli.main(words.split()) == 0
    said = capsys.readouterr()
    assert said.out.strip() == str(out / "scene.xml") and "ambient term" in said.err
    scene = mi.load_file(str(out / "scene.xml"), spp=1)
    assert len(scene.sensors()) == 2 and list(scene.sensors()[1].film().size()) == [32, 24]
    assert (out / "scene.xml").read_text().count('name="spp" value="4"') == 1
    again = load(out / "scene.xml")
    assert again.names.cameras == ("frame_0000", "frame_0001") and again.features.emissive
    assert cli.main(f"export cornell --out {tmp_path}".split()) == 2
    assert "is not empty" in capsys.readouterr().err
    assert cli.main(["export", "cornell"]) == 2 and "--out DIR" in capsys.readouterr().err


def test_the_command_keeps_the_size_of_the_scenes_camera(tmp_path: Path):
    path = export_mitsuba(scene_of(square(matte("m", (1, 1, 1)))), tmp_path / "a", camera=CAMERA)
    assert cli.main(f"export {path} --out {tmp_path / 'b'}".split()) == 0
    (camera,) = describe_file(tmp_path / "b" / "scene.xml").cameras.values()
    assert (camera.width, camera.height) == SIZE


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["gltf-ToyCar/ToyCar.gltf", "gltf-GlassVaseFlowers/GlassVaseFlowers.glb", "living-room/scene.xml"]
)
def test_real_scenes_are_written_and_read(tmp_path: Path, name: str):
    path = Path(os.environ.get("JAXREFL_SCENES", "nowhere")) / name
    if not path.is_file():
        pytest.skip(f"{name} is not there: set JAXREFL_SCENES to the folder of real scene files")
    scene = load(path)
    written = export_mitsuba(scene, tmp_path / "out", camera=scene.cameras[0] if scene.cameras else CAMERA)
    again = load(written)
    assert again.mesh.faces.shape == scene.mesh.faces.shape
    assert set(again.names.materials) == set(scene.names.materials)
    np.testing.assert_allclose(again.lower, scene.lower, atol=1e-5 * float(jnp.abs(scene.upper).max()))
    mi.load_file(str(written))
