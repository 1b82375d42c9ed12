"""The command line: what it understands, what it says, how it ends."""

import dataclasses
import errno
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from jaxrefl._types import Features
from jaxrefl.techniques import TECHNIQUES
from pipelines import cli
from pipelines.flags import CompareBase, RenderBase, knob_groups
from pipelines.flags_to_job import job_of, key_values, parse
from pipelines.folder import locked
from pipelines.job import Job, Keyframe, Reference, read_job
from pipelines.switches import STAGES
from pipelines.toml_tables import JobError
from scenes import BUILT_IN

JOB = """
scene = { source = "cornell", parameters = { triangles = 3000 } }
techniques = ["envmap"]
frames = 5
size = [40, 30]
[camera]
keyframes = [{ position = [0, 1, 4], target = [0, 1, 0] }]
[technique.envmap]
height = 32
[reference]
technique = "raytrace"
knobs = { samples = 3, bounces = 1 }
[light]
area_samples = 2
"""


def job(base: type, *words: str) -> Job:
    flags, file = parse(base, words, prog="jaxrefl", description="")
    return job_of(flags, file)


def test_flags_fill_a_job():
    made = job(
        RenderBase,
        *"cornell --technique raytrace envmap --frames 24 --size 960 540 --seed 4 --out DIR".split(),
        *"--parameters triangles=2000 block_alpha=0.2 --raytrace.samples 4 --light.area-samples 7".split(),
        *"--composite.fresnel schlick --camera.swing 2 --outputs.no-layers --envmap.rough_height 32".split(),
    )
    assert made.scene.source == "cornell" and made.scene.parameters == {"triangles": 2000, "block_alpha": 0.2}
    assert (made.techniques, made.frames, made.size, made.seed) == (("raytrace", "envmap"), 24, (960, 540), 4)
    assert made.technique["raytrace"]["samples"] == 4 and made.technique["envmap"]["rough_height"] == 32
    assert made.light["area_samples"] == 7 and made.composite["fresnel"] == "schlick"
    assert made.camera.swing == 2 and not made.outputs.layers and made.reference is None


def test_words_after_a_size_are_not_swallowed():
    assert job(RenderBase, *"--size 960 540 cornell --out DIR".split()).scene.source == "cornell"


def test_compare_has_a_reference_with_knobs_of_its_own():
    words = "cornell --techniques envmap --out DIR --reference raytrace --reference-samples 99"
    made = job(CompareBase, *words.split(), "--reference-knobs", "bounces=2")
    assert made.reference == Reference("raytrace", {"samples": 99, "bounces": 2})
    assert job(CompareBase, "cornell", "--out", "DIR").reference == Reference("raytrace", {})


def test_a_job_file_gives_the_defaults_of_the_flags(tmp_path):
    path = tmp_path / "job.toml"
    path.write_text(JOB)
    for base in (RenderBase, CompareBase):
        same = job(base, "--job", str(path), "--out", "DIR")
        written = read_job(path)
        assert dataclasses.replace(same, light={}, composite={}, technique={}) == dataclasses.replace(
            written, light={}, composite={}, technique={}
        )
        assert same.technique["envmap"]["height"] == 32 and same.light["area_samples"] == 2
    changed = job(CompareBase, f"--job={path}", "--out", "DIR", "--frames", "2", "--envmap.height", "64")
    assert changed.frames == 2 and changed.technique["envmap"]["height"] == 64
    assert changed.camera.keyframes == (Keyframe((0.0, 1.0, 4.0), target=(0.0, 1.0, 0.0)),)
    assert changed.reference == Reference("raytrace", {"samples": 3, "bounces": 1})


def test_a_camera_flag_replaces_the_jobs_path(tmp_path):
    path = tmp_path / "job.toml"
    path.write_text(JOB)
    made = job(RenderBase, "--job", str(path), "--out", "DIR", "--camera.name", "front")
    assert made.camera.name == "front" and made.camera.keyframes == ()


def test_every_knob_is_a_flag_with_a_meaning(capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["render", "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    for group, knobs in knob_groups().items():
        for name in knobs:
            assert f"--{group}.{name}".replace("_", "-") in text
    assert "Examples:" in text and "jaxrefl render cornell" in text


def test_the_top_level_help_teaches(capsys):
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(command in text for command in cli.COMMANDS)
    assert cli.main([]) == 2
    assert cli.main(["--version"]) == 0 and "jaxrefl" in capsys.readouterr().out


def test_scenes_lists_what_is_built_in(capsys):
    assert cli.main(["scenes"]) == 0
    text = capsys.readouterr().out
    assert all(f"{name}: {module.STRESSES}" in text for name, module in BUILT_IN.items())


def test_info_tells_what_is_in_a_scene_and_why(capsys):
    assert cli.main(["info", "cornell", "--parameters", "triangles=1000"]) == 0
    text = capsys.readouterr().out
    assert "stages switched on" in text and "emissive: shadow rays to area lights" in text and "because of" in text


def test_key_values_are_read_as_toml():
    words = ["a=1", "b=0.5", "c=true", "d=glass", 'e="x=y"', "f=x=y"]
    assert key_values(words, flag="--x") == {"a": 1, "b": 0.5, "c": True, "d": "glass", "e": "x=y", "f": "x=y"}
    with pytest.raises(JobError, match="--x: expected KEY=VALUE, got 'a'"):
        key_values(["a"], flag="--x")


BAD = [
    ("rendre cornell", "unknown command 'rendre'; did you mean 'render'"),
    ("render --out OUT", "which scene?"),
    ("render cornel --out OUT", "did you mean 'cornell'"),
    ("render absent.glb --out OUT", "absent.glb: does not exist"),
    ("render broken.ply --out OUT", "broken.ply"),
    ("render scene.xyz --out OUT", "scene.xyz"),
    ("info absent.glb", "absent.glb: does not exist"),
    ("render cornell --technique raytrase --out OUT", "did you mean 'raytrace'"),
    ("compare cornell --techniques raytrace --reference nothing --out OUT", "technique 'nothing' does not exist"),
    ("render cornell --size 0 540 --out OUT", "at least 1 pixel, got 0 540"),
    ("render cornell --frames 0 --out OUT", "frames: expected at least 1, got 0"),
    ("render cornell --raytrace.samples 0 --out OUT", "[technique.raytrace]: samples: expected a value from 1"),
    ("render cornell --envmap.height 64 --out OUT", "--envmap.height would have no effect"),
    ("render cornell --light.area-samples -1 --out OUT", "[light]: area_samples"),
    ("render cornell --parameters triangels=9 --out OUT", "did you mean 'triangles'"),
    ("render cornell --parameters triangles --out OUT", "expected KEY=VALUE"),
    ("render cornell --parameters triangles=-5 --out OUT", "triangles"),
    ("render cornell --overrides x.toml --out OUT", "overrides is for scene files"),
    ("render cornell --job absent.toml --out OUT", "absent.toml: cannot be read"),
    ("render --job unknown.toml --out OUT", "unknown key 'frams'; did you mean 'frames'"),
    ("render --job syntax.toml --out OUT", "is not valid TOML"),
    ("render cornell --camera.file absent.json --out OUT", "absent.json: cannot be read"),
    ("render cornell --camera.file singular.json --out OUT", "frame 0: transform_matrix: "),
    ("render cornell --camera.file singular.json --frames 9 --out OUT", "frame 0: transform_matrix: "),
    ("render cornell --camera.name nowhere --out OUT", "no camera 'nowhere'"),
    ("render cornell --scheduler everywhere --out OUT", "--scheduler: expected local:N or an address"),
    ("render cornell --out file", "file: expected a folder, got a file"),
    ("report absent", "absent: expected a results folder"),
]


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """A working folder with broken files in it."""
    monkeypatch.chdir(tmp_path)
    Path("broken.ply").write_bytes(b"not a mesh")
    Path("scene.xyz").write_text("0 0 0\n")
    Path("unknown.toml").write_text('scene = "cornell"\nframs = 3\n')
    Path("syntax.toml").write_text("scene = \n")
    Path("file").write_text("")
    singular = {"camera_angle_x": 1.0, "frames": [{"transform_matrix": [[0.0] * 4] * 4}]}
    Path("singular.json").write_text(json.dumps(singular))
    return tmp_path


@pytest.mark.parametrize(("words", "said"), BAD)
def test_bad_input_gives_one_message_and_a_code(here, capfd, words, said):
    assert cli.main(words.split()) == 2
    captured = capfd.readouterr()
    assert said in captured.err and captured.err.startswith("jaxrefl: ") and captured.err.count("\n") == 1
    assert "Traceback" not in captured.err and captured.out == ""
    assert not list(here.rglob("frame_*")) and not list(here.rglob(".*"))


@pytest.mark.parametrize(
    "words",
    [
        "render cornell --out",
        "render cornell --out OUT --frmes 3",
        "render cornell --out OUT --size 3",
    ],
)
def test_words_that_are_no_flags_end_with_code_2(here, words, capfd):
    with pytest.raises(SystemExit) as caught:
        cli.main(words.split())
    assert caught.value.code == 2 and "Traceback" not in capfd.readouterr().err


def test_a_folder_in_use_and_another_job(here, capfd):
    with locked(here / "OUT"):
        assert cli.main(["render", "cornell", "--out", "OUT"]) == 2
        assert "OUT: is in use by process" in capfd.readouterr().err
    (here / "OUT" / "job.toml").write_text("seed = 8\n")
    (here / "OUT" / "raytrace").mkdir()
    (here / "OUT" / "raytrace" / "frame_0000.json").write_text("[]")
    assert cli.main(["render", "cornell", "--out", "OUT"]) == 2
    assert "holds the results of another job (seed: 8 there, 0 now" in capfd.readouterr().err


def test_a_full_disk_gives_one_message_and_code_1(here, capfd, monkeypatch):
    def fsync(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fsync)
    assert cli.main(["render", "cornell", "--out", "OUT"]) == 1
    assert capfd.readouterr().err == "jaxrefl: OUT/job.toml: No space left on device\n"


def test_an_interruption_says_how_to_go_on(capfd, monkeypatch):
    def interrupted(words):
        raise KeyboardInterrupt

    monkeypatch.setattr("pipelines.commands.render", interrupted)
    assert cli.main(["render", "cornell", "--out", "OUT"]) == 130
    assert "the same command continues" in capfd.readouterr().err


def test_defects_show_their_traceback_and_users_errors_do_if_asked(monkeypatch):
    def defect(words):
        return int("no number")

    monkeypatch.setattr("pipelines.commands.scenes", lambda words: tomllib.loads("="))
    with pytest.raises(ValueError):
        cli.main(["scenes"])
    monkeypatch.setenv("JAXREFL_TRACEBACK", "1")
    with pytest.raises(JobError):
        cli.main(["rendre"])


def test_the_whole_way_from_words_to_a_report(tmp_path):
    """As a user types it: another process, a comparison, a report; a second time nothing is left to do."""
    words = "compare cornell --parameters triangles=1000 --frames 2 --size 32 24 --techniques raytrace"
    more = ["--reference-samples", "2", "--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "out")]
    command = [sys.executable, "-m", "pipelines.cli", *words.split(), *more]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[1])
    assert done.returncode == 0, done.stderr
    assert "frames rendered: 4; report: " in done.stdout and "4/4 raytrace 0001" in done.stderr
    assert (tmp_path / "out" / "report.html").stat().st_size > 1000 and any((tmp_path / "cache").iterdir())
    rows = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert len(rows) == 4 and set(rows[0]["stamp"]["hardware"]) == {"processor", "cores", "memory_gib", "system"}
    assert rows[0]["stamp"]["command"].startswith("jaxrefl compare cornell") and rows[0]["technique"] in TECHNIQUES
    assert all(row["mae255"] is not None and row["compile_seconds"] >= 0 for row in rows)


def test_a_job_file_alone_is_enough(here: Path):
    """`jaxrefl render --job JOB.toml` puts its results into results/JOB."""
    Path("JOB.toml").write_text('scene = "cornell"\nsize = [16, 9]\nframes = 1\n')
    assert cli.main(["render", "--job", "JOB.toml"]) == 0
    assert Path("results/JOB/report.html").exists()


def test_every_feature_says_what_it_switches_on():
    assert set(STAGES) == {field.name for field in dataclasses.fields(Features)}
