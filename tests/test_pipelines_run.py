"""Whole runs: what they leave, how they go on after being killed, what they refuse."""

import dataclasses
import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from fake_techniques import FAKES, PLAIN
from PIL import Image
from results_folders import figures, images

from jaxrefl.metrics import compare
from pipelines import outputs
from pipelines.folder import FolderError, locked
from pipelines.frames import Unit
from pipelines.job import Job, Outputs, Reference, SceneSource
from pipelines.outputs import read_exr
from pipelines.plan import plan
from pipelines.resolve import resolve
from pipelines.run import run_job
from pipelines.toml_tables import JobError

JOB = Job(
    SceneSource("cornell", parameters={"triangles": 1000}),
    techniques=("plain", "carrying"),
    frames=4,
    size=(16, 12),
    seed=3,
    reference=Reference("plain", {"level": 0.7, "samples": 4}),
)
ONE = dataclasses.replace(JOB, techniques=("plain",), frames=2, reference=None, size=(8, 6))


def run(job: Job, out: Path, **options):
    return run_job(job, out, quiet=True, techniques=FAKES, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """An unbroken run of JOB."""
    out = tmp_path_factory.mktemp("whole")
    assert run(JOB, out).rendered == 12
    return out


def test_a_run_leaves_every_file_and_no_other(whole):
    names = {"reference", "plain", "carrying"}
    suffixes = (".png", ".exr", ".layers.exr", ".json")
    frames = {f"{name}/frame_{i:04d}{suffix}" for name in names for i in range(4) for suffix in suffixes}
    found = {str(p.relative_to(whole)) for p in whole.rglob("*") if p.is_file()}
    assert found == frames | {"job.toml", "metrics.json", "metrics.csv"}


def test_rows_hold_what_was_asked_for(whole):
    rows = json.loads((whole / "metrics.json").read_text())
    keys = [(row["frame"], row["technique"], row["mask"]) for row in rows]
    assert keys == [(f, t, m) for f in range(4) for t in ("plain", "carrying") for m in ("reflective", "frame")]
    expected = "scene technique frame mask mae255 rmse relmse psnr dssim seconds compile_seconds stages rays peak_mib"
    for row in rows:
        assert set(expected.split()) | {"reflective_share", "info", "stamp"} <= set(row)
        assert row["scene"] == "cornell" and 0 < row["reflective_share"] < 1
        assert row["stages"] == {"pretend": 0.25} and row["info"] == {"pixels": 7}
        assert row["rays"] == 16 * 12 and row["seconds"] > 0
        assert {"versions", "seed", "command", "hardware"} <= set(row["stamp"])


def test_figures_are_those_of_the_files(whole):
    def linear(name):
        planes = read_exr(whole / name / "frame_0002.exr")
        return np.stack([planes[c] for c in "RGB"], -1)

    rows = json.loads((whole / "metrics.json").read_text())
    (row,) = (r for r in rows if (r["technique"], r["frame"], r["mask"]) == ("plain", 2, "frame"))
    expected = compare(linear("plain"), linear("reference"), None)
    for name, value in expected.items():
        assert row[name] == (None if value is None else pytest.approx(value, rel=1e-6)), name


def test_layers_say_what_is_seen(whole):
    planes = read_exr(whole / "plain" / "frame_0001.layers.exr")
    plain = read_exr(whole / "plain" / "frame_0001.exr")
    for axis in "RGB":
        np.testing.assert_array_equal(planes[axis], plain[axis])
    seen = planes["valid"] == 1
    assert seen.any()
    length = np.sqrt(sum(planes[f"normal.{axis}"] ** 2 for axis in "XYZ"))
    np.testing.assert_allclose(length[seen], 1, atol=1e-5)
    assert (planes["Z"][seen] > 0).all() and (planes["object_id"][seen] >= 0).all()
    assert (planes["object_id"][~seen] == -1).all() and {"motion.X", "source", "reflected_distance"} <= set(planes)
    assert {plane.dtype for plane in planes.values()} == {np.dtype(np.float32)}


def test_pngs_show_the_linear_image_and_carry_no_time(whole):
    picture = Image.open(whole / "plain" / "frame_0000.png")
    planes = read_exr(whole / "plain" / "frame_0000.exr")
    linear = np.clip(np.stack([planes[c] for c in "RGB"], -1).astype(np.float64), 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(np.asarray(picture) - srgb * 255).max() <= 0.51
    stamp = json.loads(picture.text["jaxrefl"])
    assert set(stamp) == {"versions", "seed", "command", "hardware", "job"} and stamp["seed"] == 3


def test_running_again_does_nothing(whole):
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("frame_*")}
    result = run(JOB, whole)
    assert result.rendered == 0 and len(result.rows) == 16
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("frame_*")} == before


def test_only_missing_frames_are_rendered_and_come_out_the_same(whole, tmp_path):
    out = tmp_path / "again"
    run(JOB, out)
    for name in ("plain/frame_0001.png", "carrying/frame_0002.json", "reference/frame_0003.exr"):
        (out / name).unlink()
    kept = (out / "plain" / "frame_0000.png").stat().st_mtime_ns
    assert run(JOB, out).rendered == 3
    assert (out / "plain" / "frame_0000.png").stat().st_mtime_ns == kept
    assert images(out) == images(whole) and figures(out) == figures(whole)


def test_intervals_of_a_technique_that_carries_state_start_afresh(tmp_path):
    job = resolve(dataclasses.replace(JOB, frames=5), techniques=FAKES)
    units = plan(job, tmp_path, techniques=FAKES)
    assert [u for u in units if u.technique == "carrying"] == [
        Unit("carrying", 0, 2, (0, 1, 2)),
        Unit("carrying", 3, 4, (3, 4)),
    ]
    order = [(u.technique, u.last) for u in units]
    for unit in units:  # whatever a unit is measured against comes before it
        assert all(order.index(("reference", n)) <= order.index((unit.technique, unit.last)) for n in unit.missing)


class Killed(BaseException):
    """Stands for a kill: nobody catches it, and nothing is cleaned up by us."""


@pytest.mark.parametrize("after", [0, 1, 2, 3, 4, 5, 8, 10])
def test_a_run_killed_at_any_write_goes_on_and_ends_the_same(tmp_path, monkeypatch, after):
    expected = tmp_path / "expected"
    run(ONE, expected)
    out, left, really = tmp_path / "out", [after], os.replace

    def replace(source, target):
        if left[0] == 0:
            monkeypatch.setattr(os, "replace", really)
            raise Killed
        left[0] -= 1
        really(source, target)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(Killed):
        run(ONE, out)
    run(ONE, out)
    assert images(out) == images(expected) and figures(out) == figures(expected)


SCRIPT = """
import sys, time
from pathlib import Path
from typing import NamedTuple
import test_pipelines_run as t
slow = t.PLAIN._replace(step=lambda *a, **k: (time.sleep(0.3), t.PLAIN.step(*a, **k))[1])
t.run_job(t.JOB, Path(sys.argv[1]), quiet=True, techniques={**t.FAKES, "plain": slow})
"""


def test_a_run_killed_by_the_system_goes_on_and_ends_the_same(whole, tmp_path):
    out = tmp_path / "out"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    process = subprocess.Popen([sys.executable, "-c", SCRIPT, str(out)], env=environment)
    deadline = time.monotonic() + 60
    while len(list(out.glob("*/frame_*.json"))) < 4 and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    done = len(list(out.glob("*/frame_*.json")))
    assert 4 <= done < 12 and not (out / "metrics.json").exists() and (out / ".lock").exists()
    (out / "plain" / ".frame_0009.png.1.part").write_bytes(b"half")
    assert run(JOB, out).rendered == 12 - done
    assert images(out) == images(whole) and figures(out) == figures(whole)
    assert not [p for p in out.rglob(".*")]


def test_a_full_disk_keeps_what_was_done_and_nothing_half(tmp_path, monkeypatch):
    out, really = tmp_path / "out", outputs.os.fsync
    count = []

    def fsync(descriptor):
        count.append(1)
        if 6 < len(count):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        really(descriptor)

    monkeypatch.setattr(outputs.os, "fsync", fsync)
    with pytest.raises(OSError, match="No space left on device"):
        run(ONE, out)
    monkeypatch.undo()
    files = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    assert "plain/frame_0000.json" in files and "plain/frame_0001.json" not in files
    assert not [name for name in files if name.endswith(".part") or "/." in name]
    assert run(ONE, out).rendered == 1


def test_another_job_into_the_folder_is_refused(whole):
    with pytest.raises(FolderError, match="seed: 3 there, 4 now"):
        run(dataclasses.replace(JOB, seed=4), whole)


def test_a_folder_in_use_is_refused(tmp_path):
    with locked(tmp_path), pytest.raises(FolderError, match="is in use by process"):
        run(ONE, tmp_path)


def test_the_seed_and_the_frame_decide_the_noise(whole, tmp_path):
    run(dataclasses.replace(JOB, seed=4, frames=1, techniques=("plain",)), tmp_path)
    first = read_exr(whole / "plain" / "frame_0000.exr")["G"]
    assert not np.array_equal(first, read_exr(whole / "plain" / "frame_0001.exr")["G"])
    assert not np.array_equal(first, read_exr(tmp_path / "plain" / "frame_0000.exr")["G"])


def test_the_command_is_in_the_rows_and_not_in_the_images(tmp_path):
    run(ONE, tmp_path / "a", command="typed this")
    run(ONE, tmp_path / "b", command="typed that")
    rows = json.loads((tmp_path / "a" / "metrics.json").read_text())
    assert {row["stamp"]["command"] for row in rows} == {"typed this"}
    assert images(tmp_path / "a") == images(tmp_path / "b")


def test_outputs_that_are_off_are_not_written(tmp_path):
    run(dataclasses.replace(ONE, outputs=Outputs(png=True, exr=False, layers=False)), tmp_path)
    assert {p.name for p in (tmp_path / "plain").iterdir()} == {
        f"frame_000{i}{s}" for i in (0, 1) for s in (".png", ".json")
    }


def test_pixels_that_are_not_finite_stop_the_run(tmp_path):
    with pytest.raises(FloatingPointError, match=r"broken: frame 0: \d+ pixels are not finite"):
        run(dataclasses.replace(ONE, techniques=("broken",)), tmp_path)
    assert not list(tmp_path.glob("broken/*"))


def test_an_unknown_technique_writes_nothing(tmp_path):
    with pytest.raises(JobError, match="there are: plain, carrying, broken"):
        run(dataclasses.replace(ONE, techniques=("nothing",)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_scene_that_is_broken_is_named(tmp_path):
    scene = tmp_path / "scene.ply"
    scene.write_bytes(b"not a mesh")
    with pytest.raises(ValueError, match=r"scene\.ply"):
        run(dataclasses.replace(ONE, scene=SceneSource(str(scene))), tmp_path / "out")
    assert PLAIN.name == "plain"


def test_frames_before_a_key_frame_are_told_its_camera(tmp_path):
    """Every second frame is a key frame, four are handed out at once: each frame looks ahead to the next key frame."""
    told = []

    def step(state, frame, params, *, options=PLAIN.Options()):  # noqa: B008
        told.append((float(frame.camera.world_from_camera[0, 3]), float(frame.ahead.world_from_camera[0, 3])))
        return PLAIN.step(state, frame, params, options=options)

    looking = PLAIN._replace(name="looking", step=step, interval=lambda options: 4, ahead=lambda options: 2)
    job = dataclasses.replace(ONE, techniques=("looking",), frames=5)
    run_job(job, tmp_path, quiet=True, techniques={**FAKES, "looking": looking})
    at = {camera: number for number, (camera, _) in enumerate(dict.fromkeys(told))}
    assert {(at[camera], at[ahead]) for camera, ahead in told} == {(0, 2), (1, 2), (2, 4), (3, 4), (4, 4)}


def test_a_technique_s_own_images_are_in_the_layers(tmp_path):
    def step(state, frame, params, *, options=PLAIN.Options()):  # noqa: B008
        state, reflection, info = PLAIN.step(state, frame, params, options=options)
        flow = np.stack([np.full((6, 8), 1.5), np.full((6, 8), -2.0)], -1)
        return state, reflection, _WithLayers(info.rays, info.seconds, info.counts, flow)

    drawing = PLAIN._replace(name="drawing", step=step)
    job = dataclasses.replace(ONE, techniques=("drawing",), frames=1)
    run_job(job, tmp_path, quiet=True, techniques={**FAKES, "drawing": drawing})
    planes = read_exr(tmp_path / "drawing" / "frame_0000.layers.exr")
    assert (planes["flow.X"] == 1.5).all() and (planes["flow.Y"] == -2).all() and (planes["mask"] == 1).all()


class _WithLayers(NamedTuple):
    """What the runner reads of an `Info`, with images."""

    rays: int
    seconds: dict
    counts: dict
    flow: np.ndarray

    @property
    def layers(self):
        return {"flow": self.flow, "mask": np.ones((6, 8), bool)}
