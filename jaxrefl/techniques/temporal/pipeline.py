"""Reflections reprojected from key frames, and traced where that fails.

A key frame is traced and kept as a reflection buffer. For the frames after it: search where its reflected points are
seen now, draw it there, refine each pixel to the law of reflection, test the result, trace the pixels that fail.

Source: [XWD17], Algorithm 1.
"""

import dataclasses
import time

import jax
import jax.numpy as jnp

from jaxrefl._types import Frame, Reflection, Scene, Tracer
from jaxrefl.techniques._reproject import wants_key
from jaxrefl.techniques._tracing import trace_reflected, trace_refracted
from jaxrefl.techniques.temporal.keys import advance, followed, key_frame_of, renewed
from jaxrefl.techniques.temporal.merge import choose, flow_of, nothing_offered, taken_over
from jaxrefl.techniques.temporal.propose import offer
from jaxrefl.techniques.temporal.types import Info, Options, Params, State, Taken


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


def ahead(options: Options) -> int:
    """Of how many frames one is a key frame that the frames before it must know.

    Args:
        options: Static knobs.
    Returns:
        The key-frame interval with two keys; else 0: no frame looks ahead.
    """
    return options.interval if options.keys == 2 else 0


def step(
    state: State,
    frame: Frame,
    params: Params,
    *,
    options: Options = Options(),  # noqa: B008  frozen
) -> tuple[State, Reflection, Info]:
    """Reproject the key frame's reflections into a frame and trace the rest.

    Args:
        state: From `init` or the frame before.
        frame: Scene, camera, G-buffer, key, tracer; with `keys = 2` also the camera of the next key frame.
        params: Thresholds.
        options: Tracing, method, and when to make a new key frame.
    Returns:
        The state, the reflection, and counts: `key_frame`, `reflective_pixels`, `traced_pixels`, `share` (traced of
        reflective pixels), `overflow` (pixels beyond the budget, without a reflection), `too_wide` (triangles not
        drawn), `expected_error`. What shows through glass is traced in every frame.
    """
    cast_before, began = frame.tracer.rays, time.perf_counter()
    state = advance(state, frame, params, options=options)
    looked_ahead = time.perf_counter()
    found, state, seconds = offer(state, frame, params, options=options)
    is_key = state.key is None or (
        not found.exact and wants_key(options, state.age, found.share, state.spent, found.error, params)
    )
    offered_at = time.perf_counter()
    proposal = nothing_offered(frame.gbuffer) if is_key else found.proposal
    taken, wanted, overflow = choose(proposal, frame.gbuffer, percent=100 if is_key else options.budget)
    image = trace_reflected(frame, taken_over(proposal, taken, frame.gbuffer, params), wanted, options=options)
    transmitted = trace_refracted(frame, options=options)
    result = jax.block_until_ready(dataclasses.replace(image.reflection, transmitted=transmitted))
    traced_at = time.perf_counter()
    share = int(wanted.sum()) / max(found.pixels, 1)
    if is_key:
        state = renewed(state, key_frame_of(frame, image, params, options=options))
    elif not found.exact:
        from_key = taken & (found.taken_from != int(Taken.RECENT))
        state = followed(state, frame, image, jnp.where(taken, proposal.error, 0), from_key, params, options=options)
    state = jax.block_until_ready(state)
    state = dataclasses.replace(state, age=state.age + 1, spent=state.spent + share)
    counts = {
        "key_frame": int(is_key),
        "reflective_pixels": found.pixels,
        "traced_pixels": int(wanted.sum()),
        "share": share,
        "overflow": int(overflow),
        "too_wide": found.too_wide,
        "expected_error": 0.0 if is_key else found.error,
    }
    seconds |= {"look_ahead": looked_ahead - began, "trace": traced_at - offered_at}
    seconds["keep"] = time.perf_counter() - traced_at
    rays, flow = frame.tracer.rays - cast_before, flow_of(proposal, taken)
    return state, result, Info(rays, seconds, counts, proposal.reason, flow, jnp.where(taken, found.taken_from, 0))
