"""Times, memory and errors of a step."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrefl.metrics import FIGURES, mae255
from pipelines.measure import compile_seconds, peak_memory, reset_peak_memory, rows, timed


def test_compilation_is_told_from_steady_time():
    function = jax.jit(lambda x: jnp.sin(x) * 2 + jnp.cos(x))
    x = jnp.arange(7.0)
    calls = []

    def call():
        calls.append(1)
        time.sleep(0.02)
        return function(x)

    first, second = timed(call), timed(call)
    assert len(calls) == 3  # the first compiled and was run again, the second did not
    assert first.compile_seconds > 0 and second.compile_seconds == 0
    assert first.seconds == pytest.approx(0.02, abs=0.02) and second.seconds == pytest.approx(0.02, abs=0.02)


def test_long_calls_are_run_once_and_their_compile_time_subtracted():
    function, calls = jax.jit(lambda x: jnp.sin(x) * 3), []

    def call():
        calls.append(1)
        return function(jnp.arange(11.0))

    cost = timed(call, repeat=False)
    assert len(calls) == 1 and cost.compile_seconds > 0 and cost.seconds >= 0


def test_the_listener_is_removed_again():
    with compile_seconds() as spent:
        pass
    jax.jit(lambda x: x + 5)(jnp.arange(3.0))
    assert spent == []


def test_peak_memory_forgets_what_was_before():
    if not reset_peak_memory():
        pytest.skip("the system does not tell the peak memory of a part of a run")
    before = peak_memory()
    block = np.ones(64 * 2**20, np.uint8)
    high = peak_memory()
    del block
    assert reset_peak_memory()
    after = peak_memory()
    assert high - before > 60 and high - after > 60


FACTS = {"scene": "s", "technique": "t", "frame": 3, "seconds": 0.5, "stages": {"a": 0.5}}


def test_rows_measure_over_each_mask(rng):
    reference = rng.uniform(size=(24, 24, 3)).astype(np.float32)
    reflective = np.zeros((24, 24), bool)
    reflective[4:20, 4:16] = True
    image = reference.copy()
    image[~reflective] += 0.25
    inside, whole = rows(image, reference, reflective, FACTS)
    assert (inside["mask"], whole["mask"]) == ("reflective", "frame")
    assert inside["mae255"] == inside["rmse"] == 0 and inside["psnr"] is None  # infinite
    assert whole["mae255"] == pytest.approx(mae255(image, reference, None), rel=1e-6) and whole["mae255"] > 1
    assert inside["reflective_share"] == whole["reflective_share"] == pytest.approx(192 / 576)
    assert list(inside)[:9] == ["scene", "technique", "frame", "mask", *FIGURES]
    assert inside["seconds"] == 0.5 and inside["stages"] == {"a": 0.5}


def test_rows_without_a_reference_or_a_reflection_are_null(rng):
    image = rng.uniform(size=(16, 16, 3)).astype(np.float32)
    mask = np.zeros((16, 16), bool)
    assert all(row[name] is None for row in rows(image, None, mask, FACTS) for name in FIGURES)
    inside, whole = rows(image, image * 0.5, mask, FACTS)
    assert all(inside[name] is None for name in FIGURES) and whole["rmse"] > 0
    assert inside["reflective_share"] == 0
