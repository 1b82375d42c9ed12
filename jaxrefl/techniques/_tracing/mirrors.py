"""Every reflector traced as if it were smooth: Frame -> what a mirror in its place would show."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._status import Source
from jaxrefl._types import Frame, GBuffer, Reflection
from jaxrefl.filters import relative_distance
from jaxrefl.surface import reflective
from jaxrefl.techniques._tracing.options import TraceOptions
from jaxrefl.techniques._tracing.pixels import nothing_traced, trace_reflected


def trace_mirrors(frame: Frame, *, options: TraceOptions) -> Reflection:
    """One mirror ray per reflective pixel, whatever its roughness.

    Args:
        frame: Scene, G-buffer, key and tracer.
        options: Light, bounces, block size; `samples` are light samples at the end of the ray.
    Returns:
        The sharp reflection; `transmitted` is None.
    """
    smooth = dataclasses.replace(frame.gbuffer, alpha=jnp.zeros_like(frame.gbuffer.alpha))
    frame = dataclasses.replace(frame, gbuffer=smooth)
    return trace_reflected(frame, nothing_traced(smooth), smooth.valid, options=options).reflection


@jax.jit
def distance_of(gbuffer: GBuffer, sharp: Reflection) -> Float[Array, "h w"]:
    """Relative distance of what each mirror ray hit.

    Args:
        gbuffer: G-buffer of the frame.
        sharp: From `trace_mirrors`.
    Returns:
        tau in [0, 1]: 0 at the contact, 1 for the environment.
    """
    far = sharp.source == int(Source.ENVIRONMENT)
    return relative_distance(gbuffer.t, jnp.where(far, jnp.inf, sharp.t))


@jax.jit
def blurred(sharp: Reflection, radiance: Float[Array, "h w 3"], known: Bool[Array, "h w"]) -> Reflection:
    """A sharp reflection with what a filter made of its radiance.

    Args:
        sharp: From `trace_mirrors`.
        radiance: The filtered radiance.
        known: Where the filter has a result.
    Returns:
        The reflection; sharp where the filter has none.
    """
    use = (known & sharp.valid)[..., None]
    return dataclasses.replace(sharp, radiance=jnp.where(use, radiance, sharp.radiance))


def counts_of(gbuffer: GBuffer) -> dict[str, int]:
    """What techniques that blur mirror rays tell of a frame.

    Args:
        gbuffer: G-buffer of the frame.
    Returns:
        `reflective_pixels`, and `glossy_pixels` among them.
    """
    shiny = reflective(gbuffer)
    return {"reflective_pixels": int(shiny.sum()), "glossy_pixels": int((shiny & (gbuffer.alpha > 0)).sum())}
