"""Ray origins leave their surface at any size and any position of the scene, and no further than they must."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrefl._types import Rays
from jaxrefl.core import cosine_hemisphere, look_at
from jaxrefl.rays import EmbreeTracer, offset_origin
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, Part, matte
from jaxrefl.surface import look

PIXELS = 96


def bumpy_floor(scale: float, shift: float):
    """Convex upward facets of many sizes: a ray that leaves upwards from a paraboloid never comes back."""
    x, y = np.meshgrid(np.linspace(-1, 1, 33) ** 3, np.linspace(-1, 1, 33) ** 3)
    vertices = scale * (np.stack([x, -0.2 * (x * x + y * y), -y], -1).reshape(-1, 3) + shift)
    i = (np.arange(32)[:, None] * 33 + np.arange(32)).reshape(-1, 1)
    faces = np.concatenate([i + [0, 1, 34], i + [0, 34, 33]])
    scene = assemble(Description("bumps", [Part("floor", vertices, faces, matte("m", (1, 1, 1)))]))
    middle = np.array([0, -0.05, 0]) + shift
    camera = look_at(scale * (middle + [0, 2, 0.01]), scale * middle, size=(PIXELS, PIXELS))
    return scene, camera


def self_hits(scale: float, shift: float, factor: float, key: jax.Array) -> float:
    """Share of rays that hit the convex surface they leave, with `factor` of the usual offset."""
    scene, camera = bumpy_floor(scale, shift)
    tracer = EmbreeTracer(scene.mesh)
    seen = look(scene, tracer, camera)
    wi = cosine_hemisphere(jax.random.uniform(key, (PIXELS, PIXELS, 2)), seen.n)
    origin = offset_origin(seen.p, seen.n, factor * seen.p_error, wi)
    hits = tracer.closest(Rays(origin, wi), active=seen.valid)
    return float(hits.valid.sum() / seen.valid.sum())


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("shift", [0.0, 10.0, 1000.0])
def test_no_ray_hits_the_surface_it_leaves(scale: float, shift: float, key: jax.Array):
    assert self_hits(scale, shift, 1.0, key) == 0


def test_the_offset_is_needed(key: jax.Array):
    """Without it half of the rays hit what they leave (0.49); one unit in the last place, a 48th, is too little."""
    assert self_hits(1.0, 10.0, 0.0, key) > 0.4
    assert self_hits(1.0, 10.0, 1 / 48, key) > 0


def test_rays_leave_on_the_side_they_go_to():
    p, n = jnp.zeros((2, 3)), jnp.array([[0.0, 0, 1]] * 2)
    direction = jnp.array([[0.6, 0, 0.8], [0.6, 0, -0.8]])
    np.testing.assert_allclose(offset_origin(p, n, jnp.full(2, 0.5), direction)[:, 2], [0.5, -0.5])


def test_scaling_by_a_power_of_two_changes_no_bit():
    """The offset is homogeneous: no absolute threshold hides in it."""
    small, camera_small = bumpy_floor(2.0**-10, 1.0)
    large, camera_large = bumpy_floor(2.0**10, 1.0)
    seen_small = look(small, EmbreeTracer(small.mesh), camera_small)
    seen_large = look(large, EmbreeTracer(large.mesh), camera_large)
    agree = seen_small.valid & seen_large.valid & (seen_small.triangle == seen_large.triangle)
    assert float(agree.mean()) > 0.99 * float(seen_small.valid.mean())
    np.testing.assert_array_equal(seen_small.p_error[agree] * 2.0**20, seen_large.p_error[agree])
