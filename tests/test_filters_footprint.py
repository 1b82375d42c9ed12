"""Footprints of GGX lobes: against the lobe itself, in pixels, with slant, curvature and partly blurred sources."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.gloss import edge_profile, lobe
from shapes import ball, floor

from jaxrefl.core import look_at
from jaxrefl.filters import (
    Footprint,
    FootprintOptions,
    TableOptions,
    build_table,
    footprint,
    load_table,
    lobe_gaussians,
    nearest_covariance,
    principal_axes,
    relative_distance,
    remaining,
)
from jaxrefl.filters.lobe import WIDEST
from jaxrefl.filters.lobe_file import cache_folder
from jaxrefl.filters.lobe_fit import mixture_profile
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, glossy
from jaxrefl.surface import look


@pytest.fixture(scope="module")
def table():
    return load_table()


def truth(alpha: float, degrees: float, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples of a lobe on one axis with their weights, and places across four widths to either side."""
    tangents, weights = lobe(alpha, np.cos(np.radians(degrees)))
    seen = (tangents**2).sum(-1) < WIDEST**2
    values, weights = tangents[seen, axis], weights[seen] / weights[seen].sum()
    order = np.argsort(values)
    low, middle, high = np.interp([0.2, 0.5, 0.8], np.cumsum(weights[order]), values[order])
    return values, weights, middle + (high - low) / 1.5 * np.linspace(-4, 4, 161)


def errors(table, alpha: float, degrees: float, axis: int) -> tuple[float, float]:
    """RMSE of the profile, and relative error of its width from 20 % to 80 %."""
    values, weights, places = truth(alpha, degrees, axis)
    g = lobe_gaussians(table, *(jnp.float32(x) for x in (np.cos(np.radians(degrees)), alpha, 1.0)))
    mean, sigma = (g.mean, g.along) if axis == 0 else (0 * g.mean, g.across)
    fitted = np.asarray(mixture_profile(jnp.asarray(places, jnp.float32), g.weight, mean, sigma))
    true = edge_profile(places, values, weights)
    widths = [np.diff(np.interp([0.2, 0.8], profile, places))[0] for profile in (fitted, true)]
    return float(np.sqrt(np.mean((fitted - true) ** 2))), float(widths[0] / widths[1] - 1)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("degrees", [0.0, 40.0, 60.0])
@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.25, 0.5, 1.0])
def test_edge_profiles_are_those_of_the_lobe(alpha: float, degrees: float, axis: int, table):
    rmse, width = errors(table, alpha, degrees, axis)
    assert rmse < 0.007 and abs(width) < 0.03  # worst measured: 0.0064 and 2.2 %, along at 60 degrees


@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.25, 0.5, 1.0])
def test_grazing_profiles_are_less_exact(alpha: float, table):
    for axis in (0, 1):
        rmse, width = errors(table, alpha, 85.0, axis)
        assert rmse < 0.016 and abs(width) < 0.09  # worst measured: 0.0149 and 8 %


def test_one_gaussian_is_too_wide_in_the_middle():
    """Why there are two: the published shape misses the targets for every narrow lobe."""
    rmse, width = errors(load_table(options=TableOptions("one")), 0.02, 0.0, 0)
    assert rmse > 0.02 and width > 0.1


@pytest.mark.slow
def test_second_moments_are_worse_than_a_fit():
    """The published estimate: the lobe's tails, which no Gaussian has, make it wider still."""
    for alpha in (0.02, 0.1, 0.5):
        fit, moments = (
            errors(load_table(options=TableOptions(method)), alpha, 0.0, 0) for method in ("one", "moments")
        )
        assert moments[0] > fit[0] and moments[1] > fit[1] > 0


def test_narrow_frontal_lobes_are_student_distributions(table):
    """The closed form: 1/2 (1 + u / sqrt(u^2 + w^2)) with w = 2 alpha tau."""
    alpha, tau = 0.01, 0.3
    g = lobe_gaussians(table, jnp.float32(1), jnp.float32(alpha), jnp.float32(tau))
    u = np.linspace(-4, 4, 101) * 2 * alpha * tau
    expected = 0.5 * (1 + u / np.sqrt(u**2 + (2 * alpha * tau) ** 2))
    fitted = mixture_profile(jnp.asarray(u, jnp.float32), g.weight, g.mean, g.along)
    assert np.sqrt(np.mean((np.asarray(fitted) - expected) ** 2)) < 0.004  # measured 0.003


def test_look_ups_are_differentiable_and_finite_at_the_ends(table):
    def widths(alpha, cosine, tau):
        g = lobe_gaussians(table, cosine, alpha, tau)
        return (g.along + g.across + g.mean).sum()

    gradient = jax.jit(jax.vmap(jax.value_and_grad(widths, (0, 1, 2))))
    grid = np.stack(np.meshgrid([0, 1e-30, 1e-3, 0.3, 1], [0, 1e-6, 0.5, 1], [0, 0.5, 1]), -1).reshape(-1, 3)
    values, gradients = gradient(*(jnp.asarray(grid[:, i], jnp.float32) for i in range(3)))
    assert all(np.isfinite(np.asarray(x)).all() for x in (values, *gradients))
    step = 1e-3
    for alpha in (0.11, 0.4, 0.77):
        at = [jnp.asarray([alpha + d, 0.6, 0.5], jnp.float32) for d in (0, -step, step)]
        low, high = (float(widths(*x)) for x in at[1:])
        assert float(gradient(*(x[None] for x in at[0]))[1][0][0]) == pytest.approx((high - low) / (2 * step), rel=0.02)


def test_relative_distance_at_contact_and_at_infinity():
    t = jnp.asarray([0.0, 0.0, 1.0, 1.0, 2.0], jnp.float32)
    r = jnp.asarray([0.0, jnp.inf, 0.0, jnp.inf, 6.0], jnp.float32)
    np.testing.assert_allclose(relative_distance(t, r), [0, 1, 0, 1, 0.75])
    assert np.isfinite(np.asarray(jax.grad(lambda t, r: relative_distance(t, r).sum(), (0, 1))(t, r))).all()


def seen(parts, camera):
    scene = assemble(Description("footprint", parts, ambient=(1.0, 1.0, 1.0)))
    return look(scene, EmbreeTracer(scene.mesh), camera)


def test_a_slanted_floor_in_pixels_against_points_projected_one_by_one(table):
    """Mirrored points of the lobe, projected through the camera: their spread on the image, off its middle too."""
    alpha, d_r = 0.05, 3.0
    camera = look_at((0, 2, 4), (0.5, 0, 0), fov_y=60, size=(48, 36))
    g = seen([floor("floor", glossy("g", (1, 1, 1), alpha=alpha, metallic=1.0), size=20.0)], camera)
    tau = relative_distance(g.t, jnp.full(g.t.shape, d_r))
    shape = jax.jit(footprint)(table, camera, g, tau)
    matrix = np.asarray(camera.world_from_camera, np.float64)
    for y, x in ((20, 24), (30, 4), (14, 44)):
        p, wo = (np.asarray(v, np.float64)[y, x] for v in (g.p, g.wo))
        n, view = np.array([0, 1.0, 0]), -wo
        along = (n - n @ view * view) / np.linalg.norm(n - n @ view * view)
        tangents, weights = lobe(alpha, wo @ n)
        near = (tangents**2).sum(-1) < WIDEST**2
        tangents, weights = tangents[near], weights[near] / weights[near].sum()
        points = p + d_r * (view + tangents[:, :1] * along + tangents[:, 1:] * np.cross(view, along))
        local = (points - matrix[:3, 3]) @ matrix[:3, :3]
        focal, centre = np.asarray(camera.focal, np.float64), np.asarray(camera.centre, np.float64)
        image = centre + focal * np.stack([local[:, 0], -local[:, 1]], -1) / -local[:, 2:] - [x + 0.5, y + 0.5]
        for angle in np.radians([0, 45, 90, 135]):
            d = np.array([np.cos(angle), np.sin(angle)])
            places = np.linspace(-12, 12, 121)
            true = edge_profile(places, image @ d, weights)
            c, m = (np.asarray(v, np.float64)[y, x] for v in (shape.covariance, shape.mean))
            sigma = np.sqrt(c[:, 0] * d[0] ** 2 + 2 * c[:, 1] * d[0] * d[1] + c[:, 2] * d[1] ** 2)
            fitted = mixture_profile(*(jnp.asarray(v, jnp.float32) for v in (places, shape.weight[y, x], m @ d, sigma)))
            # 0.012: worst measured; perspective bends wide lobes, which a matrix cannot.
            assert np.sqrt(np.mean((np.asarray(fitted) - true) ** 2)) < 0.012
    rows = np.asarray(principal_axes(shape.covariance[..., 0, :]).sin)[20, 24]
    assert abs(rows) > 0.95, "reflections on a floor are longer than wide"


@pytest.mark.slow
def test_convex_mirrors_shrink_footprints(table):
    """In the middle of a ball of radius R: tau / (1 + 2 tau d_c / R) in place of tau."""
    metal = glossy("g", (1, 1, 1), alpha=0.1, metallic=1.0)
    camera = look_at((0, 0, 5), (0, 0, 0), fov_y=30, size=(65, 65))
    g = seen([ball("ball", metal, subdivisions=5)], camera)
    tau = jnp.full(g.t.shape, 0.5)
    options = FootprintOptions(curvature=False)
    widths = [
        float(jnp.sqrt(f(table, camera, g, tau).covariance[32, 32, 0, 0]))
        for f in (jax.jit(footprint), jax.jit(lambda *a: footprint(*a, options=options)))
    ]
    assert widths[0] / widths[1] == pytest.approx(1 / (1 + 2 * 0.5 * 4.0), rel=0.03)


def test_half_a_covariance_is_left_where_the_source_had_half():
    covariance = jnp.asarray([[[4.0, 1.0, 2.0]]])
    full = Footprint(jnp.ones((1, 1)), jnp.zeros((1, 1, 2)), covariance)
    half = dataclasses.replace(full, covariance=covariance / 2)
    np.testing.assert_allclose(remaining(full, half).covariance, covariance / 2)
    np.testing.assert_allclose(remaining(half, full).covariance, 0, atol=1e-6)


def test_the_nearest_covariance_against_numpy(rng):
    matrices = rng.normal(size=(50, 2, 2))
    matrices += matrices.swapaxes(1, 2)
    packed = jnp.asarray(np.stack([matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]], -1), jnp.float32)
    found = np.asarray(nearest_covariance(packed))
    values, vectors = np.linalg.eigh(matrices)
    expected = np.einsum("nij,nj,nkj->nik", vectors, np.maximum(values, 0), vectors)
    np.testing.assert_allclose(found[:, [0, 1, 1, 2]].reshape(-1, 2, 2), expected, atol=2e-6)
    axes = principal_axes(packed)
    np.testing.assert_allclose(axes.major, np.sqrt(np.maximum(values[:, 1], 0)), atol=2e-6)


def test_options_are_checked():
    for make in (lambda: TableOptions("three"), lambda: TableOptions(surface="cube"), lambda: TableOptions(size=1)):
        with pytest.raises(ValueError, match="expected"):
            make()
    with pytest.raises(ValueError, match="foreshortening"):
        FootprintOptions("none")


@pytest.mark.slow
def test_the_shipped_table_is_what_the_code_makes():
    built, shipped = build_table(options=TableOptions()), load_table()
    for a, b in zip(jax.tree.leaves(built), jax.tree.leaves(shipped), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-2, atol=1e-2)  # fits stop at 1e-5 of their own


@pytest.mark.slow
def test_other_tables_are_built_once_and_read_afterwards(tmp_path, monkeypatch):
    monkeypatch.setenv("JAXREFL_CACHE", str(tmp_path))
    options = TableOptions("moments", "sphere", 3)
    load_table.cache_clear()
    first = load_table(options=options)
    assert cache_folder() == tmp_path and len(list(tmp_path.iterdir())) == 1
    load_table.cache_clear()
    assert jax.tree.all(jax.tree.map(lambda a, b: bool((a == b).all()), first, load_table(options=options)))
    near, far = (lobe_gaussians(first, *map(jnp.float32, (1.0, 0.5, tau))).along[0] / tau for tau in (0.05, 0.95))
    assert near < far, "on a sphere the footprint of what is near is narrower than tau says"
