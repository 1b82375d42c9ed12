"""Overrides: a small TOML file that changes the materials, lights, cameras, units and axes of a scene file.

    units = 0.01                     # world units per unit of the file
    up = "z"                         # axis of the file that points up
    environment = "studio.hdr"

    [materials.floor]                # or [materials."wood_*"], a glob pattern
    kind = "glossy"
    alpha = 0.1

    [objects.lampshade]              # objects win over materials
    kind = "ignore"

`scene.jaxrefl.toml` beside `scene.obj` is read by itself. Unknown keys and names that match nothing are errors.
"""

import fnmatch
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxrefl._types import Camera
from jaxrefl._validate import checked_array, checked_keys, checked_number
from jaxrefl.scene.description import Description, Material, Part, PunctualLight, emitter, glass, matte, mirror
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.materials import checked_material
from jaxrefl.scene.override_lights import SkySettings, read_cameras, read_lights, read_sky

SUFFIX = ".jaxrefl.toml"
_TOP = ["units", "up", "crease_angle", "ambient", "sky", "environment", "environment_scale", "environment_rotation"]
_TABLES = ["materials", "objects", "lights", "cameras"]
_SURFACE = [
    *("colour", "alpha", "metallic", "eta", "transmission", "attenuation", "thin", "emission"),
    *("emits_back", "conductor", "coupled", "opacity"),
]
_KINDS = {
    "mirror": ["colour"],
    "glossy": ["colour", "alpha", "metallic", "eta"],
    "glass": ["colour", "alpha", "eta", "attenuation", "thin"],
    "matte": ["colour"],
    "emitter": ["radiance", "emits_back"],
    "ignore": [],
}
_SHOWN = 30


@dataclass(frozen=True)
class Overrides:
    """What an override file says; see the head of this module."""

    source: str = "overrides"
    """File name, for messages."""
    materials: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Changes by material name or pattern, in file order; later ones win."""
    objects: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Changes by object name or pattern; they win over those by material."""
    lights: list[PunctualLight] = field(default_factory=list)
    """Lights to add."""
    cameras: dict[str, Camera] = field(default_factory=dict)
    """Cameras to add, by name; they replace those of the file with the same name."""
    sky: SkySettings = field(default_factory=SkySettings)
    """Sky or environment map; replaces that of the file if it says anything."""
    ambient: tuple[float, float, float] | None = None
    """Ambient radiance; None keeps that of the file."""
    units: float | None = None
    """World units per unit of the file; None: not said."""
    up: str | None = None
    """Axis of the file that points up; None: not said."""
    crease_angle: float | None = None
    """Degrees; None: not said."""


def find_overrides(path: Path) -> Path | None:
    """The override file that belongs to a scene file.

    Args:
        path: Scene file, such as `room.obj`.
    Returns:
        `room.jaxrefl.toml` beside it, or None if there is no such file.
    """
    beside = path.with_name(path.stem + SUFFIX)
    return beside if beside.is_file() else None


def read_overrides(source: str | Path | dict[str, Any]) -> Overrides:
    """Overrides from a TOML file or from the same keys in a dictionary.

    Args:
        source: The file, or the dictionary (paths in it are relative to the working directory).
    Returns:
        The checked overrides.
    Raises:
        SceneError: If the file is missing or is not TOML, a key is unknown or missing, or a value is out of range.
    """
    if isinstance(source, dict):
        name, folder, data = "overrides", Path(), source
    else:
        path = Path(source)
        name, folder = str(path), path.parent
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise SceneError(f"{path}: cannot read the overrides: {error.strerror}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise SceneError(f"{path}: not a TOML file: {error}") from error
    try:
        return _read(name, folder, data)
    except SceneError:
        raise
    except (TypeError, ValueError) as error:
        raise SceneError(f"{name}: {error}") from error


def apply_overrides(description: Description, overrides: Overrides) -> Description:
    """A description with the changed materials, and with the added lights, cameras, sky and ambient term.

    Args:
        description: The scene as read, already in world units and axes.
        overrides: What to change.
    Returns:
        The new description.
    Raises:
        SceneError: If a name or pattern matches nothing (lists what exists), or a changed material is out of range.
    """
    by_material = _matches(overrides, "materials", [part.material.name for part in description.parts])
    by_object = _matches(overrides, "objects", [part.name for part in description.parts])
    parts: list[Part] = []
    for i, part in enumerate(description.parts):
        changes = [*by_material[i], *by_object[i]]
        if any(change.get("kind") == "ignore" for change in changes):
            continue
        material = part.material
        for change in changes:
            material = _changed(material, change, overrides.source)
        parts.append(part if material is part.material else Part(**{**vars(part), "material": material}))
    sky = overrides.sky.build()
    return Description(
        description.name,
        parts,
        lights=[*description.lights, *overrides.lights],
        sky=description.sky if sky is None else sky,
        ambient=description.ambient if overrides.ambient is None else overrides.ambient,
        cameras={**description.cameras, **overrides.cameras},
        notes=list(description.notes),
    )


def _read(name: str, folder: Path, data: dict[str, Any]) -> Overrides:
    checked_keys("overrides", data, _TOP + _TABLES)
    for table in ("materials", "objects"):
        for pattern, change in _table(data, table).items():
            _check_change(f"{table}.{pattern}", change)
    ambient = None if "ambient" not in data else _colour("ambient", data["ambient"])
    return Overrides(
        source=name,
        materials=_table(data, "materials"),
        objects=_table(data, "objects"),
        lights=read_lights(data.get("lights", [])),
        cameras=read_cameras(data.get("cameras", [])),
        sky=read_sky(data, folder),
        ambient=ambient,
        units=None if "units" not in data else checked_number("units", data["units"], above=0.0),
        up=data.get("up"),
        crease_angle=None if "crease_angle" not in data else checked_number("crease_angle", data["crease_angle"]),
    )


def _table(data: dict[str, Any], key: str) -> dict[str, dict[str, Any]]:
    table = data.get(key, {})
    if not isinstance(table, dict) or not all(isinstance(value, dict) for value in table.values()):
        raise ValueError(f"{key}: expected tables such as [{key}.NAME], got {table!r}")
    return table


def _check_change(where: str, change: dict[str, Any]) -> None:
    kind = change.get("kind")
    if kind is not None and kind not in _KINDS:
        raise ValueError(f"{where}: kind: expected one of {', '.join(_KINDS)}, got {kind!r}")
    checked_keys(where, change, ["kind", *(_SURFACE if kind is None else _KINDS[kind])])
    if kind is None and not change:
        raise ValueError(f"{where}: expected a kind or a parameter, got an empty table")
    if kind == "emitter" and "radiance" not in change:
        raise ValueError(f"{where}: an emitter needs its radiance")
    for key, value in change.items():
        if key in ("alpha", "metallic", "transmission", "opacity"):
            checked_number(f"{where}: {key}", value, low=0, high=1)
        elif key == "eta":
            checked_number(f"{where}: {key}", value, low=1)
        elif key in ("thin", "coupled", "emits_back") and not isinstance(value, bool):
            raise ValueError(f"{where}: {key}: expected true or false, got {value!r}")
        elif key == "conductor":
            _conductor(f"{where}: {key}", value)
        elif key in ("colour", "attenuation", "emission", "radiance"):
            colour = _colour(f"{where}: {key}", value)
            if key == "colour" and max(colour) > 1:
                raise ValueError(f"{where}: colour: expected components from 0 to 1, got {value!r}")


def _changed(material: Material, change: dict[str, Any], source: str) -> Material:
    """The material after one change; a kind starts afresh but keeps colours and pictures where that makes sense."""
    values = {key: value for key, value in change.items() if key != "kind"}
    for key in ("colour", "attenuation", "emission", "radiance"):
        if key in values:
            values[key] = _colour(key, values[key])
    if "conductor" in values:
        values["conductor"] = _conductor("conductor", values["conductor"])
    kept = Material(
        material.name,
        base_colour=material.base_colour,
        base_colour_texture=material.base_colour_texture,
        normal_texture=material.normal_texture,
        normal_scale=material.normal_scale,
    )
    if "colour" in values:
        values["base_colour"] = values.pop("colour")
        kept = kept.replace(base_colour_texture=None)
    makers: dict[str | None, Callable[[], Material]] = {
        None: lambda: _with_parameters(material, values),
        "mirror": lambda: mirror(material.name, colour=values.get("base_colour", (0.95, 0.95, 0.95))),
        "glossy": lambda: kept.replace(**{"alpha": 0.1, **values}),
        "glass": lambda: glass(material.name, colour=values.pop("base_colour", (1.0, 1.0, 1.0))).replace(**values),
        "matte": lambda: kept.replace(**{**vars(matte(material.name, kept.base_colour)), **_pictures(kept), **values}),
        "emitter": lambda: emitter(material.name, values.pop("radiance")).replace(**values),
    }
    try:
        return checked_material(makers[change.get("kind")]())
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from error


def _with_parameters(material: Material, values: dict[str, Any]) -> Material:
    """The material with some parameters set; a texture that would multiply one of them is dropped."""
    dropped = {"base_colour": "base_colour_texture", "emission": "emission_texture"}
    dropped |= {"alpha": "metallic_roughness_texture", "metallic": "metallic_roughness_texture"}
    dropped |= {"opacity": "opacity_texture"}
    return material.replace(**values, **{dropped[key]: None for key in values if key in dropped})


def _pictures(material: Material) -> dict[str, Any]:
    return {name: getattr(material, name) for name in ("base_colour_texture", "normal_texture", "normal_scale")}


def _matches(overrides: Overrides, table: str, names: list[str]) -> list[list[dict[str, Any]]]:
    """For each name, the changes whose name or pattern matches it, in file order."""
    result: list[list[dict[str, Any]]] = [[] for _ in names]
    for pattern, change in getattr(overrides, table).items():
        hits = [i for i, name in enumerate(names) if name == pattern]
        hits = hits or [i for i, name in enumerate(names) if fnmatch.fnmatchcase(name, pattern)]
        if not hits:
            existing = list(dict.fromkeys(names))
            listed = ", ".join(existing[:_SHOWN]) + (f" and {len(existing) - _SHOWN} more" * (len(existing) > _SHOWN))
            raise SceneError(f"{overrides.source}: {table}.{pattern} matches nothing; there are {listed}")
        for i in hits:
            result[i].append(change)
    return result


def _conductor(name: str, value: Any) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
    """A complex index `{ eta = ..., k = ... }`, each one number or three; false takes it away."""
    if value is False:
        return None
    if not isinstance(value, dict) or value.keys() != {"eta", "k"}:
        raise ValueError(f"{name}: expected {{ eta = ..., k = ... }} or false, got {value!r}")
    return _colour(f"{name}: eta", value["eta"]), _colour(f"{name}: k", value["k"])


def _colour(name: str, value: Any) -> tuple[float, float, float]:
    """A colour from one number or three."""
    colour = checked_array(name, [value] * 3 if isinstance(value, int | float) else value, (3,))
    if (colour < 0).any():
        raise ValueError(f"{name}: expected components >= 0, got {value!r}")
    red, green, blue = np.asarray(colour, float).tolist()
    return red, green, blue
