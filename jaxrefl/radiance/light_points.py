"""One point on one light: where it is, what it emits towards a place, and with which density it was found.

The primitives that direct light (`light_samples`, every kind of light at each point) and the path tracer (one light per
point) are built from, and the densities with which a ray that hits a light by itself would have been found by them.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import AreaLights, PunctualLights, Scene
from jaxrefl.core import cone, cross, dot, largest, safe, triangle
from jaxrefl.rays.offset import ERROR_PER_COORDINATE, offset_origin
from jaxrefl.scene.distributions import invert_cdf
from jaxrefl.scene.textures import texture_rgba

FAR = 1e30
"""Length of a shadow ray that leaves the scene, world units."""


class LightPoint(eqx.Module):
    """Points on lights, one per receiver."""

    wi: Float[Array, "n 3"]
    """Unit direction from the receiver to the light."""
    end: Float[Array, "n 3"]
    """Where the shadow ray ends, world space; `FAR` away along `wi` for lights without a position."""
    radiance: Float[Array, "n 3"]
    """Radiance towards the receiver; for punctual lights the irradiance of a surface that faces them."""
    inverse_density: Float[Array, "n"]
    """One over the density per solid angle; 1 for punctual lights, which have none; 0 for a light seen edge-on."""


class EmissivePoint(eqx.Module):
    """Points of emissive triangles, whoever looks at them."""

    q: Float[Array, "n 3"]
    """Position, world space."""
    q_error: Float[Array, "n"]
    """Bound on its rounding error, world units."""
    n: Float[Array, "n 3"]
    """Unit normal of the triangle."""
    emission: Float[Array, "n 3"]
    """Emitted radiance."""
    inverse_density: Float[Array, "n"]
    """One over the density per area, world units squared."""
    emits_back: Bool[Array, "n"] | None
    """False where only the front emits; None: both sides do everywhere."""


def area_light_point(point: EmissivePoint, p: Float[Array, "n 3"]) -> LightPoint:
    r"""An emissive point as a receiver sees it.

    $$ \frac{1}{p(\omega)} = \frac{\cos\theta_l}{p_A\,d^2} $$

    Args:
        point: From `emissive_point`, one per receiver.
        p: Receivers, world space.
    Returns:
        The points.
    Edge cases: a receiver at the very position of the point, and one behind a triangle that emits from its front only,
        has the inverse density 0.
    """
    to_light = point.q - p
    distance = safe.norm(to_light)
    wi = safe.normalise(to_light)
    facing = -dot(point.n, wi)
    if point.emits_back is not None:
        facing = jnp.where(point.emits_back, facing, jnp.maximum(facing, 0))
    # Divided twice, since the square of a small distance may underflow.
    inverse_density = safe.divide(safe.divide(point.inverse_density, distance), distance) * jnp.abs(facing)
    return LightPoint(wi, offset_origin(point.q, point.n, point.q_error, -wi), point.emission, inverse_density)


def emissive_point(scene: Scene, area: AreaLights, u: Float[Array, "n 2"]) -> EmissivePoint:
    """A point on the emissive triangles, uniform on each and between them in proportion to their power.

    Args:
        scene: Its mesh, materials and textures are used.
        area: The emissive triangles.
        u: Uniform numbers in [0, 1).
    Returns:
        The points.
    """
    row, rest = invert_cdf(area.cdf, u[:, 0])
    face = area.triangle[row]
    corners = scene.mesh.faces[face]
    a, b, c = (scene.mesh.vertices[corners[:, i]] for i in range(3))
    barycentric = triangle(jnp.stack([rest, u[:, 1]], -1))
    w1, w2 = barycentric[:, :1], barycentric[:, 1:]
    q = a * (1 - w1 - w2) + b * w1 + c * w2
    n_light = safe.normalise(cross(b - a, c - a))

    material = scene.mesh.material[face]
    emission = scene.materials.emission[material]
    if area.textured and scene.textures is not None and scene.mesh.uv is not None:
        uv = scene.mesh.uv
        uv = uv[corners[:, 0]] * (1 - w1 - w2) + uv[corners[:, 1]] * w1 + uv[corners[:, 2]] * w2
        emission = emission * texture_rgba(scene.textures, scene.materials.emission_texture[material], uv)[:, :3]

    emits_back = None if scene.materials.emits_back is None else scene.materials.emits_back[material]
    q_error = ERROR_PER_COORDINATE * jnp.maximum(jnp.maximum(_largest(a), _largest(b)), _largest(c))
    return EmissivePoint(q, q_error, n_light, emission, area.area[row] / area.probability[row], emits_back)


def punctual_light_point(
    light: PunctualLights, p: Float[Array, "n 3"], p_error: Float[Array, "n"], u: Float[Array, "n 2"]
) -> LightPoint:
    """The place of one punctual light per receiver; in the disk of the sun a point.

    Args:
        light: One light per receiver [n].
        p: Receivers, world space.
        p_error: Bound on the rounding error of `p`, world units.
        u: Uniform numbers in [0, 1) that choose the point in the disk of a directional light with a radius.
    Returns:
        The points.
    Source: KHR_lights_punctual for the spot's falloff.
    """
    to_light = light.position - p
    distance = safe.norm(to_light)
    wi = safe.normalise(to_light)
    scale = jnp.maximum(light.cos_inner - light.cos_outer, 1e-3)
    spot = jnp.clip((-dot(wi, light.direction) - light.cos_outer) / scale, 0, 1) ** 2
    strength = safe.divide(safe.divide(spot, distance), distance)

    cos_radius = jnp.cos(light.angular_radius)
    sun = cone(u, -light.direction, cos_radius)
    # A disk of half angle r and radiance L brings pi L sin^2 r; its solid angle is 2 pi (1 - cos r).
    strength = jnp.where(light.directional, 2 / (1 + cos_radius), strength)
    # A lamp may lie on the surface that it is mounted on, so its ray ends a little before it.
    end = light.position - wi * (ERROR_PER_COORDINATE * _largest(light.position) + p_error)[:, None]
    parallel = light.directional[:, None]
    wi = jnp.where(parallel, sun, wi)
    end = jnp.where(parallel, sun * FAR, end)
    return LightPoint(wi, end, light.intensity * strength[:, None], jnp.ones_like(strength))


def area_density(area: AreaLights, triangles: int) -> Float[Array, "f"]:
    """Density per area with which `area_light_point` finds the points of each triangle.

    Args:
        area: The emissive triangles.
        triangles: How many triangles the mesh has.
    Returns:
        Density by triangle, one over world units squared; 0 where nothing emits.
    """
    per_area = safe.divide(area.probability, area.area)
    return jnp.zeros((triangles,), per_area.dtype).at[area.triangle].set(per_area)


def density_of_hit(
    per_area: Float[Array, "f"], triangle_hit: Int[Array, "n"], t: Float[Array, "n"], cos: Float[Array, "n"]
) -> Float[Array, "n"]:
    r"""Density per solid angle with which a light sample would have found the point that a ray has hit.

    $$ p(\omega) = \frac{p_A\,t^2}{\cos\theta_l} $$

    Args:
        per_area: From `area_density`.
        triangle_hit: Triangles that were hit; -1 for none.
        t: Distances of the hits.
        cos: Cosine between the ray and the triangle's normal, >= 0.
    Returns:
        Densities, 1/sr; 0 where the triangle does not emit.
    """
    density = jnp.where(triangle_hit >= 0, per_area[jnp.maximum(triangle_hit, 0)], 0)
    return safe.divide(density * t * t, cos)


def _largest(v: Float[Array, "n 3"]) -> Float[Array, "n"]:
    return largest(jnp.abs(v))
