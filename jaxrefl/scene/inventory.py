"""What is in a scene, for people: numbers, names, parameters, lights, features with their reasons, memory.

Input: a `Scene`. Output of `inventory`: plain Python values (JSON can hold them); of `format_inventory`: text.
"""

from typing import Any

import jax
import numpy as np

from jaxrefl._types import Conductors, Lights, Scene
from jaxrefl.scene.features import feature_reasons, reflective_materials

_SHOWN = 40
_IMAGES = (
    "base_colour_texture",
    "metallic_roughness_texture",
    "normal_texture",
    "emission_texture",
    "opacity_texture",
)


def inventory(scene: Scene) -> dict[str, Any]:
    """What is in a scene.

    Args:
        scene: Any scene.
    Returns:
        `name`, `triangles`, `vertices`, `bounds` (lower, upper, diagonal), `objects` (name, triangles, materials),
        `materials` (name, triangles and every parameter; rare ones only in scenes that have them), `lights`, `cameras`,
        `textures`, `features` (reason by name), `absent` features, `memory` (bytes by group, and their total) and
        `notes`.
    """
    mesh = scene.mesh
    lower, upper = np.asarray(scene.lower, float), np.asarray(scene.upper, float)
    reasons = feature_reasons(scene)
    return {
        "name": scene.names.scene,
        "triangles": int(mesh.faces.shape[0]),
        "vertices": int(mesh.vertices.shape[0]),
        "bounds": {
            "lower": lower.tolist(),
            "upper": upper.tolist(),
            "diagonal": float(np.linalg.norm(upper - lower)),
        },
        "objects": _objects(scene),
        "materials": _materials(scene),
        "lights": _lights(scene.lights),
        "cameras": [
            {"name": name, "width": camera.width, "height": camera.height, "fov_y": _fov_y(camera)}
            for name, camera in zip(scene.names.cameras, scene.cameras, strict=True)
        ],
        "textures": _textures(scene),
        "features": reasons,
        "absent": [name for name in vars(scene.features) if name not in reasons],
        "memory": _memory(scene),
        "notes": list(scene.names.notes),
    }


def format_inventory(data: dict[str, Any]) -> str:
    """The inventory as text for a terminal.

    Args:
        data: What `inventory` returned.
    Returns:
        Lines of text without colours; long lists are cut after 40 entries with a count of the rest.
    """
    bounds = data["bounds"]
    lines = [
        f"{data['name']}: {data['triangles']:,} triangles, {data['vertices']:,} vertices",
        f"bounds     {_vector(bounds['lower'])} to {_vector(bounds['upper'])}, diagonal {bounds['diagonal']:.4g}",
    ]
    objects = [f"  {o['name']}: {o['triangles']:,} triangles, {', '.join(o['materials'])}" for o in data["objects"]]
    cameras = [f"  {c['name']}: {c['width']}x{c['height']}, {c['fov_y']:.3g} degrees high" for c in data["cameras"]]
    textures = [f"  {t['width']}x{t['height']}, {t['coding']}" for t in data["textures"]]
    features = [f"  {name}: {reason}" for name, reason in data["features"].items()]
    memory = [f"  {name}: {size / 2**20:.2f} MiB" for name, size in data["memory"].items()]
    sections = {
        "objects": objects,
        "materials": [_material_line(m) for m in data["materials"]],
        "lights": [f"  {light}" for light in data["lights"]],
        "cameras": cameras,
        "textures": textures,
        "features": features,
        "memory": memory,
        "notes": [f"  {note}" for note in data["notes"]],
    }
    for name, entries in sections.items():
        lines.append(f"{name} ({len(entries)})" if name not in ("features", "memory") else name)
        lines += entries[:_SHOWN]
        if len(entries) > _SHOWN:
            lines.append(f"  ... and {len(entries) - _SHOWN} more")
    if data["absent"]:
        lines.append(f"switched off: {', '.join(data['absent'])}")
    return "\n".join(lines)


def _objects(scene: Scene) -> list[dict[str, Any]]:
    owner, material = np.asarray(scene.mesh.object), np.asarray(scene.mesh.material)
    counts = np.bincount(owner, minlength=len(scene.names.objects))
    used: dict[int, list[str]] = {}
    size = len(scene.names.materials)
    for pair in np.unique(owner.astype(np.int64) * size + material):
        used.setdefault(int(pair) // size, []).append(scene.names.materials[int(pair) % size])
    return [
        {"name": name, "triangles": int(counts[i]), "materials": used.get(i, [])}
        for i, name in enumerate(scene.names.objects)
    ]


def _materials(scene: Scene) -> list[dict[str, Any]]:
    table = scene.materials
    counts = np.bincount(np.asarray(scene.mesh.material), minlength=len(scene.names.materials))
    reflective = reflective_materials(table)
    plain = {n: v for n, v in vars(table).items() if n not in ("textured", "conductor") and v is not None}
    columns = {name: np.asarray(value) for name, value in plain.items()}
    return [
        {"name": name, "triangles": int(counts[i]), "reflective": bool(reflective[i])}
        | {column: values[i].tolist() for column, values in columns.items()}
        | _conductor(table.conductor, i)
        for i, name in enumerate(scene.names.materials)
    ]


def _conductor(table: Conductors | None, row: int) -> dict[str, Any]:
    """Complex index of one material, where it has one."""
    if table is None or not bool(table.known[row]):
        return {}
    return {"conductor": {name: np.asarray(getattr(table, name)[row]).tolist() for name in ("eta", "k")}}


def _material_line(material: dict[str, Any]) -> str:
    """One line with the parameters that say something; textures by their number."""
    words = [f"colour {_vector(material['base_colour'])}"]
    if material["reflective"]:
        words += [f"metallic {material['metallic']:.3g}", f"alpha {material['alpha']:.3g}"]
        words += [f"index {material['eta']:.4g}"] if material["metallic"] < 1 else []
    else:
        words.append("matte")
    if material["transmission"] > 0:
        words.append(f"transmission {material['transmission']:.3g}{' (thin)' if material['thin'] else ''}")
    if max(material["attenuation"]) > 0:
        words.append(f"absorption {_vector(material['attenuation'])}")
    if max(material["emission"]) > 0:
        side = "" if material.get("emits_back", True) else " (front)"
        words.append(f"emission {_vector(material['emission'])}{side}")
    if "conductor" in material:
        eta, k = (_vector(material["conductor"][name]) for name in ("eta", "k"))
        words.append(f"complex index {eta} + i {k}")
    words += ["coupled"] if material.get("coupled", False) else []
    words += [f"opacity {material['opacity']:.3g}"] if material.get("opacity", 1) < 1 else []
    images = [f"{slot.removesuffix('_texture')} {material[slot]}" for slot in _IMAGES if material.get(slot, -1) >= 0]
    words += [f"textures: {', '.join(images)}"] if images else []
    return f"  {material['name']}: {', '.join(words)}; {material['triangles']:,} triangles"


def _lights(lights: Lights) -> list[str]:
    """One sentence per kind of light, and one per punctual light."""
    found = []
    if lights.area is not None:
        count, area = lights.area.triangle.shape[0], float(np.asarray(lights.area.area, np.float64).sum())
        found.append(f"{count} emissive triangles of {area:.4g} square units")
    if lights.punctual is not None:
        p = lights.punctual
        rows = zip(
            np.asarray(p.directional), np.asarray(p.cos_outer), np.asarray(p.intensity), np.asarray(p.position),
            np.asarray(p.direction), strict=True,
        )  # fmt: skip
        for directional, cos_outer, intensity, position, direction in rows:
            if directional:
                found.append(f"sun of irradiance {_vector(intensity)} along {_vector(direction)}")
            else:
                kind = "point" if cos_outer < -1 else "spot"
                found.append(f"{kind} light of intensity {_vector(intensity)} at {_vector(position)}")
    if lights.environment is not None:
        radiance = np.asarray(lights.environment.radiance)
        h, w = radiance.shape[:2]
        if h == w == 1:
            found.append(f"constant sky of radiance {_vector(radiance[0, 0])}")
        else:
            found.append(f"environment map of {w}x{h} texels, maximum {radiance.max():.4g}")
    if np.asarray(lights.ambient).max() > 0:
        found.append(f"ambient radiance {_vector(lights.ambient)}")
    return found


def _textures(scene: Scene) -> list[dict[str, Any]]:
    if scene.textures is None:
        return []
    t = scene.textures
    rows = zip(np.asarray(t.width), np.asarray(t.height), np.asarray(t.srgb), strict=True)
    return [{"width": int(w), "height": int(h), "coding": "sRGB" if srgb else "linear"} for w, h, srgb in rows]


def _memory(scene: Scene) -> dict[str, int]:
    groups = {name: getattr(scene, name) for name in ("mesh", "materials", "textures", "lights")}
    sizes = {name: sum(leaf.nbytes for leaf in jax.tree.leaves(value)) for name, value in groups.items()}
    return sizes | {"total": sum(sizes.values())}


def _fov_y(camera) -> float:
    return float(np.degrees(2 * np.arctan(0.5 * camera.height / float(camera.focal[1]))))


def _vector(values) -> str:
    return "(" + ", ".join(f"{float(v):.4g}" for v in np.asarray(values)) + ")"
