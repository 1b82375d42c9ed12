"""Mitsuba scene files: old, broken and incomplete ones, and real scenes."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mitsuba_reading import SPHERE, described, picture
from mitsuba_scenes import mitsuba, seen_by_mitsuba, write_scene

from jaxrefl.core import resize
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import SceneError, assemble, describe_file, load
from jaxrefl.scene.mitsuba import describe_mitsuba
from jaxrefl.scene.mitsuba_shapes import SEGMENTS
from jaxrefl.surface import look

mi = mitsuba()
pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


def test_old_versions_defaults_includes_and_unused_properties(tmp_path: Path):
    (tmp_path / "parts").mkdir()
    picture(tmp_path / "parts")
    (tmp_path / "parts" / "more.xml").write_text(
        '<scene version="0.6.0"><bsdf type="diffuse" id="paint"><texture type="bitmap" name="reflectance">'
        '<string name="filename" value="picture.png"/><boolean name="highQualityEdges" value="true"/></texture></bsdf>'
        '<shape type="sphere"><float name="radius" value="$size"/><ref id="paint"/></shape></scene>'
    )
    path = write_scene(
        tmp_path,
        '<default name="size" value="2"/>',
        '<integrator type="path"><integer name="maxDepth" value="4"/></integrator>',
        '<include filename="parts/more.xml"/>',
        '<shape type="disk" id="lid"><transform name="toWorld"><scale value="0.5"/></transform></shape>',
        '<shape type="hair"/>',
        version="0.5.0",
    )
    description = describe_file(path)
    ball, lid = description.parts
    assert ball.material.name == "paint" and ball.material.base_colour_texture is not None
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 2, rtol=1e-6)
    assert lid.name == "lid" and np.abs(lid.vertices).max() == pytest.approx(0.5)
    assert "shapes of the type hair are left out" in " ".join(description.notes)
    with pytest.raises(RuntimeError):
        mi.load_file(str(path))  # Mitsuba itself refuses it


def test_overrides_by_the_ids_of_materials(tmp_path: Path):
    path = write_scene(tmp_path, SPHERE.format('<bsdf type="twosided" id="paint"><bsdf type="diffuse"/></bsdf>'))
    (part,) = describe_file(path, overrides={"materials": {"paint": {"kind": "mirror"}}}).parts
    assert part.material.metallic == 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("<shape", "Error parsing"),
        ('<shape type="sphere"><ref id="nothing"/></shape>', 'unresolved reference to "nothing"'),
        ('<float name="x" value="$unknown"/>', "undefined parameter"),
        ('<include filename="missing.xml"/>', "missing.xml"),
        ('<shape type="obj"><string name="filename" value="missing.obj"/></shape>', "missing.obj does not exist"),
        ('<shape type="sphere"/><emitter type="envmap"><string name="filename" value="no.exr"/></emitter>', "no.exr"),
        ('<shape type="sphere"><bsdf type="conductor"><string name="material" value="xy"/></bsdf></shape>', "xy"),
        ('<shape type="sphere"><float name="radius" value="nan"/></shape>', "radius: expected a finite number"),
        ('<shape type="hair"/>', "at least one triangle"),
    ],
)
def test_broken_files_are_refused_with_their_name(tmp_path: Path, content: str, words: str):
    path = write_scene(tmp_path, content)
    with pytest.raises(SceneError, match="room.xml") as caught:
        describe_file(path)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_a_broken_mesh_file_is_refused(tmp_path: Path):
    (tmp_path / "m.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    path = write_scene(tmp_path, '<shape type="ply"><string name="filename" value="m.ply"/></shape>')
    with pytest.raises(SceneError, match="room.xml"):
        describe_file(path)


@pytest.mark.parametrize("name", ["missing.png", "broken.png"])
def test_missing_textures_are_grey_and_noted(tmp_path: Path, name: str):
    (tmp_path / "broken.png").write_bytes(b"not a picture")
    path = write_scene(
        tmp_path,
        SPHERE.format(
            f'<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="{name}"/>'
            "</texture></bsdf>"
        ),
    )
    description = describe_file(path)
    assert description.parts[0].material.base_colour == (0.5, 0.5, 0.5)
    assert f"texture '{name}' left out" in " ".join(description.notes)


def test_mitsubas_settings_are_as_they_were(tmp_path: Path):
    path = write_scene(tmp_path, '<path value="."/>', SPHERE.format(""))
    mi.set_variant("scalar_spectral")
    try:
        before = (mi.variant(), str(mi.file_resolver()), mi.log_level())
        describe_file(path)
        assert (mi.variant(), str(mi.file_resolver()), mi.log_level()) == before
        write_scene(tmp_path, "<shape")
        with pytest.raises(SceneError):
            describe_file(path)
        assert (mi.variant(), str(mi.file_resolver()), mi.log_level()) == before
    finally:
        mi.set_variant("scalar_rgb")


def test_without_mitsuba_the_message_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(SceneError, match=r"pip install 'jaxrefl\[mitsuba\]'"):
        describe_file(write_scene(tmp_path, SPHERE.format("")))


def test_mitsuba_is_imported_only_when_it_is_needed():
    code = "import sys, jaxrefl; assert not {'mitsuba', 'jaxrefl.scene.mitsuba'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_render_material_tables_hold_what_was_read(tmp_path: Path):
    scene = assemble(
        described(
            tmp_path,
            SPHERE.format('<bsdf type="conductor"><string name="material" value="Au"/></bsdf>'),
            SPHERE.format('<bsdf type="plastic"/>'),
        )
    )
    assert scene.features.conductive and scene.features.coupled and not scene.features.emissive


REAL = {
    # folder: triangles of its mesh files and named materials, as its README.md says; triangles of rectangles and disks
    "living-room": (143163, 19, 0),
    "staircase2": (30911, 8, 5 * SEGMENTS + 8 * 2),
    "veach-bidir": (11540, 4, 2 * 2),
    "coffee": (235265, 5, 3 * 2),
    "teapot": (126048, 2, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_scenes(name: str):
    path = Path(os.environ.get("JAXREFL_SCENES", "nowhere")) / name / "scene.xml"
    if not path.is_file():
        pytest.skip(f"{name} is not there: set JAXREFL_SCENES to the folder of real scene files")
    triangles, materials, more = REAL[name]
    assert sum(len(part.faces) for part in describe_mitsuba(path).parts) == triangles + more
    start = time.perf_counter()
    scene = load(path)
    assert time.perf_counter() - start < 15  # measured 1.8 s for living-room; the rest is for a busy machine
    ids = set(re.findall(r'<bsdf [^>]*id="([^"]+)"', path.read_text()))
    assert len(ids) == materials and ids <= set(scene.names.materials)
    (camera,) = scene.cameras
    size = (camera.width // 40, camera.height // 40)
    seen, expected = look(scene, EmbreeTracer(scene.mesh), resize(camera, size)), seen_by_mitsuba(mi, path, size)
    both = np.asarray(seen.valid) & expected["valid"]
    near = np.linalg.norm(np.asarray(seen.p) - expected["p"], axis=-1) < 1e-4 * float(np.abs(scene.upper).max())
    assert both.mean() > 0.5 and near[both].mean() > 0.99
    albedo = np.abs(np.asarray(seen.base_colour) - expected["albedo"]).max(-1)[both & (seen.metallic == 0)]
    # measured 0.0019 on the teapot's checkerboard (8-bit colours), 3e-5 elsewhere; the rest is glass
    assert np.quantile(albedo, 0.9) < 3e-3
