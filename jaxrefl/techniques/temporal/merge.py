"""From what key frames offer to the image: what to take, what to trace within the budget, where each pixel is from.

Proposal + Frame -> mask of pixels to trace, Traced, Reflection.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._status import Source
from jaxrefl._types import GBuffer, Reflection
from jaxrefl.core.safe import norm
from jaxrefl.surface import reflective
from jaxrefl.techniques._reproject import pixel_centres
from jaxrefl.techniques._tracing import Reached, Traced
from jaxrefl.techniques.temporal.check import no_proposal
from jaxrefl.techniques.temporal.types import Params, Proposal, Reason, ReflectionBuffer


@jax.jit
def nothing_offered(gbuffer: GBuffer) -> Proposal:
    """What there is when all pixels are traced.

    Args:
        gbuffer: G-buffer of the frame.
    Returns:
        A proposal with reason KEY at each reflective pixel.
    """
    return no_proposal(jnp.where(reflective(gbuffer), int(Reason.KEY), int(Reason.NONE)).astype(jnp.int32))


@jax.jit
def as_kept(buffer: ReflectionBuffer) -> Proposal:
    """The key frame itself, for a camera that has not moved: exact.

    Args:
        buffer: The key frame.
    Returns:
        A proposal with its own pixels.
    """
    h, w = buffer.valid.shape
    centres = pixel_centres(h, w)
    known = buffer.valid[..., None]
    reason = jnp.where(buffer.valid, int(Reason.REUSED), int(Reason.NONE)).astype(jnp.int32)
    return Proposal(
        uv=jnp.where(known, centres, 0),
        reason=reason,
        error=jnp.zeros_like(buffer.t),
        radiance=buffer.radiance,
        reflected=jnp.where(known, buffer.reflected, 0),
        triangle=buffer.triangle,
        seen=buffer.seen,
    )


@functools.partial(jax.jit, static_argnames="percent")
def choose(
    proposal: Proposal, gbuffer: GBuffer, *, percent: int
) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"], Int[Array, ""]]:
    """What to take and what to trace.

    Args:
        proposal: What is offered.
        gbuffer: G-buffer of the frame.
        percent: Most pixels to trace, of the whole image.
    Returns:
        Pixels to take, pixels to trace, and how many more should have been traced. Of those, pixels that failed for
            their contrast alone are taken, and the others stay without a reflection.
    Edge cases: the budget goes to pixels in order, from the top.
    """
    wanted, taken = reflective(gbuffer), proposal.reason == int(Reason.REUSED)
    missing = wanted & ~taken
    most = wanted.size * percent // 100
    rank = jnp.cumsum(missing.reshape(-1).astype(jnp.int32)).reshape(missing.shape)
    traced = missing & (rank <= most)
    doubtful = missing & ~traced & (proposal.reason == int(Reason.CONTRAST))
    return (wanted & taken) | doubtful, traced, (missing & ~traced).sum().astype(jnp.int32)


@jax.jit
def taken_over(proposal: Proposal, taken: Bool[Array, "h w"], gbuffer: GBuffer, params: Params) -> Traced:
    r"""The image with all pixels that are taken from a key frame.

    $$ \text{confidence} = \frac{1}{1 + e / \text{contrast}} $$

    Args:
        proposal: What is offered.
        taken: Which pixels to take.
        gbuffer: G-buffer of the frame.
        params: `contrast`.
    Returns:
        The image; the other pixels have fill values.
    """
    finite = taken & (proposal.reflected[..., 3] > 0.5)
    point = jnp.where(finite[..., None], proposal.reflected[..., :3], 0)
    confidence = 1 / (1 + proposal.error / jnp.maximum(params.contrast, 1e-6))
    reflection = Reflection(
        radiance=jnp.where(taken[..., None], proposal.radiance, 0),
        valid=taken,
        source=jnp.where(taken, int(Source.REUSED), int(Source.NONE)).astype(jnp.int32),
        confidence=jnp.where(taken, confidence, 0),
        p=point,
        t=jnp.where(finite, norm(point - gbuffer.p), 0),
    )
    reached = Reached(
        triangle=jnp.where(taken, proposal.triangle, -1),
        colour=jnp.where(taken[..., None], proposal.seen, 0),
        changing=jnp.zeros_like(taken),
    )
    return Traced(reflection, reached)


@jax.jit
def flow_of(proposal: Proposal, taken: Bool[Array, "h w"]) -> Float[Array, "h w 2"]:
    """Specular flow.

    Args:
        proposal: What is offered.
        taken: Pixels taken from a key frame.
    Returns:
        Key-frame coordinate minus pixel centre, (x, y) in pixels; 0 elsewhere.
    """
    h, w = taken.shape
    centres = pixel_centres(h, w)
    return jnp.where(taken[..., None], proposal.uv - centres, 0)
