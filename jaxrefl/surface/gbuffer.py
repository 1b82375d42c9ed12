"""The G-buffer stage: Scene + Rays + Hits -> GBuffer."""

import functools
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import Camera, GBuffer, Hits, Rays, Scene, Tracer
from jaxrefl.core import dot, project
from jaxrefl.core.safe import normalise
from jaxrefl.rays import camera_rays
from jaxrefl.surface.interpolate import interpolate, position
from jaxrefl.surface.material import apply_normal_map, sample_material

T = TypeVar("T")


@jax.jit
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
    emission = sample.emission
    if emission is not None and scene.materials.emits_back is not None:
        shines = outside | scene.materials.emits_back[material]
        emission = jnp.where(shines[..., None], emission, 0)

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
        emission=emission,
        transmission=sample.transmission,
        motion=motion,
        conductor=sample.conductor,
        coupled=sample.coupled,
        opacity=sample.opacity,
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


_BLOCK = 131072
"""Pixels whose rays are cast while the pixels before them are built."""


def look(scene: Scene, tracer: Tracer, camera: Camera, *, previous_camera: Camera | None = None) -> GBuffer:
    """Cast a camera's rays and build its G-buffer.

    Rows are built on the device while the host casts the rays of the next ones.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        camera: The camera.
        previous_camera: Camera of the previous frame, for motion vectors.
    Returns:
        The G-buffer [h w].
    """
    rows = max(1, min(camera.height, _BLOCK // camera.width))
    rays = _rays(camera)
    gbuffer = _blank(scene, camera, previous_camera)
    for start in range(0, camera.height, rows):
        first = min(start, camera.height - rows)
        hits = tracer.closest_rows(rays, first, rows)
        gbuffer = _build_rows(gbuffer, scene, rays, hits, camera, previous_camera, first)
    return gbuffer


_rays = jax.jit(camera_rays)


def _slice_rows(tree: T, first: Array | int, count: int) -> T:
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, count), tree)


@functools.partial(jax.jit, donate_argnums=0)
def _build_rows(
    gbuffer: GBuffer, scene: Scene, rays: Rays, hits: Hits, camera: Camera, previous_camera: Camera | None, first: Array
) -> GBuffer:
    """Write the rows from `first` on into the G-buffer, in place."""
    part = _slice_rows(rays, first, hits.valid.shape[0])
    built = build_gbuffer(scene, part, hits, camera=camera, previous_camera=previous_camera)
    return jax.tree.map(lambda x, rows: jax.lax.dynamic_update_slice_in_dim(x, rows, first, 0), gbuffer, built)


@jax.jit
def _blank(scene: Scene, camera: Camera, previous_camera: Camera | None) -> GBuffer:
    """Zeros in the shape of the camera's G-buffer."""

    def build(scene: Scene, camera: Camera, previous_camera: Camera | None) -> GBuffer:
        shape = (camera.height, camera.width)
        zero = jnp.zeros(shape, jnp.float32)
        hits = Hits(jnp.zeros(shape, bool), zero, jnp.zeros(shape, jnp.int32), jnp.zeros((*shape, 2), jnp.float32))
        return build_gbuffer(scene, camera_rays(camera), hits, camera=camera, previous_camera=previous_camera)

    shapes = jax.eval_shape(build, scene, camera, previous_camera)
    return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
