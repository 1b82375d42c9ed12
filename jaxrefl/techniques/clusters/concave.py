"""The second intersection of concave reflectors: their own pixels as a depth image, seen from the viewer's eye.

Source: [WXKP14] §4.4, its second way; in its first, and with `concave = "reflector"`, nothing here is used.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera, GBuffer, Rays
from jaxrefl.rays.views import Views, view_of
from jaxrefl.techniques.clusters.cluster import Clusters
from jaxrefl.techniques.clusters.depth_images import planes_seen
from jaxrefl.techniques.clusters.look_up import Seen
from jaxrefl.techniques.clusters.traverse import distance_along, follow, project_rays
from jaxrefl.techniques.clusters.types import Found


class SelfImage(eqx.Module):
    """The viewer's image of the concave clusters."""

    view: Views
    """The viewer's camera."""
    plane: Float[Array, "m 3"]
    """Planes of the pixels of concave clusters, as in `DepthImages`; 0 for all others."""
    label: Int[Array, "m"]
    """Cluster of each pixel."""
    diffuse: Float[Array, "m 3"]
    """Their diffuse light."""
    concave: Bool[Array, "c"]
    """Which clusters are."""


@jax.jit
def image_of_concave(camera: Camera, gbuffer: GBuffer, clusters: Clusters, diffuse: Float[Array, "h w 3"]) -> SelfImage:
    """Make a depth image of the pixels of concave clusters.

    Args:
        camera: The viewer's camera.
        gbuffer: What it sees.
        clusters: The clusters.
        diffuse: Diffuse light of each pixel.
    Returns:
        The image.
    """
    view = view_of(camera)
    flat = lambda x: x.reshape(-1, *x.shape[2:])  # noqa: E731
    at = jnp.zeros(clusters.label.shape, jnp.int32)
    shown = (clusters.label >= 0) & clusters.concave[clusters.label]
    plane = planes_seen(view, at, flat(gbuffer.p), flat(gbuffer.n), shown)
    return SelfImage(view, plane, clusters.label, flat(diffuse), clusters.concave)


def meet_cluster(
    itself: SelfImage, rays: Rays, cluster: Int[Array, "n"], active: Bool[Array, "n"], seen: Seen,
    found: Int[Array, "n"], reach: Float[Array, "n"], *, steps: int,
) -> tuple[Seen, Int[Array, "n"]]:  # fmt: skip
    """What rays of concave clusters see of their own cluster, where that is nearer than what they saw otherwise.

    Args:
        itself: From `image_of_concave`.
        rays: Rays [n].
        cluster: Cluster of each.
        active: Which rays count.
        seen: What they brought back from the depth images.
        found: How they ended there.
        reach: Their lengths, world units.
        steps: Most steps.
    Returns:
        `seen`, with the cluster's diffuse light where a ray meets it, and `found`, with `SURFACE` there.
    """
    at = jnp.zeros(cluster.shape, jnp.int32)
    lines, ahead = project_rays(itself.view, at, rays, reach)
    crossing = follow(itself.plane, lines, active & ahead & itself.concave[cluster], steps=steps)
    meets = (crossing.found == int(Found.SURFACE)) & (itself.label[crossing.texel] == cluster)
    t = distance_along(lines, crossing.share, reach)
    nearer = meets & (t > 0) & (~seen.hit | (t < seen.t))
    column = nearer[:, None]
    met = Seen(
        radiance=jnp.where(column, itself.diffuse[crossing.texel], seen.radiance),
        known=seen.known | nearer,
        hit=seen.hit | nearer,
        p=jnp.where(column, rays.origin + rays.direction * t[:, None], seen.p),
        t=jnp.where(nearer, t, seen.t),
    )
    return met, jnp.where(nearer, int(Found.SURFACE), found).astype(jnp.int32)
