"""What a scene contains, decided once on the host, so that nothing is traced or stored for what it does not."""

import dataclasses

import numpy as np

from jaxrefl._types import Features, Lights, Materials, Mesh, Scene
from jaxrefl.scene.normals import FLAT_COSINE, face_normals

PLANAR_SHARE = 0.01
"""A plane is a planar reflector of its own if it holds this share of its object's reflective area."""


def find_features(mesh: Mesh, materials: Materials, lights: Lights) -> Features:
    """Which features a scene has.

    Args:
        mesh: Geometry.
        materials: Material table.
        lights: Everything that emits.
    Returns:
        The features; `moving` is False: a file holds one moment.
    """
    owners = _feature_triangles(mesh, materials)
    on = {name: bool(mask.any()) for name, mask in owners.items()}
    return Features(
        punctual=lights.punctual is not None,
        environment_lit=lights.environment is not None,
        vertex_coloured=mesh.colours is not None,
        **on,
    )


def feature_reasons(scene: Scene) -> dict[str, str]:
    """Why each feature of a scene is on.

    Args:
        scene: Any scene.
    Returns:
        One sentence per feature that is on, in the order of `Features`.
    """
    masks = _feature_triangles(scene.mesh, scene.materials)
    by_object = {"planar", "curved"}
    reasons = {}
    for field in dataclasses.fields(Features):
        name = field.name
        if not getattr(scene.features, name):
            continue
        if name in masks:
            owner = scene.mesh.object if name in by_object else scene.mesh.material
            names = scene.names.objects if name in by_object else scene.names.materials
            rows = np.unique(np.asarray(owner)[masks[name]])
            kind = "object" if name in by_object else "material"
            reasons[name] = _listed(kind, [names[row] for row in rows])
        elif name == "punctual" and scene.lights.punctual is not None:
            reasons[name] = f"{scene.lights.punctual.position.shape[0]} point, spot or directional lights"
        elif name == "environment_lit" and scene.lights.environment is not None:
            h, w = scene.lights.environment.radiance.shape[:2]
            reasons[name] = "a constant sky" if h == w == 1 else f"an environment map of {w}x{h} texels"
        elif name == "vertex_coloured":
            reasons[name] = "vertices carry colours"
        else:
            reasons[name] = "set by whoever made the scene"
    return reasons


def reflective_materials(materials: Materials) -> np.ndarray:
    """Which materials have a specular lobe.

    Args:
        materials: Material table.
    Returns:
        [m] True where the material is a metal, or a dielectric whose index is not 1, or is textured in metalness.
    """
    textured = np.asarray(materials.metallic_roughness_texture) >= 0
    return (np.asarray(materials.metallic) > 0) | (np.asarray(materials.eta) != 1) | textured


def planar_triangles(mesh: Mesh, reflective: np.ndarray) -> np.ndarray:
    """Which reflective triangles belong to a planar reflector.

    A triangle does if its shading normals agree with its face normal, and the triangles of the same object in the same
    plane hold at least 1 % of the object's reflective area: the faces of a box do, the facets of a sphere do not.

    Args:
        mesh: Geometry.
        reflective: [f] True for triangles that reflect.
    Returns:
        [f] True for triangles of planar reflectors.
    Edge cases: planes are told apart by rounded coefficients (normal to 1/2048, offset to 1/4096 of the scene's
        diagonal), so a plane on a rounding boundary may be split in two.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    planar = np.zeros(len(faces), bool)
    rows = np.flatnonzero(reflective)
    if not len(rows):
        return planar
    faces = faces[rows]
    normals, areas = face_normals(vertices, faces)
    flat = np.ones(len(rows), bool)
    if mesh.normals is not None:
        shading = np.asarray(mesh.normals)[faces]
        flat = ((shading * normals[:, None]).sum(-1) >= FLAT_COSINE).all(1)
    owner = np.asarray(mesh.object)[rows]
    total = np.bincount(owner, areas)
    lower, upper = vertices.min(0), vertices.max(0)
    diagonal = max(float(np.linalg.norm(upper - lower)), np.finfo(np.float32).tiny)
    offset = ((vertices[faces[:, 0]] - 0.5 * (lower + upper)) * normals).sum(1) / diagonal
    coefficients = [owner, *np.rint(normals.T * 2048), np.rint(offset * 4096)]
    plane = _group_numbers(np.stack([np.asarray(c, np.int64) for c in coefficients], 1)[flat])
    share = np.bincount(plane, areas[flat])[plane] / np.maximum(total[owner[flat]], np.finfo(float).tiny)
    planar[rows[flat]] = share >= PLANAR_SHARE
    return planar


def _feature_triangles(mesh: Mesh, materials: Materials) -> dict[str, np.ndarray]:
    """For each feature that comes from surfaces, the triangles that switch it on."""
    reflects = reflective_materials(materials)
    alpha, roughness = np.asarray(materials.alpha), np.asarray(materials.metallic_roughness_texture)
    by_material = {
        "glossy": reflects & (alpha > 0),
        "refractive": np.asarray(materials.transmission) > 0,
        "textured": (np.asarray(materials.base_colour_texture) >= 0)
        | (roughness >= 0)
        | (np.asarray(materials.emission_texture) >= 0),
        "normal_mapped": np.asarray(materials.normal_texture) >= 0,
        "emissive": (np.asarray(materials.emission) > 0).any(1),
    }
    if materials.conductor is not None:
        by_material["conductive"] = np.asarray(materials.conductor.known)
    if materials.coupled is not None:
        by_material["coupled"] = np.asarray(materials.coupled)
    if materials.opacity is not None:
        by_material["cut_out"] = (np.asarray(materials.opacity) < 1) | (np.asarray(materials.opacity_texture) >= 0)
    row = np.asarray(mesh.material)
    reflective = reflects[row]
    planar = planar_triangles(mesh, reflective)
    masks = {"planar": planar, "curved": reflective & ~planar}
    return masks | {name: mask[row] for name, mask in by_material.items()}


def _group_numbers(keys: np.ndarray) -> np.ndarray:
    """Number of the group of equal rows that each row belongs to."""
    order = np.lexsort(keys.T)
    ordered = keys[order]
    new = np.ones(len(ordered), bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(1)
    number = np.empty(len(keys), np.int64)
    number[order] = np.cumsum(new) - 1
    return number


def _listed(kind: str, names: list[str]) -> str:
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return f"{kind}{'s' if len(names) > 1 else ''} {shown}"
