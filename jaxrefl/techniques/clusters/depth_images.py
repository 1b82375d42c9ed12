"""Depth images of cluster cameras: views -> for each texel the plane of the surface seen there, and its radiance.

All texels of a frame are one flat list, made block by block: cast or drawn, shaded as the end of a reflected ray is,
and written as planes. A texel's plane is that of the triangle it shows, so a ray that meets the triangle there is
intersected with the triangle itself: flat things are exact at any resolution.

Source: [WXKP14] §3.4.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Frame, Hits, Mesh, Rays
from jaxrefl.core import dot
from jaxrefl.core.safe import divide
from jaxrefl.radiance import Incoming, incoming
from jaxrefl.rays import blocks_of, offset_origin, put_block
from jaxrefl.rays.raster import draw_triangles, raster_hits
from jaxrefl.rays.views import Views, dot_axis, in_view, texel_count, view_rays
from jaxrefl.surface.interpolate import position
from jaxrefl.techniques._tracing import following_mirrors
from jaxrefl.techniques.clusters.types import Options

LAYERS = 8
"""How many unseen surfaces of its own reflector a camera's ray passes before it stops at one."""


_ROUNDING = 1e-5
"""Share of its depth by which a texel's ray starts before the points that its image begins at."""
_LEFT = 1 / 64
"""Share of its length that is left of a ray whose hit was drawn; what the view does not see lies behind."""


class DepthImages(eqx.Module):
    """What all views see, one row per texel."""

    plane: Float[Array, "n 3"]
    """1 / z at the texel's centre, and its change from texel to texel along x and y; 0 where nothing is seen."""
    radiance: Float[Array, "n 3"]
    """Radiance towards the view's eye; where nothing is seen that of the environment."""
    triangle: Int[Array, "n"]
    """Row in `Mesh.faces`; -1 where nothing is seen."""
    begin: Float[Array, "n"] | None = None
    """1 / z from which on the texel's image says what there is; None: from the clipping plane on."""


def make_depth_images(
    frame: Frame, views: Views, needed: Bool[Array, "m"], begin: Float[Array, "m"] | None = None, *, options: Options
) -> DepthImages:
    """Render what all views see.

    Args:
        frame: Scene, key and tracer.
        views: The views.
        needed: Which texels to render; nothing is seen at the others.
        begin: From `begin_texels`; None: images begin at the clipping plane.
        options: Light, bounces and block size.
    Returns:
        Depth images.
    Source: [WXKP14] §3.1, step 3b.
    """
    room, count = needed.shape[0], texel_count(views)
    mesh = frame.scene.mesh
    drawn = draw_triangles(mesh, views, room=room, begin=begin) if options.maker == "raster" else None
    nothing = lambda: jnp.zeros((room, 3), jnp.float32)  # noqa: E731  each is written in place
    images = DepthImages(nothing(), nothing(), jnp.full(room, -1, jnp.int32))
    follow = following_mirrors(options)
    key = jax.random.fold_in(frame.key, 1)
    for number, texel in enumerate(blocks_of(needed, size=options.block)):
        rays, view, active = _rays(views, begin, texel, count)
        if drawn is None:
            rays, hits = cast_views(frame, rays, view, views, active)
        else:
            rays, hits = _drawn_hits(mesh, views, texel, active, drawn)
        light = incoming(
            frame.scene, frame.tracer, rays, active, jax.random.fold_in(key, number), hits=hits, options=follow
        )
        index = jnp.where(active, texel, -1)
        images = put_block(index, images, _texels(views, view, light), batch_dims=1)
    return dataclasses.replace(images, begin=begin)


@jax.jit
def _rays(
    views: Views, begin: Array | None, texel: Int[Array, "n"], count: Int[Array, ""]
) -> tuple[Rays, Int[Array, "n"], Array]:
    rays, view, sees = view_rays(views, jnp.maximum(texel, 0))
    if begin is not None:
        _, z = in_view(views, view, rays.origin)
        left = jnp.maximum((1 - _ROUNDING) / begin[jnp.maximum(texel, 0)] - z, 0)
        rays = Rays(
            rays.origin + rays.direction * (left / dot_axis(views, view, rays.direction, 2))[:, None], rays.direction
        )
    return rays, view, (texel >= 0) & (texel < count) & sees


@jax.jit
def _drawn_hits(mesh: Mesh, views: Views, texel: Array, active: Array, drawn: Array) -> tuple[Rays, Hits]:
    """Hits of texels' rays on what was drawn there; the rays start just before, as nothing else lies in between."""
    triangle = jnp.where(active, drawn[jnp.minimum(texel, drawn.shape[0] - 1)], -1)
    rays, hits = raster_hits(mesh, views, texel, triangle)
    origin = rays.origin + rays.direction * (hits.t * (1 - _LEFT))[:, None]
    return Rays(origin, rays.direction), eqx.tree_at(lambda h: h.t, hits, hits.t * _LEFT)


def cast_views(
    frame: Frame, rays: Rays, view: Int[Array, "n"], views: Views, active: Bool[Array, "n"]
) -> tuple[Rays, Hits]:
    """Closest hits of texels' rays that are not on the unseen side of their view's own object.

    Args:
        frame: Scene and tracer.
        rays: Rays of texels.
        view: View of each.
        views: The views.
        active: Which rays to cast.
    Returns:
        The rays, from the last unseen surface on, and their hits.
    """
    hits = frame.tracer.closest(rays, active=active)
    for _ in range(LAYERS):
        unseen, beyond = _pass(frame.scene.mesh, rays, hits, view, views)
        if not unseen.any():
            break
        rays = beyond
        more = frame.tracer.closest(rays, active=unseen)
        hits = _choose(unseen, more, hits)
    return rays, hits


@jax.jit
def _pass(mesh: Mesh, rays: Rays, hits: Hits, view: Int[Array, "n"], views: Views) -> tuple[Bool[Array, "n"], Rays]:
    """Hits on unseen sides, and the rays moved behind them."""
    p, p_error, n = position(mesh, mesh.faces[hits.triangle], hits)
    side = jnp.where(dot(n, rays.direction) <= 0, 1, 2)
    own = mesh.object[hits.triangle] == views.own[view]
    unseen = hits.valid & own & (views.unseen[view] & side > 0)
    beyond = offset_origin(p, n, p_error, rays.direction)
    return unseen, Rays(jnp.where(unseen[:, None], beyond, rays.origin), rays.direction)


@jax.jit
def _choose(condition: Bool[Array, "n"], a: Hits, b: Hits) -> Hits:
    return jax.tree.map(lambda x, y: jnp.where(condition.reshape(-1, *(1,) * (x.ndim - 1)), x, y), a, b)


@jax.jit
def _texels(views: Views, view: Int[Array, "n"], light: Incoming) -> DepthImages:
    plane = planes_seen(views, view, light.p, light.first.n, light.hit)
    return DepthImages(plane, light.radiance, jnp.where(light.hit, light.first.triangle, -1))


def planes_seen(
    views: Views, view: Int[Array, "n"], p: Float[Array, "n 3"], n: Float[Array, "n 3"], hit: Bool[Array, "n"]
) -> Float[Array, "n 3"]:
    r"""Planes through points on surfaces as a view sees them: 1 / z is linear in the image.

    $$ 1 / z = \frac{n \cdot (s_x\,right + s_y\,down + forward)}{n \cdot (p - e)} $$

    Args:
        views: The views.
        view: View of each point.
        p: The points, world space, at the centres of texels.
        n: Unit normals of the planes.
        hit: Which of them there are.
    Returns:
        1 / z, and its change from texel to texel along x and y; 0 where there is nothing ahead of the eye.
    Edge cases: planes seen edge on change by half of their 1 / z at the most: the next texel shows something else.
    """
    _, z = in_view(views, view, p)
    seen = hit & (z > 0)
    inverse = divide(jnp.ones_like(z), jnp.where(seen, z, 1))
    height = dot(n, p - views.eye[view])
    slopes = jnp.stack([dot_axis(views, view, n, 0), dot_axis(views, view, n, 1)], -1) * views.pitch[view]
    steepest = 0.5 * inverse[:, None]
    gradient = jnp.clip(divide(slopes, height[:, None]), -steepest, steepest)
    return jnp.where(seen[:, None], jnp.concatenate([inverse[:, None], gradient], -1), 0)
