"""What key frames offer for each pixel of a frame: State + Frame -> Offer."""

import dataclasses
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Frame
from jaxrefl.surface import reflective
from jaxrefl.techniques._reproject import same_camera, seen_before
from jaxrefl.techniques.temporal.buffer import as_of
from jaxrefl.techniques.temporal.check import judge, unhidden
from jaxrefl.techniques.temporal.edges import seek_edges
from jaxrefl.techniques.temporal.flat import Mirrors, mirrors_of
from jaxrefl.techniques.temporal.kept import flatten
from jaxrefl.techniques.temporal.keys import is_still
from jaxrefl.techniques.temporal.match import search as search_forward
from jaxrefl.techniques.temporal.merge import as_kept, nothing_offered
from jaxrefl.techniques.temporal.published import propose_as_published
from jaxrefl.techniques.temporal.refine import refine
from jaxrefl.techniques.temporal.shift import starts
from jaxrefl.techniques.temporal.types import Options, Params, Proposal, Reason, ReflectionBuffer, Search, State, Taken


class Offer(NamedTuple):
    """What all key frames together offer."""

    proposal: Proposal
    """The better one per pixel; all to be traced where there is no key frame."""
    taken_from: Int[Array, "h w"]
    """Which frame offers it, a `Taken` code."""
    exact: bool
    """True: the camera is that of the key frame, and nothing has moved."""
    pixels: int
    """Reflective pixels."""
    missing: int
    """Those that must be traced."""
    error: float
    """Mean expected relative error of the others."""
    too_wide: int
    """Triangles that were not drawn."""

    @property
    def share(self) -> float:
        """Share of the reflective pixels that must be traced."""
        return self.missing / max(self.pixels, 1)


def offer(state: State, frame: Frame, params: Params, *, options: Options) -> tuple[Offer, State, dict[str, float]]:
    """What the key frames of a state offer.

    Args:
        state: The key frames.
        frame: The frame to render.
        params: Thresholds.
        options: The method, and its steps.
    Returns:
        The offer, the state with what was found for the next frame to start from, and seconds per stage.
    """
    wanted, seconds, too_wide, exact = reflective(frame.gbuffer), {}, 0, False
    taken_from = jnp.full(wanted.shape, int(Taken.KEY), jnp.int32)
    if state.key is None:
        proposal = nothing_offered(frame.gbuffer)
    elif same_camera(state.key.camera, frame.camera) and is_still(state.key, frame):
        proposal, exact = as_kept(state.key), True
    else:
        mirrors = mirrors_of(frame.gbuffer, params.sharp)
        proposal, search, seconds, too_wide = propose(
            state.key, state.search, mirrors, frame, wanted, params, options=options
        )
        state = dataclasses.replace(state, search=search)
        for buffer, before, within, code in (
            (state.ahead, state.search_ahead, None, Taken.AHEAD),
            (state.recent, None, state.lacking, Taken.RECENT),
        ):
            if buffer is None:
                continue
            asked = wanted if code == Taken.AHEAD else wanted & (proposal.reason != int(Reason.REUSED))
            other, search, more, wide = propose(buffer, before, mirrors, frame, asked, params, within, options=options)
            if code == Taken.AHEAD:
                state = dataclasses.replace(state, search_ahead=search)
            seconds, too_wide = {name: seconds[name] + more[name] for name in seconds}, too_wide + wide
            proposal, taken_from = better(proposal, other, taken_from, int(code))
    pixels, missing, error = _count(proposal, wanted)
    found = Offer(proposal, taken_from, exact, int(pixels), int(missing), float(error), too_wide)
    return found, state, seconds


def propose(
    buffer: ReflectionBuffer,
    before: Search | None,
    mirrors: Mirrors,
    frame: Frame,
    asked: Bool[Array, "h w"],
    params: Params,
    within: Bool[Array, "h w"] | None = None,
    *,
    options: Options,
) -> tuple[Proposal, Search, dict[str, float], int]:
    """What one key frame offers.

    Args:
        buffer: The key frame.
        before: The last search in it.
        mirrors: The pixels of the frame.
        frame: The frame to render.
        asked: Pixels for which to look; the others are UNSEEN.
        within: Key-frame pixels that have what is looked for; None: all.
        params: Thresholds.
        options: The method, and its steps.
    Returns:
        The proposal, the search for the next frame, seconds per stage, and triangles that were dropped as too wide.
    """
    buffer, moved = as_of(buffer, frame, options=options)
    if options.method == "as_published":
        return (*propose_as_published(buffer, before, frame, moved, params, options=options), 0)
    times, smooth = [time.perf_counter()], mirrors.smooth
    search = jax.block_until_ready(search_forward(buffer, before, mirrors, frame.camera, within, options=options))
    times.append(time.perf_counter())
    uv, covered, too_wide = jax.block_until_ready(starts(buffer, search, frame, asked & smooth, options=options))
    times.append(time.perf_counter())
    if frame.scene.features.glossy:
        there, seen = seen_before(frame.gbuffer, buffer.camera, buffer.p, buffer.object, params.surface)
        uv, covered = _by_roughness(smooth, uv, covered, there, seen)
    covered = covered & asked
    kept = flatten(buffer)
    refined = jax.block_until_ready(refine(kept, mirrors.rays, smooth, uv, covered, options=options))
    times.append(time.perf_counter())
    proposal = judge(kept, mirrors, frame.gbuffer, refined, covered, moved, params, options=options)
    proposal = unhidden(proposal, mirrors, frame, options=options)
    proposal = jax.block_until_ready(seek_edges(proposal, refined.uv, kept, mirrors, frame, params, options=options))
    times.append(time.perf_counter())
    names = ("search", "shift", "refine", "check")
    seconds = {name: b - a for name, a, b in zip(names, times, times[1:], strict=False)}
    return proposal, search, seconds, int(too_wide)


@jax.jit
def _by_roughness(smooth: Array, uv: Array, covered: Array, there: Array, seen: Array) -> tuple[Array, Array]:
    """Mirrors start where the drawn mesh says; rough reflections stay on their surface."""
    return jnp.where(smooth[..., None], uv, there), jnp.where(smooth, covered, seen)


@jax.jit
def better(
    a: Proposal, b: Proposal, taken_from: Int[Array, "h w"], code: Int[Array, ""] | int
) -> tuple[Proposal, Int[Array, "h w"]]:
    """The better of two proposals at each pixel.

    Args:
        a: What one key frame offers.
        b: What another offers.
        taken_from: `Taken` codes of `a`.
        code: That of `b`.
    Returns:
        Pixel by pixel the one that may be taken and has the smaller expected error, `a` if they are equal; and its
            code.
    """
    fine_a, fine_b = a.reason == int(Reason.REUSED), b.reason == int(Reason.REUSED)
    take_b = fine_b & (~fine_a | (b.error < a.error))

    def choose(x: Array, y: Array) -> Array:
        return jnp.where(take_b.reshape(take_b.shape + (1,) * (x.ndim - 2)), y, x)

    return jax.tree.map(choose, a, b), jnp.where(take_b, code, taken_from).astype(jnp.int32)


@jax.jit
def _count(proposal: Proposal, wanted: Bool[Array, "h w"]) -> tuple[Int[Array, ""], Int[Array, ""], Float[Array, ""]]:
    """Reflective pixels, those to trace, and the mean expected error of the others."""
    reused = wanted & (proposal.reason == int(Reason.REUSED))
    error = jnp.where(reused, proposal.error, 0).sum() / jnp.maximum(reused.sum(), 1).astype(jnp.float32)
    return wanted.sum(), (wanted & ~reused).sum(), error
