"""Materials of a description -> the `Materials` table and the list of texture images it points at.

Input: host-side `Material`s. Output: one row per distinct material, in order of first use.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Conductors, Materials
from jaxrefl._validate import checked_array, checked_number
from jaxrefl.scene.description import Image, Material
from jaxrefl.scene.errors import SceneError

_TEXTURES = {
    "base_colour_texture": True,
    "metallic_roughness_texture": False,
    "normal_texture": False,
    "emission_texture": True,
    "opacity_texture": False,
}
"""Texture slots of a material and whether their colours are sRGB-coded."""


def distinct_materials(materials: list[Material]) -> tuple[list[Material], list[int]]:
    """Materials without repetitions, each under a name of its own.

    Args:
        materials: One per part, in order.
    Returns:
        The distinct materials and, for each given one, its row among them.
    Edge cases: different materials under one name keep it with " (2)", " (3)" ... behind it.
    """
    rows: dict[tuple, int] = {}
    table: list[Material] = []
    index = []
    for material in materials:
        key = _key(material)
        if key not in rows:
            rows[key] = len(table)
            table.append(material)
        index.append(rows[key])
    names = unique_names([m.name for m in table])
    return [m.replace(name=name) for m, name in zip(table, names, strict=True)], index


def unique_names(names: list[str]) -> list[str]:
    """The names with " (2)", " (3)" ... behind those that came before.

    Args:
        names: Any names.
    Returns:
        As many distinct names; the first of each keeps its own.
    """
    taken, seen = set(names), dict.fromkeys(names, 0)
    result = []
    for name in names:
        seen[name] += 1
        if seen[name] == 1:
            result.append(name)
            continue
        number = seen[name]
        while (candidate := f"{name} ({number})") in taken:
            number += 1
        taken.add(candidate)
        result.append(candidate)
    return result


def checked_material(material: Material) -> Material:
    """Refuse a material that is not physically meaningful.

    Args:
        material: Any material.
    Returns:
        The same material.
    Raises:
        SceneError: If a parameter is not a finite number in its range; names the material and the parameter.
    """
    try:
        for field in ("metallic", "alpha", "transmission", "opacity"):
            checked_number(field, getattr(material, field), low=0, high=1)
        checked_number("eta", material.eta, low=1)
        checked_number("normal_scale", material.normal_scale)
        for field, high in (("base_colour", 1.0), ("attenuation", np.inf), ("emission", np.inf)):
            colour = checked_array(field, getattr(material, field), (3,))
            if (colour < 0).any() or (colour > high).any():
                limit = "from 0 to 1" if high == 1 else ">= 0"
                raise ValueError(f"{field}: expected components {limit}, got {tuple(colour.tolist())}")
        if material.conductor is not None and (checked_array("conductor", material.conductor, (2, 3)) < 0).any():
            raise ValueError(f"conductor: expected components >= 0, got {material.conductor}")
    except ValueError as error:
        raise SceneError(f"material {material.name!r}: {error}") from error
    return material


def material_table(materials: list[Material]) -> tuple[Materials, list[tuple[Image, bool]]]:
    """Arrays for the renderer, one row per material.

    Args:
        materials: Distinct materials.
    Returns:
        The table, and the images its texture columns point at, each with True if its colours are sRGB-coded.
    Raises:
        SceneError: If a parameter is out of range.
    """
    for material in materials:
        checked_material(material)
    images: dict[tuple, int] = {}
    pool: list[tuple[Image, bool]] = []

    def row(image: Image | None, srgb: bool) -> int:
        if image is None:
            return -1
        key = (id(image.rgba), image.repeat, srgb)
        if key not in images:
            images[key] = len(pool)
            pool.append((image, srgb))
        return images[key]

    rows = {slot: [row(getattr(m, slot), srgb) for m in materials] for slot, srgb in _TEXTURES.items()}
    used = tuple(slot for slot, column in rows.items() if max(column) >= 0)
    opacity = rows.pop("opacity_texture")
    textures = {slot: jnp.asarray(column, jnp.int32) for slot, column in rows.items()}
    numbers = {
        name: jnp.asarray([getattr(m, name) for m in materials], jnp.float32)
        for name in ("base_colour metallic alpha eta transmission attenuation emission normal_scale".split())
    }
    thin = jnp.asarray([m.thin for m in materials], bool)
    return Materials(thin=thin, **numbers, **textures, **_rare_columns(materials, opacity), textured=used), pool


def _rare_columns(materials: list[Material], opacity_rows: list[int]) -> dict[str, Any]:
    """Columns that are None unless some material needs them."""
    columns: dict[str, Any] = {}
    if not all(m.emits_back for m in materials):
        columns["emits_back"] = jnp.asarray([m.emits_back for m in materials], bool)
    if any(m.conductor is not None for m in materials):
        index = np.array([m.conductor or ((0, 0, 0), (1, 1, 1)) for m in materials], np.float32)
        known = jnp.asarray([m.conductor is not None for m in materials], bool)
        columns["conductor"] = Conductors(known, jnp.asarray(index[:, 0]), jnp.asarray(index[:, 1]))
    if any(m.coupled for m in materials):
        columns["coupled"] = jnp.asarray([m.coupled for m in materials], bool)
    if any(m.opacity < 1 or m.opacity_texture is not None for m in materials):
        columns["opacity"] = jnp.asarray([m.opacity for m in materials], jnp.float32)
        columns["opacity_texture"] = jnp.asarray(opacity_rows, jnp.int32)
    return columns


def _key(material: Material) -> tuple:
    """What makes two materials the same: equal parameters and the very same images."""
    values = []
    for field in dataclasses.fields(material):
        value = getattr(material, field.name)
        if isinstance(value, Image):
            value = (id(value.rgba), value.repeat)
        elif isinstance(value, list | tuple | np.ndarray):
            value = tuple(np.ravel(value).tolist())
        values.append(value)
    return tuple(values)
