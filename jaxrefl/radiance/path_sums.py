"""What paths see, added to the sums of their rays: lights that were not blocked, emission, sky, ambient term."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Lights, Scene
from jaxrefl.core import apart, dot, largest, safe
from jaxrefl.radiance.light_points import (
    density_of_hit,
)
from jaxrefl.radiance.path_types import (
    CHANNELS,
    DIFFUSE,
    EMITTED,
    REFLECTED,
    Paths,
    Shadows,
    Vertex,
    own_layer,
)
from jaxrefl.scene.environment import environment_light, environment_radiance


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
    sky = apart(escaped, functools.partial(_sky, kinds=kinds, ambient=ambient), scene.lights, paths)
    seen = jnp.where(escaped[:, None], sky, seen)
    rows.append(_rows(paths.job, paths.layer, vertex.throughput * seen, paths.factor, layered))
    if ambient:
        light = vertex.throughput * vertex.lobes.diffuse * jnp.broadcast_to(scene.lights.ambient, points.p.shape)
        own = own_layer(paths, DIFFUSE, light, 1 - vertex.lobes.specular)
        rows.append(_rows(jnp.where(vertex.stays, paths.job, -1), *own, layered))
    index, value = (jnp.concatenate(parts) for parts in zip(*rows, strict=True))
    return sums.at[index].add(value, mode="drop")


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


def _sky(lights: Lights, paths: Paths, *, kinds: tuple[str, ...], ambient: bool) -> Float[Array, "n 3"]:
    """What paths see that leave the scene."""
    seen = jnp.zeros_like(paths.throughput)
    if (environment := lights.environment) is not None:
        if "environment" in kinds:
            seen, found = environment_light(environment, paths.rays.direction)
            seen = seen * _by_chance(paths.density, found / len(kinds))[:, None]
        else:
            seen = environment_radiance(environment, paths.rays.direction)
    if ambient:
        # Diffuse lobes have had their ambient light at the surface, without shadows; only mirrors still look for it.
        specular = (paths.density == 0) | (paths.layer == REFLECTED)
        seen = seen + jnp.where(specular[:, None], jnp.broadcast_to(lights.ambient, seen.shape), 0)
    return seen
