"""Radiance that arrives along rays: Rays -> Incoming.

The colour of what a ray hits follows the rule of the papers this library implements: a reflective surface seen in a
reflection shows its emission and diffuse component (plus the ambient term in its specular colour).
`IncomingOptions.bounces` follows mirrors further; refractive surfaces are followed through up to `interfaces`
interfaces, greedily: refraction where there is one, total internal reflection where there is not. The diffuse component
is that of `light_model`; with its model `path` no rule is left, and rays bring all light that arrives along them.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import GBuffer, Hits, Rays, Scene, Tracer
from jaxrefl.core import dot, pixel_sequences, seed_of
from jaxrefl.radiance.light_model import LightOptions, diffuse_light
from jaxrefl.radiance.path import path_radiance
from jaxrefl.radiance.path_types import PathOptions
from jaxrefl.rays.offset import offset_origin
from jaxrefl.surface.gbuffer import build_gbuffer
from jaxrefl.surface.specular import (
    reflective,
    refractive,
    sample_reflection,
    sample_refraction,
    specular_weight,
    transmission_weight,
)

_PATHS_AT_ONCE = 2**19


@dataclasses.dataclass(frozen=True)
class IncomingOptions:
    """How far light is followed; static."""

    bounces: int = 0
    """Further mirror bounces after the first hit; 0 shows the diffuse component of mirrors seen in mirrors."""
    interfaces: int = 4
    """Refractive interfaces a ray may pass; 2 lead through one glass object."""
    light: LightOptions = LightOptions()
    """Diffuse light at each hit; with the model `path` everything that arrives, whatever has scattered it."""


class Incoming(eqx.Module):
    """What arrives along a batch of rays."""

    radiance: Float[Array, "n 3"]
    """Linear radiance; fill 0."""
    hit: Bool[Array, "n"]
    """True where the ray's first hit is a surface, False where it leaves the scene or was not cast."""
    p: Float[Array, "n 3"]
    """First hit, world space; fill 0."""
    t: Float[Array, "n"]
    """Distance to the first hit, world units; fill 0."""
    first: GBuffer
    """Everything about the first hit [n]; not valid where `hit` is False."""


class _Path(eqx.Module):
    """Rays on their way, with what they have gathered."""

    rays: Rays
    active: Bool[Array, "n"]
    throughput: Float[Array, "n 3"]
    radiance: Float[Array, "n 3"]
    bounces: Int[Array, "n"]
    interfaces: Int[Array, "n"]


def incoming(
    scene: Scene,
    tracer: Tracer,
    rays: Rays,
    active: Bool[Array, "n"],
    key: Array,
    *,
    hits: Hits | None = None,
    options: IncomingOptions = IncomingOptions(),  # noqa: B008  frozen
) -> Incoming:
    """Trace rays and shade what they hit.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        rays: Rays [n].
        active: Which rays to trace.
        key: Random key, for light samples and rough refraction.
        hits: Closest hits of the rays where they are known already; None: they are cast.
        options: Bounces, interfaces, diffuse light.
    Returns:
        Radiance and first hits [n].
    Edge cases: a path that runs out of bounces or interfaces ends with the diffuse and ambient colour of its last hit.
        With the light model `path`, `options.light.bounces` counts the surface that the rays come from, and the other
        two counts are not used.
    """
    if options.light.model == "path":
        return _all_light(scene, tracer, rays, active, key, hits, options.light)
    follow_mirrors = options.bounces if scene.features.planar or scene.features.curved else 0
    follow_glass = options.interfaces if scene.features.refractive else 0
    path = _start(rays, active, follow_mirrors, follow_glass)
    first: list[GBuffer] = []
    for depth in range(follow_mirrors + follow_glass + 1):
        key_light, key_lobe = jax.random.split(jax.random.fold_in(key, depth))
        if depth > 0 or hits is None:
            hits = tracer.closest(path.rays, active=path.active)
        points = build_gbuffer(scene, path.rays, hits)
        light = diffuse_light(scene, tracer, points, key_light, options=options.light)
        first = first or [points]
        if depth == follow_mirrors + follow_glass:
            path = _finish(scene, path, points, light)
        else:
            path = _advance(scene, path, points, light, key_lobe, follow_mirrors > 0)
            if not path.active.any():
                break
    return Incoming(path.radiance, first[0].valid, first[0].p, first[0].t, first[0])


def _all_light(
    scene: Scene,
    tracer: Tracer,
    rays: Rays,
    active: Bool[Array, "n"],
    key: Array,
    hits: Hits | None,
    options: LightOptions,
) -> Incoming:
    """Everything that arrives along rays, by path tracing."""
    points = build_gbuffer(scene, rays, tracer.closest(rays, active=active) if hits is None else hits)
    rays = _parked(scene, rays, active)
    count, seed = active.shape[0], seed_of(key)
    sequence = pixel_sequences(seed, jnp.arange(count, dtype=jnp.int32))
    at_once = max(min(options.path_samples, _PATHS_AT_ONCE // count), 1)
    paths = PathOptions(bounces=options.bounces - 1)
    total = jnp.zeros_like(rays.origin)
    for first in range(0, options.path_samples, at_once):
        number = jnp.arange(first, min(first + at_once, options.path_samples), dtype=jnp.uint32)
        shape = (number.shape[0], count)
        many = jax.tree.map(lambda x, k=shape[0]: jnp.broadcast_to(x, (k, *x.shape)), rays)
        numbers = jnp.broadcast_to(number[:, None], shape)
        light = path_radiance(scene, tracer, many, jnp.broadcast_to(sequence, shape), numbers, options=paths)
        total = total + light.sum(0)
    radiance = jnp.where(active[:, None], total / options.path_samples, 0)
    return Incoming(radiance, points.valid, points.p, points.t, points)


@jax.jit
def _parked(scene: Scene, rays: Rays, active: Bool[Array, "n"]) -> Rays:
    """Rays that are not wanted leave the scene from its outside: their paths end at once instead of being followed."""
    outside = jnp.broadcast_to(2 * scene.upper - scene.lower, rays.origin.shape)
    wanted = active[:, None]
    return Rays(jnp.where(wanted, rays.origin, outside), jnp.where(wanted, rays.direction, 3**-0.5))


@functools.partial(jax.jit, static_argnums=(2, 3))
def _start(rays: Rays, active: Array, bounces: int, interfaces: int) -> _Path:
    one = jnp.ones_like(rays.origin)
    count = jnp.ones(active.shape, jnp.int32)
    return _Path(rays, active, one, jnp.zeros_like(one), count * bounces, count * interfaces)


@jax.jit
def _finish(scene: Scene, path: _Path, points: GBuffer, light: Float[Array, "n 3"]) -> _Path:
    """Add what the path sees at its hit, and end it."""
    radiance, _ = _gather(scene, path, points, light, path.active)
    return dataclasses.replace(path, radiance=radiance, active=jnp.zeros_like(path.active))


@functools.partial(jax.jit, static_argnums=5)
def _advance(
    scene: Scene, path: _Path, points: GBuffer, light: Float[Array, "n 3"], key: Array, bouncing: bool
) -> _Path:
    """Add what the path sees at its hit and send it on where it has somewhere to go; mirrors only if `bouncing`."""
    seen = path.active & points.valid
    refracts = seen & (path.interfaces > 0) & refractive(points)
    mirrors = seen & (path.bounces > 0) & reflective(points) & ~refracts
    goes_on = refracts | mirrors
    radiance, specular = _gather(scene, path, points, light, seen & ~goes_on)
    throughput = path.throughput * _absorption(scene, path.rays, points)

    key_reflect, key_refract = jax.random.split(key)
    n = seen.shape[0]
    wi, weight = path.rays.direction, specular
    if bouncing:
        wi, _ = sample_reflection(points, jax.random.uniform(key_reflect, (n, 2)))
    if points.transmission is not None:
        thin = scene.materials.thin[jnp.maximum(points.material, 0)]
        wt = sample_refraction(points, thin, jax.random.uniform(key_refract, (n, 2)))
        wi = jnp.where(refracts[..., None], wt, wi)
        turned_back = dot(wt, points.n) > 0
        through = jnp.where(turned_back[..., None], 1.0, transmission_weight(points, specular))
        weight = jnp.where(refracts[..., None], through, weight)
    origin = offset_origin(points.p, points.n, points.p_error, wi)
    rays = Rays(
        jnp.where(goes_on[..., None], origin, path.rays.origin), jnp.where(goes_on[..., None], wi, path.rays.direction)
    )
    bounces, interfaces = path.bounces - mirrors.astype(jnp.int32), path.interfaces - refracts.astype(jnp.int32)
    return _Path(rays, goes_on, throughput * weight, radiance, bounces, interfaces)


def _gather(
    scene: Scene, path: _Path, points: GBuffer, light: Float[Array, "n 3"], ends: Bool[Array, "n"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Radiance of the path with what it sees at its hit, and the specular weight there."""
    specular = specular_weight(points)
    emission = 0.0 if points.emission is None else points.emission
    ambient = jnp.broadcast_to(scene.lights.ambient, light.shape)
    surface = emission + (1 - specular) * (light - emission) + jnp.where(ends[..., None], specular * ambient, 0)
    arrived = jnp.where(points.valid[..., None], surface, light) * _absorption(scene, path.rays, points)
    radiance = path.radiance + jnp.where(path.active[..., None], path.throughput * arrived, 0)
    return radiance, specular


def _absorption(scene: Scene, rays: Rays, points: GBuffer) -> Float[Array, "n 3"]:
    """Beer-Lambert attenuation of a ray that reaches a refractive surface from its inside."""
    if points.transmission is None:
        return jnp.ones_like(rays.origin)
    coefficient = scene.materials.attenuation[jnp.maximum(points.material, 0)]
    inside = points.valid & ~points.outside & (points.transmission > 0)
    return jnp.exp(-coefficient * jnp.where(inside, points.t, 0)[..., None])
