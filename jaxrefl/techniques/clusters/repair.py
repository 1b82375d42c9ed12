"""What is done for pixels whose depth image has no answer: Answer -> Reflection.

Source: [WXKP14] §4.1, environment maps; tracing is a departure.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxrefl._status import Source
from jaxrefl._types import Frame, GBuffer, Reflection
from jaxrefl.surface import reflective
from jaxrefl.techniques._tracing import Traced, nothing_traced, trace_reflected, trace_refracted
from jaxrefl.techniques.clusters.answer import Answer
from jaxrefl.techniques.clusters.types import Found, Options

_GUESS = 0.5
"""Confidence in a surface that a ray met after it had passed behind something."""
_MAP = 0.1
"""Confidence in an environment map that stands in for a depth image."""


def repaired(frame: Frame, found: Answer, *, options: Options) -> tuple[Reflection, int]:
    """The reflection, with the pixels that have no sure answer traced if that is wanted.

    Args:
        frame: Scene, G-buffer, key and tracer.
        found: What the depth images showed.
        options: `repair`, and how to trace.
    Returns:
        The reflection, and how many pixels were traced. What shows through glass is traced always.
    """
    image, wanted = _assemble(frame.gbuffer, found)
    count = 0
    if options.repair == "trace":
        count = int(wanted.sum())
        image = trace_reflected(frame, image, wanted, options=options) if count else image
    transmitted = trace_refracted(frame, options=options)
    return dataclasses.replace(image.reflection, transmitted=transmitted), count


@jax.jit
def _assemble(gbuffer: GBuffer, found: Answer) -> tuple[Traced, Bool[Array, "h w"]]:
    shiny = reflective(gbuffer)
    sure = (found.found == int(Found.SURFACE)) | (found.found == int(Found.SKY))
    valid = shiny & (found.known > 0)
    from_image = valid & (sure | (found.found == int(Found.PASSED)) | (found.hits > 0))
    source = jnp.where(from_image & (found.hits > 0), int(Source.DEPTH_IMAGE), int(Source.ENVIRONMENT))
    guess = jnp.where(found.found == int(Found.PASSED), _GUESS, _MAP)
    hit = (valid & (found.hits > 0))[..., None]
    reflection = Reflection(
        radiance=jnp.where(valid[..., None], found.radiance, 0),
        valid=valid,
        source=jnp.where(valid, source, int(Source.NONE)).astype(jnp.int32),
        confidence=jnp.where(valid, jnp.where(sure, jnp.clip(found.known, 0, 1), guess), 0),
        p=jnp.where(hit, found.p, 0),
        t=jnp.where(hit[..., 0], found.t, 0),
    )
    return Traced(reflection, nothing_traced(gbuffer).reached), shiny & ~sure
