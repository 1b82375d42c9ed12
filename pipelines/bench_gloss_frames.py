"""Frames of scenes whose reflectors all have one roughness, and what a technique makes of them in which time.

Times are processor time of a whole step, compilation left out: other processes on the machine do not count.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Frame
from jaxrefl.core import resize
from jaxrefl.surface import look, reflective
from jaxrefl.techniques import TECHNIQUES
from pipelines.job import Job, SceneSource
from pipelines.measure import compile_seconds
from pipelines.resolve import resolve
from pipelines.stage import Stage

LIGHT: dict[str, Any] = {"light": "baked"}
"""Light where rays end, for all: from a map, so that no noise of shadow rays hides what is compared."""


class Run(NamedTuple):
    """A technique's frame and its cost."""

    image: np.ndarray
    """[h w 3] linear."""
    ms: float
    """Processor time of the step."""
    filter_ms: float
    """Of filtering or gathering alone."""


def frame_of(name: str, size: tuple[int, int], alpha: float | None) -> Frame:
    """First frame of a scene's path, all of whose reflectors have one roughness.

    Args:
        name: Built-in scene or file.
        size: (width, height).
        alpha: Width of the lobe; None: as the scene says.
    Returns:
        The frame.
    """
    stage = _stage(name)
    camera = resize(stage.camera(0), size)
    gbuffer = look(stage.scene, stage.tracer, camera)
    scene = dataclasses.replace(stage.scene, features=dataclasses.replace(stage.scene.features, glossy=True))
    return with_alpha(Frame(scene, camera, gbuffer, stage.key(0, 1), stage.tracer), alpha)


@functools.lru_cache(maxsize=8)
def _stage(name: str) -> Stage:
    light = {"model": "baked", "texels": 2**14, "bake_samples": 16}
    return Stage(resolve(Job(SceneSource(name), techniques=("raytrace",), frames=240, light=light)), say=print)


def with_alpha(frame: Frame, alpha: float | None) -> Frame:
    """A frame all of whose reflectors have one roughness.

    Args:
        frame: A frame.
        alpha: Width of the lobe; None: as it is.
    Returns:
        The frame.
    """
    if alpha is None:
        return frame
    rough = jnp.where(reflective(frame.gbuffer), jnp.float32(alpha), 0)
    return dataclasses.replace(frame, gbuffer=dataclasses.replace(frame.gbuffer, alpha=rough))


def glossy_pixels(frame: Frame) -> np.ndarray:
    """Pixels over which errors are averaged.

    Args:
        frame: A frame.
    Returns:
        [h w], True where the surface is glossy.
    """
    return np.asarray(reflective(frame.gbuffer) & (frame.gbuffer.alpha > 0))


def processor_seconds(call: Callable[[], Any]) -> tuple[Any, float]:
    """A result and the processor time it took, all threads together; what has to compile first is run again.

    Args:
        call: A call without side effects.
    Returns:
        Both.
    """
    with compile_seconds() as spent:
        began = time.process_time()
        value = jax.block_until_ready(call())
        seconds = time.process_time() - began
    if spent:
        began = time.process_time()
        value = jax.block_until_ready(call())
        seconds = time.process_time() - began
    return value, seconds


def run(frame: Frame, name: str, knobs: Mapping[str, Any]) -> Run:
    """One frame of a technique.

    Args:
        frame: The frame.
        name: Of the technique.
        knobs: Its options.
    Returns:
        The image and its cost.
    """
    technique = TECHNIQUES[name]
    options = technique.Options(**knobs)
    state = technique.init(frame.scene, frame.tracer, options=options)
    (_, reflection, info), seconds = processor_seconds(
        lambda: technique.step(state, frame, technique.Params(), options=options)
    )
    filtering = info.seconds.get("gloss", 0.0) + info.seconds.get("gather", 0.0)
    share = filtering / max(sum(info.seconds.values()), 1e-12)
    return Run(np.asarray(reflection.radiance), 1e3 * seconds, 1e3 * seconds * share)


def rays_of(frame: Frame, samples: int, key: int) -> Run:
    """Ray tracing.

    Args:
        frame: The frame.
        samples: GGX rays per pixel.
        key: Number of the random key.
    Returns:
        The image and its cost.
    """
    frame = dataclasses.replace(frame, key=jax.random.fold_in(frame.key, key))
    return run(frame, "raytrace", {**LIGHT, "samples": samples})
