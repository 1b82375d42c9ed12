"""Sums over the rays of a block of pixels, and what they come to: Seen ... -> Answer."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._status import Source
from jaxrefl._types import GBuffer, Reflection
from jaxrefl.techniques._shape import no_reflection
from jaxrefl.techniques.clusters.look_up import Seen
from jaxrefl.techniques.clusters.types import Found, is_clean

_GUESS = 0.5
"""Confidence in what a ray met after it had passed behind something."""
_MAP = 0.1
"""Confidence in an environment map that stands in for a depth image."""


class Answer(eqx.Module):
    """What pixels reflect [*b]."""

    reflection: Reflection
    """Means over the rays that have an answer; `transmitted` is None."""
    found: Int[Array, "*b"]
    """A `Found` code, that of most of their rays."""
    unsure: Float[Array, "*b"]
    """Share of their rays that no depth image has shown to the end."""
    steps: Float[Array, "*b"]
    """Steps taken by all their rays."""


class Sums(eqx.Module):
    """Running sums over the rays of n pixels."""

    weight: Float[Array, "n"]
    """Of all rays."""
    known: Float[Array, "n"]
    """Of those with an answer."""
    clean: Float[Array, "n"]
    """Of those that a depth image has shown to the end."""
    traced: Float[Array, "n"]
    """Of those that were traced."""
    confidence: Float[Array, "n"]
    hits: Float[Array, "n"]
    """Of those that ended on a surface."""
    radiance: Float[Array, "n 3"]
    p: Float[Array, "n 3"]
    t: Float[Array, "n"]
    steps: Float[Array, "n"]
    codes: Float[Array, "n f"]
    """Number of rays per `Found` code."""


@jax.jit
def no_answer(gbuffer: GBuffer) -> Answer:
    """An image without answers.

    Args:
        gbuffer: G-buffer of the frame.
    Returns:
        Fill values.
    """
    zero = jnp.zeros(gbuffer.t.shape, jnp.float32)
    reflection = dataclasses.replace(no_reflection(gbuffer), transmitted=None)
    return Answer(reflection, zero.astype(jnp.int32), zero, jnp.zeros_like(zero))


def start_sums(count: int) -> Sums:
    """Empty sums.

    Args:
        count: Pixels.
    Returns:
        Zeros.
    """
    zero, vector = jnp.zeros(count, jnp.float32), jnp.zeros((count, 3), jnp.float32)
    codes = jnp.zeros((count, len(Found)), jnp.float32)
    return Sums(zero, zero, zero, zero, zero, zero, vector, vector, zero, zero, codes)


def add_seen(
    sums: Sums, weight: Float[Array, "n"], seen: Seen, found: Int[Array, "n"], steps: Int[Array, "n"]
) -> Sums:  # fmt: skip
    """Add one ray per pixel that was followed through its depth image.

    Args:
        sums: Sums so far.
        weight: Weights of the rays.
        seen: What they brought back.
        found: `Found` codes.
        steps: Steps they took.
    Returns:
        The new sums.
    """
    known, clean = jnp.where(seen.known, weight, 0), is_clean(found)
    confidence = jnp.where(clean, 1, jnp.where(found == int(Found.PASSED), _GUESS, _MAP))
    hits = jnp.where(seen.hit, known, 0)
    return Sums(
        weight=sums.weight + weight,
        known=sums.known + known,
        clean=sums.clean + jnp.where(clean, weight, 0),
        traced=sums.traced,
        confidence=sums.confidence + known * confidence,
        hits=sums.hits + hits,
        radiance=sums.radiance + known[:, None] * seen.radiance,
        p=sums.p + hits[:, None] * seen.p,
        t=sums.t + hits * seen.t,
        steps=sums.steps + steps.astype(jnp.float32),
        codes=sums.codes + jax.nn.one_hot(found, len(Found), dtype=jnp.float32),
    )


@jax.jit
def add_traced(
    sums: Sums, pixel: Int[Array, "m"], weight: Float[Array, "m"], radiance: Float[Array, "m 3"], hit: Bool[Array, "m"],
    p: Float[Array, "m 3"], t: Float[Array, "m"],
) -> Sums:  # fmt: skip
    """Add traced rays that had been counted as rays without an answer.

    Args:
        sums: Sums so far.
        pixel: Pixel of each ray.
        weight: Weights of the rays; 0 for padding.
        radiance: What they brought back.
        hit: Which of them ended on a surface.
        p: Where, world space.
        t: At what distance, world units.
    Returns:
        The new sums.
    """
    hits = jnp.where(hit, weight, 0)
    return Sums(
        weight=sums.weight,
        known=sums.known.at[pixel].add(weight),
        clean=sums.clean,
        traced=sums.traced.at[pixel].add(weight),
        confidence=sums.confidence.at[pixel].add(weight),
        hits=sums.hits.at[pixel].add(hits),
        radiance=sums.radiance.at[pixel].add(weight[:, None] * radiance),
        p=sums.p.at[pixel].add(hits[:, None] * p),
        t=sums.t.at[pixel].add(hits * t),
        steps=sums.steps,
        codes=sums.codes,
    )


@jax.jit
def means_of(sums: Sums, active: Bool[Array, "n"]) -> Answer:
    """Means over the rays.

    Args:
        sums: Complete sums.
        active: Which pixels there are.
    Returns:
        Answers.
    """
    over_all, over_known, over_hits = (1 / jnp.where(x > 0, x, 1) for x in (sums.weight, sums.known, sums.hits))
    valid = active & (sums.known > 0)
    seen = jnp.where(sums.hits > 0, int(Source.DEPTH_IMAGE), int(Source.ENVIRONMENT))
    source = jnp.where(2 * sums.traced > sums.known, int(Source.TRACED), seen)
    reflection = Reflection(
        radiance=sums.radiance * over_known[:, None],
        valid=valid,
        source=jnp.where(valid, source, int(Source.NONE)).astype(jnp.int32),
        confidence=jnp.minimum(sums.confidence * over_all, 1),
        p=sums.p * over_hits[:, None],
        t=sums.t * over_hits,
    )
    return Answer(
        reflection=reflection,
        found=jnp.where(active, jnp.argmax(sums.codes, -1), int(Found.NONE)).astype(jnp.int32),
        unsure=jnp.where(active, jnp.clip(1 - sums.clean * over_all, 0, 1), 0),
        steps=sums.steps,
    )
