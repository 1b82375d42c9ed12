"""Safe functions, vectors, frames, shapes and the directions of reflection and refraction.

Tolerances of the property tests are twice the worst of 2 million random cases, or more.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import floats, shapes, unit_vectors
from tolerances import assert_close

from jaxrefl import core
from jaxrefl.core import safe


def vectors(shape: tuple[int, ...]) -> st.SearchStrategy:
    return floats(-10.0, 10.0, (*shape, 3))


def with_shape(build) -> st.SearchStrategy:
    """A tuple of arrays that share one of the three batch shapes."""
    return shapes().flatmap(lambda shape: st.tuples(*build(shape)))


class TestSafe:
    def test_agrees_with_numpy_where_numpy_is_defined(self, rng):
        a, b = rng.normal(size=(2, 100)).astype(np.float32)
        v = rng.normal(size=(100, 3)).astype(np.float32)
        assert_close(safe.divide(jnp.asarray(a), jnp.asarray(b)), a.astype(np.float64) / b)
        assert_close(safe.sqrt(jnp.asarray(a * a)), np.abs(a, dtype=np.float64))
        assert_close(safe.arccos(jnp.tanh(jnp.asarray(a))), np.arccos(np.tanh(a, dtype=np.float64)), scale=3)
        assert_close(safe.norm(jnp.asarray(v)), np.linalg.norm(v.astype(np.float64), axis=-1))
        assert_close(safe.normalise(jnp.asarray(v)), v / np.linalg.norm(v.astype(np.float64), axis=-1, keepdims=True))

    def test_fills(self):
        zero = jnp.zeros(())
        assert safe.divide(jnp.ones(()), zero, fill=7.0) == 7
        assert safe.divide(jnp.ones(()), zero) == 0
        assert safe.sqrt(-jnp.ones(())) == 0
        assert_close(safe.arccos(jnp.asarray([1.5, -1.5])), np.array([0.0, np.pi]))
        assert safe.norm(jnp.zeros(3)) == 0
        assert_close(safe.normalise(jnp.zeros(3)), np.array([0.0, 0, 1]))
        assert_close(safe.normalise(jnp.zeros(3), fill=(0, 0, -1)), np.array([0.0, 0, -1]))

    @pytest.mark.parametrize("scale", [1e-15, 1e-8, 1e8, 1e25])
    def test_lengths_neither_overflow_nor_underflow(self, scale):
        v = jnp.asarray([3.0, 0.0, -4.0]) * scale
        assert_close(safe.norm(v) / scale, np.array(5.0))
        assert_close(safe.normalise(v), np.array([0.6, 0, -0.8]))

    def test_gradients_are_the_true_ones(self):
        v = jnp.asarray([3.0, 0.0, -4.0])
        assert_close(jax.grad(safe.norm)(v), np.array([0.6, 0, -0.8]))
        projection = (np.eye(3) - np.outer([0.6, 0, -0.8], [0.6, 0, -0.8])) / 5
        assert_close(jax.jacobian(safe.normalise)(v), projection)
        assert_close(jax.grad(safe.sqrt)(jnp.asarray(4.0)), np.array(0.25))
        assert_close(jax.grad(safe.arccos)(jnp.asarray(0.6)), np.array(-1.25))
        for argument, slope in ((0, 0.5), (1, -0.75)):
            gradient = jax.grad(safe.divide, argnums=argument)(jnp.asarray(3.0), jnp.asarray(2.0))
            assert_close(gradient, np.array(slope))

    def test_nan_is_not_hidden(self):
        nan = jnp.asarray(np.nan, jnp.float32)
        one = jnp.ones(())
        for result in (safe.sqrt(nan), safe.arccos(nan), safe.divide(nan, one), safe.divide(one, nan)):
            assert np.isnan(result)
        assert np.isnan(safe.norm(jnp.full(3, nan)))


class TestVectors:
    @given(with_shape(lambda s: (vectors(s), vectors(s), floats(0.0, 1.0, s))))
    def test_against_numpy(self, abt):
        a, b, t = abt
        a64, b64, t64 = (np.asarray(x, np.float64) for x in (a, b, t))
        assert_close(core.dot(a, b), (a64 * b64).sum(-1), scale=10)  # terms of up to 100 cancel
        assert_close(core.cross(a, b), np.cross(a64, b64), scale=10)
        assert_close(core.lerp(a, b, t), a64 + (b64 - a64) * t64[..., None])

    @given(with_shape(lambda s: (vectors(s), vectors(s))))
    def test_interpolation_meets_both_ends_exactly(self, ab):
        a, b = ab
        assert (core.lerp(a, b, jnp.zeros(a.shape[:-1])) == a).all()
        assert (core.lerp(a, b, jnp.ones(a.shape[:-1])) == b).all()


class TestFrames:
    @given(shapes().flatmap(unit_vectors))
    def test_is_orthonormal_and_right_handed(self, n):
        tangent, bitangent = core.frame_from_normal(n)
        frame = np.stack([tangent, bitangent, n], -1).astype(np.float64)
        np.testing.assert_allclose(frame.swapaxes(-1, -2) @ frame, np.broadcast_to(np.eye(3), frame.shape), atol=1e-6)
        assert (np.linalg.det(frame) > 0.999).all()

    @given(with_shape(lambda s: (vectors(s), unit_vectors(s))))
    def test_there_and_back_again(self, vn):
        v, n = vn
        assert_close(core.to_world(core.to_local(v, n), n), v, scale=5)
        assert_close(core.to_local(core.to_world(v, n), n), v, scale=5)
        assert_close(core.to_local(v, n)[..., 2], core.dot(v, n))

    @pytest.mark.parametrize("z", [1.0, -1.0])
    def test_the_poles(self, z):
        tangent, bitangent = core.frame_from_normal(jnp.asarray([0.0, 0.0, z]))
        assert_close(core.cross(tangent, bitangent), np.array([0, 0, z]))


class TestShapes:
    @given(with_shape(lambda s: (vectors(s), unit_vectors(s), vectors(s), floats(0.1, 5.0, s))))
    def test_sphere_hits_lie_on_the_sphere(self, case):
        origin, direction, centre, radius = case
        enter, leave, valid = core.intersect_sphere(origin, direction, centre, radius)
        for t in (enter, leave):
            distance = safe.norm(origin + t[..., None] * direction - centre)
            np.testing.assert_allclose(np.where(valid, distance, radius), radius, atol=2e-5)
        assert ((leave >= enter) | ~valid).all()
        assert ((leave >= 0) | ~valid).all()
        assert ((enter == 0) & (leave == 0) | valid).all()

    @given(with_shape(lambda s: (vectors(s), unit_vectors(s), vectors(s), floats(0.1, 5.0, s))))
    def test_sphere_is_missed_only_by_rays_that_miss_it(self, case):
        origin, direction, centre, radius = (np.asarray(x, np.float64) for x in case)
        t = np.maximum(0, ((centre - origin) * direction).sum(-1))
        closest = np.linalg.norm(origin + t[..., None] * direction - centre, axis=-1)
        _, _, valid = core.intersect_sphere(*case)
        clear = np.abs(closest - radius) > 1e-4
        assert (np.asarray(valid) == (closest < radius))[clear].all()

    def test_sphere_seen_from_far_away_and_from_inside(self):
        down, o = jnp.asarray([0.0, 0.0, -1.0]), jnp.zeros(3)
        enter, leave, valid = core.intersect_sphere(jnp.asarray([0.0, 0.0, 1e4]), down, o, jnp.asarray(0.5))
        assert valid and abs(enter - 9999.5) < 2e-3 and abs(leave - 10000.5) < 2e-3  # one ulp is 1e-3
        enter, leave, valid = core.intersect_sphere(o, down, o, jnp.asarray(2.0))
        assert valid and enter == -2 and leave == 2
        assert not core.intersect_sphere(jnp.asarray([0.0, 0.0, -3.0]), down, o, jnp.asarray(1.0))[2]

    @given(with_shape(lambda s: (vectors(s), unit_vectors(s), vectors(s), unit_vectors(s))))
    def test_plane_hits_lie_in_the_plane(self, case):
        origin, direction, point, n = case
        t, valid = core.intersect_plane(origin, direction, point, n)
        slope = np.abs(core.dot(direction, n))
        height = core.dot(origin + t[..., None] * direction - point, n)
        np.testing.assert_array_less(np.where(valid & (slope > 0.01), np.abs(height), 0), 2e-3)  # t up to 3,000
        behind = np.asarray(core.dot(point - origin, n) * core.dot(direction, n)) < -1e-3
        assert not (np.asarray(valid) & behind).any()

    def test_plane_parallel_to_the_ray_is_not_met(self):
        origin, direction, n = jnp.zeros(3), jnp.asarray([1.0, 0, 0]), jnp.asarray([0.0, 1, 0])
        assert not core.intersect_plane(origin, direction, jnp.asarray([0.0, 1, 0]), n)[1]
        t, valid = core.intersect_plane(origin, n, jnp.asarray([5.0, 2, 0]), n)
        assert valid and t == 2

    def test_distance_to_a_triangle_is_that_of_its_nearest_point(self, rng):
        corners = rng.normal(size=(40, 3, 3)).astype(np.float32)
        p = (2 * rng.normal(size=(40, 3))).astype(np.float32)
        u, v = np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 201))
        weights = np.stack([1 - u - v, u, v], -1)[u + v <= 1]
        points = np.einsum("kc,ncd->nkd", weights, corners)
        slow = np.linalg.norm(points - p[:, None], axis=-1).min(-1)
        a, b, c = (jnp.asarray(corners[:, i]) for i in range(3))
        found = np.asarray(core.distance_to_triangle(jnp.asarray(p), a, b, c))
        np.testing.assert_allclose(found, slow, atol=0.01)
        assert (found <= slow + 1e-5).all()

    @given(with_shape(lambda s: (vectors(s), vectors(s), unit_vectors(s))))
    def test_mirror_twice_is_the_identity(self, case):
        p, point, n = case
        image = core.mirror_point(p, point, n)
        np.testing.assert_allclose(core.mirror_point(image, point, n), p, atol=6e-5)
        middle = 0.5 * (p + image)
        np.testing.assert_allclose(core.dot(middle - point, n), 0, atol=3e-5)


class TestReflectAndRefract:
    @given(with_shape(lambda s: (unit_vectors(s), unit_vectors(s))))
    def test_mirror_twice_is_the_identity(self, case):
        wo, n = case
        wi = core.reflect(wo, n)
        np.testing.assert_allclose(core.reflect(wi, n), wo, atol=1e-6)
        np.testing.assert_allclose(core.dot(wi, n), core.dot(wo, n), atol=1e-6)
        np.testing.assert_allclose(safe.norm(wi), 1, atol=1e-6)
        assert_close(core.reflect(wo, -n), wi)

    @given(with_shape(lambda s: (unit_vectors(s), unit_vectors(s), floats(1.0, 3.0, s))))
    def test_refraction_obeys_snell_and_can_be_undone(self, case):
        wo, n, eta = case
        wi, valid = core.refract(wo, n, eta)
        assert valid.all()
        np.testing.assert_allclose(safe.norm(wi), 1, atol=1e-6)
        np.testing.assert_allclose(core.cross(n, wo), -eta[..., None] * core.cross(n, wi), atol=3e-6)
        assert (core.dot(wo, n) * core.dot(wi, n) <= 1e-6).all()
        back, valid = core.refract(wi, n, 1 / eta)
        # Grazing light comes back at the critical angle, where total reflection is a matter of rounding.
        clear = np.abs(core.dot(wo, n)) > 0.01
        assert (np.asarray(valid) | ~clear).all()
        # Rounding of an angle near the critical one grows by 1 / cos: 1.8e-4 at the cosine of 0.01.
        np.testing.assert_allclose(np.where(clear[..., None], back, wo), wo, atol=4e-4)

    @given(with_shape(lambda s: (unit_vectors(s), floats(1.05, 3.0, s), floats(0.0, 1.0, s))))
    def test_total_internal_reflection_starts_at_the_critical_angle(self, case):
        n, eta, share = case
        tangent, _ = core.frame_from_normal(n)
        n64, tangent64, share64 = (np.asarray(x, np.float64) for x in (n, tangent, share))
        critical = 1 / np.asarray(eta, np.float64)
        before, beyond = 0.999 * critical * share64, 1.001 * critical + (1 - 1.001 * critical) * share64
        for sin, expected in ((before, True), (beyond, False)):
            cos = np.sqrt(np.maximum(0, 1 - sin * sin))
            wo = jnp.asarray(cos[..., None] * n64 + sin[..., None] * tangent64, jnp.float32)
            wi, valid = core.refract(wo, n, 1 / eta)
            assert (np.asarray(valid) == expected).all()
            if not expected:
                assert_close(wi, core.reflect(wo, n))

    @given(with_shape(lambda s: (unit_vectors(s), unit_vectors(s))))
    def test_without_a_change_of_index_light_goes_straight_on(self, case):
        wo, n = case
        wi, valid = core.refract(wo, n, jnp.ones(wo.shape[:-1]))
        np.testing.assert_allclose(wi, -wo, atol=1e-6)
        assert valid.all()
