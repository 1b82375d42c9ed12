"""How a technique names its knobs: in one place, with range and meaning, for the command line and for sweeps.

`Params` are `equinox.Module`s whose fields are made by `tunable`: traced scalars, so a new value does not recompile.
`Options` are frozen dataclasses whose fields are made by `option`: static, for whatever sets a shape or a branch.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array


def _as_float32(value: Any) -> Array:
    return jnp.asarray(value, jnp.float32)


def tunable(default: float, low: float, high: float, help: str) -> Any:
    """A field of `Params`: a float32 scalar in [low, high].

    Args:
        default: Value used when none is given.
        low: Smallest sensible value.
        high: Largest sensible value.
        help: One sentence for the command line, units included.
    Returns:
        The dataclass field.
    """
    metadata = {"low": low, "high": high, "help": help}
    return eqx.field(converter=_as_float32, default=default, metadata=metadata)


def option(default: Any, help: str, *, low: float | None = None, high: float | None = None, choices: tuple = ()) -> Any:
    """A field of `Options`: an int, bool or str.

    Args:
        default: Value used when none is given.
        help: One sentence for the command line.
        low: Smallest allowed number.
        high: Largest allowed number.
        choices: The allowed strings.
    Returns:
        The dataclass field.
    """
    metadata = {"low": low, "high": high, "choices": choices, "help": help}
    return dataclasses.field(default=default, metadata=metadata)


def check_options(options: Any) -> None:
    """Check an `Options` instance against the ranges of its fields; call it from `__post_init__`.

    Args:
        options: An instance of a dataclass whose fields were made by `option`.
    Raises:
        ValueError: If a value is outside its range or not one of the choices; names the option.
    """
    for field in dataclasses.fields(options):
        value, meta = getattr(options, field.name), field.metadata
        if meta.get("choices") and value not in meta["choices"]:
            raise ValueError(f"{field.name}: expected one of {', '.join(meta['choices'])}, got {value!r}")
        low, high = meta.get("low"), meta.get("high")
        if (low is not None and value < low) or (high is not None and value > high):
            raise ValueError(f"{field.name}: expected a value from {low} to {high}, got {value!r}")
