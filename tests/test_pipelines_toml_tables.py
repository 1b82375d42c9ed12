"""Dataclasses <-> TOML."""

import tomllib
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.toml_tables import JobError, read_table, suggestion, toml_text, write_table


@dataclass(frozen=True)
class Inner:
    size: tuple[int, int] = (1, 2)
    weights: tuple[float, ...] = ()
    name: str | None = None


@dataclass(frozen=True)
class Outer:
    title: str
    on: bool = True
    count: int = 0
    inner: Inner = field(default_factory=Inner)
    many: tuple[Inner, ...] = ()
    knobs: dict[str, bool | int | float | str] = field(default_factory=dict)


texts = st.text(st.characters(exclude_categories=("Cs",)), max_size=8)
numbers = st.floats(allow_nan=False, allow_infinity=False)
inners = st.builds(
    Inner,
    size=st.tuples(st.integers(-9, 9), st.integers(-9, 9)),
    weights=st.lists(numbers, max_size=3).map(tuple),
    name=st.none() | texts,
)
outers = st.builds(
    Outer,
    title=texts,
    on=st.booleans(),
    count=st.integers(-(2**60), 2**60),
    inner=inners,
    many=st.lists(inners, max_size=2).map(tuple),
    knobs=st.dictionaries(texts, st.booleans() | st.integers(-9, 9) | numbers | texts, max_size=3),
)


@given(outers)
def test_what_is_written_is_read_back(value):
    assert read_table(Outer, tomllib.loads(toml_text(write_table(value))), where="x") == value


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"title": "a", "cuont": 1}, "unknown key 'cuont'; did you mean 'count'"),
        ({"count": 1}, "'title' is missing"),
        ({"title": 1}, "title: expected a string, got 1"),
        ({"title": "a", "count": True}, "count: expected a whole number, got True"),
        ({"title": "a", "count": 1.5}, "count: expected a whole number, got 1.5"),
        ({"title": "a", "on": "yes"}, "on: expected true or false, got 'yes'"),
        ({"title": "a", "inner": 3}, "inner: expected a table, got 3"),
        ({"title": "a", "inner": {"size": [1]}}, "size: expected 2 values, got 1"),
        ({"title": "a", "inner": {"size": 1}}, "size: expected a list, got 1"),
        ({"title": "a", "inner": {"weights": [1.0, "x"]}}, "weights[1]: expected a number, got 'x'"),
        ({"title": "a", "inner": {"weights": [float("nan")]}}, "expected a finite number, got nan"),
        ({"title": "a", "many": [{"name": 3}]}, "many[0]: name: expected a string, got 3"),
        ({"title": "a", "knobs": 3}, "knobs: expected a table, got 3"),
    ],
)
def test_what_does_not_fit_is_named(table, said):
    with pytest.raises(JobError) as caught:
        read_table(Outer, table, where="job.toml")
    assert str(caught.value).startswith("job.toml") and said in str(caught.value)


def test_whole_numbers_are_numbers():
    assert read_table(Outer, {"title": "a", "inner": {"weights": [1]}}, where="x").inner.weights == (1.0,)


def test_none_and_empty_tables_are_left_out():
    written = write_table(Outer("a"))
    assert written == {"title": "a", "on": True, "count": 0, "inner": {"size": [1, 2], "weights": []}, "many": []}


def test_suggestion_lists_what_exists():
    assert suggestion("envmpa", ["raytrace", "envmap"]) == "did you mean 'envmap'? there are: raytrace, envmap"
    assert suggestion("zzz", ["raytrace"]) == "there are: raytrace"
