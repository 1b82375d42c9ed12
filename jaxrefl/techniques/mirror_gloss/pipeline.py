"""One mirror ray per pixel, then the gloss filter: glossy reflections without noise.

Source: [RLPWSD20] §6, with a mirror image in place of reprojected probes.
"""

import dataclasses
import functools
import time

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import Camera, Frame, GBuffer, Reflection, Scene, Tracer
from jaxrefl.filters import Guides, footprint, gloss, guides_of, load_table
from jaxrefl.surface import reflective
from jaxrefl.techniques._tracing import blurred, counts_of, distance_of, trace_mirrors, trace_refracted
from jaxrefl.techniques.mirror_gloss.types import Info, Options, Params, State

_footprint = jax.jit(footprint, static_argnames="options")


def init(scene: Scene, tracer: Tracer, *, options: Options = Options()) -> State:  # noqa: B008  frozen
    """Read the table of lobes, or build it.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        options: Static knobs.
    Returns:
        The table; none for a scene without glossy surfaces.
    """
    return State(load_table(options=options.table) if scene.features.glossy else None)


def step(
    state: State,
    frame: Frame,
    params: Params,
    *,
    options: Options = Options(),  # noqa: B008  frozen
) -> tuple[State, Reflection, Info]:
    """Trace mirror rays and blur what they show.

    Args:
        state: From `init`.
        frame: Scene, camera, G-buffer, key and tracer.
        params: Thresholds of the filter.
        options: Tracing and filtering.
    Returns:
        The state, the reflection, and counts: `reflective_pixels`, `glossy_pixels`. `p` and `t` are those of the mirror
        ray.
    """
    began, cast_before = time.perf_counter(), frame.tracer.rays
    sharp = trace_mirrors(frame, options=options)
    transmitted = trace_refracted(frame, options=options)
    sharp = jax.block_until_ready(dataclasses.replace(sharp, transmitted=transmitted))
    traced_at = time.perf_counter()
    result = sharp if state.table is None else blur(state, frame.camera, frame.gbuffer, sharp, params, options=options)
    result = jax.block_until_ready(result)
    seconds = {"trace": traced_at - began, "gloss": time.perf_counter() - traced_at}
    return state, result, Info(frame.tracer.rays - cast_before, seconds, counts_of(frame.gbuffer))


def blur(
    state: State, camera: Camera, gbuffer: GBuffer, sharp: Reflection, params: Params, *, options: Options
) -> Reflection:
    """The filter alone: a sharp reflection becomes that of the surface's roughness.

    Args:
        state: From `init`, with a table.
        camera: The frame's camera.
        gbuffer: What it sees.
        sharp: Sharp reflection.
        params: Thresholds.
        options: Footprints and filter.
    Returns:
        The glossy reflection.
    Raises:
        ValueError: If the state has no table.
    """
    if state.table is None:
        raise ValueError("state: expected one of a scene with glossy surfaces, got one without a table")
    tau: Float[Array, "h w"] = distance_of(gbuffer, sharp)
    size = _footprint(state.table, camera, gbuffer, tau, options=options.footprint)
    guides = _guides(camera, gbuffer, within=options.within)
    radiance, known = gloss(
        sharp.radiance, sharp.confidence, tau, guides, size, params.gloss, options=options.filter
    )  # fmt: skip
    return blurred(sharp, radiance, known)


@functools.partial(jax.jit, static_argnames="within")
def _guides(camera: Camera, gbuffer: GBuffer, *, within: str) -> Guides:
    ids = 0 if within == "plane" else gbuffer.material
    return guides_of(camera, gbuffer, ids=jnp.where(reflective(gbuffer), ids, -1))
