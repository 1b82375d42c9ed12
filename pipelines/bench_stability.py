"""The same scene scaled and moved: what float32 leaves of its image."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import scenes
from jaxrefl._types import Camera
from jaxrefl.radiance import camera_samples, path_radiance
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import Description, assemble

CHANGES = {
    "as it is, another seed": (1.0, 0.0),
    "scaled by 0.001": (1e-3, 0.0),
    "scaled by 1000": (1e3, 0.0),
    "moved by 1 diameter": (1.0, 1.0),
    "moved by 10 diameters": (1.0, 10.0),
    "moved by 100 diameters": (1.0, 100.0),
    "moved by 1000 diameters": (1.0, 1000.0),
}
"""Factor on all lengths, and distance along the diagonal in diameters."""


def bench_stability(name: str, size: tuple[int, int], samples: int) -> list[dict]:
    """Images of a changed scene against the scene as it is.

    Args:
        name: Built-in scene without point lights.
        size: (width, height).
        samples: Samples per pixel.
    Returns:
        One row per change: difference of the mean radiance, and of the typical and the worst pixels, in per cent of
            the mean. The first row has another seed instead of a change: it is the noise.
    """
    description = scenes.build(name)
    camera = scenes.BUILT_IN[name].path(1, size=size)[0]
    vertices = np.concatenate([part.vertices for part in description.parts])
    diameter = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    truth = _image(description, camera, samples, seed=0)
    rows = []
    for label, (scale, distance) in CHANGES.items():
        offset = np.full(3, scale * distance * diameter / np.sqrt(3))
        parts = [dataclasses.replace(p, vertices=scale * p.vertices + offset) for p in description.parts]
        matrix = np.array(camera.world_from_camera, np.float64)
        matrix[:3, 3] = scale * matrix[:3, 3] + offset
        moved = dataclasses.replace(camera, world_from_camera=jnp.asarray(matrix, jnp.float32))
        changed = dataclasses.replace(description, parts=parts)
        found = _image(changed, moved, samples, seed=1 if (scale, distance) == (1, 0) else 0)
        off = 100 * np.abs(found - truth).mean(-1) / truth.mean()
        rows.append(
            {
                "scene": label,
                "mean, %": float(100 * (found.mean() / truth.mean() - 1)),
                "typical pixel, %": float(np.median(off)),
                "99th percentile, %": float(np.quantile(off, 0.99)),
            }
        )
    return rows


def _image(description: Description, camera: Camera, samples: int, *, seed: int) -> np.ndarray:
    scene = assemble(description)
    number = jnp.arange(samples, dtype=jnp.uint32)
    rays = camera_samples(camera, jnp.full_like(number, seed), number)
    return np.asarray(path_radiance(scene, EmbreeTracer(scene.mesh), *rays)).mean(0)
