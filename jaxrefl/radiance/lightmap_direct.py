"""Light that reaches texels straight from emitters: places with rays in cosine distribution -> direct light.

Emissive triangles are found by light samples and by the rays themselves, combined by the balance heuristic, so that a
lamp close to a wall is as smooth as one far away. All other lights have their samples from `light_samples`.

Source: [VG95] §3 for the balance heuristic.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt32

from jaxrefl._types import GBuffer, Hits, Rays, Scene, Tracer
from jaxrefl.core import dot, owen_sobol, safe
from jaxrefl.radiance.direct import arriving_light
from jaxrefl.radiance.light_points import area_density, area_light_point, density_of_hit, emissive_point
from jaxrefl.radiance.light_samples import (
    DirectOptions,
    LightPoints,
    LightSamples,
    receivers_of,
    sample_light_points,
    shadow_rays,
)
from jaxrefl.rays.offset import offset_origin
from jaxrefl.surface.coupling import coupling
from jaxrefl.surface.gbuffer import build_gbuffer

LAMP_SAMPLES = 8
"""Light samples of emissive triangles per path: a shadow ray is much cheaper than a path, and direct light has the
finest detail, of which smoothing must take nothing away."""
_PAIR = 2**20
"""Pair of random numbers of the light samples, far from those of any path."""


def other_light(scene: Scene, tracer: Tracer, points: GBuffer, key: Array, samples: int) -> Float[Array, "n 3"]:
    """Light from the environment and from lights without a shape, and the ambient term.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        points: Places [n].
        key: Random key.
        samples: Samples of the environment at each place.
    Returns:
        Irradiance / pi.
    """
    scene = dataclasses.replace(scene, lights=dataclasses.replace(scene.lights, area=None))
    ambient = jnp.broadcast_to(scene.lights.ambient, points.p.shape)
    found = _light_points(scene, points, key, DirectOptions(environment_samples=samples))
    if found is None:
        return ambient
    shadows = _shadow_rays(points, found)
    return arriving_light(shadows, tracer.occluded(shadows.rays, shadows.t_max)) / jnp.pi + ambient


@eqx.filter_jit
def _light_points(scene: Scene, points: GBuffer, key: Array, options: DirectOptions) -> LightPoints | None:
    return sample_light_points(scene, receivers_of(points), key, options=options)


@jax.jit
def _shadow_rays(points: GBuffer, found: LightPoints) -> LightSamples:
    samples = shadow_rays(receivers_of(points), found)
    if points.coupled is None:
        return samples
    share = jax.vmap(lambda wi: coupling(points, dot(points.ns, wi)))(samples.rays.direction)
    return eqx.tree_at(lambda x: x.irradiance, samples, samples.irradiance * share[..., None])


def lamp_light(
    scene: Scene,
    tracer: Tracer,
    points: GBuffer,
    numbers: tuple[UInt32[Array, "k"], UInt32[Array, "k"]],
    rays: Rays,
    weight: Float[Array, "k"],
    hits: Hits,
) -> Float[Array, "k 3"]:
    """Light from emissive triangles.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        points: Places, one per ray.
        numbers: Sequence and number of each ray.
        rays: A ray from each place, in cosine distribution.
        weight: Weights of the rays.
        hits: What they meet.
    Returns:
        Irradiance / pi of each sample.
    """
    if scene.lights.area is None:
        return jnp.zeros_like(points.p)
    light = _met_lamps(scene, points, rays, weight, hits)
    sequence, number = numbers
    for sample in range(LAMP_SAMPLES):
        own = number * jnp.uint32(LAMP_SAMPLES) + jnp.uint32(sample)
        shadow, t_max, brought = _towards_lamps(scene, points, sequence, own)
        light = _add_free(light, brought, tracer.occluded(shadow, t_max))
    return light


@jax.jit
def _towards_lamps(
    scene: Scene, points: GBuffer, sequence: UInt32[Array, "k"], number: UInt32[Array, "k"]
) -> tuple[Rays, Float[Array, "k"], Float[Array, "k 3"]]:
    """Shadow rays, their lengths, and what they bring if nothing is in the way."""
    if scene.lights.area is None:
        raise ValueError("scene: has no emissive triangles")
    u = jnp.stack(owen_sobol(sequence, number, jnp.full_like(number, _PAIR)), -1)
    light = area_light_point(emissive_point(scene, scene.lights.area, u), points.p)
    cos = jnp.where(dot(points.n, light.wi) > 0, jnp.maximum(dot(points.ns, light.wi), 0), 0) / jnp.pi
    # 1 / (n d + c), with the density d of each of n light samples and that of the ray, c.
    share = safe.divide(light.inverse_density, LAMP_SAMPLES + cos * light.inverse_density) * cos
    brought = light.radiance * (share * coupling(points, jnp.pi * cos))[:, None]
    origin = offset_origin(points.p, points.n, points.p_error, light.wi)
    way = light.end - origin
    t_max = jnp.where(brought.max(-1) > 0, safe.norm(way), 0)
    return Rays(origin, safe.normalise(way)), t_max, brought


@jax.jit
def _add_free(
    light: Float[Array, "k 3"], brought: Float[Array, "k 3"], blocked: Bool[Array, "k"]
) -> Float[Array, "k 3"]:
    return light + jnp.where(blocked[:, None], 0, brought)


@jax.jit
def _met_lamps(scene: Scene, points: GBuffer, rays: Rays, weight: Float[Array, "k"], hits: Hits) -> Float[Array, "k 3"]:
    """Emission of the lamps that the rays meet by themselves."""
    seen = build_gbuffer(scene, rays, hits)
    if scene.lights.area is None or seen.emission is None:
        return jnp.zeros_like(points.p)
    density = jnp.maximum(dot(points.ns, rays.direction), 0) / jnp.pi
    per_area = area_density(scene.lights.area, scene.mesh.faces.shape[0])
    found = density_of_hit(per_area, seen.triangle, seen.t, jnp.abs(dot(seen.n, rays.direction)))
    share = safe.divide(density, density + LAMP_SAMPLES * found)
    return seen.emission * (weight * share)[:, None]
