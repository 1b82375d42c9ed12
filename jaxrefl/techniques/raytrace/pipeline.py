"""Brute-force ray tracing: one mirror ray, or n rays from the GGX lobe, per reflective pixel.

The opponent of every other technique, and with many samples their reference.
"""

import time

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxrefl._types import Frame, GBuffer, Reflection, Scene, Tracer
from jaxrefl.radiance import DirectOptions, IncomingOptions, incoming
from jaxrefl.rays import block_size, blocks_of, put_block, take_block
from jaxrefl.surface import reflective
from jaxrefl.techniques._shape import no_reflection
from jaxrefl.techniques.raytrace.trace import (
    add_reflected,
    add_transmitted,
    reflected_rays,
    reflection_of,
    refracted_rays,
    start_sums,
)
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
        The state, the reflection, and counts: `mirror_pixels` and `glossy_pixels`.
    """
    began, cast_before = time.perf_counter(), frame.tracer.rays
    mirror, glossy = _classify(frame.gbuffer)
    result = no_reflection(frame.gbuffer)
    counts = {}
    classes = {"mirror": (mirror, 1), "glossy": (glossy, options.samples)}
    for key, (name, (mask, samples)) in zip(jax.random.split(frame.key), classes.items(), strict=True):
        for number, index in enumerate(blocks_of(mask, size=block_size(mask.size, options.block))):
            block = _trace_block(frame, index, jax.random.fold_in(key, number), samples, options)
            result = put_block(index, result, block)
        counts[f"{name}_pixels"] = int(mask.sum())
    result = jax.block_until_ready(result)
    seconds = {"trace": time.perf_counter() - began}
    return state, result, Info(frame.tracer.rays - cast_before, seconds, counts)


@jax.jit
def _classify(gbuffer: GBuffer) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"]]:
    """Pixels whose lobe is one direction, and those that need samples."""
    wanted, smooth = reflective(gbuffer), gbuffer.alpha == 0
    return wanted & smooth, wanted & ~smooth


def _trace_block(frame: Frame, index: jax.Array, key: jax.Array, samples: int, options: Options) -> Reflection:
    light = DirectOptions(area_samples=options.area_samples, environment_samples=options.environment_samples)
    follow = IncomingOptions(bounces=options.bounces, interfaces=options.interfaces, light=light)
    points = take_block(frame.gbuffer, index)
    sums = start_sums(points, index)
    key_reflect, key_refract, key_light = jax.random.split(key, 3)
    for number in range(samples):
        sample = jnp.asarray(number, jnp.int32)
        key_in, key_through = jax.random.split(jax.random.fold_in(key_light, number))
        rays, weight = reflected_rays(points, sums.traced, key_reflect, sample)
        light_in = incoming(frame.scene, frame.tracer, rays, weight > 0, key_in, options=follow)
        sums = add_reflected(sums, weight, light_in)
        if frame.scene.features.refractive:
            rays, active = refracted_rays(frame.scene, points, sums.traced, key_refract, sample)
            light_in = incoming(frame.scene, frame.tracer, rays, active, key_through, options=follow)
            sums = add_transmitted(sums, jnp.asarray(1 / samples, jnp.float32), light_in)
    return reflection_of(sums)
