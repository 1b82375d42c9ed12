"""Crossings that are hits in mid air: Crossing -> Crossing without them.

A texel's plane is known to be a surface at the texel's centre alone. Seen nearly edge on, it rises so fast from texel
to texel that a ray may cross it far from the triangle that the texel shows.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrefl._types import Mesh, Rays
from jaxrefl.core import distance_to_triangle
from jaxrefl.rays.views import Views
from jaxrefl.techniques.clusters.depth_images import DepthImages
from jaxrefl.techniques.clusters.traverse import Crossing, Lines, distance_along
from jaxrefl.techniques.clusters.types import Found, is_hit

NEAR = 2.0
"""Distance to the triangle, in widths of a texel there, up to which a crossing counts: the next triangle of a smooth
surface, that the texel's centre just misses, lies within."""


@jax.jit
def confirmed(
    mesh: Mesh, images: DepthImages, views: Views, view: Int[Array, "n"], lines: Lines, crossing: Crossing, rays: Rays,
    reach: Float[Array, "n"],
) -> Crossing:  # fmt: skip
    """Take back the crossings that are not near the triangle whose plane was met.

    Args:
        mesh: The triangles.
        images: Depth images.
        views: Their views.
        view: View of each ray.
        lines: Images of the rays.
        crossing: Where they ended.
        rays: The rays themselves.
        reach: Lengths up to which they were followed, world units.
    Returns:
        Crossings; those taken back are `HIDDEN`.
    Edge cases: a ray whose image is no longer than a texel, as those of planar clusters are, sees what that texel
        shows, wherever along it that is.
    """
    hit = is_hit(crossing.found, crossing.share)
    p = rays.origin + rays.direction * distance_along(lines, crossing.share, reach)[:, None]
    corners = mesh.vertices[mesh.faces[jnp.maximum(images.triangle[crossing.texel], 0)]]
    inverse = lines.start_z + (lines.end_z - lines.start_z) * crossing.share
    width = views.pitch[view].max(-1) / jnp.where(inverse > 0, inverse, 1)
    far = distance_to_triangle(p, corners[:, 0], corners[:, 1], corners[:, 2]) > NEAR * width
    long = jnp.abs(lines.end - lines.start).max(-1) > 1
    found = jnp.where(hit & far & long, int(Found.HIDDEN), crossing.found).astype(jnp.int32)
    return Crossing(found, crossing.share, crossing.texel, crossing.steps)
