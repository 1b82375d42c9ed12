"""How well energy is kept: the built-in furnace, slice by slice.

In a world of radiance 1 each pixel should be 1. The furnace is a convex white ball cut into slices of alpha 0 to 1,
metal above and dielectric below.
"""

import jax
import numpy as np

import scenes
from jaxrefl._types import Frame
from jaxrefl.composite import Options, blend
from jaxrefl.radiance import DirectOptions, direct_light
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.surface import look
from jaxrefl.techniques import raytrace


def bench_energy(size: tuple[int, int], samples: int) -> list[dict]:
    """Mean image value of each slice, with and without multiple scattering.

    Args:
        size: (width, height).
        samples: Rays per pixel and light samples per point.
    Returns:
        One row per slice: mean with each option, and the share of pixels off by more than 0.5 %.
    """
    scene = assemble(scenes.build("furnace"))
    tracer, camera = EmbreeTracer(scene.mesh), scenes.BUILT_IN["furnace"].path(1, size=size)[0]
    gbuffer = look(scene, tracer, camera)
    light = DirectOptions(environment_samples=samples)
    diffuse = direct_light(scene, tracer, gbuffer, jax.random.key(0), options=light)
    frame = Frame(scene, camera, gbuffer, jax.random.key(1), tracer)
    options = raytrace.Options(samples=samples)
    _, reflection, _ = raytrace.step(raytrace.State(), frame, raytrace.Params(), options=options)
    full = np.asarray(blend(gbuffer, diffuse, reflection))[..., 0]
    single = np.asarray(blend(gbuffer, diffuse, reflection, options=Options(multiple_scattering=False)))[..., 0]
    rows = []
    for index, name in enumerate(scene.names.materials):
        seen = np.asarray(gbuffer.material) == index
        if seen.any():
            rows.append(
                {
                    "slice": name,
                    "mean": float(full[seen].mean()),
                    "mean, single scattering": float(single[seen].mean()),
                    "pixels off by > 0.5 %": float((np.abs(full[seen] - 1) > 5e-3).mean()),
                }
            )
    return rows
