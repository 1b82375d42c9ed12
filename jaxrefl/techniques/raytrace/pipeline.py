"""Brute-force ray tracing: one mirror ray, or n rays from the GGX lobe, per reflective pixel.

The opponent of every other technique, and with many samples their reference.
"""

import dataclasses
import time

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxrefl._types import Frame, GBuffer, Reflection, Scene, Tracer
from jaxrefl.radiance import IncomingOptions, incoming
from jaxrefl.rays import block_size, blocks_of, put_block, take_block
from jaxrefl.surface import reflective, refractive
from jaxrefl.techniques._shape import no_reflection
from jaxrefl.techniques.raytrace.light import following, following_mirrors
from jaxrefl.techniques.raytrace.trace import add_sample, reflected_rays, reflection_of, refracted_rays, start_sums
from jaxrefl.techniques.raytrace.types import Info, Options, Params, State


def init(scene: Scene, tracer: Tracer, *, options: Options = Options()) -> State:  # noqa: B008  frozen
    """Nothing to prepare.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        options: Static knobs.
    Returns:
        An empty state.
    """
    return State()


def step(
    state: State,
    frame: Frame,
    params: Params,
    *,
    options: Options = Options(),  # noqa: B008  frozen
) -> tuple[State, Reflection, Info]:
    """Trace the reflections of one frame.

    Args:
        state: From `init`.
        frame: Scene, camera, G-buffer, key and tracer.
        params: No knobs.
        options: Samples, bounces, block size.
    Returns:
        The state, the reflection, and counts: `mirror_pixels`, `glossy_pixels`, `refractive_pixels`.
    """
    began, cast_before = time.perf_counter(), frame.tracer.rays
    mirror, glossy, clear = _classify(frame.gbuffer)
    follow, samples = following(options), options.samples
    passes = {
        "mirror": (mirror, _reflect_block, 1, following_mirrors(options)),
        "glossy": (glossy, _reflect_block, samples, follow),
        "refractive": (clear, _refract_block, samples, follow),
    }
    result = no_reflection(frame.gbuffer)
    for key, (mask, trace, rays, chosen) in zip(jax.random.split(frame.key, len(passes)), passes.values(), strict=True):
        for number, index in enumerate(blocks_of(mask, size=block_size(mask.size, options.block))):
            points = take_block(frame.gbuffer, index)
            result = trace(result, frame, index, points, jax.random.fold_in(key, number), rays, chosen)
    result = jax.block_until_ready(result)
    counts = {f"{name}_pixels": int(mask.sum()) for name, (mask, *_) in passes.items()}
    seconds = {"trace": time.perf_counter() - began}
    return state, result, Info(frame.tracer.rays - cast_before, seconds, counts)


@jax.jit
def _classify(gbuffer: GBuffer) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"], Bool[Array, "h w"]]:
    """Pixels whose lobe is one direction, those that need samples, and those that let light through."""
    wanted, smooth = reflective(gbuffer), gbuffer.alpha == 0
    return wanted & smooth, wanted & ~smooth, refractive(gbuffer)


def _reflect_block(
    result: Reflection, frame: Frame, index: Array, points: GBuffer, key: Array, samples: int, follow: IncomingOptions
) -> Reflection:
    sums = start_sums(index)
    key_lobe, key_light = jax.random.split(key)
    for number in range(samples):
        rays, weight = reflected_rays(points, sums.traced, key_lobe, jnp.asarray(number, jnp.int32))
        key_in = jax.random.fold_in(key_light, number)
        light = incoming(frame.scene, frame.tracer, rays, weight > 0, key_in, options=follow)
        sums = add_sample(sums, weight, light)
    rest = dataclasses.replace(result, transmitted=None)
    return dataclasses.replace(put_block(index, rest, reflection_of(sums)), transmitted=result.transmitted)


def _refract_block(
    result: Reflection, frame: Frame, index: Array, points: GBuffer, key: Array, samples: int, follow: IncomingOptions
) -> Reflection:
    mean = jnp.zeros_like(points.p)
    key_lobe, key_light = jax.random.split(key)
    for number in range(samples):
        rays = refracted_rays(frame.scene, points, key_lobe, jnp.asarray(number, jnp.int32))
        key_in = jax.random.fold_in(key_light, number)
        light = incoming(frame.scene, frame.tracer, rays, index >= 0, key_in, options=follow)
        mean = mean + light.radiance / samples
    return dataclasses.replace(result, transmitted=put_block(index, result.transmitted, mean))
