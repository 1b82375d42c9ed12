"""`Description` -> `Scene`: the only place where host-side scene data becomes JAX arrays.

Order: check the parts, drop triangles without an area, number materials and objects, merge, add textures and lights,
find the features.
"""

import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Mesh, Names, Scene
from jaxrefl.scene.description import Description
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.features import find_features
from jaxrefl.scene.lights import build_lights
from jaxrefl.scene.materials import distinct_materials, material_table
from jaxrefl.scene.meshes import Merged, merge
from jaxrefl.scene.parts import checked_part, without_degenerate_triangles
from jaxrefl.scene.textures import build_textures


def assemble(description: Description) -> Scene:
    """A scene as arrays.

    Args:
        description: Parts in world space, lights, sky, cameras and notes.
    Returns:
        The scene. Objects and materials are numbered in order of first use; parts with the same name are one object.
    Raises:
        SceneError: If there is no triangle, an array has the wrong shape, an index is out of range, a position is NaN
            or infinite, or a material parameter is out of range; names the object or material.
    Edge cases: triangles without an area are left out and counted in `scene.names.notes`; fields that no part uses
        (normals, uv, tangents, colours) are None.
    """
    notes = list(description.notes)
    parts = without_degenerate_triangles([checked_part(part) for part in description.parts], notes)
    if not parts:
        raise SceneError(f"scene {description.name!r}: expected at least one triangle with an area, got none")
    table, material_rows = distinct_materials([part.material for part in parts])
    materials, images = material_table(table)
    if see_through := [m.name for m in table if m.opacity < 1 or m.opacity_texture is not None]:
        names = ", ".join(see_through)
        notes.append(f"cut-outs let path traced light through alone; images see them as opaque: {names}")
    objects = list(dict.fromkeys(part.name for part in parts))
    object_rows = [objects.index(part.name) for part in parts]
    mesh = _as_mesh(merge(parts, material_rows, object_rows, notes, textured=bool(images)))
    textures = build_textures(images) if images else None
    lights = build_lights(description, mesh, materials, textures=textures)
    vertices = np.asarray(mesh.vertices)
    return Scene(
        mesh=mesh,
        materials=materials,
        lights=lights,
        textures=textures,
        lower=jnp.asarray(vertices.min(0), jnp.float32),
        upper=jnp.asarray(vertices.max(0), jnp.float32),
        cameras=tuple(description.cameras.values()),
        features=find_features(mesh, materials, lights),
        names=Names(
            scene=description.name,
            objects=tuple(objects),
            materials=tuple(m.name for m in table),
            cameras=tuple(description.cameras),
            notes=tuple(notes),
        ),
    )


def _as_mesh(merged: Merged) -> Mesh:
    def optional(array: np.ndarray | None):
        return None if array is None else jnp.asarray(array)

    return Mesh(
        vertices=jnp.asarray(merged.vertices),
        faces=jnp.asarray(merged.faces),
        material=jnp.asarray(merged.material),
        object=jnp.asarray(merged.object),
        normals=optional(merged.normals),
        uv=optional(merged.uv),
        tangents=optional(merged.tangents),
        colours=optional(merged.colours),
    )
