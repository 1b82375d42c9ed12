"""Pixels -> radiance from depth images: rays of each pixel's lobe, followed, looked up, repaired and averaged.

Source: [WXKP14] §3.4 and §3.5.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrefl._types import Frame, GBuffer, Lights, Mesh, Rays
from jaxrefl.core import lerp
from jaxrefl.rays import block_size, blocks_of, put_block, take_block
from jaxrefl.techniques._captured import Captured, read_stack
from jaxrefl.techniques._tracing import following, following_mirrors
from jaxrefl.techniques.clusters.cameras import ClusterCameras
from jaxrefl.techniques.clusters.concave import SelfImage, meet_cluster
from jaxrefl.techniques.clusters.confirm import confirmed
from jaxrefl.techniques.clusters.depth_images import DepthImages
from jaxrefl.techniques.clusters.hierarchy import Pyramid, follow_levels
from jaxrefl.techniques.clusters.lobes import MIRROR, lobe_rays, mirror_rays
from jaxrefl.techniques.clusters.look_up import Seen, look_beside, look_up
from jaxrefl.techniques.clusters.sums import Answer, Sums, add_seen, means_of, no_answer, start_sums
from jaxrefl.techniques.clusters.trace import Missing, trace_missing
from jaxrefl.techniques.clusters.traverse import follow, project_rays
from jaxrefl.techniques.clusters.types import Options, is_clean


class Surroundings(eqx.Module):
    """What rays may meet."""

    mesh: Mesh
    """The scene's triangles."""
    lights: Lights
    """The environment."""
    cameras: ClusterCameras
    """The clusters' cameras."""
    images: DepthImages
    """What they see."""
    maps: Captured | None = None
    """Environment maps for rays without an answer; None: they have none."""
    pyramid: Pyramid | None = None
    """Bounds of the depth images' planes; None: rays are followed texel by texel."""
    itself: SelfImage | None = None
    """What concave clusters show of themselves; None: nothing special."""
    diffuse: Float[Array, "h w 3"] | None = None
    """Diffuse light of the pixels, into which far reflections fade; None: they do not."""


def answer(frame: Frame, label: Int[Array, "h w"], around: Surroundings, *, options: Options) -> Answer:
    """What all pixels of all clusters reflect.

    Args:
        frame: Scene, G-buffer, key and tracer.
        label: Cluster of each pixel; -1 for none.
        around: What rays may meet.
        options: Samples, steps, kinds of lobes, repair.
    Returns:
        Answers.
    """
    image, smooth = no_answer(frame.gbuffer), frame.gbuffer.alpha == 0
    size = block_size(label.size, options.block)
    key = jax.random.fold_in(frame.key, 2)
    passes = (
        ((label >= 0) & smooth, MIRROR, following_mirrors(options)),
        ((label >= 0) & ~smooth, options.samples, following(options)),
    )
    for pass_number, (mask, samples, light) in enumerate(passes):
        for number, index in enumerate(blocks_of(mask, size=size)):
            own = jax.random.fold_in(jax.random.fold_in(key, pass_number), number)
            points, some = take_block((frame.gbuffer, (label, around.diffuse)), index)
            sums, missing = _block(points, some, index, own, around, samples, options)
            if missing is not None:
                sums = trace_missing(frame, points, sums, missing, own, size=size, options=light)
            image = put_block(index, image, means_of(sums, index >= 0))
    return image


@functools.partial(jax.jit, static_argnames=("samples", "options"))
def _block(
    points: GBuffer, some: tuple, index: Array, key: Array, around: Surroundings, samples: int, options: Options
) -> tuple[Sums, Missing | None]:  # fmt: skip
    label, diffuse = some
    active = (index >= 0) & (label >= 0)
    view = jnp.maximum(label, 0)
    one_for_all = options.glossy == "neighbourhood" and samples != MIRROR
    first = _see(mirror_rays(points), view, active, around, options) if one_for_all else None

    def add(sums: Sums, number: Array) -> tuple[Sums, Missing | None]:
        rays, weight = lobe_rays(points, active, key, number, samples=samples, options=options)
        if first is None:
            seen, found, steps = _see(rays, view, active, around, options)
        else:
            middle, found, steps = first
            seen = look_beside(around.images, around.cameras.views, view, rays, middle, around.lights)
        missing = None
        if options.repair == "trace":
            sure = seen.known & is_clean(found)
            missing = Missing(rays.direction, jnp.where(sure, jnp.zeros_like(weight), weight))
            seen = eqx.tree_at(lambda s: s.known, seen, sure)
        if around.maps is not None:
            seen = _from_map(seen, around.maps, points, rays)
        if diffuse is not None:
            seen = _faded(seen, diffuse, points, around.cameras.reach[view])
        return add_seen(sums, weight, seen, found, steps), missing

    return jax.lax.scan(add, start_sums(active.shape[0]), jnp.arange(max(samples, 1), dtype=jnp.int32))


def _see(rays: Rays, view: Array, active: Array, around: Surroundings, options: Options) -> tuple[Seen, Array, Array]:
    """Follow one ray per pixel and look up what it found."""
    cameras, images = around.cameras, around.images
    views, reach = cameras.views, cameras.reach[view]
    lines, ahead = project_rays(views, view, rays, reach)
    there, active = active, active & ahead & cameras.usable[view]
    if around.pyramid is None:
        crossing = follow(images.plane, lines, active, steps=options.steps, begin=images.begin)
    else:
        crossing = follow_levels(
            images.plane, around.pyramid, lines, view, active, steps=options.steps, begin=images.begin
        )
    crossing = confirmed(around.mesh, images, views, view, lines, crossing, rays, reach)
    seen, found = look_up(images, lines, crossing, rays, reach, around.lights), crossing.found
    if around.itself is not None:
        seen, found = meet_cluster(around.itself, rays, view, there, seen, found, reach, steps=options.steps)
    return seen, found, crossing.steps


def _from_map(seen: Seen, maps: Captured, points: GBuffer, rays: Rays) -> Seen:
    """An environment map's radiance where there is no answer."""
    row = maps.map_of_object[jnp.maximum(points.object, 0)]
    far = read_stack(maps.sharp, jnp.maximum(row, 0), rays.direction)
    lacks = ~seen.known & (row >= 0)
    return eqx.tree_at(
        lambda s: (s.radiance, s.known), seen, (jnp.where(lacks[:, None], far, seen.radiance), seen.known | lacks)
    )


def _faded(seen: Seen, diffuse: Array, points: GBuffer, reach: Array) -> Seen:
    """Rough reflections lose themselves in the diffuse colour towards the far plane.

    Source: [WXKP14] §3.5 (2).
    """
    share = jnp.where(seen.hit, jnp.clip(seen.t / reach, 0, 1), 1)
    colour = jnp.where((points.alpha > 0)[:, None], lerp(seen.radiance, diffuse, share), seen.radiance)
    return eqx.tree_at(lambda s: s.radiance, seen, colour)
