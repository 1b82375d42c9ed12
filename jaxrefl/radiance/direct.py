"""Emission and diffusely reflected direct light: GBuffer + Scene -> radiance towards the viewer.

`direct_light` is the whole stage: light samples (jitted), shadow rays (host), sum and shading (jitted), block by block.
The two jitted halves are public for those who cast the shadow rays themselves or differentiate: `sample_lights` needs
only geometry, `outgoing_light` is linear in the irradiance and differentiable in every material parameter.
"""

import dataclasses
from collections.abc import Iterator
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import GBuffer, Lights, Scene, Tracer
from jaxrefl.radiance.light_samples import (
    DirectOptions,
    LightPoints,
    LightSamples,
    Receivers,
    receivers_of,
    sample_light_points,
    samples_per_point,
    shadow_rays,
)
from jaxrefl.rays.blocks import blocks_of, put_block, take_block
from jaxrefl.scene.environment import environment_radiance
from jaxrefl.surface.specular import diffuse_albedo

T = TypeVar("T")

_RAYS_PER_BLOCK = 2**18
_POINTS_PER_BLOCK = 2**14


def direct_light(
    scene: Scene,
    tracer: Tracer,
    gbuffer: GBuffer,
    key: Array,
    *,
    options: DirectOptions = DirectOptions(),  # noqa: B008  frozen
) -> Float[Array, "*b 3"]:
    """Radiance from each point towards the viewer without its reflection: emission and diffuse direct light.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        gbuffer: Points [*b].
        key: Random key; the same key gives the same noise.
        options: Sample counts.
    Returns:
        Linear radiance; where the G-buffer is not valid, the background in that direction (environment plus ambient).
    Edge cases: a scene without lights shows its emission and ambient term. Under `jax.grad` with respect to material
        parameters the shadow rays are cast as usual, as they do not depend on them; positions and normals must be
        concrete arrays.
    Source: [PBRT4] §13.1, direct lighting; see `sample_lights` and `outgoing_light`.
    """
    lights, dims = scene.lights, gbuffer.valid.ndim
    size = _block_size(gbuffer.valid.size, samples_per_point(lights, options=options))
    image = jnp.zeros(gbuffer.p.shape, gbuffer.p.dtype)

    def sampled(number: int, index: Int[Array, "n"]) -> tuple[Int[Array, "n"], GBuffer, LightSamples | None]:
        points = take_block(gbuffer, index, batch_dims=dims)
        return index, points, _samples(scene, receivers_of(points), index, jax.random.fold_in(key, number), options)

    blocks = enumerate(blocks_of(gbuffer.valid, size=size))
    for index, points, samples in _one_ahead(sampled(number, index) for number, index in blocks):
        arriving = jnp.zeros_like(points.p)
        if samples is not None:
            arriving = arriving_light(samples, tracer.occluded(samples.rays, samples.t_max))
        image = put_block(index, image, outgoing_light(lights, points, arriving), batch_dims=dims)
    for index in blocks_of(~gbuffer.valid, size=size):
        away = -take_block(gbuffer.wo, index, batch_dims=dims)
        image = put_block(index, image, background(lights, away), batch_dims=dims)
    return image


@jax.jit
def outgoing_light(lights: Lights, gbuffer: GBuffer, irradiance: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    r"""Emission and diffuse reflection of known irradiance.

    $$ L_o = L_e + \rho\,(E / \pi + L_a) $$

    with the diffuse albedo $\rho$ and the ambient radiance $L_a$. The specular share of the ambient light belongs to
    the reflection and is not included (`radiance.incoming` adds it where a reflection is not followed any further).

    Args:
        lights: For the ambient term.
        gbuffer: Points [*b].
        irradiance: Irradiance at the points, shadows included.
    Returns:
        Linear radiance; 0 where the G-buffer is not valid.
    Source: Lambert's law.
    """
    ambient = jnp.broadcast_to(lights.ambient, irradiance.shape)
    radiance = diffuse_albedo(gbuffer) * (irradiance / jnp.pi + ambient)
    if gbuffer.emission is not None:
        radiance = radiance + gbuffer.emission
    return jnp.where(gbuffer.valid[..., None], radiance, 0)


@jax.jit
def background(lights: Lights, direction: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """What is seen where there is no surface: the environment and the ambient radiance.

    Args:
        lights: The scene's lights.
        direction: Unit directions away from the viewer, world space.
    Returns:
        Linear radiance.
    """
    radiance = jnp.broadcast_to(lights.ambient, direction.shape)
    if lights.environment is not None:
        radiance = radiance + environment_radiance(lights.environment, direction)
    return radiance


@jax.jit
def arriving_light(samples: LightSamples, occluded: Bool[Array, "s n"]) -> Float[Array, "n 3"]:
    """Irradiance from light samples and what their shadow rays met.

    Args:
        samples: From `sample_lights`.
        occluded: True where a shadow ray is blocked.
    Returns:
        Irradiance at each point.
    """

    def add(total: Array, sample: tuple[Array, Array]) -> tuple[Array, None]:
        irradiance, blocked = sample
        return total + jnp.where(blocked[:, None], 0, irradiance), None

    # One sample after another: 15 times faster than a reduction over them.
    nothing = jnp.zeros_like(samples.irradiance[0])
    return jax.lax.scan(add, nothing, (samples.irradiance, occluded))[0]


def _samples(
    scene: Scene, receivers: Receivers, index: Int[Array, "n"], key: Array, options: DirectOptions
) -> LightSamples | None:
    """Light samples of one block; its padding (index -1) gets no rays."""
    points = _light_points(scene, receivers, key, options=options)
    return None if points is None else _shadow_rays(receivers, points, index)


_light_points = jax.jit(sample_light_points, static_argnames="options")


@jax.jit
def _shadow_rays(receivers: Receivers, points: LightPoints, index: Int[Array, "n"]) -> LightSamples:
    return shadow_rays(dataclasses.replace(receivers, valid=receivers.valid & (index >= 0)), points)


def _one_ahead(items: Iterator[T]) -> Iterator[T]:
    """The same items, each handed on after the next one has been started: the device samples while the host casts."""
    previous = None
    for item in items:
        if previous is not None:
            yield previous
        previous = item
    if previous is not None:
        yield previous


def _block_size(points: int, samples: int) -> int:
    """Points per block: a power of two that depends on the shapes alone, so that each is compiled once."""
    most = max(_RAYS_PER_BLOCK // max(samples, 1), 1)
    most = min(2 ** (most.bit_length() - 1), _POINTS_PER_BLOCK)
    return min(most, max(2 ** max(points - 1, 0).bit_length(), 256))
