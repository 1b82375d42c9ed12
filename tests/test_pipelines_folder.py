"""The results folder: locks, claims, tables."""

import csv
import io
import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from fake_techniques import FAKES

from pipelines.folder import FolderError, claim, collect, csv_text, frame_path, is_done, locked, read_reference, store
from pipelines.frames import FrameFiles
from pipelines.job import Job, Outputs, Reference, SceneSource, job_text
from pipelines.outputs import exr_bytes
from pipelines.resolve import resolve


@pytest.fixture
def job() -> Job:
    scene = SceneSource("cornell", parameters={"triangles": 1000})
    return resolve(Job(scene, techniques=("plain",), frames=2, size=(8, 6)), techniques=FAKES)


HOLD = """
import sys, time
from pathlib import Path
from pipelines.folder import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def holder(folder):
    """Another process that holds the lock."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def test_two_runs_into_one_folder_refuse_each_other(tmp_path):
    other = holder(tmp_path)
    try:
        with pytest.raises(FolderError, match=rf"is in use by process {other.pid} on "), locked(tmp_path):
            pass
        assert (tmp_path / ".lock").exists()
    finally:
        other.kill()
        other.wait()
        other.stdout.close()


def test_the_lock_of_a_killed_run_does_not_block(tmp_path):
    other = holder(tmp_path)
    other.kill()
    other.wait()
    other.stdout.close()
    assert (tmp_path / ".lock").exists()
    with locked(tmp_path):
        assert f"process {os.getpid()}" in (tmp_path / ".lock").read_text()
    assert not (tmp_path / ".lock").exists()


def test_the_lock_ends_with_an_error_too(tmp_path):
    with pytest.raises(RuntimeError, match="inside"), locked(tmp_path / "new"):
        raise RuntimeError("inside")
    with locked(tmp_path / "new"):
        pass


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FolderError, match="expected a folder, got a file"), locked(tmp_path / "file"):
        pass


def test_another_job_is_refused_and_says_what_differs(tmp_path, job):
    claim(tmp_path, job)
    store(tmp_path, finished(0, []))
    claim(tmp_path, job)
    changed = resolve(Job(job.scene, techniques=("plain",), frames=3, size=(8, 6), seed=5), techniques=FAKES)
    with pytest.raises(FolderError, match=r"frames: 2 there, 3 now; seed: 0 there, 5 now"):
        claim(tmp_path, changed)
    (tmp_path / "job.toml").write_text("= broken")
    with pytest.raises(FolderError, match=r"its job\.toml is broken"):
        claim(tmp_path, job)


def test_a_job_without_a_frame_gives_way(tmp_path, job):
    (tmp_path / "job.toml").write_text("seed = 8")
    claim(tmp_path, job)
    assert (tmp_path / "job.toml").read_text() == job_text(job)
    assert collect(tmp_path, job) == [] and not (tmp_path / "metrics.json").exists()


def test_frames_of_unknown_origin_are_refused(tmp_path, job):
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "frame_0000.json").write_text("[]")
    with pytest.raises(FolderError, match=r"no job\.toml"):
        claim(tmp_path, job)


def test_claiming_clears_what_a_killed_run_left(tmp_path, job):
    (tmp_path / "plain").mkdir()
    leftovers = [tmp_path / ".job.toml.1.part", tmp_path / "plain" / ".frame_0000.png.1.part"]
    for path in leftovers:
        path.write_bytes(b"half")
    (tmp_path / "plain" / "notes.txt").write_text("mine")
    claim(tmp_path, job)
    assert not any(path.exists() for path in leftovers)
    assert (tmp_path / "plain" / "notes.txt").exists()


def finished(frame, rows):
    files = {".png": b"p", ".exr": b"e", ".layers.exr": b"l", ".json": json.dumps(rows).encode()}
    return FrameFiles("plain", frame, files, 0.1)


def test_a_frame_is_done_when_all_its_files_are_there(tmp_path, job):
    assert not is_done(tmp_path, job, "plain", 0)
    store(tmp_path, finished(0, []))
    assert is_done(tmp_path, job, "plain", 0) and not is_done(tmp_path, job, "plain", 1)
    frame_path(tmp_path, "plain", 0, ".exr").unlink()
    assert not is_done(tmp_path, job, "plain", 0)
    fewer = resolve(Job(job.scene, techniques=("plain",), outputs=Outputs(exr=False)), techniques=FAKES)
    assert is_done(tmp_path, fewer, "plain", 0)


def test_the_reference_always_has_its_plain_exr(tmp_path, job, rng):
    bare = Outputs(png=False, exr=False, layers=False)
    job = resolve(Job(job.scene, techniques=("plain",), outputs=bare, reference=Reference("plain")), techniques=FAKES)
    image = rng.normal(size=(3, 4, 3)).astype(np.float32)
    exr = exr_bytes({axis: image[..., i] for i, axis in enumerate("RGB")}, {})
    store(tmp_path, FrameFiles("reference", 7, {".exr": exr, ".json": b"[]"}, 0.0))
    assert is_done(tmp_path, job, "reference", 7)
    np.testing.assert_array_equal(read_reference(tmp_path, 7), image)


ROW = {"scene": 'a "b", c', "technique": "plain", "psnr": None, "stages": {"trace": 0.5}, "stamp": {"seed": 1}}


def test_tables_hold_all_rows_in_order(tmp_path, job):
    store(tmp_path, finished(1, [{**ROW, "frame": 1}]))
    assert [row["frame"] for row in collect(tmp_path, job)] == [1]
    store(tmp_path, finished(0, [{**ROW, "frame": 0}]))
    assert [row["frame"] for row in collect(tmp_path, job)] == [0, 1]
    assert [row["frame"] for row in json.loads((tmp_path / "metrics.json").read_text())] == [0, 1]
    lines = list(csv.DictReader(io.StringIO((tmp_path / "metrics.csv").read_text())))
    assert [line["frame"] for line in lines] == ["0", "1"]
    assert lines[0]["scene"] == 'a "b", c' and lines[0]["stages.trace"] == "0.5" and lines[0]["psnr"] == ""
    assert not any(key.startswith("stamp") for key in lines[0])


def test_broken_rows_are_named(tmp_path, job):
    store(tmp_path, finished(0, []))
    frame_path(tmp_path, "plain", 0, ".json").write_text("[")
    with pytest.raises(FolderError, match=r"frame_0000\.json: is not valid JSON"):
        collect(tmp_path, job)


def test_csv_of_nothing_is_empty():
    assert csv_text([]).strip() == ""


def test_a_lock_removed_by_its_holder_is_not_held(tmp_path, monkeypatch):
    """The previous holder removes the file between our open and our lock: we must not lock a ghost."""
    import fcntl

    calls = []
    really = fcntl.flock

    def flock(descriptor, how):
        if not calls:
            (tmp_path / ".lock").unlink()
        calls.append(descriptor)
        return really(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", flock)
    began = time.monotonic()
    with locked(tmp_path):
        assert len(calls) == 2
        assert os.stat(tmp_path / ".lock").st_ino == os.fstat(calls[-1]).st_ino
    assert time.monotonic() - began < 5
