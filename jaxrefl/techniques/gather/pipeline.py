"""Image-space gathering: one mirror ray per pixel, then a mean over a disk in the image. A baseline.

Source: [RS09] Robison and Shirley, "Image space gathering", HPG 2009.
Differs from the source: wide disks are averaged on a pyramid, with the functions of the gloss filter, so that times
compare.
"""

import dataclasses
import time

import jax

from jaxrefl._types import Frame, Reflection, Scene, Tracer
from jaxrefl.filters import GlossOptions, GlossParams, gloss, guides_of
from jaxrefl.techniques._tracing import blurred, counts_of, distance_of, trace_mirrors, trace_refracted
from jaxrefl.techniques.gather.cone import cone_footprint
from jaxrefl.techniques.gather.types import Info, Options, Params, State

_guides = jax.jit(guides_of)


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
    """Trace mirror rays and gather around each pixel.

    Args:
        state: From `init`.
        frame: Scene, camera, G-buffer, key and tracer.
        params: Thresholds and the cone's width.
        options: Tracing and searching.
    Returns:
        The state, the reflection, and counts: `reflective_pixels`, `glossy_pixels`.
    """
    began, cast_before = time.perf_counter(), frame.tracer.rays
    sharp = trace_mirrors(frame, options=options)
    transmitted = trace_refracted(frame, options=options)
    result = jax.block_until_ready(dataclasses.replace(sharp, transmitted=transmitted))
    traced_at = time.perf_counter()
    if frame.scene.features.glossy:
        tau = distance_of(frame.gbuffer, sharp)
        size = cone_footprint(frame.camera, frame.gbuffer, tau, params, search=options.search)
        how = GlossOptions("window", options.radius, options.layers, spread=False)
        limits, guides = GlossParams(params.normal, params.depth), _guides(frame.camera, frame.gbuffer)
        radiance, known = gloss(sharp.radiance, sharp.confidence, tau, guides, size, limits, options=how)
        result = jax.block_until_ready(blurred(result, radiance, known))
    seconds = {"trace": traced_at - began, "gather": time.perf_counter() - traced_at}
    return state, result, Info(frame.tracer.rays - cast_before, seconds, counts_of(frame.gbuffer))
