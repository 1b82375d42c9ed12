"""Some pixels of a frame, traced: Frame + mask -> Traced. Compacted into blocks: work grows with the pixels wanted."""

import dataclasses
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxrefl._types import Frame, GBuffer, Reflection
from jaxrefl.radiance import IncomingOptions, incoming
from jaxrefl.rays import block_size, blocks_of, put_block, take_block
from jaxrefl.surface import reflective, refractive
from jaxrefl.techniques._shape import no_reflection
from jaxrefl.techniques._tracing.light import following, following_mirrors
from jaxrefl.techniques._tracing.options import TraceOptions
from jaxrefl.techniques._tracing.samples import (
    Reached,
    add_sample,
    means_of,
    reflected_rays,
    refracted_rays,
    start_sums,
)

_PATHS_AT_ONCE = 2**18
"""Most paths of glossy pixels that are followed in one call."""
_CUT = 16
"""How many small blocks make a whole one."""


class Traced(eqx.Module):
    """An image of reflections, and what they show."""

    reflection: Reflection
    """Radiance, and where it comes from [h w]; `transmitted` is None: it is kept apart."""
    reached: Reached
    """What was hit first [h w]."""


@jax.jit
def nothing_traced(gbuffer: GBuffer) -> Traced:
    """An image in which nothing has been traced yet.

    Args:
        gbuffer: G-buffer of the frame.
    Returns:
        Fill values of the G-buffer's shape.
    """
    reflection = dataclasses.replace(no_reflection(gbuffer), transmitted=None)
    shape = gbuffer.t.shape
    return Traced(
        reflection,
        Reached(jnp.full(shape, -1, jnp.int32), jnp.zeros((*shape, 3), jnp.float32), jnp.zeros(shape, bool)),
    )


def trace_reflected(frame: Frame, image: Traced, wanted: Bool[Array, "h w"], *, options: TraceOptions) -> Traced:
    """Trace the reflections of some pixels: one mirror ray each, or samples of a glossy lobe.

    Args:
        frame: Scene, G-buffer, key and tracer.
        image: What is known of the other pixels; consumed, its memory is reused.
        wanted: Which pixels to trace; those that are not reflective are left out.
        options: Samples, bounces, light, block size.
    Returns:
        `image` with the wanted pixels replaced.
    """
    mirror, glossy = _classify(frame.gbuffer, wanted)
    key_mirror, key_glossy, _ = jax.random.split(frame.key, 3)
    passes = (
        (mirror, key_mirror, 1, following_mirrors(options)),
        (glossy, key_glossy, options.samples, following(options)),
    )
    for mask, key, samples, follow in passes:
        for number, index in enumerate(_blocks(mask, options)):
            points = take_block(frame.gbuffer, index)
            block = _reflect_block(frame, index, points, jax.random.fold_in(key, number), samples, follow)
            image = put_block(index, image, block)
    return image


def trace_refracted(frame: Frame, *, options: TraceOptions) -> Array | None:
    """Trace what shows through the refractive pixels of a frame.

    Args:
        frame: Scene, G-buffer, key and tracer.
        options: Samples, interfaces, light, block size.
    Returns:
        [h w 3] radiance before the transmission weight, fill 0; None: the scene has no refractive material.
    """
    if frame.gbuffer.transmission is None:
        return None
    image, mask = jnp.zeros_like(frame.gbuffer.p), refractive(frame.gbuffer)
    _, _, key = jax.random.split(frame.key, 3)
    for number, index in enumerate(_blocks(mask, options)):
        points = take_block(frame.gbuffer, index)
        block = _refract_block(frame, index, points, jax.random.fold_in(key, number), options)
        image = put_block(index, image, block)
    return image


@jax.jit
def _classify(gbuffer: GBuffer, wanted: Bool[Array, "h w"]) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"]]:
    """Pixels whose lobe is one direction, and those that need samples."""
    traced, smooth = reflective(gbuffer) & wanted, gbuffer.alpha == 0
    return traced & smooth, traced & ~smooth


def _blocks(mask: Bool[Array, "h w"], options: TraceOptions) -> Iterator[Int[Array, "n"]]:
    """Blocks of a mask; where padding is dear, what does not fill one is cut into small ones of a second size."""
    whole = block_size(mask.size, options.block)
    if options.light != "path":
        yield from blocks_of(mask, size=whole)
        return
    rank = jnp.cumsum(mask.reshape(-1).astype(jnp.int32)).reshape(mask.shape)
    head = (int(mask.sum()) + whole // 2) // whole * whole
    yield from blocks_of(mask & (rank <= head), size=whole)
    yield from blocks_of(mask & (rank > head), size=max(whole // _CUT, 1))


def _reflect_block(
    frame: Frame, index: Array, points: GBuffer, key: Array, samples: int, follow: IncomingOptions
) -> Traced:
    sums, count = start_sums(index), index.shape[0]
    key_lobe, key_light = jax.random.split(key)
    for numbers in _groups(samples, count, follow):
        rays, weights = zip(
            *(reflected_rays(points, sums.traced, key_lobe, jnp.asarray(number, jnp.int32)) for number in numbers),
            strict=True,
        )
        together = jax.tree.map(lambda *x: jnp.concatenate(x), *rays)
        key_in = jax.random.fold_in(key_light, numbers.start)
        light = incoming(frame.scene, frame.tracer, together, jnp.concatenate(weights) > 0, key_in, options=follow)
        for i, weight in enumerate(weights):
            own = jax.tree.map(lambda x, start=i * count: x[start : start + count], light)
            sums = add_sample(sums, weight, own, options=follow)
    return Traced(*means_of(sums))


def _refract_block(frame: Frame, index: Array, points: GBuffer, key: Array, options: TraceOptions) -> Array:
    mean, follow = jnp.zeros_like(points.p), following(options)
    key_lobe, key_light = jax.random.split(key)
    for numbers in _groups(options.samples, index.shape[0], follow):
        rays = [refracted_rays(frame.scene, points, key_lobe, jnp.asarray(number, jnp.int32)) for number in numbers]
        together = jax.tree.map(lambda *x: jnp.concatenate(x), *rays)
        key_in = jax.random.fold_in(key_light, numbers.start)
        active = jnp.tile(index >= 0, len(rays))
        light = incoming(frame.scene, frame.tracer, together, active, key_in, options=follow)
        mean = mean + light.radiance.reshape(len(rays), -1, 3).sum(0) / options.samples
    return mean


def _groups(samples: int, count: int, follow: IncomingOptions) -> Iterator[range]:
    """Numbers of the samples that are followed together: short batches of paths are mostly beginning and end."""
    size = max(_PATHS_AT_ONCE // count, 1) if follow.light.model == "path" else 1
    for first in range(0, samples, size):
        yield range(first, min(first + size, samples))
