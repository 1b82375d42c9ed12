"""Job files: read, checked, resolved."""

import dataclasses

import pytest
from fake_techniques import FAKES

from pipelines.job import CameraPath, Job, Keyframe, Reference, SceneSource, job_text, parse_job, read_job
from pipelines.resolve import resolve
from pipelines.toml_tables import JobError

FULL = """
scene = { source = "cornell", parameters = { triangles = 2000 } }
techniques = ["plain", "carrying"]
frames = 4
size = [32, 24]
seed = 7

[camera]
closed = true
keyframes = [
  { position = [0, 1, 4], target = [0, 1, 0], fov_y = 40 },
  { position = [1, 1, 4], target = [0, 1, 0] },
]

[outputs]
layers = false
exposure = 1

[light]
area_samples = 2

[technique.plain]
level = 2
samples = 8

[reference]
technique = "plain"
knobs = { noise = false }
"""


def small(**changes) -> Job:
    return dataclasses.replace(Job(SceneSource("cornell"), techniques=("plain",)), **changes)


def test_a_full_job_is_read():
    job = parse_job(FULL)
    assert job.scene == SceneSource("cornell", parameters={"triangles": 2000})
    assert job.camera.keyframes[1] == Keyframe((1.0, 1.0, 4.0), target=(0.0, 1.0, 0.0))
    assert job.technique == {"plain": {"level": 2, "samples": 8}}
    assert job.outputs.exposure == 1.0 and not job.outputs.layers


def test_resolving_writes_every_default_and_changes_nothing_the_second_time():
    job = resolve(parse_job(FULL), techniques=FAKES)
    assert job.technique["plain"] == {"noise": True, "samples": 8, "mode": "plain", "level": 2.0}
    assert job.technique["carrying"]["level"] == 0.5
    assert job.light["area_samples"] == 2 and "environment_samples" in job.light and "fresnel" in job.composite
    assert job.scene.parameters["triangles"] == 2000 and len(job.scene.parameters) > 1
    assert parse_job(job_text(job)) == job
    assert resolve(job, techniques=FAKES) == job


def test_the_reference_gets_many_samples_unless_told():
    knobs = {"plain": {"samples": 8}}
    told = resolve(small(reference=Reference("plain", {"samples": 3})), techniques=FAKES)
    untold = resolve(small(reference=Reference("plain"), technique=knobs), techniques=FAKES)
    least = resolve(small(reference=Reference("plain")), techniques=FAKES)
    capped = resolve(small(reference=Reference("plain"), technique={"plain": {"samples": 4000}}), techniques=FAKES)
    samples = [job.reference.knobs["samples"] for job in (told, untold, least, capped)]
    assert samples == [3, 128, 64, 4096]


def test_defaults_of_frames_and_size():
    job = resolve(small(), techniques=FAKES)
    assert (job.frames, job.size) == (1, (960, 540))


def test_paths_count_from_the_jobs_folder_and_files_are_digested(tmp_path):
    (tmp_path / "scene.obj").write_text("v 0 0 0\n")
    path = tmp_path / "job.toml"
    path.write_text('scene = "scene.obj"\ntechniques = ["plain"]\n')
    job = resolve(read_job(path), techniques=FAKES)
    assert job.scene.source == str(tmp_path / "scene.obj")
    assert list(job.digests) == [job.scene.source]
    (tmp_path / "scene.obj").write_text("v 0 0 1\n")
    with pytest.raises(JobError, match=r"scene\.obj: is not the file this job was made with"):
        resolve(job, techniques=FAKES)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the key 'scene' is missing"),
        ("scene = ", "is not valid TOML"),
        ('scene = "cornell"\nframs = 3', "unknown key 'frams'; did you mean 'frames'"),
        ('scene = "cornell"\n[technique.plain]\nsampels = 3', "unknown key 'sampels'; did you mean 'samples'"),
        ('scene = "cornell"\n[technique.plian]', "technique 'plian' does not exist; did you mean 'plain'"),
        ('scene = "cornell"\n[light]\narea = 3', "[light]: unknown key 'area'; did you mean 'area_samples'"),
        ('scene = "cornell"\n[composite]\nfresnel = "exakt"', "did you mean 'exact'"),
        ('scene = "cornell"\ntechniques = []', "techniques: expected at least one"),
        ('scene = "cornell"\ntechniques = ["plain", "plain"]', "one is named twice"),
        ('scene = "cornell"\ntechniques = ["reference"]', "technique 'reference' does not exist"),
        ('scene = "cornell"\nframes = 0', "frames: expected at least 1, got 0"),
        ('scene = "cornell"\nsize = [0, 24]', "at least 1 pixel, got 0 24"),
        ('scene = "cornell"\nsize = [32]', "size: expected 2 values"),
        ('scene = "cornell"\nseed = -1', "seed: expected a whole number from 0"),
        ('scene = "cornel"', "did you mean 'cornell'"),
        ('scene = "."', "is a folder"),
        ('scene = { source = "cornell", parameters = { triangels = 3 } }', "did you mean 'triangles'"),
        ('scene = { source = "cornell", up = "z" }', "up is for scene files"),
        ('scene = "cornell"\n[camera]\nfile = "absent.json"', "absent.json: cannot be read: No such file"),
        ('scene = "cornell"\n[camera]\nfile = "a"\nname = "b"', "expected one of file, name and keyframes"),
        ('scene = "cornell"\n[camera]\nup = "x"', "up: expected 'y' or 'z', got 'x'"),
        ('scene = "cornell"\n[camera]\nswing = 100', "swing: expected degrees from 0 to 90"),
        ('scene = "cornell"\n[reference]\ntechnique = "none"', "technique 'none' does not exist"),
        ('scene = "cornell"\n[reference]\nknobs = { samples = 0 }\ntechnique = "plain"', "[reference.knobs]: samples"),
    ],
)
def test_bad_jobs_are_refused_with_a_hint(text, said):
    if text.startswith("scene") and "techniques" not in text:
        text = f'techniques = ["plain"]\n{text}'
    with pytest.raises(JobError) as caught:
        resolve(parse_job(text, name="job.toml"), techniques=FAKES)
    assert said in str(caught.value)


def test_missing_and_binary_job_files(tmp_path):
    with pytest.raises(JobError, match=r"absent\.toml: cannot be read: No such file"):
        read_job(tmp_path / "absent.toml")
    (tmp_path / "job.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(JobError, match="expected UTF-8"):
        read_job(tmp_path / "job.toml")


def test_a_camera_path_names_one_kind():
    with pytest.raises(JobError, match="file and keyframes"):
        CameraPath(file="a.json", keyframes=(Keyframe((0, 0, 0), target=(0, 0, 1)),))
