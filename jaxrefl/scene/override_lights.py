"""Lights, sky and cameras of an override file.

All positions and directions are in world space, that is after `units` and `up`.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxrefl._types import Camera
from jaxrefl._validate import checked_array, checked_keys, checked_number
from jaxrefl.core.cameras import look_at
from jaxrefl.scene.description import PunctualLight, Sky, constant_sky
from jaxrefl.scene.images import read_radiance

_LIGHTS = {
    "point": ["position", "intensity"],
    "spot": ["position", "direction", "intensity", "inner_angle", "outer_angle"],
    "sun": ["direction", "irradiance", "angular_radius"],
}
_CAMERA = ["name", "eye", "target", "up", "fov_y", "size"]


@dataclass(frozen=True)
class SkySettings:
    """Light from infinitely far away, before any file is read."""

    colour: tuple[float, float, float] | None = None
    """Radiance of a constant sky."""
    file: Path | None = None
    """Environment map, `.hdr` or `.exr`."""
    scale: float = 1.0
    """Factor on the map's radiance."""
    rotation: float = 0.0
    """Degrees by which the map is turned around +Y, counter-clockwise seen from above."""

    def build(self) -> Sky | None:
        """The sky; None if neither a colour nor a file is set. Reads the file."""
        if self.colour is not None:
            return constant_sky(self.colour)
        if self.file is None:
            return None
        return environment_sky(self.file, scale=self.scale, rotation=self.rotation)


def environment_sky(path: str | Path, *, scale: float = 1.0, rotation: float = 0.0) -> Sky:
    """An environment map as a sky.

    Args:
        path: Latitude-longitude image, `.hdr` or `.exr`; row 0 up, the middle column along -Z.
        scale: Factor on the radiance, >= 0.
        rotation: Degrees around +Y, counter-clockwise seen from above.
    Returns:
        The sky.
    Raises:
        ValueError: If the file cannot be read.
    """
    s, c = math.sin(math.radians(rotation)), math.cos(math.radians(rotation))
    world_from_map = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return Sky(read_radiance(path) * np.float32(scale), world_from_map, name=Path(path).name)


def read_sky(data: dict[str, Any], folder: Path) -> SkySettings:
    """The keys `sky`, `environment`, `environment_scale` and `environment_rotation`.

    Args:
        data: The whole override file.
        folder: Where relative paths start.
    Returns:
        The settings.
    Raises:
        ValueError: If both a sky and an environment are given, or a value is out of range.
    """
    if "sky" in data and "environment" in data:
        raise ValueError("sky, environment: expected one of the two, got both")
    if "environment" not in data and {"environment_scale", "environment_rotation"} & data.keys():
        raise ValueError("environment_scale, environment_rotation: these need an environment")
    if "sky" in data:
        return SkySettings(colour=_radiance("sky", data["sky"]))
    if "environment" not in data:
        return SkySettings()
    if not isinstance(data["environment"], str):
        raise ValueError(f"environment: expected a path, got {data['environment']!r}")
    return SkySettings(
        file=folder / data["environment"],
        scale=checked_number("environment_scale", data.get("environment_scale", 1.0), low=0),
        rotation=checked_number("environment_rotation", data.get("environment_rotation", 0.0)),
    )


def read_lights(tables: Any) -> list[PunctualLight]:
    """The `[[lights]]` of an override file.

    Args:
        tables: One table per light with `type` "point", "spot" or "sun".
    Returns:
        The lights.
    Raises:
        ValueError: If a key is unknown or missing or a value is out of range; names the light by its number.
    """
    return [_light(f"lights[{i}]", table) for i, table in enumerate(_tables("lights", tables))]


def read_cameras(tables: Any) -> dict[str, Camera]:
    """The `[[cameras]]` of an override file.

    Args:
        tables: One table per camera with `eye`, `target` and, if wanted, `name`, `up`, `fov_y` (degrees) and `size`.
    Returns:
        Cameras by name.
    Raises:
        ValueError: If a key is unknown or missing, or the values span no camera frame; names the camera by its number.
    """
    cameras: dict[str, Camera] = {}
    for i, table in enumerate(_tables("cameras", tables)):
        where = f"cameras[{i}]"
        checked_keys(where, table, _CAMERA)
        _require(where, table, ["eye", "target"])
        vectors = {key: checked_array(f"{where}: {key}", table[key], (3,)) for key in ("eye", "target")}
        up = checked_array(f"{where}: up", table.get("up", [0, 1, 0]), (3,))
        size = checked_array(f"{where}: size", table.get("size", [960, 540]), (2,), dtype=np.int64)
        fov_y = checked_number(f"{where}: fov_y", table.get("fov_y", 45.0))
        name = str(table.get("name", f"camera {i}"))
        if name in cameras:
            raise ValueError(f"{where}: the name {name!r} is taken by another camera")
        try:
            width, height = (int(s) for s in size)
            cameras[name] = look_at(vectors["eye"], vectors["target"], up=up, fov_y=fov_y, size=(width, height))
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error
    return cameras


def _light(where: str, table: dict[str, Any]) -> PunctualLight:
    kind = table.get("type")
    if kind not in _LIGHTS:
        raise ValueError(f"{where}: type: expected one of {', '.join(_LIGHTS)}, got {kind!r}")
    checked_keys(where, table, ["type", "name", *_LIGHTS[kind]])
    strength = "irradiance" if kind == "sun" else "intensity"
    _require(where, table, [strength, "direction" if kind == "sun" else "position"])
    name, light = str(table.get("name", kind)), _radiance(f"{where}: {strength}", table[strength])
    direction = _triple(f"{where}: direction", table.get("direction", [0, -1, 0]))
    length = math.hypot(*direction)
    if length == 0:
        raise ValueError(f"{where}: direction: expected a vector that is not zero, got {table['direction']!r}")
    x, y, z = (d / length for d in direction)
    if kind == "sun":
        radius = checked_number(f"{where}: angular_radius", table.get("angular_radius", 0.0), low=0, high=90)
        return PunctualLight(name, light, direction=(x, y, z), directional=True, angular_radius=math.radians(radius))
    position = _triple(f"{where}: position", table["position"])
    if kind == "point":
        return PunctualLight(name, light, position=position)
    outer = checked_number(f"{where}: outer_angle", table.get("outer_angle", 45.0), low=0, high=90)
    inner = checked_number(f"{where}: inner_angle", table.get("inner_angle", 0.0), low=0, high=outer)
    return PunctualLight(
        name,
        light,
        position=position,
        direction=(x, y, z),
        cos_inner=math.cos(math.radians(inner)),
        cos_outer=math.cos(math.radians(outer)),
    )


def _tables(key: str, tables: Any) -> list[dict[str, Any]]:
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ValueError(f"{key}: expected tables [[{key}]], got {tables!r}")
    return tables


def _require(where: str, table: dict[str, Any], keys: list[str]) -> None:
    missing = [key for key in keys if key not in table]
    if missing:
        raise ValueError(f"{where}: needs {', '.join(missing)}")


def _triple(name: str, value: Any) -> tuple[float, float, float]:
    x, y, z = checked_array(name, value, (3,)).tolist()
    return x, y, z


def _radiance(name: str, value: Any) -> tuple[float, float, float]:
    """A colour from one number or three, all >= 0."""
    red, green, blue = _triple(name, [value] * 3 if isinstance(value, int | float) else value)
    if min(red, green, blue) < 0:
        raise ValueError(f"{name}: expected components >= 0, got {value!r}")
    return red, green, blue
