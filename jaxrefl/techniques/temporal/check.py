"""Whether a place in the key frame may be taken for a pixel: Refined + key frame -> Proposal.

One test per way in which reuse can be wrong: the point is not on the mirror ray, it lies between two things, the
colours around it differ too much, it looks different from here, something hides it. What passes has an expected error.

Beyond [XWD17], whose mask only knows gaps and magnified triangles: its Fig. 9 shows what that misses.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import Frame, GBuffer, Rays
from jaxrefl.core.safe import norm
from jaxrefl.rays import offset_origin
from jaxrefl.surface import mirror_direction, reflective
from jaxrefl.techniques._reproject import SNAP, Footprint, all_of, components, footprint, read
from jaxrefl.techniques.temporal.refine import Refined
from jaxrefl.techniques.temporal.types import Options, Params, Proposal, Reason, ReflectionBuffer

_SHORT = 1e-3
"""Share of the way to the point at its end in which nothing is looked for: there lies the point itself."""


@jax.jit
def judge(
    buffer: ReflectionBuffer,
    gbuffer: GBuffer,
    refined: Refined,
    covered: Bool[Array, "h w"],
    moved: Bool[Array, "h w"],
    params: Params,
) -> Proposal:
    r"""Test each pixel, all but for what may hide its point.

    $$ e = 2 f_x (1 - f_x)\, b_x + 2 f_y (1 - f_y)\, b_y $$

    is the expected error of a value between pixels with second differences b: that of an edge somewhere between them.

    Args:
        buffer: The key frame.
        gbuffer: What is seen now.
        refined: Place and residual per pixel.
        covered: Where there was a start.
        moved: Where the reflector has moved.
        params: `tolerance`, `contrast`, `lobe`.
    Returns:
        The proposal; a place within `SNAP` of a key-frame pixel needs no neighbours and has no error.
    """
    shape, smooth = covered.shape, gbuffer.alpha == 0
    at = footprint(refined.uv.reshape(-1, 2), shape=buffer.t.shape, snap=SNAP)
    rough_known = all_of(buffer.valid.reshape(-1), at)
    known = rough_known & all_of(buffer.smooth.reshape(-1), at)
    single = ((at.fx == 0) | (at.fx == 1)) & ((at.fy == 0) | (at.fy == 1))
    whole = buffer.connected.reshape(-1)[at.cell] | single
    steady = all_of(~buffer.changing.reshape(-1), at)
    edge = jnp.where(smooth, (known & whole).reshape(shape), rough_known.reshape(shape))
    between = _expected_error(buffer, at).reshape(shape)
    turn = refined.tangent / jnp.maximum(gbuffer.alpha, 1e-6)
    inherited = read([buffer.error.reshape(-1)], at)[0].reshape(shape)
    error = inherited + jnp.where(smooth, between, params.contrast * turn / jnp.maximum(params.lobe, 1e-6))

    # The first test that fails is the reason, so the last one written wins.
    reason = jnp.full(shape, int(Reason.REUSED), jnp.int32)
    for failed, code in (
        (error > jnp.where(smooth, params.contrast, 2 * params.contrast), Reason.CONTRAST),
        (~smooth & (turn > params.lobe), Reason.LOBE),
        (~steady.reshape(shape) & smooth, Reason.CHANGING),
        (smooth & ~(refined.residual <= params.tolerance), Reason.RESIDUAL),
        (~edge, Reason.EDGE),
        (~covered, Reason.UNSEEN),
        (moved, Reason.MOVED),
        (~reflective(gbuffer), Reason.NONE),
    ):
        reason = jnp.where(failed, int(code), reason)
    usable = (reason == int(Reason.REUSED)) | (reason == int(Reason.CONTRAST))
    values = read(components(jnp.concatenate([buffer.radiance, buffer.reflected, buffer.seen], -1)), at)
    nearest = at.cell + jnp.where(at.fx >= 0.5, 1, 0) + jnp.where(at.fy >= 0.5, at.width, 0)
    triangle = buffer.triangle.reshape(-1)[nearest].reshape(shape)
    radiance = jnp.stack(values[:3], -1).reshape(*shape, 3)
    seen = jnp.stack(values[7:], -1).reshape(*shape, 3)
    reflected = jnp.stack(values[3:7], -1).reshape(*shape, 4)
    return Proposal(
        uv=jnp.where(usable[..., None], refined.uv, 0),
        reason=reason,
        error=jnp.where(usable, error, 0),
        radiance=jnp.where(usable[..., None], radiance, 0),
        reflected=jnp.where(usable[..., None], reflected, 0),
        triangle=jnp.where(usable, triangle, -1),
        seen=jnp.where(usable[..., None], seen, 0),
    )


def _expected_error(buffer: ReflectionBuffer, at: Footprint) -> Float[Array, "n"]:
    bend_x, bend_y = buffer.bend_x.reshape(-1)[at.cell], buffer.bend_y.reshape(-1)[at.cell]
    return 2 * (at.fx * (1 - at.fx) * bend_x + at.fy * (1 - at.fy) * bend_y)


def unhidden(proposal: Proposal, frame: Frame, *, options: Options) -> Proposal:
    """Take out what cannot be seen: a shadow ray from each mirror to the point that it would show.

    Args:
        proposal: From `judge`.
        frame: Its G-buffer, scene and tracer; the scene as it is now, so things that have moved hide too.
        options: `occlusion`: `depths` trusts the depth test of the drawing.
    Returns:
        The proposal, with reason HIDDEN where something lies between.
    Edge cases: rough reflections have no single point, and are not tested. The last 0.1 % of the way are not either.
    """
    if options.occlusion == "depths":
        return proposal
    rays, t_max = _shadow_rays(proposal, frame.gbuffer, norm(frame.scene.upper - frame.scene.lower))
    return _without(proposal, frame.tracer.occluded(rays, t_max))


@jax.jit
def _shadow_rays(proposal: Proposal, gbuffer: GBuffer, size: Float[Array, ""]) -> tuple[Rays, Float[Array, "h w"]]:
    wi = mirror_direction(gbuffer)
    finite = proposal.reflected[..., 3] > 0.5
    t = norm(proposal.reflected[..., :3] - gbuffer.p)
    reach = jnp.where(finite, (1 - _SHORT) * t, 4 * size)
    usable = (proposal.reason == int(Reason.REUSED)) | (proposal.reason == int(Reason.CONTRAST))
    asked = usable & (gbuffer.alpha == 0)
    rays = Rays(offset_origin(gbuffer.p, gbuffer.n, gbuffer.p_error, wi), wi)
    return rays, jnp.where(asked, reach, 0)


@jax.jit
def _without(proposal: Proposal, hidden: Bool[Array, "h w"]) -> Proposal:
    kept = ~hidden
    return Proposal(
        uv=jnp.where(kept[..., None], proposal.uv, 0),
        reason=jnp.where(hidden, int(Reason.HIDDEN), proposal.reason).astype(jnp.int32),
        error=jnp.where(kept, proposal.error, 0),
        radiance=jnp.where(kept[..., None], proposal.radiance, 0),
        reflected=jnp.where(kept[..., None], proposal.reflected, 0),
        triangle=jnp.where(kept, proposal.triangle, -1),
        seen=jnp.where(kept[..., None], proposal.seen, 0),
    )
