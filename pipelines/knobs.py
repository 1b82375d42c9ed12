"""The knobs of techniques, of direct light and of compositing: one list for job files, flags and checks.

A technique names its knobs in `Params` (traced numbers) and `Options` (static choices); direct light and compositing
have an options class each. Everything the runner knows about a knob (type, default, range, meaning) is read from there.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx

from jaxrefl.techniques._shape import Technique
from pipelines.toml_tables import JobError, suggestion

Knobs = dict[str, bool | int | float | str]
"""Values of knobs by name."""


@dataclass(frozen=True)
class Knob:
    """One adjustable value."""

    name: str
    """Key in job files and flag on the command line."""
    kind: type
    """bool, int, float or str."""
    default: bool | int | float | str
    """Value used when none is given."""
    help: str
    """One sentence."""
    low: float | None = None
    """Smallest allowed number."""
    high: float | None = None
    """Largest allowed number."""
    choices: tuple[str, ...] = ()
    """Allowed strings; empty: any."""

    @property
    def explanation(self) -> str:
        """The help sentence with the range behind it."""
        if self.low is not None and self.high is not None:
            return f"{self.help} From {self.low} to {self.high}."
        return self.help if self.low is None else f"{self.help} At least {self.low}."

    def checked(self, value: Any, *, where: str) -> bool | int | float | str:
        """The value in the knob's type.

        Args:
            value: What was given.
            where: Place for messages.
        Returns:
            The value; whole numbers are accepted for floats.
        Raises:
            JobError: If its type is wrong, or it is outside the range or not one of the choices.
        """
        if self.kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if type(value) is not self.kind:
            raise JobError(f"{where}: {self.name}: expected {self.kind.__name__}, got {value!r}")
        if self.choices and value not in self.choices:
            raise JobError(f"{where}: {self.name}: {value!r} is not a choice; {suggestion(str(value), self.choices)}")
        if isinstance(value, int | float) and not isinstance(value, bool):
            low = float("-inf") if self.low is None else self.low
            high = float("inf") if self.high is None else self.high
            if not low <= value <= high:
                raise JobError(f"{where}: {self.name}: expected a value from {low} to {high}, got {value!r}")
        return value


def knobs_of(*kinds: type) -> dict[str, Knob]:
    """All knobs of some classes.

    Args:
        *kinds: `Params` and `Options` classes; names must not repeat.
    Returns:
        Knobs by name, in the order of the fields.
    Raises:
        TypeError: If a field has no plain default, or two classes use one name: a defect of the technique.
    """
    found: dict[str, Knob] = {}
    for kind in kinds:
        for field in dataclasses.fields(kind):
            default: Any = field.default
            if issubclass(kind, eqx.Module) and type(default) is int:  # a traced parameter is a float
                default = float(default)
            if type(default) not in (bool, int, float, str):
                raise TypeError(f"{kind.__module__}.{kind.__name__}.{field.name}: a knob needs a plain default")
            if field.name in found:
                raise TypeError(f"{kind.__module__}.{kind.__name__}.{field.name}: the name is used twice")
            meta = field.metadata
            found[field.name] = Knob(
                name=field.name,
                kind=type(default),
                default=default,
                help=meta.get("help", ""),
                low=meta.get("low"),
                high=meta.get("high"),
                choices=tuple(meta.get("choices") or ()),
            )
    return found


def technique_knobs(technique: Technique) -> dict[str, Knob]:
    """Knobs of a technique, options before parameters.

    Args:
        technique: Any technique.
    Returns:
        Knobs by name.
    """
    return knobs_of(technique.Options, technique.Params)


def find_technique(name: str, techniques: Mapping[str, Technique]) -> Technique:
    """A technique by name.

    Args:
        name: Its name.
        techniques: Those that exist.
    Returns:
        The technique.
    Raises:
        JobError: If there is none of this name; lists those that exist.
    """
    if name not in techniques:
        raise JobError(f"technique {name!r} does not exist; {suggestion(name, techniques)}")
    return techniques[name]


def complete(known: Mapping[str, Knob], given: Mapping[str, Any], *, where: str) -> Knobs:
    """Values for all knobs.

    Args:
        known: The knobs that exist.
        given: Values by name; the others get their default.
        where: Place for messages, such as "[technique.raytrace]".
    Returns:
        One checked value per knob.
    Raises:
        JobError: If a name is unknown or a value does not fit.
    """
    for name in given:
        if name not in known:
            raise JobError(f"{where}: unknown key {name!r}; {suggestion(name, known)}")
    return {n: k.checked(given[n], where=where) if n in given else k.default for n, k in known.items()}


def build(kind: type, values: Mapping[str, Any], *, where: str) -> Any:
    """An instance of a knob class from a table that may hold the knobs of others too.

    Args:
        kind: `Params` or `Options` class.
        values: Values by name.
        where: Place for messages.
    Returns:
        The instance.
    Raises:
        JobError: If the class refuses the combination of values.
    """
    names = {field.name for field in dataclasses.fields(kind)}
    try:
        return kind(**{name: value for name, value in values.items() if name in names})
    except ValueError as error:
        raise JobError(f"{where}: {error}") from error
