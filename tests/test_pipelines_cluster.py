"""Frames on other processes: the same bytes, and workers that die."""

import dataclasses
import os
import signal
import sys
import threading
import time

import dask.config
import distributed  # noqa: F401  its defaults must be there before they are changed
import pytest
from fake_techniques import FAKES
from results_folders import figures, images

from pipelines.job import Job, Reference, SceneSource
from pipelines.run import run_job
from pipelines.toml_tables import JobError

JOB = Job(
    SceneSource("cornell", parameters={"triangles": 1000}),
    techniques=("plain", "carrying"),
    frames=4,
    size=(32, 24),
    reference=Reference("plain", {"samples": 2}),
)


def test_workers_give_the_same_bytes_even_if_one_is_killed(tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    run_job(JOB, here, quiet=True, techniques=FAKES)
    killed = []

    def kill_one():
        import psutil

        while not list(there.glob("reference/frame_*.json")) and not killed_in_vain():
            time.sleep(0.02)
        workers = [c for c in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(c.cmdline())]
        killed.append(workers[0].pid)
        os.kill(workers[0].pid, signal.SIGKILL)

    began = time.monotonic()
    killed_in_vain = lambda: time.monotonic() - began > 60  # noqa: E731
    killer = threading.Thread(target=kill_one)
    killer.start()
    with dask.config.set({"distributed.worker.preload": ["register_fakes"]}):
        result = run_job(JOB, there, scheduler="local:2", quiet=True, techniques=FAKES)
    killer.join()
    assert killed and result.rendered == 12
    assert images(there) == images(here)
    assert figures(there) == figures(here)


@pytest.mark.parametrize(
    ("scheduler", "said"),
    [
        ("local:0", "expected local:N with N processes, at least 1, got 'local:0'"),
        ("local:many", "expected local:N"),
        ("nonsense", "expected local:N or an address"),
        ("tcp://127.0.0.1:1", "tcp://127.0.0.1:1: cannot be reached"),
    ],
)
def test_schedulers_that_cannot_be_used_are_named(tmp_path, scheduler, said, monkeypatch):
    monkeypatch.setattr("pipelines.cluster.TIMEOUT", 1)
    with pytest.raises(JobError, match=said):
        run_job(dataclasses.replace(JOB, frames=1), tmp_path, scheduler=scheduler, quiet=True, techniques=FAKES)


def test_a_missing_extra_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(JobError, match=r"pip install 'jaxrefl\[cluster\]'"):
        run_job(dataclasses.replace(JOB, frames=1), tmp_path, scheduler="local:2", quiet=True, techniques=FAKES)
