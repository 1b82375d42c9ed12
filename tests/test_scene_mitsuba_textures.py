"""Mitsuba scene files: textures, compared with what Mitsuba makes of them."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from mitsuba_reading import SIZE, only_material, picture
from mitsuba_scenes import camera, mitsuba, seen_by_mitsuba, write_png, write_scene

from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import load, texture_rgba
from jaxrefl.scene.mitsuba_textures import CHECKERBOARD
from jaxrefl.surface import look

mi = mitsuba()
pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


def test_two_texels_lie_as_in_mitsuba(tmp_path: Path):
    write_png(tmp_path / "two.png", [[[255, 0, 0]], [[0, 0, 255]]])
    settings = {"type": "bitmap", "filename": str(tmp_path / "two.png"), "filter_type": "nearest"}
    texture, si = mi.load_dict(settings), mi.SurfaceInteraction3f()
    scene = load(
        write_scene(
            tmp_path,
            '<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
            '<string name="filename" value="two.png"/></texture></bsdf></shape>',
        )
    )
    assert scene.textures is not None
    for v in (0.25, 0.75):
        si.uv = [0.5, v]
        ours = texture_rgba(scene.textures, jnp.zeros(1, jnp.int32), jnp.asarray([[0.5, v]], jnp.float32))
        np.testing.assert_allclose(ours[0, :3], np.asarray(texture.eval(si)), atol=1e-6)


@pytest.mark.parametrize("raw", ["true", "false"])
@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_coding_wrapping_and_the_transform_of_textures(tmp_path: Path, raw: str, wrap: str):
    picture(tmp_path)
    texture = (
        '<texture type="bitmap" name="reflectance"><string name="filename" value="picture.png"/>'
        f'<boolean name="raw" value="{raw}"/><string name="wrap_mode" value="{wrap}"/>'
        '<transform name="to_uv"><scale x="1.5" y="-2"/><rotate z="1" angle="20"/><translate x="0.2" y="0.1"/>'
        "</transform></texture>"
    )
    path = write_scene(tmp_path, camera(), f'<shape type="rectangle"><bsdf type="diffuse">{texture}</bsdf></shape>')
    scene = load(path)
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0]), seen_by_mitsuba(mi, path, SIZE)
    # measured worst cases: 0.004 for raw pictures, which are coded with 8 bits anew, and 3e-6 for the others
    tolerance = 8e-3 if raw == "true" else 1e-4
    np.testing.assert_allclose(gbuffer.base_colour, expected["albedo"], atol=tolerance)


def test_checkerboards(tmp_path: Path):
    texture = (
        '<texture type="checkerboard" name="reflectance"><rgb name="color0" value="0.9, 0.5, 0.1"/>'
        '<rgb name="color1" value="0.1, 0.2, 0.3"/><transform name="to_uv"><scale x="3" y="2"/></transform></texture>'
    )
    path = write_scene(tmp_path, camera(), f'<shape type="rectangle"><bsdf type="diffuse">{texture}</bsdf></shape>')
    scene = load(path)
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0]), seen_by_mitsuba(mi, path, SIZE)
    np.testing.assert_allclose(
        gbuffer.base_colour, expected["albedo"], atol=4e-3
    )  # measured worst case 0.0037, half a step of 8-bit sRGB
    assert str(CHECKERBOARD) in " ".join(scene.names.notes)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_opacity_is_what_mitsuba_takes_of_a_bitmap(tmp_path: Path, channels: int):
    path = picture(tmp_path, channels=channels)
    material = only_material(
        tmp_path,
        '<bsdf type="mask" id="leaf"><texture type="bitmap" name="opacity"><string name="filename" '
        'value="picture.png"/></texture><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>',
    )
    mask = mi.load_dict(
        {"type": "mask", "opacity": {"type": "bitmap", "filename": str(path)}, "nested": {"type": "diffuse"}}
    )
    assert material.name == "leaf" and material.opacity == 1 and material.opacity_texture is not None
    alpha = material.opacity_texture.rgba[..., 3]
    si = mi.SurfaceInteraction3f()
    si.wi = [0, 0, 1]
    for row, column in np.ndindex(8, 8):
        si.uv = [(column + 0.5) / 8, (row + 0.5) / 8]
        passed = float(np.asarray(mask.eval_null_transmission(si))[0])
        assert alpha[row, column] / 255 == pytest.approx(1 - passed, abs=3e-3)  # half a step is 0.002
