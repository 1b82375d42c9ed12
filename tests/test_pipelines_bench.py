"""The benchmarks' arithmetic, and that they run."""

import json

import numpy as np
import pytest

from pipelines.bench import growth, interleaved, main
from pipelines.bench_path import slopes
from pipelines.bench_tables import table


def test_growth_finds_exponents():
    rows = [
        {"triangles": n, "side": side, "bare_ms": 2.0 * side**2, "whole_ms": 3.0 * side}
        for n in (10, 1000)
        for side in (8, 32)
    ]
    pixels = growth(rows, "side")
    assert [row["triangles"] for row in pixels] == [10, 1000]
    assert pixels[0]["bare_exponent"] == pytest.approx(1) and pixels[0]["whole_exponent"] == pytest.approx(0.5)
    assert growth(rows, "triangles")[0]["whole_times"] == pytest.approx(1)


def test_runs_are_interleaved_and_the_first_does_not_count():
    order = []
    medians = interleaved(3, lambda: order.append("a"), lambda: order.append("b"))
    assert order == ["a", "b"] * 4 and len(medians) == 2 and min(medians) > 0


def test_tables_are_markdown():
    assert table([{"a": 1, "b": 0.123456}]) == "| a | b |\n|---|---|\n| 1 | 0.1235 |"


def test_slopes_of_known_errors_are_found():
    spp = (4, 16, 64)
    errors = [np.full((8, 3, 5), 0.09 / n) for n in spp]
    found = slopes(errors, spp)
    assert found["slope"] == pytest.approx(-0.5) and found["slope, typical pixel"] == pytest.approx(-0.5)
    assert found["RMSE at 4 samples"] == pytest.approx(0.15) and found["RMSE at 64 samples"] == pytest.approx(0.0375)
    errors[2][3, 1, 2] = 1e6  # one bright pixel in one run moves neither median
    assert slopes(errors, spp)["slope"] == pytest.approx(-0.5)
    assert slopes([np.zeros((8, 3, 5))] * 3, spp)["slope"] is None


def test_the_main_job_needs_its_scenes(tmp_path, monkeypatch):
    monkeypatch.setenv("JAXREFL_SCENES", str(tmp_path))
    with pytest.raises(ValueError, match="JAXREFL_SCENES: expected a folder with cornell-obj"):
        main(["--main-job", str(tmp_path / "out")])


@pytest.mark.slow
def test_a_quick_benchmark_writes_its_tables(tmp_path):
    assert main(["--quick", "--runs", "1", "--out", str(tmp_path)]) == 0
    for name in ("bench", "energy"):
        assert (tmp_path / f"{name}.md").read_text().startswith("**")
        assert json.loads((tmp_path / f"{name}.json").read_text())["stamp"]["hardware"]


@pytest.mark.slow
def test_a_quick_benchmark_of_reprojection_writes_its_tables(tmp_path):
    for part in ("errors", "growth"):
        assert main(["--temporal", "mirror_room", "--quick", "--part", part, "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "temporal_errors.json").read_text())
    errors = next(rows for title, rows in found.items() if "light from a map" in title)
    by_method = {row["method"]: row for row in errors}
    assert by_method["raytrace"]["MAE of 255"] == 0
    assert by_method["temporal"]["MAE of 255, mirrors"] < by_method["warp"]["MAE of 255, mirrors"]
    growth = json.loads((tmp_path / "temporal_growth.json").read_text())
    assert all(row["ratio"] > 0 for title, rows in growth.items() if title.startswith("Stages") for row in rows)


@pytest.mark.slow
def test_a_quick_benchmark_of_clusters_writes_its_tables(tmp_path):
    assert main(["--clusters", "mirror_room", "--quick", "--part", "errors", "--out", str(tmp_path)]) == 0
    errors = json.loads((tmp_path / "clusters_errors.json").read_text())["Against ray tracing"]
    by_method = {row["method"]: row for row in errors if row["scene"] == "mirror_room"}
    assert by_method["clusters, traced"]["wrong %"] < by_method["envmap"]["wrong %"]
    assert (tmp_path / "clusters_mirror_room.png").exists()


@pytest.mark.slow
def test_a_quick_convergence_benchmark_writes_its_table(tmp_path):
    assert main(["--path", "--quick", "--out", str(tmp_path)]) == 0
    (rows,) = (v for k, v in json.loads((tmp_path / "path_convergence.json").read_text()).items() if "Slope" in k)
    assert [(row["light"], row["sampler"]) for row in rows] == [
        ("direct", "sobol"),
        ("direct", "independent"),
        ("all", "sobol"),
        ("all", "independent"),
    ]
    assert all(row["RMSE at 8 samples"] > 0 for row in rows)
