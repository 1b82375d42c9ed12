r"""Path tracing until an image is good enough: Camera -> ProgressiveState -> Estimate, with an error for every pixel.

The samples of an image are dealt out to `REPLICATES` independent estimates of it: sample s is number s // R of
replicate s % R. Each replicate has scrambling seeds of its own, so its samples are a low-discrepancy sequence of their
own, and how far the replicates lie apart tells the error of their mean honestly, which the spread of the samples of one
low-discrepancy sequence does not:

$$ \hat\sigma^2 = \frac{1}{N (R' - 1)} \sum_r n_r (m_r - m)^2,\qquad m = \frac1N \sum_r n_r m_r $$

with the mean $m_r$ of the $n_r$ samples of replicate r and the R' replicates that have any. For independent samples
this is unbiased whatever the counts.

A state says all: going on from one gives the same bits as never having stopped.

Sources: [Owe97] Owen, "Monte Carlo Variance of Scrambled Net Quadrature", SIAM J. Numer. Anal. 34(5), 1997, and [LL02]
L'Ecuyer and Lemieux, "Recent Advances in Randomized Quasi-Monte Carlo Methods", 2002, for replicates.
"""

import dataclasses
import functools
import math
import time
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

from jaxrefl._types import Camera, Rays, Scene, Tracer
from jaxrefl.core import hash_words, luminance
from jaxrefl.core.safe import divide
from jaxrefl.radiance.path import camera_samples, path_light
from jaxrefl.radiance.path_types import PathLight, PathOptions
from jaxrefl.rays.camera_rays import camera_rays

REPLICATES = 8
"""Independent estimates of the image, R."""
MOST_AT_ONCE = 64
"""Samples per pixel that are traced at once at the most."""
_BLOCKS_PER_PASS = 16
"""Rays per pass, in blocks: the last paths of a pass leave blocks half empty, so a pass should fill several."""


@dataclasses.dataclass(frozen=True)
class ProgressiveOptions:
    """How the samples of an image are made; static."""

    path: PathOptions = PathOptions()
    """How paths are followed."""
    pixel: str = "box"
    """"box" (rays through random points of each pixel: smooth edges) or "centre" (all through its centre)."""

    def __post_init__(self):
        if self.pixel not in ("box", "centre"):
            raise ValueError(f"pixel: expected 'box' or 'centre', got {self.pixel!r}")


@dataclasses.dataclass(frozen=True)
class Goal:
    """When an image is good enough: as soon as one of these is reached."""

    MOST: ClassVar[int] = 2**24

    spp: int | None = None
    """Samples per pixel; None: any number."""
    error: float | None = None
    """`relative_error`, looked at after passes that leave all replicates equal, from two rounds on; None: any."""
    seconds: float | None = None
    """Seconds of the call, compilation included, looked at after each pass; None: any."""

    def __post_init__(self):
        if self.spp is None and self.error is None and self.seconds is None:
            raise ValueError("goal: expected at least one of spp, error and seconds, got none")
        if self.spp is not None and not 1 <= self.spp <= self.MOST:
            raise ValueError(f"spp: expected a whole number from 1 to {self.MOST}, got {self.spp!r}")
        for name in ("error", "seconds"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ValueError(f"{name}: expected a finite number above 0, got {value!r}")


class ProgressiveState(eqx.Module):
    """Sums of samples."""

    radiance: Float[Array, "r h w 3"]
    """Sum of all light per replicate."""
    counts: Int[Array, "r"]
    """Samples per pixel in each replicate."""
    layers: PathLight
    """Sums of the layers over all replicates [h w 3]."""
    seed: UInt32[Array, ""]
    """Seed of the image."""


class Estimate(eqx.Module):
    """An image and how far it may be off."""

    light: PathLight
    """Mean of the layers [h w 3]."""
    radiance: Float[Array, "h w 3"]
    """Mean of all light."""
    error: Float[Array, "h w 3"] | None
    """Standard error of `radiance`; None: fewer than two replicates have samples, and nobody knows."""


def start_state(camera: Camera, seed: UInt32[Array, ""]) -> ProgressiveState:
    """A state without samples.

    Args:
        camera: The camera; its size counts.
        seed: Seed of the image.
    Returns:
        Sums of zero.
    """
    image = jnp.zeros((camera.height, camera.width, 3), jnp.float32)
    sums = jnp.zeros((REPLICATES, *image.shape), jnp.float32)
    layers = PathLight(*([image] * len(dataclasses.fields(PathLight))))
    return ProgressiveState(sums, jnp.zeros((REPLICATES,), jnp.int32), layers, jnp.asarray(seed, jnp.uint32))


def render_progressively(
    scene: Scene,
    tracer: Tracer,
    camera: Camera,
    seed: UInt32[Array, ""],
    *,
    goal: Goal,
    options: ProgressiveOptions = ProgressiveOptions(),  # noqa: B008  frozen
    state: ProgressiveState | None = None,
    after: Callable[[ProgressiveState], None] | None = None,
) -> ProgressiveState:
    """Add samples to an image until it is good enough.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        camera: The camera.
        seed: Seed of the image.
        goal: When to stop.
        options: Static knobs.
        state: Where to go on, from an earlier call with the same arguments; None: from nothing.
        after: Called with the state after each pass (`samples_per_pass`), to report or to save it.
    Returns:
        The state; for the same number of samples it is the same bit for bit however often it was interrupted.
    Raises:
        ValueError: If the state is that of another seed or image size.
    Edge cases: a state that has reached the goal is returned as it is. An error that a scene cannot reach (paths that
        find a small light by chance) is looked for without end unless `goal` has another limit. Sums are float32:
        rounding stays below 1e-5 of a pixel up to 1e5 samples.
    """
    found = start_state(camera, seed) if state is None else _checked(state, camera, seed)
    centres = camera_rays(camera) if options.pixel == "centre" else None
    size, began = samples_per_pass(camera, options), time.perf_counter()
    done = sample_count(found)
    while not _reached(goal, found, done, time.perf_counter() - began):
        count = min(size - done % size, (goal.spp or Goal.MOST) - done)
        rays, sequence, number = _samples(camera, found.seed, done, centres, size=size, sampler=options.path.sampler)
        light = path_light(scene, tracer, rays, sequence, number, options=options.path)
        found = _add(found, light, done, count)
        done += count
        if after is not None:
            after(found)
    return found


def samples_per_pass(camera: Camera, options: ProgressiveOptions) -> int:
    """Samples per pixel that are traced at once: several for small images, so that blocks of paths stay full.

    Args:
        camera: The camera.
        options: Static knobs.
    Returns:
        A power of two from 1 to `MOST_AT_ONCE`.
    """
    room = max(_BLOCKS_PER_PASS * options.path.block // (camera.width * camera.height), 1)
    return min(MOST_AT_ONCE, 1 << (room.bit_length() - 1))


def sample_count(state: ProgressiveState) -> int:
    """Samples per pixel so far.

    Args:
        state: Any state.
    Returns:
        Their number over all replicates.
    """
    return int(state.counts.sum())


def estimate(state: ProgressiveState) -> Estimate:
    """The image so far and its standard error.

    Args:
        state: Any state.
    Returns:
        Means, and the standard error of each pixel and channel.
    Edge cases: without samples everything is 0. A pixel of which no sample has found light yet has the error 0: rare
        bright paths are not foreseen.
    """
    total = jnp.maximum(state.counts.sum(), 1).astype(jnp.float32)
    light = jax.tree.map(lambda sums: sums / total, state.layers)
    mean, error = _mean_and_error(state.radiance, state.counts)
    return Estimate(light, mean, error if sample_count(state) > 1 else None)


@functools.partial(jax.jit, static_argnames="size")
def block_error(state: ProgressiveState, *, size: int) -> Float[Array, "bh bw 3"]:
    """Standard error of the image averaged over blocks of pixels, from the replicates' block means.

    Args:
        state: Any state; at least two replicates have samples.
        size: Side of a block, pixels, >= 1; blocks at the right and bottom edges may be smaller.
    Returns:
        Standard error of each block's mean.
    Edge cases: NaN where fewer than two replicates have samples.
    """
    height, width = state.radiance.shape[1:3]
    edges = [(0, 0), (0, -height % size), (0, -width % size), (0, 0)]

    def blocks(x: Float[Array, "r h w c"]) -> Float[Array, "r bh bw c"]:
        padded = jnp.pad(x, edges)
        rows, columns = padded.shape[1] // size, padded.shape[2] // size
        return padded.reshape(x.shape[0], rows, size, columns, size, x.shape[-1]).sum((2, 4))

    pixels = blocks(jnp.ones((1, height, width, 1), jnp.float32))
    return _mean_and_error(blocks(state.radiance) / pixels, state.counts)[1]


def relative_error(state: ProgressiveState) -> float | None:
    r"""How noisy the image is as a whole.

    $$ \sqrt{\operatorname{mean}_{p,c} \hat\sigma_{p,c}^2} \Big/ \operatorname{mean}_p Y_p $$

    Args:
        state: Any state.
    Returns:
        Root mean square of the standard error over all pixels and channels, over the mean luminance of the image. None
            with fewer than two replicates.
    Edge cases: 0 for a black image.
    """
    if sample_count(state) < 2:
        return None
    return float(_relative_error(state))


@jax.jit
def _relative_error(state: ProgressiveState) -> Float[Array, ""]:
    mean, error = _mean_and_error(state.radiance, state.counts)
    return divide(jnp.sqrt((error * error).mean()), luminance(mean).mean())


@jax.jit
def _mean_and_error(
    sums: Float[Array, "r *b"], counts: Int[Array, "r"]
) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Mean of all samples, and its standard error; NaN where fewer than two replicates have samples."""
    n = counts.astype(jnp.float32).reshape(-1, *[1] * (sums.ndim - 1))
    total = jnp.maximum(n.sum(), 1)
    mean = sums.sum(0) / total
    apart = sums / jnp.maximum(n, 1) - mean[None]
    used = (counts > 0).sum().astype(jnp.float32)
    variance = (n * apart * apart).sum(0) / (total * jnp.maximum(used - 1, 1))
    return mean, jnp.where(used < 2, jnp.nan, jnp.sqrt(variance))


def _checked(state: ProgressiveState, camera: Camera, seed: Array) -> ProgressiveState:
    there, wanted = state.radiance.shape[1:3], (camera.height, camera.width)
    if there != wanted:
        raise ValueError(
            f"state: expected an image of {wanted[1]} x {wanted[0]} pixels, got one of {there[1]} x {there[0]}"
        )
    if int(state.seed) != int(seed):
        raise ValueError(f"state: expected one of seed {int(seed)}, got one of seed {int(state.seed)}")
    return state


def _reached(goal: Goal, state: ProgressiveState, done: int, seconds: float) -> bool:
    if goal.spp is not None and done >= goal.spp:
        return True
    if goal.seconds is not None and done > 0 and seconds >= goal.seconds:
        return True
    # With one sample per replicate most bright paths are still missing, and the estimate is far too low.
    if goal.error is None or done % REPLICATES or done < 2 * REPLICATES:
        return False
    error = relative_error(state)
    return error is not None and error <= goal.error


@functools.partial(jax.jit, static_argnames=("size", "sampler"))
def _samples(
    camera: Camera, seed: Array, first: Array, centres: Rays | None, *, size: int, sampler: str
) -> tuple[Rays, UInt32[Array, "k h w"], UInt32[Array, "k h w"]]:
    """Rays and random numbers of `size` samples of each pixel, from number `first` on."""
    which = first + jnp.arange(size, dtype=jnp.int32)
    seeds = hash_words(jnp.broadcast_to(seed, (size,)), (which % REPLICATES).astype(jnp.uint32))
    sample = functools.partial(camera_samples, camera, sampler=sampler)
    rays, sequence, number = jax.vmap(sample)(seeds, (which // REPLICATES).astype(jnp.uint32))
    if centres is not None:
        rays = jax.tree.map(lambda x: jnp.broadcast_to(x, (size, *x.shape)), centres)
    return rays, sequence, number


@jax.jit
def _add(state: ProgressiveState, light: PathLight, first: Array, count: Array) -> ProgressiveState:
    """Add the first `count` samples of a pass, in order; the others only filled its blocks."""

    def add_one(i: Array, sums: ProgressiveState) -> ProgressiveState:
        one = jax.tree.map(lambda x: x[i], light)
        replicate = (first + i) % REPLICATES
        return ProgressiveState(
            radiance=sums.radiance.at[replicate].add(one.radiance),
            counts=sums.counts.at[replicate].add(1),
            layers=jax.tree.map(jnp.add, sums.layers, one),
            seed=sums.seed,
        )

    return jax.lax.fori_loop(0, count, add_one, state)
