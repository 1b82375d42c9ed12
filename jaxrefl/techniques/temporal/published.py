"""The published method after matching: shift the key frame's reflections by their offsets, then warp them by depth.

Source: [XWD17] §3.2.2 and §3.3.
"""

import time

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Frame, GBuffer
from jaxrefl.surface import reflective
from jaxrefl.techniques._reproject import GridMesh, draw, pixel_centres, read_reflection, seen_before
from jaxrefl.techniques.temporal.neighbourhood import match_pixels, silhouette
from jaxrefl.techniques.temporal.types import Options, Params, Proposal, Reason, ReflectionBuffer, Search

_INFINITE = 1.0e30


def propose_as_published(
    buffer: ReflectionBuffer,
    before: Search | None,
    frame: Frame,
    moved: Bool[Array, "h w"],
    params: Params,
    *,
    options: Options,
) -> tuple[Proposal, Search, dict[str, float]]:
    """What a key frame offers by the published method.

    Args:
        buffer: The key frame.
        before: The last search in it.
        frame: The frame to render.
        moved: Pixels whose reflector has moved.
        params: `discontinuity`, `surface`.
        options: `search_steps`, `start`, `block`.
    Returns:
        The proposal, the search for the next frame, and seconds for `search`, `shift`, `warp`.
    Edge cases: rough reflections are traced. There is no test of occlusion, as published: points that are hidden now
        may be shown (the paper's Fig. 9).
    Source: [XWD17] §3.2, §3.3.
    Differs from the source: the depth warp looks back from the new G-buffer.
    """
    times = [time.perf_counter()]
    search, why = jax.block_until_ready(match_pixels(buffer, before, frame.camera, params, options=options))
    times.append(time.perf_counter())
    uv, valid = jax.block_until_ready(shift(buffer, search, params))
    times.append(time.perf_counter())
    proposal = jax.block_until_ready(_warp(buffer, uv, valid, why, frame.gbuffer, moved, params))
    times.append(time.perf_counter())
    names = ("search", "shift", "warp")
    return proposal, search, {name: b - a for name, a, b in zip(names, times, times[1:], strict=False)}


@jax.jit
def shift(buffer: ReflectionBuffer, search: Search, params: Params) -> tuple[Float[Array, "h w 2"], Bool[Array, "h w"]]:
    """The intermediate reflection image: which reflection each key-frame pixel shows to the new eye.

    Args:
        buffer: The key frame.
        search: Offsets.
        params: `discontinuity`.
    Returns:
        Key-frame coordinates, and where there is one.
    Source: [XWD17] §3.2.2.
    """
    far = buffer.reflected[..., 3] == 0
    depth = jnp.where(far, _INFINITE, buffer.t + buffer.t_reflected)
    inverse = jnp.where(depth > 0, 1 / jnp.where(depth > 0, depth, 1), 0)
    broken = silhouette(buffer, params)
    for axis in (0, 1):
        bend = jnp.roll(inverse, 1, axis) - 2 * inverse + jnp.roll(inverse, -1, axis)
        broken = broken | (jnp.abs(bend) > params.discontinuity * inverse)
    h, w = depth.shape
    here = pixel_centres(h, w)

    def of_cell(x: Array) -> tuple[Array, Array, Array, Array]:
        return x, jnp.roll(x, -1, 0), jnp.roll(x, -1, 1), jnp.roll(x, (-1, -1), (0, 1))

    f, o = of_cell(search.found), of_cell(buffer.object)
    flags = sum(b.astype(jnp.int32) for b in of_cell(broken))
    connected = f[0] & f[1] & f[2] & f[3] & (o[0] == o[1]) & (o[0] == o[2]) & (o[0] == o[3]) & (flags < 2)
    drawn = draw(GridMesh(here + search.place, depth, connected, buffer.object), buffer.object)
    return drawn.uv, drawn.valid


@jax.jit
def _warp(
    buffer: ReflectionBuffer,
    uv: Float[Array, "h w 2"],
    valid: Bool[Array, "h w"],
    why: Int[Array, "h w"],
    gbuffer: GBuffer,
    moved: Bool[Array, "h w"],
    params: Params,
) -> Proposal:
    kept = jnp.concatenate([buffer.radiance, buffer.reflected, uv], -1)
    image, known = read_reflection(uv, valid, kept[..., :7], buffer.valid)
    image = jnp.concatenate([image, uv], -1)
    there, seen = seen_before(gbuffer, buffer.camera, buffer.p, buffer.object, params.surface)
    values, good = read_reflection(there, seen, image, known)
    # What no search led to has its own pixel's reason where that failed.
    at = jnp.clip(there.astype(jnp.int32), 0, jnp.array([uv.shape[1] - 1, uv.shape[0] - 1])[None, None, :])
    nearest = why[at[..., 1], at[..., 0]]
    failed = seen & (nearest != int(Reason.REUSED)) & (nearest != int(Reason.NONE))
    reason = jnp.where(good, int(Reason.REUSED), jnp.where(failed, nearest, int(Reason.UNSEEN)))
    reason = jnp.where(gbuffer.alpha == 0, reason, int(Reason.LOBE))
    reason = jnp.where(moved, int(Reason.MOVED), reason)
    reason = jnp.where(reflective(gbuffer), reason, int(Reason.NONE)).astype(jnp.int32)
    taken = (reason == int(Reason.REUSED))[..., None]
    return Proposal(
        uv=jnp.where(taken, values[..., 7:], 0),
        reason=reason,
        error=jnp.zeros_like(gbuffer.t),
        radiance=jnp.where(taken, values[..., :3], 0),
        reflected=jnp.where(taken, values[..., 3:7], 0),
        triangle=jnp.full_like(reason, -1),
        seen=jnp.zeros_like(gbuffer.p),
    )
