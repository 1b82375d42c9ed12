"""Texture images: packing, wrap modes, decoding before filtering."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import lookup as reference
from strategies import floats, shapes

from jaxrefl.scene import Image, SceneError, build_textures, texture_rgba

lookup = eqx.filter_jit(texture_rgba)
gradient = eqx.filter_jit(jax.grad(lambda uv, textures, index: texture_rgba(textures, index, uv).sum()))


def images() -> list[tuple[Image, bool]]:
    """All wrap modes and both codings, odd sizes, a single texel."""
    rng = np.random.default_rng(0)
    cases = [((5, 7), (True, True), True), ((4, 3), (False, True), False), ((1, 1), (False, False), True)]
    cases += [((2, 9), (True, False), False), ((1, 6), (True, True), True)]
    return [
        (Image(f"image {i}", rng.integers(0, 256, (*size, 4), dtype=np.uint8), repeat), srgb)
        for i, (size, repeat, srgb) in enumerate(cases)
    ]


@given(floats(-2.5, 3.5, (5, 2)))
def test_lookup_agrees_with_the_definition(uv: jax.Array):
    pool = images()
    textures = build_textures(pool)
    rgba = lookup(textures, jnp.arange(5), uv)
    for (image, srgb), value, (u, v) in zip(pool, np.asarray(rgba), np.asarray(uv, np.float64), strict=True):
        expected = reference.texture(image.rgba, u, v, srgb=srgb, repeat=image.repeat)
        np.testing.assert_allclose(value, expected, atol=1e-5)  # 9 texels times the rounding of uv up to 3.5


@pytest.mark.parametrize("index", range(5))
def test_texel_centres_show_the_texel(index: int):
    pool = images()
    image, srgb = pool[index]
    height, width, _ = image.rgba.shape
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    uv = jnp.asarray(np.stack([u, v], -1), jnp.float32)
    rgba = np.asarray(lookup(build_textures(pool), jnp.full(uv.shape[:-1], index), uv))
    decoded = np.vectorize(reference.srgb_decoded)(image.rgba[..., :3]) if srgb else image.rgba[..., :3] / 255
    np.testing.assert_allclose(rgba[..., :3], decoded, atol=2e-6)
    np.testing.assert_allclose(rgba[..., 3], image.rgba[..., 3] / 255, atol=2e-6)


def test_colours_are_decoded_before_they_are_filtered():
    """Between black and white lies 0.5, not the decoded middle of the bytes (0.21)."""
    image = Image("step", np.array([[[0, 0, 0, 0], [255, 255, 255, 255]]], np.uint8), (False, False))
    rgba = lookup(build_textures([(image, True)]), jnp.int32(0), jnp.asarray([0.5, 0.5]))
    np.testing.assert_allclose(rgba, 0.5, atol=1e-6)


@given(st.data(), shapes())
def test_no_texture_is_white(data: st.DataObject, shape: tuple[int, ...]):
    uv = data.draw(floats(-1.0, 2.0, (*shape, 2)))
    np.testing.assert_array_equal(lookup(build_textures(images()), jnp.full(shape, -1), uv), 1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-30, 0.0, 1.0, -0.0])
def test_strange_coordinates_stay_finite(value: float):
    textures = build_textures(images())
    uv = jnp.full((5, 2), value, jnp.float32)
    rgba = np.asarray(lookup(textures, jnp.arange(5), uv))
    assert ((rgba >= 0) & (rgba <= 1)).all()
    assert np.isfinite(gradient(uv, textures, jnp.arange(5))).all()


def test_gradient_is_the_slope_between_texels():
    image = Image("step", np.array([[[0, 51, 0, 0], [255, 153, 0, 0]]], np.uint8), (False, False))
    textures = build_textures([(image, False)])
    slope = eqx.filter_jit(jax.jacobian(texture_rgba, argnums=2))(textures, jnp.int32(0), jnp.asarray([0.4, 0.5]))
    np.testing.assert_allclose(slope[:, 0], [2, 0.8, 0, 0], atol=1e-5)
    np.testing.assert_allclose(slope[:, 1], 0, atol=1e-5)


@pytest.mark.parametrize(
    "rgba", [np.ones((2, 2, 3), np.uint8), np.ones((2, 2, 4), np.float32), np.ones((0, 2, 4), np.uint8)]
)
def test_bad_images_are_named(rgba: np.ndarray):
    with pytest.raises(SceneError, match="wood.png.*h w 4.*uint8"):
        build_textures([(Image("wood.png", rgba), True)])


def test_an_empty_list_is_refused():
    with pytest.raises(SceneError, match="at least one"):
        build_textures([])
