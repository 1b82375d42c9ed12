"""Measuring glossy layers: errors without the truth's noise, and what a mirror image can show."""

import json

import jax
import numpy as np
import pytest
from shapes import floor

from jaxrefl._types import Frame
from jaxrefl.core import look_at
from jaxrefl.metrics import compare
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, Part, glossy, matte
from jaxrefl.surface import look
from jaxrefl.techniques import mirror_gloss
from jaxrefl.techniques._tracing import trace_mirrors
from pipelines.bench import main
from pipelines.bench_gloss_shown import shown_rays
from pipelines.bench_gloss_truth import Truth, errors_of, noise_of


def test_errors_leave_out_the_noise_of_the_truth(rng):
    shape, mask = (96, 128, 3), np.ones((96, 128), bool)
    y, x = np.mgrid[:96, :128]
    true = 0.4 + 0.2 * np.sin(0.2 * x)[..., None] * np.ones(3)
    image = true + 0.05 * np.cos(0.3 * y)[..., None]
    exact = errors_of(image, Truth(true, true), mask)
    figures = compare(image, true, mask)
    assert exact["RMSE"] == pytest.approx(figures["rmse"], rel=1e-5)
    assert exact["DSSIM"] == pytest.approx(figures["dssim"], rel=0.02)
    noisy = Truth(*(true + 0.1 * rng.standard_normal(shape) for _ in range(2)))
    found = errors_of(image, noisy, mask)
    assert found["RMSE"] == pytest.approx(exact["RMSE"], rel=0.03)
    assert found["RMSE shown"] == pytest.approx(exact["RMSE shown"], rel=0.05)
    # The variance of the truth is an estimate in each window of 11 pixels: some of the bias is left.
    assert abs(found["DSSIM"] - exact["DSSIM"]) < 0.3 * abs(compare(image, noisy.mean, mask)["dssim"] - exact["DSSIM"])
    assert noise_of(noisy, mask) == pytest.approx(0.1 / 2**0.5, rel=0.05)
    own = [image + 0.1 * rng.standard_normal(shape) for _ in range(2)]
    assert errors_of(own[0], noisy, mask, again=own[1])["RMSE"] == pytest.approx(exact["RMSE"], rel=0.05)


@pytest.mark.slow
def test_a_mirror_image_shows_what_lies_in_its_picture():
    """A floor under a ceiling: near the middle of the picture narrow lobes are shown whole, at its border half."""
    ceiling = [[-9, 1, -9], [9, 1, -9], [9, 1, 9], [-9, 1, 9]]
    above = Part(
        "ceiling", np.asarray(ceiling, np.float64), np.array([[0, 1, 2], [0, 2, 3]]), matte("m", (0.3, 0.5, 0.7))
    )
    parts = [floor("floor", glossy("g", (1, 1, 1), alpha=0.05, metallic=1.0), size=20.0), above]
    scene = assemble(Description("shown", parts, ambient=(1.0, 1.0, 1.0)))
    tracer, camera = EmbreeTracer(scene.mesh), look_at((0, 0.5, 0), (0, 0, 0), up=(0, 0, -1), fov_y=60, size=(48, 32))
    frame = Frame(scene, camera, look(scene, tracer, camera), jax.random.key(0), tracer)
    sharp = trace_mirrors(frame, options=mirror_gloss.Options())
    found = shown_rays(frame, sharp, jax.random.key(1), samples=32)
    assert found.share[12:20, 20:28].mean() > 0.97  # the tails of the lobe go on beyond the picture
    assert found.share[:, 0].mean() == pytest.approx(0.5, abs=0.1)
    np.testing.assert_allclose(found.share + found.outside, 1, atol=0.02)
    np.testing.assert_allclose(found.image, np.broadcast_to([0.3, 0.5, 0.7], found.image.shape), atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["flat", "errors", "knobs"])
def test_a_quick_benchmark_of_the_gloss_filter_writes_its_tables(part: str, tmp_path):
    assert main(["--gloss", "roughness_steps", "--quick", "--part", part, "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / f"gloss_{part}.json").read_text())
    tables = {title: rows for title, rows in found.items() if title not in ("stamp", "commands")}
    first = next(iter(tables.values()))
    if part == "flat":
        assert all(row["RMSE"] < 0.02 for row in first if row["Gaussians"] == "two")
        return
    errors = {row["method"]: row["RMSE"] for row in first}
    assert errors["mirror_gloss"] < errors["gather"]
    for name in ("gloss_sweep.png",) if part == "knobs" else ("gloss.png", "gloss_errors_roughness_steps.png"):
        assert 0 < (tmp_path / name).stat().st_size < 300_000
    if part == "errors":
        limits = next(rows for title, rows in tables.items() if "does not show" in title)
        assert all(0 < row["share of the lobe shown"] <= 1 for row in limits)
