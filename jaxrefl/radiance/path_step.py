"""The jitted stages of one step of a block of paths: arrive, gather what is seen, look for light, go on.

Stages are compiled apart where their results fan out, because XLA on a CPU computes what it fuses with several results
again for each of them. All have the block's shape, so nothing is compiled again from bounce to bounce; slots whose path
has ended are refilled from the batch instead of being carried along.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import GBuffer, Lights, Rays, Scene
from jaxrefl.core import dot, largest, owen_sobol, safe, uniform
from jaxrefl.radiance.light_points import (
    FAR,
    LightPoint,
    area_light_point,
    density_of_hit,
    emissive_point,
    punctual_light_point,
)
from jaxrefl.radiance.path_types import (
    CHANNELS,
    DIFFUSE,
    EMITTED,
    REFLECTED,
    Batch,
    Lamps,
    PathOptions,
    Paths,
    Shadows,
    Vertex,
)
from jaxrefl.rays.offset import offset_origin
from jaxrefl.scene.environment import environment_pdf, environment_radiance, sample_environment
from jaxrefl.surface.bsdf import STRAIGHT, Draws, Response, Scattered, draw_directions, lobes_of, respond, scatter
from jaxrefl.surface.specular import LobeAlbedo, lobe_albedo

PAIRS = 4
"""Pairs of random numbers per vertex; pair 0 of a sequence is left to whoever makes the rays."""
_LIGHT, _DIRECTION, _LOBE, _ROULETTE = range(PAIRS)
_CERTAIN = 1e30
"""Density, 1/sr, of a direction that only a light sample can find."""


def light_kinds(lights: Lights) -> tuple[str, ...]:
    """Kinds of light that shadow rays are sent to; a constant sky is found by the paths themselves, without noise.

    Args:
        lights: The scene's lights.
    Returns:
        Some of "area", "environment" and "punctual".
    """
    sky = lights.environment is not None and lights.environment.probability.size > 1
    there = {"area": lights.area is not None, "environment": sky, "punctual": lights.punctual is not None}
    return tuple(kind for kind, is_there in there.items() if is_there)


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
        choice = random[2 * _LOBE]
        stays = stays & (choice < points.opacity)
        random = random.at[2 * _LOBE].set(jnp.clip(safe.divide(choice, points.opacity), 0, 1))
    return Vertex(points, lobes_of(points, albedo, options.scattering), random, throughput, stays)


@functools.partial(jax.jit, static_argnames=("kinds", "ambient", "layered"), donate_argnames="sums")
def gather(
    scene: Scene,
    per_area: Float[Array, "f"] | None,
    sums: Float[Array, "m 3"],
    paths: Paths,
    vertex: Vertex,
    shadows: Shadows,
    blocked: Bool[Array, "n"],
    *,
    kinds: tuple[str, ...],
    ambient: bool,
    layered: bool,
) -> Float[Array, "m 3"]:
    """Add the light samples that were not blocked, and what the paths see where they have arrived.

    Light that is found by chance counts with the balance heuristic against the chance that a light sample finds it.

    Args:
        scene: The scene.
        per_area: From `light_points.area_density`; None: nothing emits.
        sums: Sums of the batch, a row per ray and channel; consumed.
        paths: The paths before they go on.
        vertex: Where they are.
        shadows: Light samples of the step before.
        blocked: Which of those were blocked.
        kinds: From `light_kinds`.
        ambient: Whether the ambient term is not 0.
        layered: Whether there are `CHANNELS` rows per ray or one.
    Returns:
        The new sums.
    Source: [VG95] §3 for the balance heuristic.
    """
    points = vertex.points
    lit = jnp.where((shadows.t_max > 0) & ~blocked, shadows.job, -1)
    parts = zip(shadows.layers, shadows.light, shadows.factors, strict=True)
    rows = [_rows(lit, *part, layered) for part in parts]
    seen = jnp.zeros_like(points.p)
    if points.emission is not None and per_area is not None:
        cos = jnp.abs(dot(points.n, points.wo))
        found = density_of_hit(per_area, points.triangle, points.t, cos) / len(kinds)
        seen = points.emission * _by_chance(paths.density, found)[:, None]
    seen = jnp.where(vertex.stays[:, None], seen, 0)
    escaped = (paths.job >= 0) & ~points.valid
    seen = jnp.where(escaped[:, None], _sky(scene.lights, paths, kinds, ambient), seen)
    rows.append(_rows(paths.job, paths.layer, vertex.throughput * seen, paths.factor, layered))
    if ambient:
        light = vertex.throughput * vertex.lobes.diffuse * jnp.broadcast_to(scene.lights.ambient, points.p.shape)
        own = _own(paths, DIFFUSE, light, 1 - vertex.lobes.specular)
        rows.append(_rows(jnp.where(vertex.stays, paths.job, -1), *own, layered))
    index, value = (jnp.concatenate(parts) for parts in zip(*rows, strict=True))
    return sums.at[index].add(value, mode="drop")


def _own(
    paths: Paths, layer: int, light: Float[Array, "n 3"], factor: Float[Array, "n 3"]
) -> tuple[Int[Array, "n"], Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Layer, light and first weight of what a lobe scatters: at the first surface its own, later those of the path."""
    first = paths.layer == EMITTED
    own = first[:, None]
    layers = jnp.where(first, jnp.full_like(paths.layer, layer), paths.layer)
    return layers, jnp.where(own, light, light * factor), jnp.where(own, factor, paths.factor)


def _rows(
    job: Int[Array, "n"], layer: Int[Array, "n"], light: Float[Array, "n 3"], factor: Float[Array, "n 3"], layered: bool
) -> tuple[Int[Array, "k"], Float[Array, "k 3"]]:
    """Which rows of the sums to add to, and what; rows past the end are dropped."""
    nowhere = jnp.iinfo(jnp.int32).max
    there = (job >= 0) & (largest(light) > 0)
    if not layered:
        return jnp.where(there, job, nowhere), light * factor
    before = jnp.where(there, job * CHANNELS + layer, nowhere)
    after = jnp.where(there & (layer > EMITTED), job * CHANNELS + layer + 3, nowhere)
    return jnp.concatenate([before, after]), jnp.concatenate([light, light * factor])


def _by_chance(density: Float[Array, "n"], light_density: Float[Array, "n"]) -> Float[Array, "n"]:
    """Balance heuristic of a direction that was scattered; a delta (density 0) could not have been found otherwise."""
    return jnp.where(density > 0, safe.divide(density, density + light_density, fill=1.0), 1)


def _sky(lights: Lights, paths: Paths, kinds: tuple[str, ...], ambient: bool) -> Float[Array, "n 3"]:
    """What paths see that leave the scene."""
    seen = jnp.zeros_like(paths.throughput)
    if (environment := lights.environment) is not None:
        seen = environment_radiance(environment, paths.rays.direction)
        if "environment" in kinds:
            found = environment_pdf(environment, paths.rays.direction) / len(kinds)
            seen = seen * _by_chance(paths.density, found)[:, None]
    if ambient:
        # Diffuse lobes have had their ambient light at the surface, without shadows; only mirrors still look for it.
        specular = (paths.density == 0) | (paths.layer == REFLECTED)
        seen = seen + jnp.where(specular[:, None], jnp.broadcast_to(lights.ambient, seen.shape), 0)
    return seen


class Aimed(eqx.Module):
    """Where light samples lie, as those who look for light see them."""

    point: LightPoint
    """The points."""
    density: Float[Array, "n"]
    """Density with which they were found, 1/sr; huge for lights that paths cannot hit by chance."""


@functools.partial(jax.jit, static_argnames="options")
def answer(vertex: Vertex, aimed: Aimed, *, options: PathOptions) -> Response:
    """What each lobe makes of a light.

    Args:
        vertex: Where paths are.
        aimed: From `aim`.
        options: Static knobs.
    Returns:
        Values and densities of the lobes.
    """
    return respond(vertex.points, vertex.lobes, aimed.point.wi, options.scattering)


@functools.partial(jax.jit, static_argnames="options")
def look_for_light(
    paths: Paths,
    vertex: Vertex,
    aimed: Aimed,
    response: Response,
    *,
    options: PathOptions,
) -> Shadows:
    """One light sample per path, with what each lobe makes of it.

    Args:
        paths: The paths, before they go on.
        vertex: Where they are.
        aimed: From `aim`.
        response: From `answer`.
        options: Static knobs.
    Returns:
        Shadow rays, and the contributions to the two layers.
    Source: [PBRT4] §13.4.
    """
    points, lobes = vertex.points, vertex.lobes
    light, density = aimed.point, aimed.density
    arriving = vertex.throughput * light.radiance * light.inverse_density[:, None]
    parts = (
        (DIFFUSE, response.diffuse, 1 - lobes.specular, response.diffuse_density),
        (REFLECTED, response.reflected, response.fresnel, response.reflected_density),
    )
    found = [
        _own(paths, layer, arriving * value * safe.divide(density, density + other, fill=1.0)[:, None], factor)
        for layer, value, factor, other in parts
    ]
    layers, brought, factors = zip(*found, strict=True)
    origin = offset_origin(points.p, points.n, points.p_error, light.wi)
    way = light.end - origin
    brings = vertex.stays & (paths.depth < options.bounces) & (largest(brought[0] + brought[1]) > 0)
    return Shadows(
        rays=Rays(origin, safe.normalise(way)),
        t_max=jnp.where(brings, safe.norm(way), 0),
        job=jnp.where(brings, paths.job, -1),
        layers=layers,
        light=brought,
        factors=factors,
    )


@functools.partial(jax.jit, static_argnames="kinds")
def aim(scene: Scene, vertex: Vertex, lamps: Lamps, *, kinds: tuple[str, ...]) -> Aimed:
    """A point on one light of one kind, and the density with which it was found.

    Args:
        scene: The scene.
        vertex: Where paths are.
        lamps: From `pick_lamps`.
        kinds: From `light_kinds`, not empty.
    Returns:
        The points, and their densities.
    """
    points, random = vertex.points, vertex.numbers
    found: list[Aimed] = []
    if lamps.area is not None:
        point = area_light_point(lamps.area, points.p)
        found.append(Aimed(point, safe.divide(jnp.ones_like(points.t), point.inverse_density)))
    if lamps.sky is not None:
        wi, radiance, density = lamps.sky
        point = LightPoint(wi, wi * FAR, radiance, safe.divide(jnp.ones_like(density), density))
        found.append(Aimed(point, density))
    if lamps.punctual is not None and scene.lights.punctual is not None:
        point = punctual_light_point(lamps.punctual, points.p, points.p_error, _pair(random, _LIGHT))
        count = scene.lights.punctual.directional.shape[0]
        point = dataclasses.replace(point, inverse_density=point.inverse_density * count)
        found.append(Aimed(point, jnp.full_like(points.t, _CERTAIN)))
    chosen = found[0]
    for number, other in enumerate(found[1:], start=1):
        meant = lamps.kind == number
        pick = lambda x, y, m=meant: jnp.where(m.reshape(-1, *[1] * (x.ndim - 1)), y, x)  # noqa: E731
        chosen = jax.tree.map(pick, chosen, other)
    point = dataclasses.replace(chosen.point, inverse_density=chosen.point.inverse_density * len(kinds))
    return Aimed(point, chosen.density / len(kinds))


@functools.partial(jax.jit, static_argnames="kinds")
def pick_lamps(scene: Scene, random: Float[Array, "8 n"], *, kinds: tuple[str, ...]) -> Lamps:
    """One light of each kind per path: all that can be looked up without knowing who looks.

    Args:
        scene: The scene.
        random: Numbers of the vertex.
        kinds: From `light_kinds`, not empty.
    Returns:
        The lights.
    """
    lights, u = scene.lights, _pair(random, _LIGHT)
    which = random[2 * _ROULETTE + 1] * len(kinds)
    kind = jnp.minimum(which.astype(jnp.int32), len(kinds) - 1)
    area, sky, punctual = None, None, None
    if lights.area is not None:
        area = emissive_point(scene, lights.area, u)
    if "environment" in kinds and lights.environment is not None:
        sky = sample_environment(lights.environment, u)
    if lights.punctual is not None:
        count = lights.punctual.directional.shape[0]
        row = jnp.minimum(((which - kind.astype(which.dtype)) * count).astype(jnp.int32), count - 1)
        punctual = jax.tree.map(lambda x: x[row], lights.punctual)
    return Lamps(kind, area, sky, punctual)


def _pair(random: Float[Array, "8 n"], pair: int) -> Float[Array, "n 2"]:
    return jnp.stack([random[2 * pair], random[2 * pair + 1]], -1)


@jax.jit
def draw(vertex: Vertex) -> Draws:
    """A direction from each lobe.

    Args:
        vertex: Where paths are.
    Returns:
        The directions.
    """
    return draw_directions(vertex.points, vertex.lobes, _pair(vertex.numbers, _DIRECTION))


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
    choice = _pair(vertex.numbers, _LOBE)
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
    alive = alive & ((stay >= 1) | (random[2 * _ROULETTE] < stay))
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
