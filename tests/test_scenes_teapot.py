"""The teapot: Newell's 32 patches, and a closed mesh that lies on them."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from test_scenes_shapes import euler_number, is_closed, least_agreement, volume

from scenes.teapot import evaluate, patches, teapot


def newell(points: np.ndarray) -> np.ndarray:
    """World positions in the axes of the published table, z upwards."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], -1)


def test_there_are_32_patches():
    assert sum(p[..., 0, 0, 0].size for p in patches().values()) == 32


@pytest.mark.parametrize(
    ("name", "published"),
    [  # one patch of each kind from the published table: rim, upper body, knob, handle, spout
        ("body", [(1.4, 0, 2.4), (1.4, -0.784, 2.4), (0.784, -1.4, 2.4), (0, -1.4, 2.4), (1.3375, -0.749, 2.53125)]),
        ("body", [(1.75, -0.98, 1.875), (0.98, -1.75, 1.875), (2, -1.12, 1.35), (1.12, -2, 0.9), (1.425, -0.798, 0)]),
        ("lid", [(0, 0, 3.15), (0.8, -0.45, 3.15), (0.45, -0.8, 3.15), (0, 0, 2.85), (0.112, -0.2, 2.7)]),
        ("lid", [(0.4, -0.224, 2.55), (1.3, -0.728, 2.55), (0.728, -1.3, 2.4)]),
        ("handle", [(-1.6, -0.3, 2.025), (-2.5, 0.3, 2.25), (-3, -0.3, 1.35), (-2.65, 0.3, 0.9375), (-1.9, 0, 0.6)]),
        ("spout", [(1.7, -0.66, 0.6), (3.1, 0.66, 0.825), (3.525, -0.25, 2.49375), (3.45, 0.15, 2.5125)]),
    ],
)
def test_control_points_are_the_published_ones(name, published):
    have = newell(patches()[name].reshape(-1, 3))
    for point in published:
        assert np.abs(have - point).max(-1).min() < 1e-12, point


def test_patches_meet_without_gaps():
    for name, chain in patches().items():
        np.testing.assert_array_equal(chain[:-1, :, 3], chain[1:, :, 0], err_msg=name)  # next piece
        np.testing.assert_allclose(chain[:, :, :, 3], np.roll(chain, -1, axis=1)[..., 0, :], err_msg=name)


def test_evaluation_agrees_with_de_casteljau(rng):
    control, s, t = rng.normal(size=(4, 4, 3)), 0.3, 0.8

    def halve(points: np.ndarray, x: float) -> np.ndarray:
        while len(points) > 1:
            points = (1 - x) * points[:-1] + x * points[1:]
        return points[0]

    def at(s: float, t: float) -> np.ndarray:
        return halve(np.stack([halve(row, t) for row in control]), s)

    p, ds, dt = evaluate(control, np.array(s), np.array(t))
    np.testing.assert_allclose(p, at(s, t), rtol=1e-12)
    np.testing.assert_allclose(ds, (at(s + 1e-6, t) - at(s - 1e-6, t)) / 2e-6, rtol=1e-6)
    np.testing.assert_allclose(dt, (at(s, t + 1e-6) - at(s, t - 1e-6)) / 2e-6, rtol=1e-6)


@pytest.mark.parametrize("segments", [3, 4, 5, 7, 10, 25])
def test_the_mesh_is_one_closed_surface_with_one_handle(segments):
    shape = teapot(segments)
    assert is_closed(shape)
    assert euler_number(shape) == 0  # genus 1
    # 26.0 in the limit, measured at 100 segments; the coarsest mesh has lost 6 %
    assert 0.93 * 26.0 < volume(shape) < 26.0
    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=-1), 1, atol=1e-9)
    # every vertex is connected to every other one
    parent = np.arange(len(shape.vertices))
    keys = np.unique(shape.vertices.astype(np.float32) + np.float32(0), axis=0, return_inverse=True)[1].reshape(-1)
    label = keys.copy()
    for _ in range(len(parent)):
        smallest = label[shape.faces].min(-1)
        before = label.copy()
        np.minimum.at(label, shape.faces.reshape(-1), np.repeat(smallest, 3))
        by_key = np.full(len(parent), len(parent))
        np.minimum.at(by_key, keys, label)
        label = by_key[keys]
        if (label == before).all():
            break
    assert len(np.unique(label)) == 1


def test_a_fine_mesh_has_the_normals_of_its_surface():
    assert least_agreement(teapot(40)) > 0.85  # measured 0.92, where the lip of the spout is tightest


def test_a_fine_mesh_lies_on_the_patches():
    grid = np.linspace(0, 1, 121)
    s, t = (x.ravel() for x in np.meshgrid(grid, grid, indexing="ij"))
    surface = [evaluate(control, s, t)[0] for chain in patches().values() for row in chain for control in row]
    distance = cKDTree(np.concatenate(surface)).query(teapot(12).vertices)[0]
    # spacing of the samples, at most 0.0275 apart; the cap of the spout lies between its lips
    off = distance > 0.02
    assert off.sum() <= 1
    assert np.allclose(teapot(12).vertices[off], (3.0, 2.4, 0), atol=0.05)


def test_too_few_segments_are_refused():
    with pytest.raises(ValueError, match="segments: expected at least 3, got 2"):
        teapot(2)


@pytest.mark.slow
def test_the_mesh_agrees_with_a_published_one():
    folder = os.environ.get("JAXREFL_SCENES")
    if not folder or not (path := Path(folder) / "meshes" / "teapot.obj").is_file():
        pytest.skip("needs teapot.obj in the folder of real scene files, named by JAXREFL_SCENES")
    lines = path.read_text().splitlines()
    published = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], np.float64)
    distance = cKDTree(teapot(80).vertices).query(published)[0]
    outside = np.abs(published[:, 0]) > 2.05  # inside the body the published handle and spout go on
    assert distance[outside].max() < 0.03
    assert np.median(distance) < 1e-5
