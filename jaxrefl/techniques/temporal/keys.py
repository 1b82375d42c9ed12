"""Key frames as a run goes on: which are at hand, tracing the next one ahead of time, a new one in place of the old.

State + Frame -> State.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import Frame
from jaxrefl.surface import look
from jaxrefl.techniques._reproject import same_camera
from jaxrefl.techniques._tracing import Traced, nothing_traced, trace_reflected
from jaxrefl.techniques.temporal.buffer import keep
from jaxrefl.techniques.temporal.types import REACH, Options, Params, ReflectionBuffer, State


def key_frame_of(frame: Frame, image: Traced, params: Params, *, options: Options) -> ReflectionBuffer:
    """A key frame from a frame all of whose pixels were traced.

    Args:
        frame: The frame.
        image: Its reflections.
        params: `sharp`.
        options: What a key frame keeps.
    Returns:
        The key frame.
    """
    return keep(frame, image, jnp.zeros_like(frame.gbuffer.t), params, options=options)


def advance(state: State, frame: Frame, params: Params, *, options: Options) -> State:
    """The key frames for a frame.

    Args:
        state: From the frame before.
        frame: The frame to render.
        params: `sharp`.
        options: `keys`.
    Returns:
        The state; where the run has arrived at the next key frame, that has become the last one. With two keys the next
        one is traced, in the scene as it is now, as soon as its camera is known.
    """
    if options.keys == 1:
        return state
    if state.ahead is not None and same_camera(state.ahead.camera, frame.camera) and is_still(state.ahead, frame):
        state = State(key=state.ahead, search=state.search_ahead, spent=1.0)
    camera = frame.ahead
    if camera is None or same_camera(camera, frame.camera):
        return dataclasses.replace(state, ahead=None, search_ahead=None)
    if state.ahead is not None and same_camera(state.ahead.camera, camera):
        return state
    gbuffer = look(frame.scene, frame.tracer, camera)
    there = Frame(frame.scene, camera, gbuffer, jax.random.fold_in(frame.key, 1), frame.tracer)
    image = trace_reflected(there, nothing_traced(gbuffer), gbuffer.valid, options=options)
    return dataclasses.replace(state, ahead=key_frame_of(there, image, params, options=options), search_ahead=None)


def renewed(state: State, key: ReflectionBuffer) -> State:
    """The state after a new key frame.

    Args:
        state: Before it.
        key: The new key frame.
    Returns:
        A state that starts from it; a key frame ahead stays.
    """
    return State(key=key, ahead=state.ahead, search_ahead=state.search_ahead)


def followed(
    state: State,
    frame: Frame,
    image: Traced,
    error: Float[Array, "h w"],
    from_key: Bool[Array, "h w"],
    params: Params,
    *,
    options: Options,
) -> State:
    """The state after a frame that is no key frame.

    Args:
        state: Before it.
        frame: The frame.
        image: Its reflections, reused and traced.
        error: Expected relative errors; 0 where it was traced.
        from_key: Pixels that were taken from a key frame.
        params: `sharp`.
        options: `recent`.
    Returns:
        With `recent` a state that keeps the frame: what it traced, the next one need not trace again. What it reused
        keeps its expected error, so errors of reuse from frame to frame add up until they count as contrast.
    """
    if not options.recent or options.method == "as_published":
        return state
    lacking = _around(image.reflection.valid & ~from_key)
    return dataclasses.replace(state, recent=keep(frame, image, error, params, options=options), lacking=lacking)


@jax.jit
def _around(mask: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """The pixels within `REACH` of a mask."""
    size = 2 * REACH + 1
    for window in ((size, 1), (1, size)):
        mask = jax.lax.reduce_window(mask, False, jax.lax.bitwise_or, window, (1, 1), "SAME")
    return mask


def is_still(buffer: ReflectionBuffer, frame: Frame) -> bool:
    """Whether a frame's scene is the very one of a key frame.

    Args:
        buffer: The key frame.
        frame: The frame.
    Returns:
        True if no vertex has moved.
    """
    vertices = frame.scene.mesh.vertices
    if vertices is buffer.vertices:
        return True
    return vertices.shape == buffer.vertices.shape and bool((vertices == buffer.vertices).all())
