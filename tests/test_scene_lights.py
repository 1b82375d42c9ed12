"""Lights of a description: which triangles emit how much, and what is refused."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxrefl.scene import (
    Description,
    Image,
    Part,
    PunctualLight,
    SceneError,
    assemble,
    build_lights,
    constant_sky,
    emitter,
    matte,
)

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], np.float64)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def square(name: str, material, *, size: float = 1.0, uv: np.ndarray | None = None) -> Part:
    return Part(name, CORNERS * size, FACES, material, uv=uv)


def lights_of(*parts: Part, **fields):
    return assemble(Description("test", list(parts), **fields)).lights


def test_a_scene_without_lights_has_none():
    lights = lights_of(square("floor", matte("grey", (0.5, 0.5, 0.5))))
    assert lights.area is None and lights.punctual is None and lights.environment is None
    np.testing.assert_array_equal(lights.ambient, 0)


def test_area_lights_are_chosen_by_power():
    lights = lights_of(
        square("floor", matte("grey", (0.5, 0.5, 0.5))),
        square("large", emitter("dim", (1, 1, 1)), size=2.0),
        square("small", emitter("green", (0, 4, 0))),
    )
    assert lights.area is not None
    assert not lights.area.textured
    np.testing.assert_array_equal(lights.area.triangle, [2, 3, 4, 5])
    np.testing.assert_allclose(lights.area.area, [2, 2, 0.5, 0.5])
    power = np.array([2, 2, 2 * 0.7152, 2 * 0.7152])  # area times luminance
    np.testing.assert_allclose(lights.area.probability, power / power.sum(), atol=1e-6)
    np.testing.assert_allclose(lights.area.cdf, np.cumsum(power) / power.sum(), atol=1e-6)


def test_emission_textures_count_triangle_by_triangle():
    """Only the lower left half of the lamp's texture is bright: its triangle gets most samples, the other a few."""
    rgba = np.zeros((64, 64, 4), np.uint8)
    rgba[np.tril_indices(64, -2)] = 255
    lamp = dataclasses.replace(emitter("lamp", (3, 3, 3)), emission_texture=Image("lamp.png", rgba))
    lights = lights_of(square("lamp", lamp, uv=CORNERS[:, [0, 2]]))
    assert lights.area is not None
    dark, bright = np.asarray(lights.area.probability)
    whole = 0.5  # mean of the texture; 0.1 of it is what even a dark triangle counts
    assert lights.area.textured
    assert bright / dark == pytest.approx((0.9 * 1 + 0.1 * whole) / (0.1 * whole), rel=0.1)


def test_triangles_in_the_black_of_their_texture_are_no_lights():
    """Of two panels on one texture only the one with a bright texel in its range shines, however small that is."""
    rgba = np.zeros((64, 64, 4), np.uint8)
    rgba[10, 10] = 255
    lamp = dataclasses.replace(emitter("lamp", (3, 3, 3)), emission_texture=Image("lamp.png", rgba))
    uv = 0.4 * CORNERS[:, [0, 2]] + 0.05
    lights = lights_of(square("dark", lamp, uv=uv + 0.5), square("lit", lamp, uv=uv))
    assert lights.area is not None
    assert set(np.asarray(lights.area.triangle).tolist()) == {2, 3}


def test_a_black_emission_texture_is_no_light():
    black = Image("black.png", np.zeros((2, 2, 4), np.uint8))
    lamp = dataclasses.replace(emitter("lamp", (3, 3, 3)), emission_texture=black)
    assert lights_of(square("lamp", lamp, uv=CORNERS[:, [0, 2]])).area is None


def test_emission_textures_need_images_and_coordinates():
    lamp = dataclasses.replace(
        emitter("lamp", (3, 3, 3)), emission_texture=Image("w", np.full((1, 1, 4), 255, np.uint8))
    )
    description = Description("test", [square("lamp", lamp, uv=CORNERS[:, [0, 2]])])
    scene = assemble(description)
    with pytest.raises(SceneError, match="no textures"):
        build_lights(description, scene.mesh, scene.materials)
    without_uv = dataclasses.replace(scene.mesh, uv=None)
    with pytest.raises(SceneError, match="no texture coordinates"):
        build_lights(description, without_uv, scene.materials, textures=scene.textures)


def test_punctual_lights_become_arrays():
    sun = PunctualLight("sun", (3, 2, 1), (9, 9, 9), (0, -2e30, 0), directional=True, angular_radius=0.1)
    spot = PunctualLight("spot", (1, 1, 1), (1, 2, 3), (1e-30, 0, 0), cos_inner=0.9, cos_outer=0.8)
    off = PunctualLight("off", (0, 0, 0))
    lights = lights_of(
        square("floor", matte("grey", (0.5, 0.5, 0.5))), lights=[sun, off, spot], ambient=(0.1, 0.2, 0.3)
    )
    assert lights.punctual is not None
    np.testing.assert_allclose(lights.punctual.direction, [[0, -1, 0], [1, 0, 0]])
    np.testing.assert_allclose(lights.punctual.position, [[0, 0, 0], [1, 2, 3]])
    np.testing.assert_array_equal(lights.punctual.directional, [True, False])
    np.testing.assert_allclose(lights.ambient, [0.1, 0.2, 0.3])


def test_a_sky_becomes_an_environment():
    lights = lights_of(square("floor", matte("grey", (0.5, 0.5, 0.5))), sky=constant_sky((1, 2, 3)))
    assert lights.environment is not None
    np.testing.assert_array_equal(lights.environment.radiance, jnp.asarray([[[1.0, 2.0, 3.0]]]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"intensity": (1.0, -1.0, 1.0)}, "intensity >= 0"),
        ({"intensity": (1.0, np.nan, 1.0)}, "intensity to be three finite"),
        ({"position": (1.0, np.inf, 1.0)}, "position to be three finite"),
        ({"direction": (0.0, 0.0, 0.0)}, "zero vector"),
        ({"cos_inner": 0.5, "cos_outer": 0.6}, "cos_outer <= cos_inner"),
        ({"cos_inner": 1.5}, "cos_outer <= cos_inner"),
        ({"angular_radius": -0.1}, "angular radius"),
        ({"angular_radius": 2.0}, "angular radius"),
    ],
)
def test_bad_lights_are_named(change: dict, message: str):
    light = dataclasses.replace(PunctualLight("lamp 7", (1, 1, 1)), **change)
    with pytest.raises(SceneError, match=f"lamp 7.*{message}"):
        lights_of(square("floor", matte("grey", (0.5, 0.5, 0.5))), lights=[light])


@pytest.mark.parametrize("ambient", [(-1.0, 0.0, 0.0), (np.nan, 0.0, 0.0)])
def test_bad_ambient(ambient):
    with pytest.raises(SceneError, match="ambient"):
        lights_of(square("floor", matte("grey", (0.5, 0.5, 0.5))), ambient=ambient)
