"""What rays found in their depth images: Crossing -> radiance, reflected point and distance.

Source: [WXKP14] §3.4.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Lights, Rays
from jaxrefl.radiance import background
from jaxrefl.rays.views import Views, in_view
from jaxrefl.techniques.clusters.depth_images import DepthImages
from jaxrefl.techniques.clusters.traverse import Crossing, Lines, distance_along
from jaxrefl.techniques.clusters.types import Found, is_hit

_SAME = 0.02
"""Difference of 1 / z, relative, up to which a neighbouring texel shows the surface that was hit."""


class Seen(eqx.Module):
    """What arrives along rays [n]."""

    radiance: Float[Array, "n 3"]
    """Linear radiance; fill 0."""
    known: Bool[Array, "n"]
    """True where the ray has an answer, be it a guess."""
    hit: Bool[Array, "n"]
    """True where that is a surface, False where it is the environment."""
    p: Float[Array, "n 3"]
    """Reflected point, world space; fill 0."""
    t: Float[Array, "n"]
    """Distance along the ray, world units; fill 0."""


@jax.jit
def look_up(
    images: DepthImages, lines: Lines, crossing: Crossing, rays: Rays, reach: Float[Array, "n"], lights: Lights
) -> Seen:
    """Radiance that rays bring back.

    Args:
        images: Depth images.
        lines: Images of the rays.
        crossing: Where they ended.
        rays: The rays themselves.
        reach: Lengths up to which they were followed, world units.
        lights: The environment, for rays that leave the scene.
    Returns:
        Radiance between the texels' centres around the hit, as far as they show the same surface.
    Source: [WXKP14] §3.4 and 4.1, bilinear.
    Differs from the source: colours do not bleed over the edges of things, and the environment is read along the ray.
    """
    ended = crossing.found
    hit = is_hit(ended, crossing.share)
    sky = (ended == int(Found.SKY)) | ((ended == int(Found.PASSED)) & ~hit)
    at = lines.start + (lines.end - lines.start) * crossing.share[:, None]
    depth = lines.start_z + (lines.end_z - lines.start_z) * crossing.share
    colour = _between(images, lines, crossing, at, depth)
    far = jnp.where(sky[:, None], background(lights, rays.direction), 0)
    t = jnp.where(hit, distance_along(lines, crossing.share, reach), 0)
    p = rays.origin + rays.direction * t[:, None]
    return Seen(jnp.where(hit[:, None], colour, far), hit | sky, hit, jnp.where(hit[:, None], p, 0), t)


@jax.jit
def look_beside(
    images: DepthImages, views: Views, view: Int[Array, "n"], rays: Rays, middle: Seen, lights: Lights
) -> Seen:
    """What a ray near one that has been followed sees, if it ends as far away: no search, one texel.

    Args:
        images: Depth images.
        views: Their views.
        view: View of each ray.
        rays: Rays beside the followed ones, from the same points.
        middle: What those found.
        lights: The environment.
    Returns:
        Radiance of the texel where the ray is as long as `middle.t`; of the environment where `middle` left the scene.
    Source: [WXKP14] §4.2, last paragraph on glossy reflections.
    """
    p = rays.origin + rays.direction * middle.t[:, None]
    lateral, z = in_view(views, view, p)
    slope = lateral / jnp.maximum(z, 1e-6 * middle.t + 1e-30)[:, None]
    size = views.size[view]
    at = jnp.floor((slope - views.low[view]) / views.pitch[view]).astype(jnp.int32)
    at = jnp.clip(at, 0, jnp.maximum(size - 1, 0))
    texel = views.offset[view] + at[:, 1] * size[:, 0] + at[:, 0]
    hit = middle.hit[:, None]
    radiance = jnp.where(hit, images.radiance[jnp.where(middle.hit, texel, 0)], background(lights, rays.direction))
    radiance = jnp.where(middle.known[:, None], radiance, 0)
    return Seen(radiance, middle.known, middle.hit, middle.p, middle.t)


def _between(images: DepthImages, lines: Lines, crossing: Crossing, at: Array, depth: Array) -> Float[Array, "n 3"]:
    """Bilinear colour of the texels that show the surface hit; that of the texel hit where no other does."""
    low = jnp.floor(at - 0.5)
    share = at - 0.5 - low
    column, row = low[:, 0].astype(jnp.int32), low[:, 1].astype(jnp.int32)
    width, height = lines.size[:, 0], lines.size[:, 1]
    total = images.radiance[crossing.texel] * 1e-4
    weight = jnp.full(depth.shape, 1e-4)
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        x, y = jnp.clip(column + dx, 0, jnp.maximum(width - 1, 0)), jnp.clip(row + dy, 0, jnp.maximum(height - 1, 0))
        texel = lines.offset + y * width + x
        plane = images.plane[texel]
        u, v = at[:, 0] - x.astype(jnp.float32) - 0.5, at[:, 1] - y.astype(jnp.float32) - 0.5
        off = jnp.abs(plane[:, 0] + plane[:, 1] * u + plane[:, 2] * v - depth)
        wx = share[:, 0] if dx else 1 - share[:, 0]
        wy = share[:, 1] if dy else 1 - share[:, 1]
        w = jnp.where((off <= _SAME * depth) & (plane[:, 0] > 0), wx * wy, 0)
        total, weight = total + w[:, None] * images.radiance[texel], weight + w
    return total / weight[:, None]


def counts_of(found: Int[Array, "h w"]) -> dict[str, Int[Array, ""]]:
    """How many pixels ended in which way.

    Args:
        found: A `Found` code per pixel.
    Returns:
        `found_surface`, `found_sky`, `passed`, `hidden`, `without_camera` and `outside`.
    """
    names = {"found_surface": Found.SURFACE, "found_sky": Found.SKY, "passed": Found.PASSED,
             "hidden": Found.HIDDEN, "without_camera": Found.NO_CAMERA, "outside": Found.OUTSIDE}  # fmt: skip
    return {name: (found == int(code)).sum() for name, code in names.items()}
