"""Scene files -> `Scene`: the entry points `load` and `describe_file`.

Order: read the file, drop triangles that cannot be rendered, add normals where there are none, bring units and axes to
the world's, apply overrides, make sure there is light, assemble. Whatever was assumed, changed or ignored on the way is
a note in `scene.names.notes` and one `SceneWarning`.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxrefl._types import Scene
from jaxrefl._validate import checked_number
from jaxrefl.scene.assemble import assemble
from jaxrefl.scene.description import Description, constant_sky
from jaxrefl.scene.errors import SceneError, warn_notes
from jaxrefl.scene.gltf import describe_gltf
from jaxrefl.scene.obj import describe_obj
from jaxrefl.scene.override_lights import environment_sky
from jaxrefl.scene.overrides import apply_overrides, find_overrides, read_overrides
from jaxrefl.scene.parts import (
    note_normals,
    with_smooth_normals,
    without_broken_triangles,
    without_degenerate_triangles,
)
from jaxrefl.scene.placement import placed
from jaxrefl.scene.ply_stl import describe_ply, describe_stl

CREASE_ANGLE = 40.0
"""Default crease angle in degrees: edges of spheres with 18 segments and more are smooth, those of boxes sharp."""

DEFAULT_SKY = (1.0, 1.0, 1.0)
"""Radiance of the constant sky of scenes without any light."""


def _describe_mitsuba(path: Path) -> Description:
    """`describe_mitsuba`, imported only when such a file is read."""
    from jaxrefl.scene.mitsuba import describe_mitsuba

    return describe_mitsuba(path)


_READERS: dict[str, Callable[[Path], Description]] = {
    ".gltf": describe_gltf,
    ".glb": describe_gltf,
    ".obj": describe_obj,
    ".ply": describe_ply,
    ".stl": describe_stl,
    ".xml": _describe_mitsuba,
}


def load(
    path: str | Path,
    *,
    overrides: str | Path | dict[str, Any] | None = None,
    environment: str | Path | None = None,
    up: str | None = None,
    units: float | None = None,
    crease_angle: float | None = None,
) -> Scene:
    """The scene in a file, ready to render.

    Args:
        path: A `.gltf`, `.glb`, `.obj`, `.ply`, `.stl` or Mitsuba `.xml` file.
        overrides: TOML file, or the same keys in a dictionary; None looks for `NAME.jaxrefl.toml` beside the file, and
            an empty dictionary does not.
        environment: Latitude-longitude map, `.hdr` or `.exr`, that lights the scene; replaces that of the overrides.
        up: Axis of the file that points up: "x", "y", "z", "-x", "-y" or "-z"; None: the overrides', or "y".
        units: World units per unit of the file, > 0; None: the overrides', or 1.
        crease_angle: Degrees in [0, 180] up to which edges of meshes without normals are smooth; None: the overrides',
            or 40.
    Returns:
        The scene.
    Raises:
        SceneError: If the file is missing, broken, of an unknown format or empty, or an override does not fit.
    Edge cases: a scene without light gets a constant sky of radiance 1. Emission from a texture does not count as
        light there: it is mostly small lamps on a dark object.
    """
    description = describe_file(
        path, overrides=overrides, environment=environment, up=up, units=units, crease_angle=crease_angle
    )
    scene = assemble(description)
    warn_notes(list(scene.names.notes), Path(path).name)
    return scene


def describe_file(
    path: str | Path,
    *,
    overrides: str | Path | dict[str, Any] | None = None,
    environment: str | Path | None = None,
    up: str | None = None,
    units: float | None = None,
    crease_angle: float | None = None,
) -> Description:
    """The scene in a file as host-side data that can still be edited; `assemble` makes a `Scene` of it.

    Args:
        path: A `.gltf`, `.glb`, `.obj`, `.ply`, `.stl` or Mitsuba `.xml` file.
        overrides: As for `load`.
        environment: As for `load`.
        up: As for `load`.
        units: As for `load`.
        crease_angle: As for `load`.
    Returns:
        The description, in world space, with every change applied; its notes say what was assumed.
    Raises:
        SceneError: As for `load`.
    """
    path = Path(path)
    found = find_overrides(path) if overrides is None else overrides
    changes = read_overrides({} if found is None else found)
    try:
        angle = checked_number(
            "crease_angle", _first(crease_angle, changes.crease_angle, CREASE_ANGLE), low=0, high=180
        )
        description = _with_clean_parts(_read(path), angle)
        description = placed(description, units=_first(units, changes.units, 1.0), up=_first(up, changes.up, "y"))
        description = apply_overrides(description, changes)
        if environment is not None:
            description = dataclasses.replace(description, sky=environment_sky(environment))
    except SceneError:
        raise
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from error
    if not description.parts:
        raise SceneError(f"{path}: expected at least one triangle with an area, got none")
    return _with_light(description)


def _read(path: Path) -> Description:
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise SceneError(f"{path}: expected a {', '.join(_READERS)} file, got {path.suffix or 'no suffix'!r}")
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise SceneError(f"{path}: expected a file, got a folder")
        if size == 0:
            raise SceneError(f"{path}: the file is empty")
        return reader(path)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from error


def _with_clean_parts(description: Description, crease_angle: float) -> Description:
    notes = list(description.notes)
    parts = without_degenerate_triangles(without_broken_triangles(description.parts, notes), notes)
    note_normals(parts, notes)
    parts = with_smooth_normals(parts, crease_angle, notes)
    return dataclasses.replace(description, parts=parts, notes=notes)


def _with_light(description: Description) -> Description:
    """The description, with a constant sky if nothing else lights it."""
    emits = [part for part in description.parts if np.max(part.material.emission) > 0]
    lit = any(part.material.emission_texture is None for part in emits)
    if lit or description.sky is not None or description.lights or np.max(description.ambient) > 0:
        return description
    reason = "the only light is textured emission" if emits else "the scene has no light"
    note = f"{reason}; a constant sky of radiance {DEFAULT_SKY[0]:g} is added"
    return dataclasses.replace(description, sky=constant_sky(DEFAULT_SKY), notes=[*description.notes, note])


def _first(*values: Any) -> Any:
    return next(value for value in values if value is not None)
