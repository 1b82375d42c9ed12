"""The G-buffer stage: Scene + Rays + Hits -> GBuffer."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import Camera, GBuffer, Hits, Rays, Scene, Tracer
from jaxrefl.core import dot, normalise, project
from jaxrefl.rays import camera_rays
from jaxrefl.surface.interpolate import interpolate, position
from jaxrefl.surface.material import apply_normal_map, sample_material


@eqx.filter_jit
def build_gbuffer(
    scene: Scene, rays: Rays, hits: Hits, *, camera: Camera | None = None, previous_camera: Camera | None = None
) -> GBuffer:
    """What each ray sees.

    Args:
        scene: The scene.
        rays: The rays [*b] that were cast.
        hits: Their hits [*b].
        camera: The camera the rays belong to, for `z_camera` and `motion`; None for other rays.
        previous_camera: Camera of the previous frame, for `motion`; needs `camera`.
    Returns:
        The G-buffer [*b]; fields of features that the scene does not have are None.
    Edge cases: interpolated and mapped normals are turned to the viewer's side of the surface.
    """
    mesh, valid = scene.mesh, hits.valid
    triangle, wo = hits.triangle, -rays.direction
    corners = mesh.faces[triangle]
    p, p_error, n_outside = position(mesh, corners, hits)
    outside = dot(n_outside, wo) >= 0
    n = jnp.where(outside[..., None], n_outside, -n_outside)

    material = mesh.material[triangle]
    uv = None if mesh.uv is None else interpolate(mesh.uv, corners, hits)
    ns = n if mesh.normals is None else normalise(interpolate(mesh.normals, corners, hits))
    if scene.features.normal_mapped and uv is not None:
        ns = apply_normal_map(scene, ns, material, corners, uv, hits)
    ns = jnp.where((dot(ns, n) < 0)[..., None], -ns, ns)
    sample = sample_material(scene, material, corners, uv, hits)

    z_camera, motion = None, None
    if camera is not None:
        z_camera, motion = _camera_fields(p, valid, camera, previous_camera)
    up = jnp.broadcast_to(jnp.array([0, 0, 1], p.dtype), p.shape)
    seen = valid[..., None]
    return GBuffer(
        valid=valid,
        p=jnp.where(seen, p, 0),
        p_error=jnp.where(valid, p_error, 0),
        n=jnp.where(seen, n, up),
        ns=jnp.where(seen, ns, up),
        wo=wo,
        t=hits.t,
        z_camera=z_camera,
        base_colour=sample.base_colour,
        metallic=sample.metallic,
        alpha=sample.alpha,
        eta=sample.eta,
        outside=outside | ~valid,
        object=jnp.where(valid, mesh.object[triangle], -1),
        material=jnp.where(valid, material, -1),
        triangle=jnp.where(valid, triangle, -1),
        emission=sample.emission,
        transmission=sample.transmission,
        motion=motion,
    )


def _camera_fields(
    p: Float[Array, "*b 3"], valid: Array, camera: Camera, previous_camera: Camera | None
) -> tuple[Float[Array, "*b"], Float[Array, "*b 2"] | None]:
    xy, depth = project(camera, p)
    z_camera = jnp.where(valid, depth, 0)
    if previous_camera is None:
        return z_camera, None
    xy_previous, depth_previous = project(previous_camera, p)
    shown = valid & (depth_previous > 0)
    return z_camera, jnp.where(shown[..., None], xy_previous - xy, 0)


def look(scene: Scene, tracer: Tracer, camera: Camera, *, previous_camera: Camera | None = None) -> GBuffer:
    """Cast a camera's rays and build its G-buffer.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        camera: The camera.
        previous_camera: Camera of the previous frame, for motion vectors.
    Returns:
        The G-buffer [h w].
    """
    rays = _rays(camera)
    return build_gbuffer(scene, rays, tracer.closest(rays), camera=camera, previous_camera=previous_camera)


_rays = eqx.filter_jit(camera_rays)
