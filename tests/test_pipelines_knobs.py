"""Knobs of techniques: found, checked, completed."""

import dataclasses

import equinox as eqx
import pytest
from fake_techniques import FAKES, PLAIN
from jaxtyping import Array, Float

from jaxrefl.techniques import TECHNIQUES
from pipelines.knobs import build, complete, find_technique, knobs_of, technique_knobs
from pipelines.toml_tables import JobError


def test_knobs_of_a_technique_come_from_its_classes():
    knobs = technique_knobs(PLAIN)
    assert list(knobs) == ["noise", "samples", "mode", "level"]
    assert (knobs["samples"].kind, knobs["samples"].low, knobs["samples"].high) == (int, 1, 4096)
    assert (knobs["level"].kind, knobs["level"].default) == (float, 0.5)
    assert knobs["mode"].choices == ("plain", "fancy")


@pytest.mark.parametrize("name", TECHNIQUES)
def test_every_technique_has_knobs_that_build_and_say_what_they_do(name):
    technique = TECHNIQUES[name]
    knobs = technique_knobs(technique)
    values = complete(knobs, {}, where=name)
    assert all(knob.help for knob in knobs.values())
    assert build(technique.Options, values, where=name) == technique.Options()
    assert isinstance(build(technique.Params, values, where=name), technique.Params)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"smaples": 4}, "unknown key 'smaples'; did you mean 'samples'"),
        ({"samples": 0}, "samples: expected a value from 1 to 4096, got 0"),
        ({"samples": 4.0}, "samples: expected int, got 4.0"),
        ({"samples": True}, "samples: expected int, got True"),
        ({"noise": 1}, "noise: expected bool, got 1"),
        ({"mode": "fanzy"}, "'fanzy' is not a choice; did you mean 'fancy'"),
        ({"level": 11.0}, "level: expected a value from 0.0 to 10.0, got 11.0"),
        ({"level": float("nan")}, "got nan"),
    ],
)
def test_what_does_not_fit_is_named(given, said):
    with pytest.raises(JobError) as caught:
        complete(technique_knobs(PLAIN), given, where="[technique.plain]")
    assert str(caught.value).startswith("[technique.plain]") and said in str(caught.value)


def test_whole_numbers_do_for_parameters():
    values = complete(technique_knobs(PLAIN), {"level": 2}, where="x")
    assert float(build(PLAIN.Params, values, where="x").level) == 2.0


def test_unknown_technique_lists_those_that_exist():
    with pytest.raises(JobError, match=r"'plane' does not exist; did you mean 'plain'\? there are: plain, carrying"):
        find_technique("plane", FAKES)


def test_a_name_used_twice_is_a_defect():
    class Params(eqx.Module):
        samples: Float[Array, ""] = eqx.field(default=1.0)

    with pytest.raises(TypeError, match="used twice"):
        knobs_of(PLAIN.Options, Params)

    @dataclasses.dataclass(frozen=True)
    class Options:
        shape: tuple = ()

    with pytest.raises(TypeError, match="plain default"):
        knobs_of(Options)
