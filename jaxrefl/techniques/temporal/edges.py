"""Pixels between two things: a ray tells which one they show, key-frame pixels that show the same piece its colour.

Proposal + key frame + rays -> Proposal. Outlines of reflected things are a line of pixels each; together they are most
of what fails. A ray that finds the nearest surface costs a fraction of its light. Around the place found, key-frame
pixels whose reflected points lie on the same piece give the radiance, weighted by nearness; how steeply it changes with
distance there gives the expected error.

Beyond [XWD17], which traces these pixels.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Frame, GBuffer, Hits, Mesh, Rays
from jaxrefl.core import apart, dot, together
from jaxrefl.rays import block_size, blocks_of, offset_origin, put_block, take_block
from jaxrefl.techniques.temporal.cells import STEEPEST, normals_of
from jaxrefl.techniques.temporal.flat import Mirrors
from jaxrefl.techniques.temporal.kept import KNOWN, SMOOTH, STEADY, Kept, has
from jaxrefl.techniques.temporal.types import Options, Params, Proposal, Reason

_SIDE = 2
"""Side of the square of key-frame pixels around the place found that are looked at."""

_MARGIN = 8.0
"""Factor on the change of colour expected from the steepness at a key-frame pixel: the edge may be steeper."""
_ALIKE = 0.9
"""Cosine between the normals of two triangles above which they may be one smooth piece."""


def seek_edges(
    proposal: Proposal,
    uv: Float[Array, "h w 2"],
    kept: Kept,
    mirrors: Mirrors,
    frame: Frame,
    params: Params,
    *,
    options: Options,
) -> Proposal:
    """Give pixels that failed at an edge what a ray says they show, if the key frame has it.

    Args:
        proposal: After all tests.
        uv: Places found in the key frame, also of pixels that failed.
        kept: The key frame.
        mirrors: The pixels of the frame.
        frame: The frame to render.
        params: `contrast`.
        options: `edges`, `block`.
    Returns:
        The proposal, with pixels of reason EDGE, HIDDEN or RESIDUAL made REUSED where a key-frame pixel shows the same
            piece, near enough for its colour.
    Edge cases: rays that leave the scene find nothing here; what has moved is not in the key frame.
    """
    if options.edges == "trace":
        return proposal
    asked, mesh = _asked(proposal, mirrors.smooth), frame.scene.mesh
    for index in blocks_of(asked, size=block_size(asked.size, options.block)):
        rays = _rays(frame.gbuffer, mirrors.rays, index)
        hits = frame.tracer.closest(rays, active=index >= 0)
        block = _read_block(kept, mesh, rays, hits, take_block((proposal, uv), index), params.contrast)
        proposal = put_block(index, proposal, block)
    return proposal


@jax.jit
def _asked(proposal: Proposal, smooth: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    codes = (Reason.EDGE, Reason.HIDDEN, Reason.RESIDUAL)
    found = functools.reduce(jnp.logical_or, [proposal.reason == int(code) for code in codes])
    return found & smooth


@jax.jit
def _rays(gbuffer: GBuffer, mirrors: Rays, index: Int[Array, "n"]) -> Rays:
    n, error, points = take_block((gbuffer.n, gbuffer.p_error, mirrors), index)
    return Rays(offset_origin(points.origin, n, error, points.direction), points.direction)


@jax.jit
def _read_block(
    kept: Kept,
    mesh: Mesh,
    rays: Rays,
    hits: Hits,
    before: tuple[Proposal, Float[Array, "n 2"]],
    contrast: Float[Array, ""],
) -> Proposal:
    proposal, uv = before
    p = rays.origin + hits.t[:, None] * rays.direction
    normal, thing = normals_of(mesh, hits.triangle), mesh.object[hits.triangle]
    column, row = (jnp.floor(uv[:, i] - 0.5).astype(jnp.int32) for i in (0, 1))
    tiny = 1e-12 * dot(p, p) + jnp.finfo(jnp.float32).tiny

    def pixel(number: Array) -> tuple[Array, Array]:
        """A key-frame pixel near the place found, and whether there is one."""
        x, y = column + number % _SIDE, row + number // _SIDE
        inside = (x >= 0) & (x < kept.width) & (y >= 0) & (y < kept.height)
        return jnp.where(inside, y * kept.width + x, 0), inside

    def weigh(at: Array, inside: Array) -> Array:
        """With which weight and which expected error it counts."""
        chord = jnp.stack([c[at] for c in kept.reflected[:3]], -1) - p
        squared, shown = dot(chord, chord), kept.triangle[at]
        same = (mesh.object[jnp.maximum(shown, 0)] == thing) & (shown >= 0) & has(kept.flags[at], KNOWN, SMOOTH, STEADY)
        alike = dot(normals_of(mesh, jnp.maximum(shown, 0)), normal) > _ALIKE
        flat = alike & (jnp.abs(dot(chord, normal)) <= STEEPEST * jnp.sqrt(squared) + jnp.sqrt(tiny))
        off = kept.error[at] + _MARGIN * kept.steepness[at] * jnp.sqrt(squared)
        fits = inside & same & flat & (off <= contrast)  # comparisons with NaN, of 0 times infinity, fail
        return together(jnp.where(fits, 1 / (squared + tiny), 0), jnp.where(fits, off, 0))

    def add(number: Array, sums: tuple[Array, ...]) -> tuple[Array, ...]:
        most, error, triangle, weight, *values = sums
        at, inside = pixel(number)
        weighed = apart(inside, weigh, at, inside)
        w, off = jnp.real(weighed), jnp.imag(weighed)
        images = (*kept.radiance, *kept.seen)
        summed = [value + w * image[at] for value, image in zip(values, images, strict=True)]
        return (jnp.maximum(most, w), error + w * off, jnp.where(w > most, kept.triangle[at], triangle), weight + w,
                *summed)  # fmt: skip

    zero = jnp.zeros_like(hits.t)
    first = (zero, zero, jnp.full_like(hits.triangle, -1), zero, *[zero] * 6)
    _, error, triangle, weight, *values = jax.lax.fori_loop(0, _SIDE * _SIDE, add, first)
    fine = hits.valid & (weight > 0)
    inverse = jnp.where(fine, 1 / jnp.where(fine, weight, 1), 0)
    mean = jnp.stack(values, -1) * inverse[:, None]
    point = jnp.concatenate([p, jnp.ones_like(p[:, :1])], -1)
    seen = fine[:, None]
    return Proposal(
        uv=jnp.where(seen, uv, proposal.uv),
        reason=jnp.where(fine, int(Reason.REUSED), proposal.reason).astype(jnp.int32),
        error=jnp.where(fine, error * inverse, proposal.error),
        radiance=jnp.where(seen, mean[:, :3], proposal.radiance),
        reflected=jnp.where(seen, point, proposal.reflected),
        triangle=jnp.where(fine, triangle, proposal.triangle),
        seen=jnp.where(seen, mean[:, 3:], proposal.seen),
    )
