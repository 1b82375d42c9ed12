"""Latitude-longitude maps and sRGB: conventions, round trips, integrals."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from strategies import floats, shapes, unit_vectors
from tolerances import assert_close

from jaxrefl import core

COMPASS = [
    ([0.0, 0.0, -1.0], [0.5, 0.5]),
    ([1.0, 0.0, 0.0], [0.75, 0.5]),
    ([-1.0, 0.0, 0.0], [0.25, 0.5]),
    ([0.0, 1.0, 0.0], [0.5, 0.0]),
    ([0.0, -1.0, 0.0], [0.5, 1.0]),
]


@pytest.mark.parametrize(("d", "uv"), COMPASS)
def test_the_convention(d, uv):
    assert_close(core.latlong_from_direction(jnp.asarray(d)), np.array(uv))
    np.testing.assert_allclose(core.direction_from_latlong(jnp.asarray(uv)), d, atol=1e-6)


def test_backwards_is_at_both_ends():
    for u in (0.0, 1.0):
        np.testing.assert_allclose(core.direction_from_latlong(jnp.asarray([u, 0.5])), [0, 0, 1], atol=1e-6)
    assert core.latlong_from_direction(jnp.asarray([0.0, 0.0, 1.0]))[0] in (0, 1)


@given(shapes().flatmap(unit_vectors))
def test_direction_round_trip(d):
    uv = core.latlong_from_direction(d)
    assert ((uv >= 0) & (uv <= 1)).all()
    np.testing.assert_allclose(core.direction_from_latlong(uv), d, atol=2e-6)
    assert_close(core.latlong_from_direction(5 * d), uv)


@given(shapes().flatmap(lambda s: floats(0.01, 0.99, (*s, 2))))
def test_map_round_trip(uv):
    np.testing.assert_allclose(core.latlong_from_direction(core.direction_from_latlong(uv)), uv, atol=3e-6)


def test_solid_angle_of_a_texel():
    """The module's docstring: texels cover 2 pi^2 sin(theta) / (h w) and together the sphere."""
    h, w = 64, 128
    theta = np.pi * (np.arange(h) + 0.5) / h
    texel = 2 * np.pi**2 * np.sin(theta) / (h * w)
    assert w * texel.sum() == pytest.approx(4 * np.pi, rel=1e-3)
    # against the area of a texel's corners, seen as a small quadrilateral
    row, column = 20, 37
    corners = [
        core.direction_from_latlong(jnp.asarray([(column + i) / w, (row + j) / h], jnp.float32))
        for i in (0, 1)
        for j in (0, 1)
    ]
    area = np.linalg.norm(np.cross(np.asarray(corners[3] - corners[0]), np.asarray(corners[2] - corners[1]))) / 2
    assert area == pytest.approx(texel[row], rel=2e-3)


@given(shapes().flatmap(lambda s: floats(-0.5, 4.0, s)))
def test_srgb_round_trip(x):
    assert_close(core.linear_from_srgb(core.srgb_from_linear(x)), x, scale=3)
    assert_close(core.srgb_from_linear(core.linear_from_srgb(x)), x, scale=3)


def test_srgb_against_the_standard(rng):
    """IEC 61966-2-1 in float64, and its well-known values."""
    x = rng.uniform(0, 1, 1000)
    expected = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    assert_close(core.srgb_from_linear(jnp.asarray(x, jnp.float32)), expected, scale=2)
    middle = core.linear_from_srgb(jnp.asarray([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(middle, [0, 0.21404114, 1], atol=1e-6)


def test_srgb_has_no_step_at_the_seam():
    seam = jnp.asarray([0.0031308 - 1e-7, 0.0031308 + 1e-7])
    low, high = core.srgb_from_linear(seam)
    assert 0 <= high - low < 1e-5
    low, high = core.linear_from_srgb(jnp.asarray([0.04045 - 1e-6, 0.04045 + 1e-6]))
    assert 0 <= high - low < 1e-6


def test_luminance():
    primaries = core.luminance(jnp.eye(3))
    assert_close(primaries, np.array([0.2126, 0.7152, 0.0722]))
    assert core.luminance(jnp.ones(3)) == pytest.approx(1)
