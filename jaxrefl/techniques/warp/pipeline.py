"""Naive warping: reflections of a traced key frame, stuck to their surfaces. The control of [XWD17].

It is right for light that does not depend on the viewer. A reflection does, and shifts as the camera moves: what
warping gets wrong is what `temporal` sets out to correct.
"""

import dataclasses
import time

import jax

from jaxrefl._types import Frame, Reflection, Scene, Tracer
from jaxrefl.surface import reflective
from jaxrefl.techniques._reproject import wants_key
from jaxrefl.techniques._tracing import nothing_traced, trace_reflected, trace_refracted
from jaxrefl.techniques.warp.stick import keep, warp
from jaxrefl.techniques.warp.types import Info, Options, Params, State


def init(scene: Scene, tracer: Tracer, *, options: Options = Options()) -> State:  # noqa: B008  frozen
    """Nothing to prepare: the first frame is a key frame.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        options: Static knobs.
    Returns:
        A state without a key frame.
    """
    return State()


def interval(options: Options) -> int:
    """Frames that a batch run must render in order.

    Args:
        options: Static knobs.
    Returns:
        Frames from one fresh start to the next.
    """
    return options.in_order


def step(
    state: State,
    frame: Frame,
    params: Params,
    *,
    options: Options = Options(),  # noqa: B008  frozen
) -> tuple[State, Reflection, Info]:
    """Warp the key frame's reflections into a frame and trace what it does not have.

    Args:
        state: From `init` or the frame before.
        frame: Scene, camera, G-buffer, key and tracer.
        params: Thresholds.
        options: Tracing, and when to make a new key frame.
    Returns:
        The state, the reflection, and counts: `key_frame`, `reflective_pixels`, `traced_pixels`, `share`. What shows
        through glass is traced in every frame.
    """
    began, cast_before = time.perf_counter(), frame.tracer.rays
    wanted = reflective(frame.gbuffer)
    count = int(wanted.sum())
    image, is_key, traced = nothing_traced(frame.gbuffer), True, count
    if state.key is not None:
        warped, error = warp(state.key, frame, params)
        traced = int((wanted & ~warped.valid).sum())
        share = traced / max(count, 1)
        is_key = wants_key(options, state.age, share, state.spent, float(error), params)
        if not is_key:
            image = dataclasses.replace(image, reflection=warped)
    warped_at = time.perf_counter()
    wanted, traced = (wanted, count) if is_key else (wanted & ~image.reflection.valid, traced)
    image = trace_reflected(frame, image, wanted, options=options)
    transmitted = trace_refracted(frame, options=options)
    result = jax.block_until_ready(dataclasses.replace(image.reflection, transmitted=transmitted))
    share = traced / max(count, 1)
    state = State(keep(frame, image), 1, 1.0) if is_key else State(state.key, state.age + 1, state.spent + share)
    seconds = {"warp": warped_at - began, "trace": time.perf_counter() - warped_at}
    counts = {"key_frame": int(is_key), "reflective_pixels": count, "traced_pixels": traced, "share": share}
    return state, result, Info(frame.tracer.rays - cast_before, seconds, counts, wanted)
