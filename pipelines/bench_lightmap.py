"""How right light maps are: the baked diffuse light of a view against path traced light, by texels and samples.

The truth has noise too. Its two halves tell how much, and the mean square of that is taken off the error's.
"""

import dataclasses
import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import scenes
from jaxrefl._types import Camera, Scene, Tracer
from jaxrefl.core import pixel_sequences, resize
from jaxrefl.radiance import LightMapOptions, bake, baked_light, path_light
from jaxrefl.rays import EmbreeTracer, camera_rays
from jaxrefl.scene import assemble, load
from jaxrefl.surface import look

_AT_ONCE = 2**19


class Truth(NamedTuple):
    """Path traced diffuse light at pixel centres."""

    light: np.ndarray
    """[h w 3] mean over all samples."""
    variance: float
    """Mean square of its noise."""
    seconds: float
    """Time it took."""


def bench_lightmap(
    names: list[str], size: tuple[int, int], samples: int, tries: tuple[tuple[int, int], ...]
) -> Iterator[dict]:
    """Errors of light maps.

    Args:
        names: Built-in scenes, or scene files with a camera.
        size: (width, height) of the views.
        samples: Paths per pixel of the truth, even.
        tries: Texels and samples per texel of the maps.
    Yields:
        One row per scene and map.
    """
    for name in names:
        scene, camera = _scene(name, size)
        tracer = EmbreeTracer(scene.mesh)
        truth = _truth(scene, tracer, camera, samples)
        gbuffer = look(scene, tracer, camera)
        for texels, each in tries:
            began = time.perf_counter()
            lightmap = bake(scene, tracer, options=LightMapOptions(texels=texels, samples=each))
            seconds = time.perf_counter() - began
            image = np.asarray(baked_light(dataclasses.replace(scene, lightmap=lightmap), gbuffer), np.float64)
            square, mean = ((image - truth.light) ** 2).mean(), truth.light.mean()
            yield {
                "scene": scene.names.scene,
                "texels": texels,
                "paths per texel and side": each,
                "bake s": seconds,
                "RMSE / mean, noise of the truth taken off": float(np.sqrt(max(square - truth.variance, 0)) / mean),
                "as measured": float(np.sqrt(square) / mean),
                "noise of the truth": float(np.sqrt(truth.variance) / mean),
                "bias": float((image - truth.light).mean() / mean),
            }


def _scene(name: str, size: tuple[int, int]) -> tuple[Scene, Camera]:
    if name in scenes.BUILT_IN:
        return assemble(scenes.build(name)), scenes.BUILT_IN[name].path(1, size=size)[0]
    scene = load(name)
    return scene, resize(scene.cameras[0], size)


def _truth(scene: Scene, tracer: Tracer, camera: Camera, samples: int) -> Truth:
    began, rays = time.perf_counter(), camera_rays(camera)
    pixels = camera.width * camera.height
    sequence = pixel_sequences(jnp.asarray(7, jnp.uint32), jnp.arange(pixels, dtype=jnp.int32))
    # The halves have sequences of their own: those of one low-discrepancy sequence would not be independent.
    halves = []
    at_once = max(min(_AT_ONCE // pixels, samples // 2), 1)
    for half in range(2):
        own, total = sequence + jnp.asarray(half, jnp.uint32), np.zeros((camera.height, camera.width, 3))
        for first in range(0, samples // 2, at_once):
            number = jnp.arange(first, min(first + at_once, samples // 2), dtype=jnp.uint32)
            shape = (number.shape[0], camera.height, camera.width)
            many = jax.tree.map(lambda x, k=shape[0]: jnp.broadcast_to(x, (k, *x.shape)), rays)
            sequences = jnp.broadcast_to(own.reshape(shape[1:]), shape)
            light = path_light(scene, tracer, many, sequences, jnp.broadcast_to(number[:, None, None], shape))
            total += np.asarray(light.diffuse, np.float64).sum(0)
        halves.append(total / (samples // 2))
    variance = float(((halves[0] - halves[1]) ** 2).mean() / 4)
    return Truth((halves[0] + halves[1]) / 2, variance, time.perf_counter() - began)
