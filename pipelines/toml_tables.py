"""Frozen dataclasses <-> TOML tables: what makes a job file strict, and its errors helpful.

Reading checks every key and type and suggests the nearest key for an unknown one; writing leaves out what is None. Both
directions know only plain values (bool, int, float, str), tuples, dictionaries and nested dataclasses.
"""

import dataclasses
import difflib
import json
import math
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any


class JobError(ValueError):
    """A job, flag or camera path that cannot be used; the message names the place, what was expected and what came."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """A hint for a misspelt name.

    Args:
        name: What was given.
        known: What exists.
    Returns:
        "did you mean 'x'? " where something is close, then the list of what exists.
    """
    known = list(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return (f"did you mean {close[0]!r}? " if close else "") + f"there are: {', '.join(known) if known else 'none'}"


def read_table(kind: type, table: Any, *, where: str) -> Any:
    """An instance of a dataclass from a TOML table.

    Args:
        kind: The dataclass; its annotations say what each key may hold.
        table: Parsed TOML.
        where: Name of the table for messages, such as "job.toml: [camera]".
    Returns:
        The instance; keys that are absent have their default.
    Raises:
        JobError: If a key is unknown, missing or of the wrong type; names the key.
    """
    if not isinstance(table, Mapping):
        raise JobError(f"{where}: expected a table, got {table!r}")
    hints, fields = typing.get_type_hints(kind), {f.name: f for f in dataclasses.fields(kind)}
    for key in table:
        if key not in fields:
            raise JobError(f"{where}: unknown key {key!r}; {suggestion(key, fields)}")
    values = {key: read_value(hints[key], value, where=f"{where}: {key}") for key, value in table.items()}
    for name, field in fields.items():
        if name not in values and field.default is field.default_factory is dataclasses.MISSING:
            raise JobError(f"{where}: the key {name!r} is missing")
    try:
        return kind(**values)
    except JobError:
        raise
    except ValueError as error:
        raise JobError(f"{where}: {error}") from error


def read_value(hint: Any, value: Any, *, where: str) -> Any:
    """A TOML value as the annotated type.

    Args:
        hint: bool, int, float, str, `X | None`, a tuple type, a dict type, or a dataclass.
        value: Parsed TOML.
        where: Place for messages.
    Returns:
        The value; whole numbers are accepted for floats.
    Raises:
        JobError: If the value has another type.
    """
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return _read_union(arguments, value, where)
    if origin is tuple:
        return _read_tuple(arguments, value, where)
    if origin is dict:
        if not isinstance(value, Mapping):
            raise JobError(f"{where}: expected a table, got {value!r}")
        return {key: read_value(arguments[1], item, where=f"{where}.{key}") for key, item in value.items()}
    if dataclasses.is_dataclass(hint):
        return read_table(typing.cast(type, hint), value, where=where)
    if hint is Any:
        return value
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise JobError(f"{where}: expected a finite number, got {value}")
        return float(value)
    if isinstance(value, hint) and not (hint is int and isinstance(value, bool)):
        return value
    raise JobError(f"{where}: expected {_NAMES.get(hint, hint)}, got {value!r}")


_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "a string"}


def _read_union(arguments: tuple[Any, ...], value: Any, where: str) -> Any:
    errors = []
    for argument in (a for a in arguments if a is not type(None)):
        try:
            return read_value(argument, value, where=where)
        except JobError as error:
            errors.append(str(error))
    raise JobError(errors[0])


def _read_tuple(arguments: tuple[Any, ...], value: Any, where: str) -> tuple:
    if not isinstance(value, list | tuple):
        raise JobError(f"{where}: expected a list, got {value!r}")
    if arguments[-1] is Ellipsis:
        arguments = (arguments[0],) * len(value)
    if len(value) != len(arguments):
        raise JobError(f"{where}: expected {len(arguments)} values, got {len(value)}: {value!r}")
    pairs = zip(arguments, value, strict=True)
    return tuple(read_value(hint, item, where=f"{where}[{i}]") for i, (hint, item) in enumerate(pairs))


def write_table(instance: Any) -> dict[str, Any]:
    """A TOML table from a dataclass instance.

    Args:
        instance: The dataclass instance.
    Returns:
        Plain values in the order of the fields; None and empty tables are left out.
    """
    table = {f.name: _plain(getattr(instance, f.name)) for f in dataclasses.fields(instance)}
    return {key: value for key, value in table.items() if value is not None and value != {}}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return write_table(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    return value


def toml_text(table: Mapping[str, Any]) -> str:
    """TOML source of a table.

    Args:
        table: Nested dictionaries of plain values and lists.
    Returns:
        Text that `tomllib` reads back to an equal table; values first, then sub-tables under their headings.
    """
    return "\n".join(_lines(table, prefix="")).lstrip("\n") + "\n"


def _lines(table: Mapping[str, Any], prefix: str) -> list[str]:
    lines = [f"{_key(key)} = {_value(value)}" for key, value in table.items() if not isinstance(value, Mapping)]
    for key, value in table.items():
        if isinstance(value, Mapping):
            name = f"{prefix}{_key(key)}"
            lines += ["", f"[{name}]", *_lines(value, prefix=f"{name}.")]
    return lines


def _key(key: str) -> str:
    bare = key and all(c.isascii() and (c.isalnum() or c in "-_") for c in key)
    return key if bare else _string(key)


def _string(text: str) -> str:
    # JSON's escapes are TOML's, but for surrogate pairs (hence no ASCII) and the delete character.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + " }"
    return repr(value)
