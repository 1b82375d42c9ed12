"""PNG, EXR, JSON, and files that are whole or not there."""

import errno
import io
import json
import os
import resource
import signal
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from pipelines.outputs import exr_bytes, json_text, png_bytes, read_exr, write_atomic

STAMP = {"seed": 3, "versions": {"jaxrefl": "0"}}


def test_png_rounds_clips_and_carries_its_stamp():
    srgb = np.array([[[0.0, 0.5, 1.0], [-1.0, 2.0, 127.4 / 255]]], np.float32)
    picture = Image.open(io.BytesIO(png_bytes(srgb, STAMP)))
    assert picture.mode == "RGB"
    np.testing.assert_array_equal(np.asarray(picture), [[[0, 128, 255], [0, 255, 127]]])
    assert json.loads(picture.text["jaxrefl"]) == STAMP


def test_exr_keeps_every_bit_and_its_stamp(tmp_path, rng):
    planes = {
        name: rng.normal(size=(5, 7)).astype(np.float32) for name in ("R", "G", "B", "normal.X", "object_id", "Z")
    }
    planes["Z"][0, :3] = [1e30, 3e-30, 16777217]
    path = tmp_path / "a.exr"
    path.write_bytes(exr_bytes(planes, STAMP))
    read = read_exr(path)
    assert set(read) == set(planes)
    for name, plane in planes.items():
        np.testing.assert_array_equal(read[name], plane)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert json.loads(file.header()["jaxrefl"]) == STAMP
        assert all(channel.type() == OpenEXR.FLOAT for channel in file.channels().values())


def test_encoders_depend_on_pixels_and_stamp_alone(rng):
    image = rng.uniform(size=(4, 6, 3)).astype(np.float32)
    planes = {"R": image[..., 0], "G": image[..., 1]}
    assert png_bytes(image, STAMP) == png_bytes(image.copy(), dict(STAMP))
    assert exr_bytes(planes, STAMP) == exr_bytes(dict(planes), dict(STAMP))
    assert png_bytes(image, STAMP) != png_bytes(image, {**STAMP, "seed": 4})


def test_broken_exr_is_named(tmp_path):
    path = tmp_path / "broken.exr"
    path.write_bytes(b"not an image")
    with pytest.raises(OSError, match=r"broken\.exr"):
        read_exr(path)
    with pytest.raises(OSError, match=r"absent\.exr"):
        read_exr(tmp_path / "absent.exr")


values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=3) | st.floats(width=32).map(np.float32),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
)


@given(values)
def test_json_is_always_valid(value):
    def refuse(word):
        raise AssertionError(word)

    json.loads(json_text(value), parse_constant=refuse)


def test_json_writes_what_is_not_finite_as_null():
    assert (
        json_text({"a": float("nan"), "b": np.float32("inf"), "c": np.arange(2)})
        == '{"a": null, "b": null, "c": [0, 1]}'
    )


def test_write_atomic_replaces_and_makes_folders(tmp_path):
    path = tmp_path / "deep" / "er" / "file.bin"
    write_atomic(path, b"one")
    write_atomic(path, b"two")
    assert path.read_bytes() == b"two"
    assert os.listdir(path.parent) == ["file.bin"]


def test_full_disk_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "file.bin"
    write_atomic(path, b"old")

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*file\.bin'"):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["file.bin"]


def test_a_real_write_error_leaves_nothing(tmp_path):
    """The kernel refuses the bytes half-way, as a full disk or a quota does."""
    code = "import pathlib, pipelines.outputs as o; o.write_atomic(pathlib.Path('big.bin'), b'x' * 10**6)"

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))

    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, preexec_fn=limit, capture_output=True, text=True)
    assert done.returncode != 0 and "File too large: 'big.bin'" in done.stderr
    assert os.listdir(tmp_path) == []
