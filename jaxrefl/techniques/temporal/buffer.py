"""Reflection buffers: a traced frame -> what later frames need of it.

Source: [XWD17] §3.1, B.1 to B.4.
Differs from the source: the specular factor B.2 is not kept, since each frame's own G-buffer has it; the reflected
triangle is, so that what moves is known.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import Camera, Frame, GBuffer, Hits, Mesh, Rays, Scene
from jaxrefl.rays import offset_origin
from jaxrefl.surface import mirror_direction
from jaxrefl.techniques._tracing import Traced
from jaxrefl.techniques.temporal.cells import bends, connections, steepness
from jaxrefl.techniques.temporal.types import Options, Params, ReflectionBuffer


def is_noisy(scene: Scene, options: Options) -> bool:
    """Whether traced light has noise, so that its differences say little about edges.

    Args:
        scene: The scene.
        options: `noise` and the light model.
    Returns:
        True: judge contrast by base colours.
    """
    if options.noise != "auto":
        return options.noise == "noisy"
    if options.light == "baked":
        return False
    lights = scene.lights
    return options.light == "path" or lights.area is not None or lights.environment is not None


def keep(
    frame: Frame, image: Traced, error: Float[Array, "h w"], params: Params, *, options: Options
) -> ReflectionBuffer:
    r"""The reflection buffer of a traced frame.

    $$ R = W + r\, \omega_i $$

    Args:
        frame: The frame.
        image: Its reflections.
        error: Expected relative error of each; 0 where it was traced.
        params: `sharp`: lobes up to this alpha are kept with the point that their mirror ray hits, a mean over samples
            would say little about its place.
        options: `noise`, `light`: what contrast is judged by; `inner_mirrors`: whether they count.
    Returns:
        The buffer.
    Edge cases: reflections of the environment have a direction in place of a point.
    Source: [XWD17] §3.1 and Algorithm 2, lines 2 to 4.
    Differs from the source: line 3 back-projects the primary depth (the paper's `s.r` there is a slip); positions are
        those of the G-buffer, which are more exact than back-projection, and of mirrors the points that were hit.
    """
    noisy, inner = is_noisy(frame.scene, options), options.inner_mirrors == "reuse"
    image = _centred(frame, image, params) if frame.scene.features.glossy else image
    smooth = frame.gbuffer.alpha <= params.sharp
    buffer = _keep(frame.camera, frame.scene.mesh, frame.gbuffer, smooth, image, error, (noisy, inner))
    # The very array of the scene: that nothing has moved is then seen without looking at the vertices.
    return dataclasses.replace(buffer, vertices=frame.scene.mesh.vertices)


def _centred(frame: Frame, image: Traced, params: Params) -> Traced:
    """The image with what the mirror rays of narrow lobes hit in place of the mean over their samples."""
    narrow, rays = _narrow_lobes(frame.gbuffer, image, params.sharp)
    return _with_hits(image, narrow, rays, frame.tracer.closest(rays, active=narrow))


@jax.jit
def _narrow_lobes(gbuffer: GBuffer, image: Traced, sharp: Float[Array, ""]) -> tuple[Bool[Array, "h w"], Rays]:
    wi = mirror_direction(gbuffer)
    narrow = image.reflection.valid & (gbuffer.alpha > 0) & (gbuffer.alpha <= sharp)
    return narrow, Rays(offset_origin(gbuffer.p, gbuffer.n, gbuffer.p_error, wi), wi)


@jax.jit
def _with_hits(image: Traced, narrow: Bool[Array, "h w"], rays: Rays, hits: Hits) -> Traced:
    t = jnp.where(narrow, jnp.where(hits.valid, hits.t, 0), image.reflection.t)
    p = jnp.where(narrow[..., None], rays.origin + hits.t[..., None] * rays.direction, image.reflection.p)
    triangle = jnp.where(narrow, jnp.where(hits.valid, hits.triangle, -1), image.reached.triangle)
    return Traced(
        dataclasses.replace(image.reflection, p=p, t=t), dataclasses.replace(image.reached, triangle=triangle)
    )


@functools.partial(jax.jit, static_argnums=6)
def _keep(
    camera: Camera,
    mesh: Mesh,
    gbuffer: GBuffer,
    smooth: Bool[Array, "h w"],
    image: Traced,
    error: Float[Array, "h w"],
    flags: tuple[bool, bool],
) -> ReflectionBuffer:
    noisy, inner = flags
    reflection, reached = image.reflection, image.reached
    wi, exact = mirror_direction(gbuffer), gbuffer.alpha == 0
    hit = reflection.valid & (reflection.t > 0)
    point = jnp.where(smooth[..., None], reflection.p, gbuffer.p + wi * reflection.t[..., None])
    w = jnp.where(hit, 1.0, 0.0)
    reflected = jnp.concatenate([jnp.where(hit[..., None], point, wi), w[..., None]], -1)
    right, down, connected = connections(mesh, reflected, reached.triangle, reflection.valid)
    seen = reached.colour if noisy else reflection.radiance
    bend_x, bend_y = bends(jnp.where(exact[..., None], seen, 0), right, down, reflection.valid)
    steep = steepness(seen, reflected, right, down, reflection.valid)
    return ReflectionBuffer(
        camera=camera,
        vertices=mesh.vertices,
        valid=reflection.valid,
        p=gbuffer.p,
        ns=gbuffer.ns,
        t=gbuffer.t,
        object=gbuffer.object,
        smooth=smooth,
        reflected=reflected,
        t_reflected=reflection.t,
        radiance=reflection.radiance,
        triangle=reached.triangle,
        changing=reached.changing & (not inner),
        connected=connected,
        seen=seen,
        error=error,
        steepness=steep,
        bend_x=bend_x,
        bend_y=bend_y,
    )


def as_of(buffer: ReflectionBuffer, frame: Frame, *, options: Options) -> tuple[ReflectionBuffer, Bool[Array, "h w"]]:
    """A key frame as it is at another frame's time, where things may have moved.

    Args:
        buffer: The key frame.
        frame: The frame to render.
        options: `moving`.
    Returns:
        The key frame with reflections of what has moved taken out, or moved along; and the pixels of `frame` whose
            reflector has moved and must be traced.
    Edge cases: rough reflections may show anything within their lobe: once something has moved they are taken out.
        A scene whose vertices are the same arrays has not moved, and costs nothing.
    """
    if frame.scene.mesh.vertices is buffer.vertices:
        return buffer, jnp.zeros_like(frame.gbuffer.valid)
    return _moved(buffer, frame.scene.mesh, frame.gbuffer, options.moving == "follow")


@functools.partial(jax.jit, static_argnums=3)
def _moved(
    buffer: ReflectionBuffer, mesh: Mesh, gbuffer: GBuffer, follow: bool
) -> tuple[ReflectionBuffer, Bool[Array, "h w"]]:
    still = (mesh.vertices == buffer.vertices).all(-1)
    still_triangle = still[mesh.faces].all(-1)
    any_moved = ~still_triangle.all()
    reflected = buffer.reflected
    shown = buffer.triangle >= 0
    same = jnp.where(shown, still_triangle[jnp.maximum(buffer.triangle, 0)], True)
    own = gbuffer.valid & ~still_triangle[jnp.maximum(gbuffer.triangle, 0)]
    kept = buffer.valid & (buffer.smooth | ~any_moved)
    if not follow:
        return dataclasses.replace(buffer, valid=kept & same), own
    corners = mesh.faces[jnp.maximum(buffer.triangle, 0)]
    there = _carried(reflected[..., :3], buffer.vertices[corners], mesh.vertices[corners])
    point = jnp.where((shown & ~same)[..., None], there, reflected[..., :3])
    moved = dataclasses.replace(
        buffer, valid=kept, reflected=jnp.concatenate([point, reflected[..., 3:]], -1), vertices=mesh.vertices
    )
    return moved, jnp.zeros_like(own)


def _carried(p: Float[Array, "h w 3"], old: Float[Array, "h w 3 3"], new: Float[Array, "h w 3 3"]) -> Array:
    """Points of triangles at the same barycentric place of the moved triangles."""
    e1, e2, d = old[..., 1, :] - old[..., 0, :], old[..., 2, :] - old[..., 0, :], p - old[..., 0, :]
    a, b, c = (e1 * e1).sum(-1), (e1 * e2).sum(-1), (e2 * e2).sum(-1)
    x, y = (d * e1).sum(-1), (d * e2).sum(-1)
    det = a * c - b * b
    inverse = jnp.where(det > 0, 1 / jnp.where(det > 0, det, 1), 0)
    u, v = (c * x - b * y) * inverse, (a * y - b * x) * inverse
    f1, f2 = new[..., 1, :] - new[..., 0, :], new[..., 2, :] - new[..., 0, :]
    return new[..., 0, :] + u[..., None] * f1 + v[..., None] * f2
