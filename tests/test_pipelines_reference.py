"""`jaxrefl reference` from words to files, how it goes on, and `compare` against what it made."""

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fake_techniques import FAKES
from PIL import Image
from results_folders import figures, images

from jaxrefl.radiance.progressive import Goal
from pipelines import cli, reference
from pipelines.flags import CompareBase
from pipelines.flags_to_job import job_of, parse
from pipelines.folder import FolderError
from pipelines.job import Job, Reference, SceneSource, parse_job
from pipelines.outputs import read_exr
from pipelines.reference import run_reference
from pipelines.reference_flags import parse_reference
from pipelines.run import run_job
from pipelines.toml_tables import JobError

JOB = Job(SceneSource("cornell", parameters={"triangles": 1000}), frames=2, size=(16, 12), seed=3, path={"bounces": 2})
SPP = 130
"""Three passes of the path tracer at this size."""
ERRORS = dataclasses.replace(JOB, techniques=("plain",), path=None)


def render(out: Path, spp: int = SPP, job: Job = JOB, **more):
    goal = more.pop("goal", None) or Goal(spp=spp)
    return run_reference(job, out, goal=goal, quiet=True, **more)


def measure(out: Path, folder: Path, job: Job = ERRORS):
    job = dataclasses.replace(job, reference=Reference(folder=str(folder)))
    return run_job(job, out, quiet=True, techniques=FAKES)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """An unbroken run of JOB."""
    out = tmp_path_factory.mktemp("whole")
    assert render(out).rendered == 2
    return out


def test_a_run_leaves_its_files(whole):
    suffixes = (".png", ".exr", ".layers.exr", ".json", ".state.npz")
    expected = {f"reference/frame_000{i}{suffix}" for i in range(2) for suffix in suffixes} | {"job.toml"}
    assert {str(p.relative_to(whole)) for p in whole.rglob("*") if p.is_file()} == expected
    assert parse_job((whole / "job.toml").read_text()).path["pixel"] == "centre"


def test_layers_add_up_and_the_error_is_that_of_the_row(whole):
    planes = read_exr(whole / "reference" / "frame_0001.layers.exr")
    plain = read_exr(whole / "reference" / "frame_0001.exr")
    rgb = lambda name: np.stack([planes[f"{name}.{axis}"] for axis in "RGB"], -1)  # noqa: E731
    image = np.stack([plain[axis] for axis in "RGB"], -1)
    np.testing.assert_array_equal(image, np.stack([planes[axis] for axis in "RGB"], -1))
    total = rgb("emission") + rgb("diffuse_weighted") + rgb("reflection_weighted")
    np.testing.assert_allclose(image, total, rtol=1e-5, atol=1e-6)
    assert {"diffuse.R", "reflection.R"} <= set(planes) and "transmitted.R" not in planes
    assert {plane.dtype for plane in planes.values()} == {np.dtype(np.float32)}
    row = reference.read_row(whole, 1)
    rms = np.sqrt((rgb("error").astype(np.float64) ** 2).mean())
    assert row["standard_error"] == pytest.approx(rms, rel=1e-5)
    assert row["relative_error"] == pytest.approx(rms / (image @ [0.2126, 0.7152, 0.0722]).mean(), rel=1e-4)
    assert (
        row["spp"] == SPP and row["rays"] > SPP * 16 * 12 and row["paths_per_second"] > 0 and row["stamp"]["seed"] == 3
    )
    picture = Image.open(whole / "reference" / "frame_0000.png")
    command = json.loads(picture.text["jaxrefl"])["command"]
    assert picture.size == (16, 12) and command == f"jaxrefl reference --job job.toml --spp {SPP} --out DIR"


def test_the_job_of_the_folder_makes_it_again(whole, tmp_path):
    words = ["--job", str(whole / "job.toml"), "--spp", str(SPP)]
    _, job, goal = parse_reference(words, description="")
    render(tmp_path / "again", job=job, goal=goal)
    assert images(tmp_path / "again") == images(whole)


def test_running_again_does_nothing_and_less_is_enough(whole):
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("frame_*")}
    assert render(whole).rendered == 0 and render(whole, 5).rendered == 0
    assert render(whole, goal=Goal(error=1e3)).rendered == 0 and render(whole, goal=Goal(seconds=1e-6)).rendered == 0
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("frame_*")} == before


def test_more_samples_go_on_from_what_is_there(whole, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    rays = reference.read_row(out, 0)["rays"]
    assert render(out, 150).rendered == 2 and render(tmp_path / "unbroken", 150).rendered == 2
    assert images(out) == images(tmp_path / "unbroken")
    row, unbroken = (reference.read_row(folder, 0) for folder in (out, tmp_path / "unbroken"))
    # The last pass of a run is filled up to its size, so a broken run casts a few rays more.
    assert row["spp"] == 150 and rays < row["rays"] <= unbroken["rays"] + rays
    assert row["relative_error"] == unbroken["relative_error"]


def test_without_states_a_frame_starts_again_and_ends_the_same(whole, tmp_path):
    out = tmp_path / "out"
    render(out, 5, keep_state=False)
    assert not list(out.rglob("*.npz"))
    render(out, keep_state=False)
    assert images(out) == images(whole)


class Killed(BaseException):
    """Stands for a kill: nobody catches it, and nothing is cleaned up by us."""


@pytest.mark.parametrize("after", [0, 1, 2, 3, 4, 5, 6, 7, 11])
def test_a_run_killed_at_any_write_goes_on_and_ends_the_same(whole, tmp_path, monkeypatch, after):
    out, left, really = tmp_path / "out", [after], os.replace
    render(out, 5)

    def replace(source, target):
        if left[0] == 0:
            monkeypatch.setattr(os, "replace", really)
            raise Killed
        left[0] -= 1
        really(source, target)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(Killed):
        render(out, save_every=0.0)
    render(out)
    assert images(out) == images(whole)
    assert {reference.read_row(out, n)["spp"] for n in range(2)} == {SPP}


def test_an_interrupted_run_saves_where_it_is(whole, tmp_path, monkeypatch):
    out, really = tmp_path / "out", reference._Frame._after

    def interrupted(frame, state):
        really(frame, state)
        raise KeyboardInterrupt

    monkeypatch.setattr(reference._Frame, "_after", interrupted)
    with pytest.raises(KeyboardInterrupt):
        render(out)
    monkeypatch.undo()
    assert [p.name for p in (out / "reference").iterdir()] == ["frame_0000.state.npz"]
    render(out)
    assert images(out) == images(whole)


SCRIPT = """
import sys, time
from pathlib import Path
import test_pipelines_reference as t
really = t.reference._Frame._after
t.reference._Frame._after = lambda *a: (really(*a), time.sleep(1.0))
t.render(Path(sys.argv[1]), save_every=0.0)
"""


def test_a_run_killed_by_the_system_goes_on_and_ends_the_same(whole, tmp_path):
    out = tmp_path / "out"
    path = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])])
    process = subprocess.Popen([sys.executable, "-c", SCRIPT, str(out)], env={**os.environ, "PYTHONPATH": path})
    deadline = time.monotonic() + 120
    state = out / "reference" / "frame_0000.state.npz"
    while not state.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert state.exists() and not (out / "reference" / "frame_0000.json").exists() and (out / ".lock").exists()
    render(out)
    assert images(out) == images(whole)
    assert not [p for p in out.rglob(".*")]


def test_error_and_time_stop_frames(whole, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    wanted = 0.8 * min(reference.read_row(out, n)["relative_error"] for n in range(2))
    rows = render(out, goal=Goal(error=wanted)).rows
    assert all(row["relative_error"] <= wanted and row["spp"] % 64 == 0 for row in rows)
    spent = [row["seconds"] + row["compile_seconds"] for row in rows]
    assert render(out, goal=Goal(seconds=min(spent))).rendered == 0
    more = render(out, goal=Goal(seconds=max(spent) + 0.2)).rows
    assert all(row["spp"] > old["spp"] for row, old in zip(more, rows, strict=True))
    assert all(row["seconds"] + row["compile_seconds"] > max(spent) for row in more)


def test_another_job_and_broken_files_are_refused(whole, tmp_path):
    for change, said in (
        ({"seed": 4}, "seed: 3 there, 4 now"),
        ({"size": (8, 6)}, "size"),
        ({"path": {"bounces": 3}}, "path.bounces: 2 there, 3 now"),
        ({"scene": SceneSource("furnace")}, "scene.source"),
    ):
        with pytest.raises(FolderError, match=said):
            render(whole, job=dataclasses.replace(JOB, **change))
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (out / "reference" / "frame_0000.state.npz").write_bytes(b"broken")
    with pytest.raises(FolderError, match=r"frame_0000\.state\.npz: cannot be read; remove it"):
        render(out, SPP + 1)
    (out / "reference" / "frame_0000.json").write_text("[]")
    with pytest.raises(FolderError, match=r"frame_0000\.json: expected the row"):
        render(out, SPP + 1)


def test_compare_measures_against_the_folder(whole, tmp_path):
    result = measure(tmp_path / "a", whole)
    assert result.rendered == 4
    (row,) = (r for r in result.rows if (r["frame"], r["mask"]) == (1, "frame"))
    linear = lambda path: np.stack([read_exr(path)[axis] for axis in "RGB"], -1)  # noqa: E731
    ours, truth = linear(tmp_path / "a" / "plain" / "frame_0001.exr"), linear(whole / "reference" / "frame_0001.exr")
    assert row["rmse"] == pytest.approx(np.sqrt(((ours - truth) ** 2).mean()), rel=1e-5)
    copied = tmp_path / "a" / "reference"
    assert {p.name for p in copied.iterdir()} == {
        f"frame_000{i}{s}" for i in range(2) for s in (".png", ".exr", ".json")
    }
    text = (tmp_path / "a" / "job.toml").read_text()
    assert str(whole / "reference" / "frame_0001.exr") in text and f'folder = "{whole}"' in text
    again = parse_job(text)
    assert run_job(again, tmp_path / "a", quiet=True, techniques=FAKES).rendered == 0
    run_job(again, tmp_path / "b", quiet=True, techniques=FAKES)
    assert images(tmp_path / "a") == images(tmp_path / "b") and figures(tmp_path / "a") == figures(tmp_path / "b")


def test_the_report_says_how_noisy_the_reference_is(whole, tmp_path):
    from pipelines.report import write_report

    measure(tmp_path, whole)
    row = reference.read_row(whole, 0)
    page = write_report(tmp_path).read_text()
    assert f"path traced images in {whole}, {SPP} samples per pixel" in page and f"{row['standard_error']:.3g}" in page


def test_a_folder_that_changed_is_refused(whole, tmp_path):
    folder, out = tmp_path / "reference", tmp_path / "out"
    shutil.copytree(whole, folder)
    measure(out, folder)
    job = parse_job((out / "job.toml").read_text())
    render(folder, SPP + 1)
    with pytest.raises(JobError, match=r"frame_0000\.exr: is not the file this job was made with"):
        run_job(job, tmp_path / "other", quiet=True, techniques=FAKES)
    with pytest.raises(FolderError, match="holds the results of another job"):
        measure(out, folder)


def test_folders_that_do_not_fit_are_refused(whole, tmp_path):
    for change, said in (
        ({"size": (8, 6)}, "its images have 16 x 12 pixels, the job's 8 x 6"),
        ({"scene": SceneSource("furnace")}, "shows another scene: source is 'cornell' there, 'furnace' here"),
        ({"scene": SceneSource("cornell")}, "shows another scene: parameters is"),
        ({"frames": 3}, r"frame_0002\.exr: missing or not finished; the job has 3 frames, the reference's job 2"),
        ({"frames": 1}, None),
        ({"camera": dataclasses.replace(JOB.camera, keyframes=())}, None),
    ):
        job = dataclasses.replace(ERRORS, **change)
        if said is None:
            measure(tmp_path / f"fits-{job.frames}", whole, job)
        else:
            with pytest.raises(JobError, match=said):
                measure(tmp_path / "out", whole, job)
    assert not (tmp_path / "out").exists()
    with pytest.raises(JobError, match="expected a folder made by `jaxrefl reference`, but it has no job.toml"):
        measure(tmp_path / "out", tmp_path)
    with pytest.raises(JobError, match="got one of another command"):
        measure(tmp_path / "out", tmp_path / "fits-1")
    box = tmp_path / "box"
    shutil.copytree(whole, box)
    text = (box / "job.toml").read_text()
    (box / "job.toml").write_text(text.replace('pixel = "centre"', 'pixel = "box"'))
    with pytest.raises(JobError, match="its pixels are 'box', but techniques sample their centres"):
        measure(tmp_path / "out", box)


def test_another_camera_is_refused_before_anything_is_rendered(whole, tmp_path):
    folder = tmp_path / "reference"
    shutil.copytree(whole, folder)
    path = folder / "reference" / "frame_0001.json"
    rows = json.loads(path.read_text())
    rows[0]["camera"]["world_from_camera"][0][3] += 0.01
    path.write_text(json.dumps(rows))
    with pytest.raises(JobError, match=r"frame 1 was made with another camera \(world_from_camera differs\)"):
        measure(tmp_path / "out", folder)
    assert not list((tmp_path / "out").glob("*/frame_*"))


def test_words_become_a_job_and_a_goal(whole):
    words = "cornell --spp 9 --error 0.1 --time 5 --frames 3 --size 20 10 --seed 4 --camera.swing 2 --bounces 7"
    more = "--sampler independent --masking separable --no-multiple-scattering --pixel box --no-keep-state --out D"
    flags, job, goal = parse_reference([*words.split(), *more.split()], description="")
    assert goal == Goal(spp=9, error=0.1, seconds=5.0) and not flags.keep_state and flags.out == Path("D")
    assert (job.frames, job.size, job.seed, job.camera.swing) == (3, (20, 10), 4, 2)
    expected = {"pixel": "box", "bounces": 7, "roulette_from": 4, "sampler": "independent", "masking": "separable"}
    assert job.path == {**expected, "multiple_scattering": False}
    assert parse_reference(["cornell"], description="")[2] == reference.GOAL
    compared, file = parse(CompareBase, ["cornell", "--reference", str(whole)], prog="", description="")
    assert job_of(compared, file).reference == Reference(folder=str(whole))


BAD = [
    ("reference", "which scene?"),
    ("reference cornel --spp 1", "did you mean 'cornell'"),
    ("reference cornell --spp 0", "--spp: expected a whole number from 1"),
    ("reference cornell --error -1", "--error: expected a finite number above 0"),
    ("reference cornell --time 0", "--time: expected a finite number above 0"),
    ("reference cornell --bounces -1", "[path]: bounces: expected a value from 0"),
    ("reference cornell --frames 0", "frames: expected at least 1, got 0"),
    ("compare cornell --reference a/b", "a/b: expected a folder made by `jaxrefl reference`, but it has no job.toml"),
    ("compare cornell --reference EMPTY", "but it has no job.toml"),
    ("compare cornell --reference EMPTY --reference-samples 4", "would have no effect: EMPTY is a folder"),
    (
        "render --job REFERENCE.toml",
        "techniques: expected at least one; a job without any is one of",
    ),
]


@pytest.mark.parametrize(("words", "said"), BAD)
def test_bad_words_give_one_message(tmp_path, monkeypatch, capfd, words, said):
    monkeypatch.chdir(tmp_path)
    Path("EMPTY").mkdir()
    Path("REFERENCE.toml").write_text('scene = "cornell"\ntechniques = []\n[path]\nbounces = 3\n')
    assert cli.main([*words.split(), "--out", "OUT"]) == 2
    captured = capfd.readouterr()
    assert said in captured.err and captured.err.startswith("jaxrefl: ") and captured.err.count("\n") == 1
    assert not list(tmp_path.rglob("frame_*"))


def test_the_whole_way_from_words_to_a_picture(tmp_path, capfd):
    words = "reference cornell --parameters triangles=1000 --size 16 12 --bounces 2 --spp 3"
    assert cli.main([*words.split(), "--out", str(tmp_path)]) == 0
    captured = capfd.readouterr()
    assert "frames worked on: 1; images: " in captured.out and "1/1 reference 0000" in captured.err
