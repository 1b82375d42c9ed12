"""Whether a place in the key frame may be taken for a pixel: Refined + key frame -> Proposal.

One test per way in which reuse can be wrong: the point is not on the mirror ray, it lies between two things, the
colours around it differ too much, it looks different from here, something hides it. What passes has an expected error.

Beyond [XWD17], whose mask only knows gaps and magnified triangles: its Fig. 9 shows what that misses.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float, Int

from jaxrefl._types import Frame, GBuffer, Rays
from jaxrefl.core import apart, together
from jaxrefl.core.safe import norm
from jaxrefl.rays import block_size, blocks_of, offset_origin, put_block, take_block
from jaxrefl.surface import reflective
from jaxrefl.techniques._reproject import SNAP, Footprint, footprint, read
from jaxrefl.techniques.temporal.flat import Mirrors, Triple, along, cross3, dot3, split
from jaxrefl.techniques.temporal.kept import CONNECTED, KNOWN, SMOOTH, STEADY, Kept, flags_at, has
from jaxrefl.techniques.temporal.refine import Refined
from jaxrefl.techniques.temporal.types import Options, Params, Proposal, Reason

_SHORT = 1e-3
"""Share of the way to the point at its end in which nothing is looked for: there lies the point itself."""


def judge(
    kept: Kept,
    mirrors: Mirrors,
    gbuffer: GBuffer,
    refined: Refined,
    covered: Bool[Array, "h w"],
    moved: Bool[Array, "h w"],
    params: Params,
    *,
    options: Options,
) -> Proposal:
    r"""Test each pixel, all but for what may hide its point.

    $$ e = 2 f_x (1 - f_x)\, b_x + 2 f_y (1 - f_y)\, b_y $$

    is the expected error of a value between pixels with second differences b: that of an edge somewhere between them.

    Args:
        kept: The key frame.
        mirrors: The pixels of the frame.
        gbuffer: What is seen now.
        refined: Place and residual per pixel.
        covered: Where there was a start.
        moved: Where the reflector has moved.
        params: `tolerance`, `contrast`, `lobe`, `inner`.
        options: `inner_mirrors`, `block`.
    Returns:
        The proposal; a place within `SNAP` of a key-frame pixel needs no neighbours and has no error.
    """
    proposal, tested = _untested(gbuffer, covered, moved)
    for index in blocks_of(tested, size=block_size(tested.size, options.block)):
        pixels = (refined, mirrors.smooth, gbuffer.alpha, gbuffer.p)
        block = _judge_block(kept, pixels, index, params, options.inner_mirrors == "turn")
        proposal = put_block(index, proposal, block)
    return proposal


@jax.jit
def _untested(
    gbuffer: GBuffer, covered: Bool[Array, "h w"], moved: Bool[Array, "h w"]
) -> tuple[Proposal, Bool[Array, "h w"]]:
    """The proposal before any test, and the pixels to test."""
    wanted = reflective(gbuffer)
    reason = jnp.where(moved, int(Reason.MOVED), int(Reason.UNSEEN))
    reason = jnp.where(wanted, reason, int(Reason.NONE)).astype(jnp.int32)
    return no_proposal(reason), wanted & covered & ~moved


def no_proposal(reason: Int[Array, "*b"]) -> Proposal:
    """A proposal of nothing.

    Args:
        reason: Why.
    Returns:
        Fill values, and the reasons.
    """
    zero = jnp.zeros(reason.shape, jnp.float32)
    wide = jnp.zeros((*reason.shape, 4), jnp.float32)
    return Proposal(wide[..., :2], reason, zero, wide[..., :3], wide, jnp.full_like(reason, -1), wide[..., :3])


@functools.partial(jax.jit, static_argnums=4)
def _judge_block(
    kept: Kept,
    pixels: tuple[Refined, Bool[Array, "h w"], Float[Array, "h w"], Float[Array, "h w 3"]],
    index: Int[Array, "n"],
    params: Params,
    turns: bool,
) -> Proposal:
    refined, smooth, alpha, p = take_block(pixels, index)
    at = footprint(refined.uv, shape=kept.shape, snap=SNAP)
    turned = apart(~has(kept.flags, STEADY), _turn, kept, at, split(p)) if turns else None
    tested = apart(index >= 0, _tests, kept, at, refined, (smooth, alpha, turned), params)
    nearest = at.cell + jnp.where(at.fx >= 0.5, 1, 0) + jnp.where(at.fy >= 0.5, at.width, 0)

    def stacked(image: tuple[Array, ...]) -> Array:
        return jnp.stack(read(image, at), -1)

    return Proposal(
        uv=refined.uv,
        reason=jnp.real(tested).astype(jnp.int32),
        error=jnp.imag(tested),
        radiance=stacked(kept.radiance),
        reflected=stacked(kept.reflected),
        triangle=kept.triangle[nearest],
        seen=stacked(kept.seen),
    )


def _tests(
    kept: Kept,
    at: Footprint,
    refined: Refined,
    mirrors: tuple[Bool[Array, "n"], Float[Array, "n"], Float[Array, "n"] | None],
    params: Params,
) -> Complex[Array, "n"]:
    """Reason codes as numbers, small enough to be exact, and expected errors."""
    flags, (smooth, alpha, turned) = flags_at(kept, at), mirrors
    single = ((at.fx == 0) | (at.fx == 1)) & ((at.fy == 0) | (at.fy == 1))
    whole = has(flags, KNOWN, SMOOTH) & (has(flags, CONNECTED) | single)
    turn = refined.tangent / jnp.maximum(alpha, 1e-6)
    between = jnp.where(smooth, _expected_error(kept, at), params.contrast * turn / jnp.maximum(params.lobe, 1e-6))
    error = read([kept.error], at)[0] + between
    steady = has(flags, STEADY)
    if turned is not None:
        error = error + jnp.where(smooth & ~steady, params.contrast * turned / jnp.maximum(params.inner, 1e-6), 0)
        steady = steady | (turned <= params.inner)
    # The first test that fails is the reason, so the last one written wins.
    reason = jnp.full(alpha.shape, float(Reason.REUSED))
    for failed, code in (
        (error > jnp.where(smooth, params.contrast, 2 * params.contrast), Reason.CONTRAST),
        (~smooth & (turn > params.lobe), Reason.LOBE),
        (~steady & smooth, Reason.CHANGING),
        (smooth & ~(refined.residual <= params.tolerance), Reason.RESIDUAL),
        (~jnp.where(smooth, whole, has(flags, KNOWN)), Reason.EDGE),
    ):
        reason = jnp.where(failed, float(code), reason)
    return together(reason, error)


def _turn(kept: Kept, at: Footprint, p: Triple) -> Float[Array, "n"]:
    """Sine of the angle by which the direction in which a reflected point is seen has turned since the key frame."""
    x, y, z, w, *then = read((*kept.reflected, *kept.p), at)
    now, before = along((x, y, z), -w, p), along((x, y, z), -w, (then[0], then[1], then[2]))
    across, length = cross3(now, before), dot3(now, now) * dot3(before, before)
    sine = jnp.sqrt(dot3(across, across) / jnp.where(length > 0, length, 1))
    return jnp.where(dot3(now, before) > 0, sine, jnp.inf)


def _expected_error(kept: Kept, at: Footprint) -> Float[Array, "n"]:
    return 2 * (at.fx * (1 - at.fx) * kept.bend_x[at.cell] + at.fy * (1 - at.fy) * kept.bend_y[at.cell])


def unhidden(proposal: Proposal, mirrors: Mirrors, frame: Frame, *, options: Options) -> Proposal:
    """Take out what cannot be seen: a shadow ray from each mirror to the point that it would show.

    Args:
        proposal: From `judge`.
        mirrors: The pixels of the frame.
        frame: Its G-buffer, scene and tracer; the scene as it is now, so things that have moved hide too.
        options: `occlusion`: `depths` trusts the depth test of the drawing.
    Returns:
        The proposal, with reason HIDDEN where something lies between.
    Edge cases: rough reflections have no single point, and are not tested. The last 0.1 % of the way are not either.
    """
    if options.occlusion == "depths":
        return proposal
    size = norm(frame.scene.upper - frame.scene.lower)
    rays, t_max = _shadow_rays(proposal, mirrors, frame.gbuffer, size)
    return _without(proposal, frame.tracer.occluded(rays, t_max))


@jax.jit
def _shadow_rays(
    proposal: Proposal, mirrors: Mirrors, gbuffer: GBuffer, size: Float[Array, ""]
) -> tuple[Rays, Float[Array, "h w"]]:
    wi, finite = mirrors.rays.direction, proposal.reflected[..., 3] > 0.5
    t = norm(proposal.reflected[..., :3] - gbuffer.p)
    reach = jnp.where(finite, (1 - _SHORT) * t, 4 * size)
    usable = (proposal.reason == int(Reason.REUSED)) | (proposal.reason == int(Reason.CONTRAST))
    asked = usable & mirrors.smooth
    rays = Rays(offset_origin(gbuffer.p, gbuffer.n, gbuffer.p_error, wi), wi)
    return rays, jnp.where(asked, reach, 0)


@jax.jit
def _without(proposal: Proposal, hidden: Bool[Array, "h w"]) -> Proposal:
    reason = jnp.where(hidden, int(Reason.HIDDEN), proposal.reason).astype(jnp.int32)
    return dataclasses.replace(proposal, reason=reason)
