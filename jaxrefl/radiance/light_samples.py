"""Where to look for light: points on surfaces + Scene -> shadow rays and what each brings if nothing is in its way.

Each kind of light has a function that makes one sample per point; `sample_lights` runs them as often as `DirectOptions`
asks and puts the samples of all kinds into one list, so that all shadow rays are cast in one call. All estimates are
unbiased.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import AreaLights, Environment, GBuffer, Lights, PunctualLights, Rays, Scene
from jaxrefl.core import cosine_hemisphere, dot, safe, stratified
from jaxrefl.radiance.light_points import FAR, area_light_point, emissive_point, punctual_light_point
from jaxrefl.rays.offset import offset_origin
from jaxrefl.scene.environment import environment_light, environment_radiance, sample_environment

COSINE_SHARE = 0.5
"""Share of the environment's samples that are drawn from the cosine lobe instead of the map.

Standard deviation of the irradiance from 4 samples, relative to its mean, averaged over 64 normals: 0.43 (an outdoor
map with a sun) and 0.62 (a studio with small lamps) at 0.5; 0.63 and 0.80 from the map alone; 0.60 and 6.4 from the
lobe alone. Between 0.25 and 0.5 it hardly changes; the worst normal is best off at 0.5.
"""


def _count(default: int, high: int, help: str) -> Any:
    return dataclasses.field(default=default, metadata={"low": 1, "high": high, "help": help})


@dataclasses.dataclass(frozen=True)
class DirectOptions:
    """How many light samples each point takes; static."""

    MOST: ClassVar[int] = 1024
    """Most shadow rays per point to one kind of light."""

    area_samples: int = _count(4, MOST, "Shadow rays per point to emissive triangles.")
    """Shadow rays per point to emissive triangles, stratified over their power."""
    environment_samples: int = _count(4, MOST, "Shadow rays per point to the environment map or sky.")
    """Shadow rays per point to the environment map or sky, stratified."""
    punctual_samples: int = _count(1, 256, "Shadow rays per point to each point, spot and directional light.")
    """Shadow rays per point to each point, spot and directional light; more than 1 only helps suns with a radius."""

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value, (low, high) = getattr(self, field.name), (field.metadata["low"], field.metadata["high"])
            if not isinstance(value, int) or not low <= value <= high:
                raise ValueError(f"{field.name}: expected a whole number from {low} to {high}, got {value!r}")


class Receivers(eqx.Module):
    """Points that receive light: the geometry of a G-buffer without its materials."""

    valid: Bool[Array, "n"]
    """False for points that are left out; they get no light and no rays."""
    p: Float[Array, "n 3"]
    """Position, world space."""
    p_error: Float[Array, "n"]
    """Bound on the rounding error of `p`, world units."""
    n: Float[Array, "n 3"]
    """Geometric unit normal on the viewer's side."""
    ns: Float[Array, "n 3"]
    """Shading unit normal on the viewer's side."""


class LightSamples(eqx.Module):
    """Shadow rays, `s` per point."""

    rays: Rays
    """From just above the point towards the light [s n]."""
    t_max: Float[Array, "*s n"]
    """Distance to the light; 0 where the sample brings nothing and need not be cast."""
    irradiance: Float[Array, "*s n 3"]
    """Share of the irradiance that arrives if nothing is in the way; the sum over `s` estimates the irradiance."""


class LightPoints(eqx.Module):
    """Where light comes from, `s` samples per point, before there are rays."""

    wi: Float[Array, "*s n 3"]
    """Unit direction from the point to the light."""
    end: Float[Array, "*s n 3"]
    """Where the shadow ray ends, world space; `FAR` away along `wi` for lights without a position."""
    irradiance: Float[Array, "*s n 3"]
    """Share of the irradiance that arrives if nothing is in the way and the point faces the light."""


def receivers_of(gbuffer: GBuffer) -> Receivers:
    """The geometry of a flat G-buffer.

    Args:
        gbuffer: A G-buffer [n].
    Returns:
        Its points [n].
    """
    return Receivers(gbuffer.valid, gbuffer.p, gbuffer.p_error, gbuffer.n, gbuffer.ns)


def samples_per_point(lights: Lights, *, options: DirectOptions) -> int:
    """How many shadow rays `sample_lights` makes for each point.

    Args:
        lights: The scene's lights.
        options: Sample counts.
    Returns:
        The number `s`; 0 without lights.
    """
    area = 0 if lights.area is None else options.area_samples
    environment = 0 if lights.environment is None else options.environment_samples
    punctual = 0 if lights.punctual is None else lights.punctual.directional.shape[0]
    return area + environment + punctual * options.punctual_samples


def sample_lights(scene: Scene, receivers: Receivers, key: Array, *, options: DirectOptions) -> LightSamples | None:
    r"""Shadow rays to all lights, with the irradiance each brings.

    $$ E = \int L_i(\omega)\,\cos\theta\,\mathrm{d}\omega \approx \sum_s \frac{L_s \cos\theta_s}{N_s\, p_s} $$

    Area lights: $p = p_\mathrm{triangle} d^2 / (A \cos\theta_l)$, both sides of the triangle shine. Point and spot
    lights: $I \cos\theta / d^2$, spots with the falloff of glTF. Directional lights: their irradiance, spread over the
    disk of their angular radius. Environment: `COSINE_SHARE` of the samples from the cosine lobe, the others from the
    map, combined by the balance heuristic; a constant sky from the cosine lobe alone, which has no variance without
    occluders.

    Args:
        scene: Its mesh, materials, textures and lights are used.
        receivers: Points [n].
        key: Random key.
        options: Sample counts.
    Returns:
        The samples; None if the scene has no light.
    Edge cases: light from below the shading or the geometric normal counts as 0 and is not cast; a sample at the very
        position of the point counts as 0.
    Source: [PBRT4] §12.2 to §12.6, [VG95] for the balance heuristic; KHR_lights_punctual for the spot's falloff.
    """
    points = sample_light_points(scene, receivers, key, options=options)
    return None if points is None else shadow_rays(receivers, points)


def sample_light_points(
    scene: Scene, receivers: Receivers, key: Array, *, options: DirectOptions
) -> LightPoints | None:
    """The first half of `sample_lights`: where light comes from, and how much of it.

    Compiled apart from `shadow_rays` it is twice as fast: what XLA fuses with several results it computes for each.

    Args:
        scene: Its mesh, materials, textures and lights are used.
        receivers: Points [n].
        key: Random key.
        options: Sample counts.
    Returns:
        The light points; None if the scene has no light.
    """
    lights, parts = scene.lights, []
    key_area, key_map, key_lobe, key_punctual = jax.random.split(key, 4)

    def run(key: Array, count: int, of: int, sample: Callable[[Float[Array, "n 2"]], LightPoints]) -> None:
        """Make `count` samples for each point, out of `of` that estimate the same integral."""
        u = jnp.moveaxis(stratified(key, count, shape=receivers.valid.shape), 1, 0)
        samples = jax.vmap(sample)(u)
        parts.append(eqx.tree_at(lambda x: x.irradiance, samples, samples.irradiance / of))

    if (area := lights.area) is not None:
        run(key_area, options.area_samples, options.area_samples, lambda u: _area(scene, area, receivers, u))
    if (environment := lights.environment) is not None:
        count = options.environment_samples
        if environment.probability.size == 1:
            run(key_lobe, count, count, lambda u: _constant_sky(environment, receivers, u))
        elif count == 1:
            run(key_lobe, 1, 1, lambda u: _lobe_or_map(environment, receivers, u))
        else:
            lobe = round(COSINE_SHARE * count)
            run(key_lobe, lobe, count, lambda u: _lobe(environment, receivers, u, lobe / count))
            run(key_map, count - lobe, count, lambda u: _map(environment, receivers, u, lobe / count))
    if (punctual := lights.punctual) is not None:
        count = options.punctual_samples
        run(key_punctual, count, count, lambda u: _all_punctual(punctual, receivers, u))
        parts[-1] = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), parts[-1])
    return jax.tree.map(lambda *x: jnp.concatenate(x), *parts) if parts else None


def _area(scene: Scene, area: AreaLights, receivers: Receivers, u: Float[Array, "n 2"]) -> LightPoints:
    """A point on the emissive triangles, uniform on each and between them in proportion to their power."""
    found = area_light_point(emissive_point(scene, area, u), receivers.p)
    return _towards(receivers, found.wi, found.end, found.radiance * found.inverse_density[:, None])


def _constant_sky(environment: Environment, receivers: Receivers, u: Float[Array, "n 2"]) -> LightPoints:
    """A direction from the cosine lobe, the density of which cancels everything but the radiance."""
    wi = cosine_hemisphere(u, receivers.ns)
    return _far(wi, environment_radiance(environment, wi) * jnp.pi)


def _lobe(environment: Environment, receivers: Receivers, u: Float[Array, "n 2"], share: float) -> LightPoints:
    """A direction from the cosine lobe, where `share` of all samples come from."""
    wi = cosine_hemisphere(u, receivers.ns)
    return _weighed(receivers, wi, *environment_light(environment, wi), share)


def _map(environment: Environment, receivers: Receivers, u: Float[Array, "n 2"], share: float) -> LightPoints:
    """A direction from the map, where all but `share` of the samples come from."""
    wi, radiance, density = sample_environment(environment, u)
    return _weighed(receivers, wi, radiance, density, share)


def _lobe_or_map(environment: Environment, receivers: Receivers, u: Float[Array, "n 2"]) -> LightPoints:
    """A direction from either: the first random number decides and is stretched again."""
    from_lobe = u[:, 0] < COSINE_SHARE
    x = jnp.where(from_lobe, u[:, 0] / COSINE_SHARE, (u[:, 0] - COSINE_SHARE) / (1 - COSINE_SHARE))
    u = jnp.stack([x, u[:, 1]], -1)
    from_map, _, _ = sample_environment(environment, u)
    wi = jnp.where(from_lobe[:, None], cosine_hemisphere(u, receivers.ns), from_map)
    radiance, density = environment_light(environment, wi)
    return _weighed(receivers, wi, radiance, density, COSINE_SHARE)


def _weighed(
    receivers: Receivers,
    wi: Float[Array, "n 3"],
    radiance: Float[Array, "n 3"],
    map_density: Float[Array, "n"],
    share: float,
) -> LightPoints:
    """The balance heuristic: radiance times cosine over the density of the lobe and the map together."""
    cos = jnp.maximum(dot(receivers.ns, wi), 0)
    density = share * cos / jnp.pi + (1 - share) * map_density
    return _far(wi, radiance * safe.divide(cos, density)[:, None])


def _all_punctual(lights: PunctualLights, receivers: Receivers, u: Float[Array, "n 2"]) -> LightPoints:
    """One ray to each light [p n]; all lights share the random numbers, which only move within a sun's disk."""
    return jax.vmap(lambda light: _punctual(light, receivers, u))(lights)


def _punctual(light: PunctualLights, receivers: Receivers, u: Float[Array, "n 2"]) -> LightPoints:
    """A ray to one light, the fields of which have lost their leading axis."""
    everywhere = jax.tree.map(lambda x: jnp.broadcast_to(x, (*receivers.p.shape[:1], *x.shape)), light)
    found = punctual_light_point(everywhere, receivers.p, receivers.p_error, u)
    return LightPoints(found.wi, found.end, found.radiance * _cosine(receivers, found.wi))


def _towards(
    receivers: Receivers, wi: Float[Array, "n 3"], end: Float[Array, "n 3"], irradiance: Float[Array, "n 3"]
) -> LightPoints:
    """A light at a known place; `irradiance` is that of a surface facing it."""
    return LightPoints(wi, end, irradiance * _cosine(receivers, wi))


def _far(wi: Float[Array, "n 3"], irradiance: Float[Array, "n 3"]) -> LightPoints:
    """A light outside the scene; `irradiance` is that of the surface."""
    return LightPoints(wi, wi * FAR, irradiance)


def _cosine(receivers: Receivers, wi: Float[Array, "n 3"]) -> Float[Array, "n 1"]:
    return jnp.maximum(dot(receivers.ns, wi), 0)[:, None]


def shadow_rays(receivers: Receivers, points: LightPoints) -> LightSamples:
    """The second half of `sample_lights`: rays that start safely above the points and end at their light.

    Args:
        receivers: Points [n].
        points: Light points [s n].
    Returns:
        Shadow rays [s n]; those that bring nothing have `t_max` 0 and no irradiance.
    Edge cases: light from below the shading or the geometric normal counts as 0.
    """

    def one(points: LightPoints) -> LightSamples:
        origin = offset_origin(receivers.p, receivers.n, receivers.p_error, points.wi)
        way = points.end - origin
        direction = safe.normalise(way)
        above = receivers.valid & (dot(receivers.n, direction) > 0) & (dot(receivers.ns, direction) > 0)
        brings = above & (points.irradiance.max(-1) > 0)
        return LightSamples(
            rays=Rays(origin, direction),
            t_max=jnp.where(brings, safe.norm(way), 0),
            irradiance=jnp.where(brings[:, None], points.irradiance, 0),
        )

    return jax.vmap(one)(points)
