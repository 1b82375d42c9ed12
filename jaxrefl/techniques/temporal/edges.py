"""Pixels between two things: a ray tells which one they show, key-frame pixels that show the same piece its colour.

Proposal + key frame + rays -> Proposal. Outlines of reflected things are a line of pixels each; together they are most
of what fails. A ray that finds the nearest surface costs a fraction of its light. Around the place found, key-frame
pixels whose reflected points lie on the same piece give the radiance, weighted by nearness; how steeply it changes with
distance there gives the expected error.

Beyond [XWD17], which traces these pixels.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Frame, GBuffer, Hits, Mesh, Rays
from jaxrefl.core import cross, dot
from jaxrefl.core.safe import normalise
from jaxrefl.rays import block_size, blocks_of, offset_origin, put_block, take_block
from jaxrefl.surface import mirror_direction
from jaxrefl.techniques._reproject import components
from jaxrefl.techniques.temporal.cells import STEEPEST
from jaxrefl.techniques.temporal.types import Options, Params, Proposal, Reason, ReflectionBuffer

_SIDE = 2
"""Side of the square of key-frame pixels around the place found that are looked at."""

_MARGIN = 8.0
"""Factor on the change of colour expected from the steepness at a key-frame pixel: the edge may be steeper."""
_ALIKE = 0.9
"""Cosine between the normals of two triangles above which they may be one smooth piece."""


class _Kept(eqx.Module):
    """The key frame as flat arrays."""

    usable: Bool[Array, "m"]
    point: tuple[Float[Array, "m"], ...]
    values: tuple[Float[Array, "m"], ...]
    triangle: Int[Array, "m"]
    steepness: Float[Array, "m"]
    error: Float[Array, "m"]
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)


def seek_edges(
    proposal: Proposal,
    uv: Float[Array, "h w 2"],
    buffer: ReflectionBuffer,
    frame: Frame,
    params: Params,
    *,
    options: Options,
) -> Proposal:
    """Give pixels that failed at an edge what a ray says they show, if the key frame has it.

    Args:
        proposal: After all tests.
        uv: Places found in the key frame, also of pixels that failed.
        buffer: The key frame.
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
    asked, kept, mesh = _asked(proposal, frame.gbuffer), _flat(buffer), frame.scene.mesh
    for index in blocks_of(asked, size=block_size(asked.size, options.block)):
        points = take_block(frame.gbuffer, index)
        rays = _rays(points)
        hits = frame.tracer.closest(rays, active=index >= 0)
        block = _read_block(kept, mesh, rays, hits, take_block((proposal, uv), index), params.contrast)
        proposal = put_block(index, proposal, block)
    return proposal


@jax.jit
def _asked(proposal: Proposal, gbuffer: GBuffer) -> Bool[Array, "h w"]:
    codes = (Reason.EDGE, Reason.HIDDEN, Reason.RESIDUAL)
    found = functools.reduce(jnp.logical_or, [proposal.reason == int(code) for code in codes])
    return found & (gbuffer.alpha == 0)


@jax.jit
def _flat(buffer: ReflectionBuffer) -> _Kept:
    values = jnp.concatenate([buffer.radiance, buffer.seen], -1)
    usable = buffer.valid & buffer.smooth & ~buffer.changing & (buffer.triangle >= 0)
    h, w = buffer.valid.shape
    return _Kept(
        usable=usable.reshape(-1),
        point=components(buffer.reflected[..., :3]),
        values=components(values),
        triangle=buffer.triangle.reshape(-1),
        steepness=buffer.steepness.reshape(-1),
        error=buffer.error.reshape(-1),
        width=w,
        height=h,
    )


@jax.jit
def _rays(points: GBuffer) -> Rays:
    wi = mirror_direction(points)
    return Rays(offset_origin(points.p, points.n, points.p_error, wi), wi)


def _normals(mesh: Mesh, triangle: Int[Array, "n"]) -> Float[Array, "n 3"]:
    corners = mesh.vertices[mesh.faces[triangle]]
    return normalise(cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


@jax.jit
def _read_block(
    kept: _Kept,
    mesh: Mesh,
    rays: Rays,
    hits: Hits,
    before: tuple[Proposal, Float[Array, "n 2"]],
    contrast: Float[Array, ""],
) -> Proposal:
    proposal, uv = before
    p = rays.origin + hits.t[:, None] * rays.direction
    normal = _normals(mesh, hits.triangle)
    thing = mesh.object[hits.triangle]
    column, row = (jnp.floor(uv[:, i] - 0.5).astype(jnp.int32) for i in (0, 1))
    tiny = 1e-12 * dot(p, p) + jnp.finfo(jnp.float32).tiny

    def add(number: Array, sums: tuple[Array, ...]) -> tuple[Array, ...]:
        weight, error, nearest, triangle, *values = sums
        x, y = column + number % _SIDE, row + number // _SIDE
        inside = (x >= 0) & (x < kept.width) & (y >= 0) & (y < kept.height)
        at = jnp.where(inside, y * kept.width + x, 0)
        chord = jnp.stack([c[at] for c in kept.point], -1) - p
        squared, shown = dot(chord, chord), kept.triangle[at]
        same = (mesh.object[jnp.maximum(shown, 0)] == thing) & kept.usable[at]
        alike = dot(_normals(mesh, jnp.maximum(shown, 0)), normal) > _ALIKE
        flat = alike & (jnp.abs(dot(chord, normal)) <= STEEPEST * jnp.sqrt(squared) + jnp.sqrt(tiny))
        off = kept.error[at] + _MARGIN * kept.steepness[at] * jnp.sqrt(squared)
        fits = inside & same & flat & (off <= contrast)  # comparisons with NaN, of 0 times infinity, fail
        w = jnp.where(fits, 1 / (squared + tiny), 0)
        closer = fits & (squared < nearest)
        summed = [value + w * image[at] for value, image in zip(values, kept.values, strict=True)]
        return (weight + w, error + jnp.where(fits, w * off, 0), jnp.where(closer, squared, nearest),
                jnp.where(closer, shown, triangle), *summed)  # fmt: skip

    zero = jnp.zeros_like(hits.t)
    first = (zero, zero, zero + jnp.inf, jnp.full_like(hits.triangle, -1), *[zero] * 6)
    weight, error, _, triangle, *values = jax.lax.fori_loop(0, _SIDE * _SIDE, add, first)
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
