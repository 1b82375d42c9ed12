"""Pixels -> radiance from depth images: rays of each pixel's lobe, followed, looked up and averaged.

Source: [WXKP14] §3.4 and §3.5.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Frame, GBuffer, Lights, Rays
from jaxrefl.core import cone, dot, lerp
from jaxrefl.rays import block_size, blocks_of, put_block, take_block
from jaxrefl.surface import keep_above, mirror_direction
from jaxrefl.techniques._captured import Captured, read_stack
from jaxrefl.techniques._tracing.samples import lobe_sample, reflected_rays
from jaxrefl.techniques.clusters.cameras import ClusterCameras
from jaxrefl.techniques.clusters.concave import SelfImage, meet_cluster
from jaxrefl.techniques.clusters.depth_images import DepthImages
from jaxrefl.techniques.clusters.look_up import Seen, look_beside, look_up
from jaxrefl.techniques.clusters.traverse import follow, project_rays
from jaxrefl.techniques.clusters.types import Found, Options, Params

MIRROR = 0
"""Number of samples of pixels whose lobe is one direction."""


class Answer(eqx.Module):
    """What pixels reflect [*b], by their depth images."""

    radiance: Float[Array, "*b 3"]
    """Mean radiance of the rays that have an answer; fill 0."""
    found: Int[Array, "*b"]
    """A `Found` code; for rough pixels that of most of their rays."""
    known: Float[Array, "*b"]
    """Share of the rays that have an answer."""
    hits: Float[Array, "*b"]
    """Share of those that ended on a surface."""
    p: Float[Array, "*b 3"]
    """Mean of the reflected points, world space; fill 0."""
    t: Float[Array, "*b"]
    """Mean distance to them, world units; fill 0."""
    steps: Float[Array, "*b"]
    """Steps taken by all rays."""


class Surroundings(eqx.Module):
    """What rays may meet."""

    cameras: ClusterCameras
    """The clusters' cameras."""
    images: DepthImages
    """What they see."""
    lights: Lights
    """The environment."""
    maps: Captured | None = None
    """Environment maps for rays without an answer; None: they have none."""
    itself: SelfImage | None = None
    """What concave clusters show of themselves; None: nothing special."""
    diffuse: Float[Array, "h w 3"] | None = None
    """Diffuse light of the pixels, into which far reflections fade; None: they do not."""


def no_answer(shape: tuple[int, ...]) -> Answer:
    """An image without answers.

    Args:
        shape: Height and width.
    Returns:
        Fill values.
    """
    fields = {"radiance": (3,), "found": (), "known": (), "hits": (), "p": (3,), "t": (), "steps": ()}
    types = {"found": jnp.int32}
    return Answer(**{name: jnp.zeros((*shape, *more), types.get(name, jnp.float32)) for name, more in fields.items()})


def answer(frame: Frame, label: Int[Array, "h w"], around: Surroundings, params: Params, *, options: Options) -> Answer:
    """What all pixels of all clusters reflect.

    Args:
        frame: G-buffer and key.
        label: Cluster of each pixel; -1 for none.
        around: What rays may meet.
        params: `lobe`, `known`.
        options: Samples, steps, kinds of lobes.
    Returns:
        Answers.
    """
    image, smooth = no_answer(label.shape), frame.gbuffer.alpha == 0
    size = block_size(label.size, options.block)
    key = jax.random.fold_in(frame.key, 2)
    passes = (((label >= 0) & smooth, MIRROR), ((label >= 0) & ~smooth, options.samples))
    for pass_number, (mask, samples) in enumerate(passes):
        for number, index in enumerate(blocks_of(mask, size=size)):
            own = jax.random.fold_in(jax.random.fold_in(key, pass_number), number)
            points, some = take_block((frame.gbuffer, (label, around.diffuse)), index)
            block = _block(points, some, index, own, around, params, samples, options)
            image = put_block(index, image, block)
    return image


@functools.partial(jax.jit, static_argnames=("samples", "options"))
def _block(
    points: GBuffer, some: tuple, index: Array, key: Array, around: Surroundings, params: Params, samples: int,
    options: Options,
) -> Answer:  # fmt: skip
    label, diffuse = some
    active = (index >= 0) & (label >= 0)
    view = jnp.maximum(label, 0)
    zero, vector = jnp.zeros(active.shape, jnp.float32), jnp.zeros_like(points.p)
    one_for_all = options.glossy == "neighbourhood" and samples != MIRROR
    first = _see(_mirror_rays(points), view, active, around, options) if one_for_all else None

    def add(number: Array, sums: tuple[Array, ...]) -> tuple[Array, ...]:
        rays, weight = _lobe_rays(points, active, key, number, params, samples, options)
        if first is None:
            seen, found, steps = _see(rays, view, active, around, options)
        else:
            middle, found, steps = first
            seen = look_beside(around.images, around.cameras.views, view, rays, middle, around.lights)
        if around.maps is not None:
            seen = _from_map(seen, around.maps, points, rays)
        colour = seen.radiance if diffuse is None else _faded(seen, diffuse, points, around.cameras.reach[view])
        known = jnp.where(seen.known, weight, 0)
        hit = jnp.where(seen.hit, known, 0)
        codes = (jnp.where(found == int(code), 1.0, 0.0) for code in Found)
        added = (known, known[:, None] * colour, hit, hit[:, None] * seen.p, hit * seen.t, weight,
                 steps.astype(jnp.float32), jnp.stack(list(codes), -1))  # fmt: skip
        return tuple(x + y for x, y in zip(sums, added, strict=True))

    sums = (zero, vector, zero, vector, zero, zero, zero, jnp.zeros((*active.shape, len(Found)), jnp.float32))
    number = jnp.zeros((), jnp.int32)
    sums = add(number, sums) if samples == MIRROR else jax.lax.fori_loop(0, samples, add, sums)
    known, radiance, hit, p, t, weight, steps, codes = sums
    inverse_known, inverse_hit = (1 / jnp.where(x > 0, x, 1) for x in (known, hit))
    share = known / jnp.where(weight > 0, weight, 1)
    found = jnp.argmax(codes, -1).astype(jnp.int32)
    clean = codes[:, int(Found.SURFACE)] + codes[:, int(Found.SKY)]
    if samples != MIRROR:
        mostly = jnp.where(codes[:, int(Found.NO_CAMERA)] > samples / 2, int(Found.NO_CAMERA), int(Found.HIDDEN))
        found = jnp.where(clean < params.known * samples, mostly, found).astype(jnp.int32)
    return Answer(
        radiance=radiance * inverse_known[:, None],
        found=jnp.where(active, found, int(Found.NONE)).astype(jnp.int32),
        known=jnp.where(active, share, 0),
        hits=hit * inverse_known,
        p=p * inverse_hit[:, None],
        t=t * inverse_hit,
        steps=steps,
    )


def _lobe_rays(
    points: GBuffer, active: Array, key: Array, number: Array, params: Params, samples: int, options: Options
) -> tuple[Rays, Float[Array, "n"]]:
    if samples == MIRROR:
        return _mirror_rays(points), jnp.where(active, 1.0, 0.0)
    if options.lobes == "ggx":
        rays, weight = reflected_rays(points, active, key, number)
        return Rays(points.p, rays.direction), weight
    return cone_rays(points, active, lobe_sample(key, number, active.shape[0]), params)


def _mirror_rays(points: GBuffer) -> Rays:
    return Rays(points.p, mirror_direction(points))


def cone_rays(
    points: GBuffer, active: Bool[Array, "n"], u: Float[Array, "n 2"], params: Params
) -> tuple[Rays, Float[Array, "n"]]:
    r"""Rays spread evenly over a cone around the mirror direction.

    Its half angle is $2 \arctan(k \alpha)$: twice that of the half vectors it takes in.

    Args:
        points: G-buffer of the pixels.
        active: Which pixels count.
        u: Uniform numbers in [0, 1).
        params: k is `lobe`.
    Returns:
        Rays, and their weights: 1, or 0 below the surface.
    Source: [WXKP14] §3.5 (3); the paper does not say how its cone follows from the glossiness.
    """
    direction = cone(u, mirror_direction(points), jnp.cos(2 * jnp.arctan(params.lobe * points.alpha)))
    above = dot(direction, points.n) > 0
    return Rays(points.p, keep_above(direction, points.n)), jnp.where(active & above, 1.0, 0.0)


def _see(rays: Rays, view: Array, active: Array, around: Surroundings, options: Options) -> tuple[Seen, Array, Array]:
    """Follow one ray per pixel and look up what it found."""
    cameras = around.cameras
    reach = cameras.reach[view]
    lines, ahead = project_rays(cameras.views, view, rays, reach)
    crossing = follow(around.images.plane, lines, active & ahead & cameras.usable[view], steps=options.steps)
    seen = look_up(around.images, lines, crossing, rays, reach, around.lights)
    if around.itself is not None:
        seen = meet_cluster(around.itself, rays, view, active, seen, reach, steps=options.steps)
    return seen, crossing.found, crossing.steps


def _from_map(seen: Seen, maps: Captured, points: GBuffer, rays: Rays) -> Seen:
    """An environment map's radiance where there is no answer."""
    row = maps.map_of_object[jnp.maximum(points.object, 0)]
    far = read_stack(maps.sharp, jnp.maximum(row, 0), rays.direction)
    lacks = ~seen.known & (row >= 0)
    return eqx.tree_at(
        lambda s: (s.radiance, s.known), seen, (jnp.where(lacks[:, None], far, seen.radiance), seen.known | lacks)
    )


def _faded(seen: Seen, diffuse: Array, points: GBuffer, reach: Array) -> Float[Array, "n 3"]:
    """Rough reflections lose themselves in the diffuse colour towards the far plane.

    Source: [WXKP14] §3.5 (2).
    """
    share = jnp.where(seen.hit, jnp.clip(seen.t / reach, 0, 1), 1)
    return jnp.where((points.alpha > 0)[:, None], lerp(seen.radiance, diffuse, share), seen.radiance)
