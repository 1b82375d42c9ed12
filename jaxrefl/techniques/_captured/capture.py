"""Capturing the surroundings of reflectors: Scene -> latitude-longitude maps."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import GBuffer, Rays, Scene, Tracer
from jaxrefl.core import direction_from_latlong
from jaxrefl.radiance import LightOptions, diffuse_light
from jaxrefl.rays import offset_origin
from jaxrefl.surface import build_gbuffer, reflective, specular_weight

_OWN_LAYERS = 16
"""How many invisible surfaces a capture ray passes before it stops at one."""


def reflectors_of(scene: Scene) -> np.ndarray:
    """Objects with a reflective material, the one with the largest surface first.

    Args:
        scene: The scene.
    Returns:
        Object indices.
    """
    materials = scene.materials
    shiny = np.asarray((materials.metallic > 0) | (materials.eta != 1))
    faces, vertices = np.asarray(scene.mesh.faces), np.asarray(scene.mesh.vertices)
    chosen = shiny[np.asarray(scene.mesh.material)]
    edges = vertices[faces[chosen, 1:]] - vertices[faces[chosen, :1]]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1)
    total = np.bincount(np.asarray(scene.mesh.object)[chosen], weights=areas, minlength=len(scene.names.objects))
    order = np.argsort(-total, kind="stable")
    return order[total[order] > 0]


def bounds_centre(scene: Scene, objects: np.ndarray) -> np.ndarray:
    """Middle of the bounding box of some objects.

    Args:
        scene: The scene.
        objects: Object indices, at least one.
    Returns:
        [3] world position.
    """
    faces = np.asarray(scene.mesh.faces)[np.isin(np.asarray(scene.mesh.object), objects)]
    corners = np.asarray(scene.mesh.vertices)[faces].reshape(-1, 3)
    return (corners.min(0) + corners.max(0)) / 2


def capture(
    scene: Scene, tracer: Tracer, centre: Float[Array, "3"], own: int, height: int, key: Array, *, light: LightOptions
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w"]]:
    """Radiance and nearness of the surroundings of a point.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        centre: Point to capture from, world space.
        own: Object whose surfaces are invisible to the capture; -1 for none. So are the back faces of all reflectors.
        height: Rows of the map.
        key: Random key for light samples.
        light: Diffuse light at each captured point.
    Returns:
        Radiance; and one over the distance, 0 where the environment is seen.
    """
    rays = _rays_around(centre, height)
    active = jnp.ones(rays.origin.shape[:-1], bool)
    points = build_gbuffer(scene, rays, tracer.closest(rays))
    for _ in range(_OWN_LAYERS):
        active = active & _invisible(points, own)
        if not active.any():
            break
        rays = _step_past(rays, points, active)
        points = _merge(points, build_gbuffer(scene, rays, tracer.closest(rays, active=active)), active)
    return _shade(scene, points, diffuse_light(scene, tracer, points, key, options=light), centre)


@functools.partial(jax.jit, static_argnames="height")
def _rays_around(centre: Float[Array, "3"], height: int) -> Rays:
    row = (jnp.arange(height, dtype=jnp.float32) + 0.5) / height
    column = (jnp.arange(2 * height, dtype=jnp.float32) + 0.5) / (2 * height)
    direction = direction_from_latlong(jnp.stack(jnp.meshgrid(column, row), -1))
    return Rays(jnp.broadcast_to(centre, direction.shape), direction)


@jax.jit
def _invisible(points: GBuffer, own: Int[Array, ""] | int) -> Bool[Array, "h w"]:
    """The reflector itself, and the inside of any other reflector: the capture point may lie within it."""
    return points.valid & ((points.object == own) | (reflective(points) & ~points.outside))


@jax.jit
def _step_past(rays: Rays, points: GBuffer, active: Bool[Array, "h w"]) -> Rays:
    beyond = offset_origin(points.p, points.n, points.p_error, rays.direction)
    return Rays(jnp.where(active[..., None], beyond, rays.origin), rays.direction)


@jax.jit
def _merge(before: GBuffer, after: GBuffer, active: Bool[Array, "h w"]) -> GBuffer:
    def choose(old: Array, new: Array) -> Array:
        return jnp.where(active.reshape(active.shape + (1,) * (old.ndim - 2)), new, old)

    return jax.tree.map(choose, before, after)


@jax.jit
def _shade(scene: Scene, points: GBuffer, light: Float[Array, "h w 3"], centre: Float[Array, "3"]):
    ambient = jnp.broadcast_to(scene.lights.ambient, light.shape)
    radiance = light + jnp.where(points.valid[..., None], specular_weight(points) * ambient, 0)
    offset = points.p - jnp.broadcast_to(centre, points.p.shape)
    distance = jnp.sqrt(jnp.maximum((offset * offset).sum(-1), jnp.finfo(jnp.float32).tiny))
    return radiance, jnp.where(points.valid, 1 / distance, 0)
