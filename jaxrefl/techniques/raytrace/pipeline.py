"""Brute-force ray tracing: one mirror ray, or n rays from the GGX lobe, per reflective pixel.

The opponent of every other technique, and with many samples their reference.
"""

import dataclasses
import time

import jax
from jaxtyping import Array, Int

from jaxrefl._types import Frame, GBuffer, Reflection, Scene, Tracer
from jaxrefl.surface import reflective, refractive
from jaxrefl.techniques._tracing import nothing_traced, trace_reflected, trace_refracted
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
    traced = trace_reflected(frame, nothing_traced(frame.gbuffer), frame.gbuffer.valid, options=options)
    transmitted = trace_refracted(frame, options=options)
    result = jax.block_until_ready(dataclasses.replace(traced.reflection, transmitted=transmitted))
    counts = {name: int(count) for name, count in _count(frame.gbuffer).items()}
    seconds = {"trace": time.perf_counter() - began}
    return state, result, Info(frame.tracer.rays - cast_before, seconds, counts)


@jax.jit
def _count(gbuffer: GBuffer) -> dict[str, Int[Array, ""]]:
    shiny, smooth = reflective(gbuffer), gbuffer.alpha == 0
    masks = {"mirror": shiny & smooth, "glossy": shiny & ~smooth, "refractive": refractive(gbuffer)}
    return {f"{name}_pixels": mask.sum() for name, mask in masks.items()}
