"""Classic environment mapping: the baseline most users would pick instead.

The surroundings are captured once from the centre of each reflector, as if they were infinitely far away, and read
along the mirror direction. Nearby objects come out at the wrong place and the wrong size: that error is what the other
techniques remove.
"""

import time

import jax
import jax.numpy as jnp

from jaxrefl._status import Source
from jaxrefl._types import Frame, GBuffer, Reflection, Scene, Tracer
from jaxrefl.core import refract
from jaxrefl.core.safe import norm
from jaxrefl.surface import mirror_direction, reflective, refractive
from jaxrefl.techniques._captured import capture_reflectors, read_stack
from jaxrefl.techniques._shape import no_reflection
from jaxrefl.techniques.envmap.lookup import read_lobe
from jaxrefl.techniques.envmap.prefilter import level_alphas, prefilter
from jaxrefl.techniques.envmap.types import Info, Options, Params, State

_CONFIDENCE_ALPHA = 0.5
"""Width of the lobe over which nearness is averaged: what is near beside the direction read may belong there."""


def init(scene: Scene, tracer: Tracer, *, options: Options = Options()) -> State:  # noqa: B008  frozen
    """Capture and prefilter the maps.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        options: Scope and sizes.
    Returns:
        The maps.
    Edge cases: a scene without reflectors gets one map, captured from its centre, that nothing uses.
    """
    cast_before = tracer.rays
    maps = capture_reflectors(
        scene, tracer, scope=options.scope, most=options.reflectors, height=options.height, light=options.captured
    )
    nearness = jnp.broadcast_to(maps.nearness[..., None], maps.sharp.shape)
    around = prefilter(nearness, jnp.full(1, _CONFIDENCE_ALPHA), options.rough_height)[:, 0, ..., 0]
    alpha = level_alphas(options.levels)
    return State(
        centre=maps.centre,
        sharp=maps.sharp,
        nearness=around,
        rough=prefilter(maps.sharp, alpha, options.rough_height),
        alpha=alpha,
        map_of_object=maps.map_of_object,
        overflow=maps.overflow,
        rays=jnp.asarray(tracer.rays - cast_before, jnp.int32),
    )


def step(
    state: State,
    frame: Frame,
    params: Params,
    *,
    options: Options = Options(),  # noqa: B008  frozen
) -> tuple[State, Reflection, Info]:
    """Read the reflections of one frame from the maps.

    Args:
        state: From `init`.
        frame: G-buffer of the frame.
        params: No knobs.
        options: As in `init`.
    Returns:
        The state, the reflection, and counts: `maps` and `overflow`.
    """
    began = time.perf_counter()
    reflection = jax.block_until_ready(_read(state, frame.gbuffer))
    counts = {"maps": state.sharp.shape[0], "overflow": int(state.overflow)}
    return state, reflection, Info(0, {"lookup": time.perf_counter() - began}, counts)


@jax.jit
def _read(state: State, gbuffer: GBuffer) -> Reflection:
    row = state.map_of_object[jnp.maximum(gbuffer.object, 0)]
    valid = reflective(gbuffer) & (row >= 0)
    row = jnp.maximum(row, 0)
    wi = mirror_direction(gbuffer)
    radiance = read_lobe(state, row, wi, gbuffer.alpha)
    nearness = read_stack(state.nearness[..., None], row, wi)[..., 0]
    transmitted = None
    if gbuffer.transmission is not None:
        relative_eta = jnp.where(gbuffer.outside, gbuffer.eta, 1 / gbuffer.eta)
        through, _ = refract(gbuffer.wo, gbuffer.ns, relative_eta)
        seen = read_lobe(state, row, through, gbuffer.alpha)
        transmitted = jnp.where((valid & refractive(gbuffer))[..., None], seen, 0)
    empty = no_reflection(gbuffer)
    return Reflection(
        radiance=jnp.where(valid[..., None], radiance, 0),
        valid=valid,
        source=jnp.where(valid, int(Source.ENVIRONMENT), int(Source.NONE)).astype(jnp.int32),
        confidence=jnp.where(valid, 1 / (1 + norm(gbuffer.p - state.centre[row]) * nearness), 0),
        p=empty.p,
        t=empty.t,
        transmitted=transmitted,
    )
