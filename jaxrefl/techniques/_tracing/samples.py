"""One block of pixels: lobe samples -> rays -> mean radiance of the lobe."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._status import Source
from jaxrefl._types import GBuffer, Rays, Reflection, Scene
from jaxrefl.core import largest
from jaxrefl.radiance.incoming import Incoming, IncomingOptions
from jaxrefl.rays import offset_origin
from jaxrefl.surface import reflective, refractive, sample_reflection, sample_refraction, specular_colour

_R2 = (0.7548776662466927, 0.5698402909980532)
"""Generators of the R2 sequence [Roberts18]: samples of one pixel stay apart at any count."""


CHANGING = 0.1
"""Reflectance at normal incidence above which a surface that is followed counts as a mirror; dielectrics have less."""


class Reached(eqx.Module):
    """What the rays of each pixel hit first; techniques that reuse a reflection need to know."""

    triangle: Int[Array, "*b"]
    """Row in `Mesh.faces`, of the last sample that hit something; fill -1."""
    colour: Float[Array, "*b 3"]
    """Base colour and emission of what was hit, averaged over the samples that hit; without noise; fill 0."""
    changing: Bool[Array, "*b"]
    """True where what was hit looks different from elsewhere: glass, or a mirror of more than `CHANGING`, that was
    followed further."""


class Sums(eqx.Module):
    """Running sums over the samples of a block of pixels."""

    weight: Float[Array, "n"]
    radiance: Float[Array, "n 3"]
    hits: Float[Array, "n"]
    t: Float[Array, "n"]
    p: Float[Array, "n 3"]
    traced: Bool[Array, "n"]
    reached: Reached


def start_sums(index: Int[Array, "n"]) -> Sums:
    """Empty sums for one block.

    Args:
        index: Indices of the block, -1 for padding.
    Returns:
        Zeros.
    """
    zero, vector = jnp.zeros(index.shape, jnp.float32), jnp.zeros((*index.shape, 3), jnp.float32)
    reached = Reached(jnp.full(index.shape, -1, jnp.int32), vector, jnp.zeros(index.shape, bool))
    return Sums(zero, vector, zero, zero, vector, index >= 0, reached)


def lobe_sample(key: Array, sample: Int[Array, ""], count: int) -> Float[Array, "n 2"]:
    """Point number `sample` of an R2 sequence, shifted differently in each pixel.

    Args:
        key: Random key of the block.
        sample: Number of the sample.
        count: Pixels in the block.
    Returns:
        Numbers in [0, 1), evenly spread over the samples of a pixel.
    Source: [Roberts18].
    """
    shift = jax.random.uniform(key, (count, 2))
    step = sample.astype(jnp.float32) * jnp.array(_R2, jnp.float32)
    return (shift + jnp.broadcast_to(step, shift.shape)) % 1


@jax.jit
def reflected_rays(
    points: GBuffer, active: Bool[Array, "n"], key: Array, sample: Int[Array, ""]
) -> tuple[Rays, Float[Array, "n"]]:
    """One ray per point from its specular lobe.

    Args:
        points: G-buffer of the block.
        active: Which points are still sampled.
        key: Random key of the block.
        sample: Number of the sample.
    Returns:
        Rays off the surface, and their weights; 0 where there is nothing to trace.
    """
    wi, weight = sample_reflection(points, lobe_sample(key, sample, active.shape[0]))
    rays = Rays(offset_origin(points.p, points.n, points.p_error, wi), wi)
    return rays, jnp.where(active, weight, 0)


@jax.jit
def refracted_rays(scene: Scene, points: GBuffer, key: Array, sample: Int[Array, ""]) -> Rays:
    """One ray per point through its surface.

    Args:
        scene: The scene.
        points: G-buffer of the block, refractive points only.
        key: Random key of the block.
        sample: Number of the sample.
    Returns:
        Rays on the far side of the surface.
    """
    thin = scene.materials.thin[jnp.maximum(points.material, 0)]
    wi = sample_refraction(points, thin, lobe_sample(key, sample, thin.shape[0]))
    return Rays(offset_origin(points.p, points.n, points.p_error, wi), wi)


@functools.partial(jax.jit, static_argnames="options")
def add_sample(sums: Sums, weight: Float[Array, "n"], light: Incoming, *, options: IncomingOptions) -> Sums:
    """Add one reflected sample per point.

    Args:
        sums: Sums so far.
        weight: Weights of the rays.
        light: What arrived along them.
        options: How they were followed.
    Returns:
        The new sums.
    """
    counts = light.hit & (weight > 0)
    hit, first = jnp.where(counts, 1.0, 0.0), light.first
    colour = first.base_colour if first.emission is None else first.base_colour + first.emission
    all_light = options.light.model == "path"
    follows = (refractive(first) & (all_light or options.interfaces > 0)) | (
        (largest(specular_colour(first)) > CHANGING) & reflective(first) & (all_light or options.bounces > 0)
    )
    reached = Reached(
        triangle=jnp.where(counts, first.triangle, sums.reached.triangle),
        colour=sums.reached.colour + hit[..., None] * colour,
        changing=sums.reached.changing | (counts & follows),
    )
    return Sums(
        weight=sums.weight + weight,
        radiance=sums.radiance + weight[..., None] * light.radiance,
        hits=sums.hits + hit,
        t=sums.t + hit * light.t,
        p=sums.p + hit[..., None] * light.p,
        traced=sums.traced,
        reached=reached,
    )


@jax.jit
def means_of(sums: Sums) -> tuple[Reflection, Reached]:
    """Means of the samples.

    Args:
        sums: Complete sums of a block of n pixels.
    Returns:
        Reflection of these pixels [n], and what it shows.
    """
    inverse_weight = jnp.where(sums.weight > 0, 1 / jnp.maximum(sums.weight, 1e-20), 0)
    inverse_hits = 1 / jnp.maximum(sums.hits, 1)
    source = jnp.where(sums.hits > 0, int(Source.TRACED), int(Source.ENVIRONMENT))
    reflection = Reflection(
        radiance=sums.radiance * inverse_weight[..., None],
        valid=sums.traced,
        source=jnp.where(sums.traced, source, int(Source.NONE)).astype(jnp.int32),
        confidence=sums.traced.astype(jnp.float32),
        p=sums.p * inverse_hits[..., None],
        t=sums.t * inverse_hits,
    )
    colour = sums.reached.colour * inverse_hits[..., None]
    return reflection, Reached(sums.reached.triangle, colour, sums.reached.changing)
