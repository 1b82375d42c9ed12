"""How paths move: start, draw numbers, arrive at a surface, choose a direction, go on or end.

Stages are compiled apart where their results fan out, because XLA on a CPU computes what it fuses with several results
again for each of them. All have the block's shape, so nothing is compiled again from bounce to bounce; slots whose path
has ended are refilled from the batch instead of being carried along.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import GBuffer, Rays, Scene
from jaxrefl.core import largest, owen_sobol, safe, uniform
from jaxrefl.radiance.path_types import (
    DIRECTION,
    EMITTED,
    LOBE,
    PAIRS,
    ROULETTE,
    Batch,
    PathOptions,
    Paths,
    Shadows,
    Vertex,
    pair_of,
)
from jaxrefl.rays.offset import offset_origin
from jaxrefl.surface.bsdf import STRAIGHT, Draws, Scattered, draw_directions, lobes_of, scatter
from jaxrefl.surface.specular import LobeAlbedo, lobe_albedo


@functools.partial(jax.jit, static_argnames="count")
def start(batch: Batch, *, count: int) -> Paths:
    """A block with its first rays.

    Args:
        batch: The rays.
        count: Slots.
    Returns:
        Paths [n]; slots beyond the end of the batch are empty.
    """
    blank = Paths(
        job=jnp.full((count,), -1, jnp.int32),
        rays=Rays(jnp.zeros((count, 3), jnp.float32), jnp.ones((count, 3), jnp.float32)),
        throughput=jnp.zeros((count, 3), jnp.float32),
        factor=jnp.zeros((count, 3), jnp.float32),
        density=jnp.zeros((count,), jnp.float32),
        depth=jnp.zeros((count,), jnp.int32),
        layer=jnp.zeros((count,), jnp.int32),
        eta_scale=jnp.zeros((count,), jnp.float32),
        sequence=jnp.zeros((count,), jnp.uint32),
        number=jnp.zeros((count,), jnp.uint32),
        next_job=jnp.asarray(0, jnp.int32),
    )
    return _refill(batch, blank, jnp.zeros((count,), bool))


def _refill(batch: Batch, paths: Paths, alive: Bool[Array, "n"]) -> Paths:
    """Give the batch's next rays to the slots that are not alive."""
    rank = jnp.cumsum(~alive, dtype=jnp.int32) - 1
    job = paths.next_job + rank
    fresh = ~alive & (job < batch.sequence.shape[0])
    row = jnp.where(fresh, job, 0)
    new = fresh[:, None]
    one = jnp.ones_like(paths.throughput)
    zero = jnp.zeros_like(paths.depth)
    return Paths(
        job=jnp.where(alive, paths.job, jnp.where(fresh, job, -1)),
        rays=Rays(
            jnp.where(new, batch.rays.origin[row], paths.rays.origin),
            jnp.where(new, batch.rays.direction[row], paths.rays.direction),
        ),
        throughput=jnp.where(new, one, paths.throughput),
        factor=jnp.where(new, one, paths.factor),
        density=jnp.where(fresh, 0, paths.density),
        depth=jnp.where(fresh, zero, paths.depth),
        layer=jnp.where(fresh, zero + EMITTED, paths.layer),
        eta_scale=jnp.where(fresh, 1, paths.eta_scale),
        sequence=jnp.where(fresh, batch.sequence[row], paths.sequence),
        number=jnp.where(fresh, batch.number[row], paths.number),
        next_job=paths.next_job + fresh.sum(dtype=jnp.int32),
    )


@functools.partial(jax.jit, static_argnames="count")
def drain(paths: Paths, shadows: Shadows, used: Bool[Array, "n"], *, count: int) -> tuple[Paths, Shadows]:
    """What is still under way, in a smaller block.

    Args:
        paths: The paths.
        shadows: The light samples.
        used: Which slots have one of either; at most `count`.
        count: Slots of the smaller block.
    Returns:
        Paths and light samples [count]; slots beyond those that were used are empty.
    """
    slot = jnp.nonzero(used, size=count, fill_value=-1)[0]
    there = slot >= 0
    paths, shadows = jax.tree.map(lambda x: x[jnp.maximum(slot, 0)] if x.ndim else x, (paths, shadows))
    paths = dataclasses.replace(paths, job=jnp.where(there, paths.job, -1))
    shadows = dataclasses.replace(shadows, t_max=jnp.where(there, shadows.t_max, 0))
    return paths, shadows


@functools.partial(jax.jit, static_argnames="options")
def numbers(paths: Paths, *, options: PathOptions) -> Float[Array, "8 n"]:
    """Random numbers of the vertex at which each path is about to arrive.

    Args:
        paths: The paths; what they draw depends on their ray and their depth alone, not on their slot.
        options: Static knobs.
    Returns:
        Numbers in [0, 1).
    """
    draw = owen_sobol if options.sampler == "sobol" else uniform
    first = paths.depth.astype(jnp.uint32) * jnp.uint32(PAIRS) + jnp.uint32(1)
    return jnp.stack([x for i in range(PAIRS) for x in draw(paths.sequence, paths.number, first + jnp.uint32(i))])


albedo_at = jax.jit(lobe_albedo)
"""`surface.lobe_albedo` as a stage of its own."""


@functools.partial(jax.jit, static_argnames="options")
def arrive(
    scene: Scene,
    paths: Paths,
    points: GBuffer,
    albedo: LobeAlbedo,
    random: Float[Array, "8 n"],
    *,
    options: PathOptions,
) -> Vertex:
    """What paths have arrived at.

    Args:
        scene: The scene.
        paths: The paths whose rays were cast.
        points: What they hit.
        albedo: From `albedo_at`.
        random: Numbers of this vertex.
        options: Static knobs.
    Returns:
        Points with their lobes, and the throughput with the absorption of the medium on the way.
    """
    throughput = paths.throughput
    if points.transmission is not None:
        coefficient = scene.materials.attenuation[jnp.maximum(points.material, 0)]
        inside = points.valid & ~points.outside & (points.transmission > 0)
        throughput = throughput * jnp.exp(-coefficient * jnp.where(inside, points.t, 0)[:, None])
    stays = points.valid & (paths.job >= 0)
    if points.opacity is not None:
        choice = random[2 * LOBE]
        stays = stays & (choice < points.opacity)
        random = random.at[2 * LOBE].set(jnp.clip(safe.divide(choice, points.opacity), 0, 1))
    return Vertex(points, lobes_of(points, albedo, options.scattering), random, throughput, stays)


@jax.jit
def draw(vertex: Vertex) -> Draws:
    """A direction from each lobe.

    Args:
        vertex: Where paths are.
    Returns:
        The directions.
    """
    return draw_directions(vertex.points, vertex.lobes, pair_of(vertex.numbers, DIRECTION))


@functools.partial(jax.jit, static_argnames="options")
def choose(scene: Scene, vertex: Vertex, draws: Draws, *, options: PathOptions) -> Scattered:
    """The direction in which each path goes on.

    Args:
        scene: The scene.
        vertex: Where paths are.
        draws: From `draw`.
        options: Static knobs.
    Returns:
        Directions with weights and densities.
    """
    thin = None
    if vertex.points.transmission is not None:
        thin = scene.materials.thin[jnp.maximum(vertex.points.material, 0)]
    choice = pair_of(vertex.numbers, LOBE)
    return scatter(vertex.points, vertex.lobes, draws, thin, choice, options.scattering)


@functools.partial(jax.jit, static_argnames="options")
def go_on(batch: Batch, paths: Paths, vertex: Vertex, sample: Scattered, *, options: PathOptions) -> Paths:
    """Send the paths on their way, end the ones that are done, and give their slots to the next rays.

    Args:
        batch: The rays.
        paths: The paths as they arrived.
        vertex: Where they are.
        sample: From `choose`.
        options: Static knobs.
    Returns:
        The paths as they leave.
    """
    points, random = vertex.points, vertex.numbers
    straight = points.valid & ~vertex.stays
    lobe = jnp.where(straight, STRAIGHT, sample.lobe)
    passes = straight[:, None]
    wi = jnp.where(passes, paths.rays.direction, sample.wi)
    first = (paths.layer == EMITTED)[:, None] & ~passes
    weight = jnp.where(passes, 1, sample.weight * jnp.where(first, 1, sample.fresnel))
    throughput = vertex.throughput * weight
    factor = jnp.where(first, sample.fresnel, paths.factor)
    eta_scale = paths.eta_scale * jnp.where(straight, 1, sample.eta_scale)
    depth = paths.depth + 1

    carried = largest(throughput * factor)
    stay = jnp.where(depth > options.roulette_from, jnp.clip(carried * eta_scale, 0.05, 0.95), 1)
    alive = (paths.job >= 0) & points.valid & (carried > 0) & (depth <= options.bounces)
    alive = alive & ((stay >= 1) | (random[2 * ROULETTE] < stay))
    origin = offset_origin(points.p, points.n, points.p_error, wi)
    there = alive[:, None]
    gone = Paths(
        job=paths.job,
        rays=Rays(jnp.where(there, origin, paths.rays.origin), jnp.where(there, wi, paths.rays.direction)),
        throughput=throughput / stay[:, None],
        factor=factor,
        density=jnp.where(straight, paths.density, sample.density),
        depth=depth,
        layer=jnp.where((paths.layer == EMITTED) & ~straight, lobe + 1, paths.layer),
        eta_scale=eta_scale,
        sequence=paths.sequence,
        number=paths.number,
        next_job=paths.next_job,
    )
    return _refill(batch, gone, alive)
