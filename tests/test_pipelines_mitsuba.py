"""The path tracer against Mitsuba 3: the same scene files, the same light."""

import dataclasses
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from shapes import ball, floor

import scenes
from jaxrefl._types import Camera
from jaxrefl.core import look_at, resize
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import SceneWarning, assemble, export_mitsuba, load
from jaxrefl.scene.description import Description, Material, constant_sky, emitter, glass, glossy, matte
from pipelines.against_mitsuba import Agreement, agreement, compare_with_mitsuba

pytest.importorskip("mitsuba", reason="needs the package mitsuba")

COPPER = ((0.2004, 0.9240, 1.1022), (3.9129, 2.4528, 2.1421))


def compared(
    description: Description, camera: Camera, folder: Path, *, samples: int = 32, bounces: int = 6
) -> Agreement:
    """Export, read the file again, render it with both."""
    file = export_mitsuba(assemble(description), folder / "scene", camera=camera)
    scene = load(file)
    own = resize(scene.cameras[0], (camera.width, camera.height))
    return compare_with_mitsuba(file, scene, EmbreeTracer(scene.mesh), own, samples=samples, bounces=bounces, block=4)


def agrees(found: Agreement) -> None:
    """Means within 1 % beyond four of their own standard errors, and as many scores beyond 3 as chance has it.

    The share of scores is that of a few hundred blocks: 4 % more is four standard errors of such a share.
    """
    assert (np.abs(found.difference) < 0.01 + 4 * found.means_error).all(), (found.difference, found.means_error)
    assert found.beyond < found.expected + 0.04, (found.beyond, found.expected)


@pytest.fixture(autouse=True)
def notes_are_expected():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        yield


def room(material: Material) -> tuple[Description, Camera]:
    """A ball on a floor under a lamp: highlights, shadows, light from the floor."""
    lamp = floor("lamp", emitter("lamp", (8, 7, 6)).replace(emits_back=False), size=1.0, height=3.0)
    lamp = dataclasses.replace(lamp, faces=lamp.faces[:, ::-1])
    shape = ball("ball", material, centre=(0, 0.9, 0), radius=0.8)
    parts = [floor("floor", matte("floor", (0.5, 0.4, 0.3))), shape, lamp]
    return Description("room", parts), look_at((0, 1.8, 4), (0, 0.7, 0), fov_y=35, size=(40, 32))


@pytest.mark.parametrize("alpha", [0.8, *(pytest.param(a, marks=pytest.mark.slow) for a in (0.02, 0.1, 0.2, 0.4))])
def test_rough_metals(alpha: float, tmp_path: Path):
    copper = glossy("copper", (1, 1, 1), alpha=alpha, metallic=1.0).replace(conductor=COPPER)
    agrees(compared(*room(copper), tmp_path))


@pytest.mark.parametrize(
    "material",
    [
        pytest.param(glossy("rough plastic", (0.5, 0.4, 0.2), alpha=0.1).replace(coupled=True), marks=pytest.mark.slow),
        glass("glass"),
        pytest.param(matte("matte", (0.8, 0.5, 0.2)), marks=pytest.mark.slow),
        pytest.param(glossy("plastic", (0.8, 0.5, 0.2), alpha=0.0).replace(coupled=True), marks=pytest.mark.slow),
        pytest.param(glass("rough glass", alpha=0.2), marks=pytest.mark.slow),
    ],
    ids=lambda m: m.name,
)
def test_materials(material: Material, tmp_path: Path):
    agrees(compared(*room(material), tmp_path))


def test_the_furnace(tmp_path: Path):
    """Mitsuba's model and ours in a white world, where nothing but the material decides."""
    metal = glossy("metal", (0.9, 0.9, 0.9), alpha=0.5, metallic=1.0).replace(conductor=((0, 0, 0), (1, 1, 1)))
    description = Description("furnace", [ball("ball", metal)], sky=constant_sky((1, 1, 1)))
    found = compared(description, look_at((0, 0, 5), (0, 0, 0), fov_y=25, size=(32, 32)), tmp_path)
    agrees(found)
    assert found.means[0].max() < 0.99  # single scattering loses light: the test sees the material


def test_the_cornell_box(tmp_path: Path):
    camera = scenes.BUILT_IN["cornell"].path(1, size=(32, 32))[0]
    agrees(compared(scenes.build("cornell", triangles=1000), camera, tmp_path, samples=32))


def test_a_glb_file(tmp_path: Path):
    """An asset as other programs write it: a textured, partly rough ball in a GLB file."""
    shape = trimesh.creation.uv_sphere(count=[24, 24])
    x, y, z = shape.vertices.T
    uv = np.stack([np.arctan2(x, y) / 6.3 + 0.5, z / 2 + 0.5], 1)
    colours = np.kron(np.random.default_rng(0).integers(60, 230, (4, 4, 3)), np.ones((8, 8, 1))).astype(np.uint8)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(colours), roughnessFactor=0.4, metallicFactor=0.0
    )
    shape.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    trimesh.Scene({"ball": shape}).export(tmp_path / "ball.glb")
    scene = load(tmp_path / "ball.glb")
    camera = look_at((0, 0, 4), (0, 0, 0), fov_y=35, size=(32, 32))
    file = export_mitsuba(scene, tmp_path / "scene", camera=camera)
    again = load(file)
    tracer, own = EmbreeTracer(again.mesh), resize(again.cameras[0], (32, 32))
    agrees(compare_with_mitsuba(file, again, tracer, own, samples=32, bounces=6, block=4))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["living-room", "veach-bidir"])
def test_interiors(name: str):
    folder = os.environ.get("JAXREFL_SCENES")
    if not folder:
        pytest.skip("JAXREFL_SCENES is not set: no real scenes")
    file = Path(folder) / name / "scene.xml"
    scene = load(file)
    own = scene.cameras[0]
    camera = resize(own, (128, 128 * own.height // own.width))
    tracer = EmbreeTracer(scene.mesh)
    found = compare_with_mitsuba(file, scene, tracer, camera, samples=8, bounces=15)
    assert (np.abs(found.difference) < 0.01 + 4 * found.means_error).all(), (found.difference, found.means_error)


def test_scores_tell_equal_from_different():
    """Two sets of replicates of the same noise agree; a difference of 2 % in one half does not."""
    rng = np.random.default_rng(0)
    images = rng.gamma(4, 0.25, (2, 8, 64, 64, 3)).astype(np.float32)
    same = agreement(images[0], images[1], block=8)
    assert abs(same.beyond - same.expected) < 0.03 and (np.abs(same.difference) < 0.02).all()
    images[1, :, :32] *= 1.1
    other = agreement(images[0], images[1], block=8)
    assert other.beyond > 3 * same.expected
    with pytest.raises(ValueError, match="expected equal shapes"):
        agreement(images[0], images[1][:, :32], block=8)
