"""Every public callable has annotations, docstring sections, keyword-only defaults and a page in the docs."""

import dataclasses
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import pytest

import jaxrefl

PAGES = Path(__file__).parent.parent / "docs" / "pages"
ROOMS = sorted(
    {"jaxrefl"}
    | {
        module.name
        for module in pkgutil.walk_packages(jaxrefl.__path__, "jaxrefl.")
        if module.ispkg and not any(part.startswith("_") for part in module.name.split("."))
    }
)


def public_callables() -> dict[str, object]:
    """Everything callable that a package re-exports, by dotted name of its room."""
    found = {}
    for room in ROOMS:
        module = importlib.import_module(room)
        for name, value in vars(module).items():
            if not name.startswith("_") and callable(value) and not inspect.ismodule(value):
                found[f"{room}.{name}"] = value
    return found


CALLABLES = public_callables()
FUNCTIONS = {name: value for name, value in CALLABLES.items() if not inspect.isclass(value)}
CLASSES = {name: value for name, value in CALLABLES.items() if inspect.isclass(value)}


def test_there_is_an_api():
    expected = {"jaxrefl.load", "jaxrefl.look", "jaxrefl.core.refract", "jaxrefl.techniques.raytrace.step"}
    assert expected <= set(FUNCTIONS)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_parameter_and_result_is_annotated(name: str):
    signature = inspect.signature(FUNCTIONS[name])
    assert signature.return_annotation is not inspect.Signature.empty
    for parameter in signature.parameters.values():
        assert parameter.annotation is not inspect.Parameter.empty, parameter


@pytest.mark.parametrize("name", FUNCTIONS)
def test_defaults_are_keyword_only_and_parameters_few(name: str):
    parameters = inspect.signature(FUNCTIONS[name]).parameters.values()
    positional = [p for p in parameters if p.default is not p.empty and p.kind is not p.KEYWORD_ONLY]
    assert not positional
    assert len(parameters) <= 8


@pytest.mark.parametrize("name", FUNCTIONS)
def test_docstrings_have_their_sections(name: str):
    text = inspect.getdoc(FUNCTIONS[name]) or ""
    first = text.split("\n\n")[0]
    assert first.endswith((".", "!")) and "\n" not in first.strip(), first
    parameters = [p for p in inspect.signature(FUNCTIONS[name]).parameters if p not in ("self", "args", "kwargs")]
    if parameters:
        assert "Args:" in text
    for parameter in parameters:
        assert re.search(rf"^\s+\*{{0,2}}{parameter}[\w, ]*:", text, re.M) or re.search(
            rf"^\s+[\w, ]*\b{parameter}\b[\w, ]*:", text, re.M
        ), f"{parameter} is not described"
    assert re.search(r"^\s*(Returns|Yields|Raises):", text, re.M)


@pytest.mark.parametrize("name", CLASSES)
def test_classes_say_what_they_are_and_what_their_fields_hold(name: str):
    value = CLASSES[name]
    assert value.__doc__ and value.__doc__.strip()
    if dataclasses.is_dataclass(value):
        source = inspect.getsource(value)
        for field in dataclasses.fields(value):
            described = field.metadata.get("help") or re.search(
                rf"^\s+{field.name}\b[^\n]*(\n(?!\s*\"\"\")[^\n]*)*?\n\s+\"\"\"", source, re.M
            )
            inherited = field.name not in source
            assert described or inherited, f"{name}.{field.name} has no description"


@pytest.mark.parametrize("room", [room for room in ROOMS if room != "jaxrefl"])
def test_every_room_is_on_a_page_of_the_docs(room: str):
    """`::: jaxrefl.room` on a page makes mkdocstrings print every public name of that room."""
    pages = "\n".join(page.read_text() for page in PAGES.glob("*.md"))
    assert re.search(rf"^::: {re.escape(room)}\s*$", pages, re.M), f"no page has '::: {room}'"
