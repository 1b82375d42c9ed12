"""Material parameters at hit points: tables, textures, normal maps.

What the scene does not have (`Scene.features`) is not looked up: an untextured scene compiles to table gathers alone.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Conductors, Hits, Scene
from jaxrefl.core import apart, cross, dot
from jaxrefl.core.safe import normalise
from jaxrefl.scene.textures import texture_rgba
from jaxrefl.surface.interpolate import interpolate


class MaterialSample(NamedTuple):
    """Material parameters at hit points; see `GBuffer` for units and fill values."""

    base_colour: Float[Array, "*b 3"]
    metallic: Float[Array, "*b"]
    alpha: Float[Array, "*b"]
    eta: Float[Array, "*b"]
    emission: Float[Array, "*b 3"] | None
    transmission: Float[Array, "*b"] | None
    conductor: Conductors | None
    coupled: Bool[Array, "*b"] | None
    opacity: Float[Array, "*b"] | None


def sample_material(
    scene: Scene, material: Int[Array, "*b"], corners: Int[Array, "*b 3"], uv: Float[Array, "*b 2"] | None, hits: Hits
) -> MaterialSample:
    """Material parameters with their textures and vertex colours applied.

    Args:
        scene: The scene.
        material: Material index of each hit, valid also where the hit is not.
        corners: Vertex indices of the triangle hit.
        uv: Texture coordinates of each hit; None in scenes without textures.
        hits: The hits [*b].
    Returns:
        The parameters, with fill values where the hit is not valid.
    Source: glTF 2.0 §3.9: textures multiply factors; roughness (G) is perceptual, so its square multiplies alpha.
    """
    table, valid = scene.materials, hits.valid
    base_colour = table.base_colour[material]
    metallic, alpha = table.metallic[material], table.alpha[material]
    emission = table.emission[material] if scene.features.emissive else None
    if "base_colour_texture" in table.textured:
        base_colour = base_colour * _texture(scene, table.base_colour_texture[material], uv)[..., :3]
    if "metallic_roughness_texture" in table.textured:
        packed = _texture(scene, table.metallic_roughness_texture[material], uv)
        metallic, alpha = metallic * packed[..., 2], alpha * packed[..., 1] ** 2
    if "emission_texture" in table.textured and emission is not None:
        emission = emission * _texture(scene, table.emission_texture[material], uv)[..., :3]
    if scene.features.vertex_coloured and scene.mesh.colours is not None:
        base_colour = base_colour * interpolate(scene.mesh.colours, corners, hits)
    transmission = table.transmission[material] if scene.features.refractive else None
    return MaterialSample(
        base_colour=jnp.where(valid[..., None], base_colour, 0),
        metallic=jnp.where(valid, metallic, 0),
        alpha=jnp.where(valid, alpha, 0),
        eta=jnp.where(valid, table.eta[material], 1),
        emission=None if emission is None else jnp.where(valid[..., None], emission, 0),
        transmission=None if transmission is None else jnp.where(valid, transmission, 0),
        conductor=_conductor(table.conductor, material, valid) if scene.features.conductive else None,
        coupled=valid & table.coupled[material] if scene.features.coupled and table.coupled is not None else None,
        opacity=_opacity(scene, material, uv, valid) if scene.features.cut_out else None,
    )


def _conductor(table: Conductors | None, material: Int[Array, "*b"], valid: Bool[Array, "*b"]) -> Conductors | None:
    if table is None:
        return None
    return Conductors(valid & table.known[material], table.eta[material], table.k[material])


def _opacity(
    scene: Scene, material: Int[Array, "*b"], uv: Float[Array, "*b 2"] | None, valid: Bool[Array, "*b"]
) -> Float[Array, "*b"] | None:
    table = scene.materials
    if table.opacity is None or table.opacity_texture is None:
        return None
    opacity = table.opacity[material]
    if "opacity_texture" in table.textured:
        opacity = opacity * _texture(scene, table.opacity_texture[material], uv)[..., 3]
    return jnp.where(valid, opacity, 1)


def _texture(scene: Scene, index: Int[Array, "*b"], uv: Float[Array, "*b 2"] | None) -> Float[Array, "*b 4"]:
    """Texture values; where no element has a texture there is no lookup."""
    textures = scene.textures
    if textures is None or uv is None:
        raise ValueError("scene: a material has a texture, but the scene has no textures or no texture coordinates")
    return apart(index >= 0, texture_rgba, textures, index, uv, fill=1.0)


def apply_normal_map(
    scene: Scene,
    ns: Float[Array, "*b 3"],
    material: Int[Array, "*b"],
    corners: Int[Array, "*b 3"],
    uv: Float[Array, "*b 2"],
    hits: Hits,
) -> Float[Array, "*b 3"]:
    """Shading normals tilted by the material's normal map.

    Args:
        scene: A scene with normal maps and tangents.
        ns: Interpolated unit normals.
        material: Material index of each hit.
        corners: Vertex indices of the triangle hit.
        uv: Texture coordinates of each hit.
        hits: The hits [*b].
    Returns:
        Unit normals; unchanged where the material has no normal map.
    Source: glTF 2.0 §3.9.3 (`2 rgb - 1`, x and y scaled) in the frame of the interpolated tangent.
    """
    if scene.textures is None or scene.mesh.tangents is None:
        return ns
    index = scene.materials.normal_texture[material]
    rgb = 2 * _texture(scene, index, uv)[..., :3] - 1
    scale = scene.materials.normal_scale[material]
    tangent = interpolate(scene.mesh.tangents, corners, hits)
    t = tangent[..., :3] - ns * dot(ns, tangent[..., :3])[..., None]
    t = normalise(t)
    handedness = jnp.where(tangent[..., 3] < 0, -1.0, 1.0)
    b = cross(ns, t) * handedness[..., None]
    tilted = t * (rgb[..., 0] * scale)[..., None] + b * (rgb[..., 1] * scale)[..., None] + ns * rgb[..., 2:3]
    return jnp.where((index >= 0)[..., None], normalise(tilted), ns)
