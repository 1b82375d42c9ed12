"""Mitsuba scene files: lights, compared with what Mitsuba makes of them."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from mitsuba_reading import SIZE, SPHERE, described
from mitsuba_scenes import camera, mitsuba, seen_by_mitsuba, write_scene

from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import environment_radiance, load
from jaxrefl.surface import look

mi = mitsuba()
pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


@pytest.mark.parametrize("flip", ["false", "true"])
@pytest.mark.parametrize("scale", ["1, 1, 1", "-1, 1, 1"])
@pytest.mark.parametrize("kind", ["rectangle", "disk", "sphere", "cube"])
def test_area_lights_shine_from_the_side_that_mitsuba_lets_shine(tmp_path: Path, kind: str, scale: str, flip: str):
    path = write_scene(
        tmp_path,
        camera(origin="0.4, 0.7, 3"),
        f'<shape type="{kind}"><boolean name="flip_normals" value="{flip}"/><transform name="to_world">'
        f'<scale value="{scale}"/></transform><emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter>'
        "</shape>",
    )
    expected = seen_by_mitsuba(mi, path, SIZE)
    scene = load(path)
    assert scene.materials.emits_back is not None and not scene.materials.emits_back.any()
    np.testing.assert_allclose(scene.materials.emission[0], [1, 2, 3])
    gbuffer = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0])
    both = np.asarray(gbuffer.valid) & expected["valid"]
    assert both.sum() > 40
    np.testing.assert_array_equal(np.asarray(gbuffer.outside)[both], expected["emission"][both].max(-1) > 0)
    np.testing.assert_array_equal(np.asarray(gbuffer.base_colour)[both], expected["albedo"][both])  # black


def write_smooth_map(folder: Path) -> Path:
    """A map whose colour is an affine function of the direction, with another gradient in each channel."""
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(128) + 0.5) / 128, indexing="ij")
    polar, azimuth = np.pi * v, 2 * np.pi * u
    d = np.stack([np.sin(polar) * np.cos(azimuth), np.cos(polar), np.sin(polar) * np.sin(azimuth)], -1)
    path = folder / "sky.exr"
    mi.Bitmap((1 + 0.9 * d).astype(np.float32)).write(str(path))
    return path


@pytest.mark.parametrize(
    "transform",
    [
        "",
        '<rotate y="1" angle="70"/>',
        '<rotate x="1" angle="130"/><rotate z="1" angle="50"/>',
        '<scale x="-1" y="1" z="1"/><rotate x="1" angle="40"/>',
    ],
)
def test_environment_maps_are_turned_as_in_mitsuba(tmp_path: Path, transform: str, rng: np.random.Generator):
    write_smooth_map(tmp_path)
    path = write_scene(
        tmp_path,
        SPHERE.format(""),
        '<emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale" value="2.5"/>'
        f'<transform name="to_world">{transform}</transform></emitter>',
    )
    scene, emitter = load(path), mi.load_file(str(path)).environment()
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    expected = []
    for d in directions.tolist():
        si = mi.SurfaceInteraction3f()
        si.wi = [-c for c in d]
        expected.append(np.asarray(emitter.eval(si)))
    assert scene.lights.environment is not None
    ours = environment_radiance(scene.lights.environment, jnp.asarray(directions, jnp.float32))
    # Mitsuba puts the first and last row at the poles and not half a row beside them: up to half a row is between the
    # two, 2.5 * 0.9 * pi / 128 = 0.055; measured worst case 0.052. A wrong turn is off by up to 4.5.
    np.testing.assert_allclose(ours, np.array(expected), atol=0.056)


def test_punctual_lights_and_constant_skies(tmp_path: Path):
    description = described(
        tmp_path,
        SPHERE.format(""),
        '<emitter type="point" id="lamp"><point name="position" x="1" y="2" z="3"/>'
        '<rgb name="intensity" value="1,2,3"/></emitter>',
        '<emitter type="directional"><vector name="direction" x="0" y="-2" z="0"/>'
        '<spectrum name="irradiance" value="3"/></emitter>',
        '<emitter type="spot"><transform name="to_world"><lookat origin="0, 3, 0" target="0, 0, 0" up="1, 0, 0"/>'
        '</transform><float name="cutoff_angle" value="40"/><float name="beam_width" value="30"/>'
        '<rgb name="intensity" value="5"/></emitter>',
        '<emitter type="constant"><rgb name="radiance" value="0.1, 0.2, 0.3"/></emitter>',
        '<emitter type="projector"/>',
    )
    point, sun, spot = description.lights
    assert (point.name, point.position, point.intensity) == ("lamp", (1, 2, 3), (1, 2, 3))
    assert sun.directional and sun.direction == (0, -1, 0)
    grey_of_spectrum = mi.load_dict({"type": "directional", "irradiance": {"type": "spectrum", "value": 3.0}})
    assert np.asarray(sun.intensity) == pytest.approx(
        np.broadcast_to(np.asarray(mi.traverse(grey_of_spectrum)["irradiance.value"]), 3), rel=1e-5
    )
    np.testing.assert_allclose(spot.direction, [0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(spot.position, [0, 3, 0], atol=1e-6)
    np.testing.assert_allclose([spot.cos_inner, spot.cos_outer], np.cos(np.radians([30, 40])))
    assert description.sky is not None
    np.testing.assert_allclose(description.sky.radiance, np.reshape([0.1, 0.2, 0.3], (1, 1, 3)), rtol=1e-6)
    assert "projector are ignored" in " ".join(description.notes)
