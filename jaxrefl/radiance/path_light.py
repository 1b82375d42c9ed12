"""The light sample at each vertex: pick a light, aim at it, ask the surface, make the shadow ray.

Four stages, compiled apart, because what XLA on a CPU fuses with several results it computes for each of them.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import Lights, Rays, Scene
from jaxrefl.core import largest, safe
from jaxrefl.radiance.light_points import (
    FAR,
    LightPoint,
    area_light_point,
    emissive_point,
    punctual_light_point,
)
from jaxrefl.radiance.path_types import (
    DIFFUSE,
    LIGHT,
    REFLECTED,
    ROULETTE,
    Lamps,
    PathOptions,
    Paths,
    Shadows,
    Vertex,
    own_layer,
    pair_of,
)
from jaxrefl.rays.offset import offset_origin
from jaxrefl.scene.environment import sample_environment
from jaxrefl.surface.bsdf import Response, respond

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
    lights, u = scene.lights, pair_of(random, LIGHT)
    which = random[2 * ROULETTE + 1] * len(kinds)
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


class Aimed(eqx.Module):
    """Where light samples lie, as those who look for light see them."""

    point: LightPoint
    """The points."""
    density: Float[Array, "n"]
    """Density with which they were found, 1/sr; huge for lights that paths cannot hit by chance."""


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
        point = punctual_light_point(lamps.punctual, points.p, points.p_error, pair_of(random, LIGHT))
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
        own_layer(paths, layer, arriving * value * safe.divide(density, density + other, fill=1.0)[:, None], factor)
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
