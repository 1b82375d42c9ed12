r"""Path tracing: all light that arrives along any rays, and what their first surface does with it.

$$ L_o(\omega_o) = L_e + \int f(\omega_o, \omega_i)\,L_i(\omega_i) \cos\theta_i\,\mathrm{d}\omega_i $$

is estimated by paths from the viewer with a light sample at each vertex, combined with the paths' own hits by the
balance heuristic. The host casts rays while the device shades: two blocks of paths take turns. A path that ends leaves
its slot to the next ray, so that blocks stay full and no shape changes from bounce to bounce; the last paths of a batch
move into a smaller block. What a path draws depends
on its ray and its depth alone, and each ray has sums of its own, so that results are the same bit for bit whatever the
block's size.

Sources: [Kaj86] Kajiya, "The Rendering Equation", 1986; [VG95] §3; [LKA13] Laine, Karras and Aila, "Megakernels
Considered Harmful", HPG 2013, for wavefronts; [PBRT4] §13.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from jaxrefl._types import Camera, Rays, Scene, Tracer
from jaxrefl.core import owen_sobol, pixel_sequences, uniform
from jaxrefl.radiance.light_points import area_density
from jaxrefl.radiance.path_light import aim, answer, light_kinds, look_for_light, pick_lamps
from jaxrefl.radiance.path_step import albedo_at, arrive, choose, drain, draw, go_on, numbers, start
from jaxrefl.radiance.path_sums import gather
from jaxrefl.radiance.path_types import CHANNELS, Batch, PathLight, PathOptions, Paths, Shadows, empty_shadows
from jaxrefl.rays.blocks import block_size
from jaxrefl.rays.camera_rays import camera_rays
from jaxrefl.surface.gbuffer import build_gbuffer

_DRAIN = 8
"""Once the batch has no more rays, a block of which less than this part is in use goes on as one of that size."""
_LEAST = 2048
"""Smallest block that is worth compiling for that."""


def path_radiance(
    scene: Scene,
    tracer: Tracer,
    rays: Rays,
    sequence: UInt32[Array, "*b"],
    number: UInt32[Array, "*b"],
    *,
    options: PathOptions = PathOptions(),  # noqa: B008  frozen
) -> Float[Array, "*b 3"]:
    """All light that arrives along rays, one path each.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        rays: Any rays [*b], those of probes, texels or reflections as well as a camera's.
        sequence: Sequence of random numbers of each ray (`core.pixel_sequences`).
        number: Number of each ray's point in its sequence; paths of one pixel count up from 0.
        options: Static knobs.
    Returns:
        Linear radiance; the mean over many paths of the same ray is the radiance along it.
    """
    sums = _trace(scene, tracer, Batch(*_flat(rays, sequence, number)), options, layered=False)
    return sums.reshape(*sequence.shape, 3)


def path_light(
    scene: Scene,
    tracer: Tracer,
    rays: Rays,
    sequence: UInt32[Array, "*b"],
    number: UInt32[Array, "*b"],
    *,
    options: PathOptions = PathOptions(),  # noqa: B008  frozen
) -> PathLight:
    """The light that arrives along rays in layers, one path each.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        rays: Any rays [*b].
        sequence: As for `path_radiance`.
        number: As for `path_radiance`.
        options: Static knobs.
    Returns:
        Layers [*b 3]; their `radiance` is what `path_radiance` returns.
    Source: [RLPWSD20] §3.1 for the split of diffuse from specular light.
    """
    sums = _trace(scene, tracer, Batch(*_flat(rays, sequence, number)), options, layered=True)
    sums = sums.reshape(*sequence.shape, CHANNELS, 3)
    return PathLight(*(sums[..., i, :] for i in range(CHANNELS)))


@functools.partial(jax.jit, static_argnames="sampler")
def camera_samples(
    camera: Camera, seed: UInt32[Array, "*s"], number: UInt32[Array, "*s"], *, sampler: str = "sobol"
) -> tuple[Rays, UInt32[Array, "*s h w"], UInt32[Array, "*s h w"]]:
    """Rays through points of each pixel, with the random numbers their paths use.

    Args:
        camera: The camera.
        seed: Seed of the image that each sample belongs to.
        number: Numbers of the samples; those of a pixel are points of one low-discrepancy sequence.
        sampler: As `PathOptions.sampler`.
    Returns:
        Rays [*s h w], their sequences and their numbers. Many samples in one call keep the blocks of the path tracer
        full where images are small.
    """
    if number.ndim:
        one = functools.partial(camera_samples, camera, sampler=sampler)
        flat = jax.vmap(one)(jnp.broadcast_to(seed, number.shape).reshape(-1), number.reshape(-1))
        return jax.tree.map(lambda x: x.reshape(*number.shape, *x.shape[1:]), flat)
    count = jnp.arange(camera.height * camera.width, dtype=jnp.int32)
    sequence = pixel_sequences(seed, count).reshape(camera.height, camera.width)
    numbers = jnp.broadcast_to(number, sequence.shape)
    x, y = (owen_sobol if sampler == "sobol" else uniform)(sequence, numbers, jnp.zeros_like(sequence))
    return camera_rays(camera, jitter=jnp.stack([x, y], -1)), sequence, numbers


def _flat(rays: Rays, sequence: Array, number: Array) -> tuple[Rays, Array, Array]:
    flat = Rays(rays.origin.reshape(-1, 3), rays.direction.reshape(-1, 3))
    return flat, sequence.reshape(-1), number.reshape(-1)


def _trace(scene: Scene, tracer: Tracer, batch: Batch, options: PathOptions, *, layered: bool) -> Float[Array, "m 3"]:
    """Sums of all rays of a batch, by two blocks that take turns."""
    rays = batch.sequence.shape[0]
    half = -(-rays // 2)
    count = block_size(half, options.block)
    blocks = [
        _Block(scene, tracer, jax.tree.map(lambda x, i=i: x[i * half : (i + 1) * half], batch), count, options, layered)
        for i in range(2 if rays > 1 else 1)
    ]
    while any([block.step() for block in blocks]):
        pass
    return jnp.concatenate([block.sums for block in blocks])


class _Block:
    """Paths of one half of a batch, and where the host stands with them."""

    def __init__(self, scene: Scene, tracer: Tracer, batch: Batch, count: int, options: PathOptions, layered: bool):
        self.scene, self.tracer, self.batch, self.options, self.layered = scene, tracer, batch, options, layered
        self.kinds = light_kinds(scene.lights)
        self.per_area = None
        if scene.lights.area is not None:
            self.per_area = area_density(scene.lights.area, scene.mesh.faces.shape[0])
        self.ambient = bool(np.asarray(scene.lights.ambient).any())
        self.sums = jnp.zeros((batch.sequence.shape[0] * (CHANNELS if layered else 1), 3), jnp.float32)
        self.paths: Paths = start(batch, count=count)
        self.shadows: Shadows = empty_shadows(count)
        self.live = True

    def step(self) -> bool:
        """Cast this block's rays and start the device on what they hit; False once nothing is left to do."""
        if not self.live:
            return False
        used = (np.asarray(self.paths.job) >= 0) | (np.asarray(self.shadows.t_max) > 0)
        self.live = bool(used.any())
        if not self.live:
            return False
        fewer = used.size // _DRAIN
        if fewer >= _LEAST and used.sum() <= fewer and self.paths.next_job >= self.batch.sequence.shape[0]:
            self.paths, self.shadows = drain(self.paths, self.shadows, jnp.asarray(used), count=fewer)
        blocked = self.tracer.occluded(self.shadows.rays, self.shadows.t_max)
        hits = self.tracer.closest(self.paths.rays, active=self.paths.job >= 0)
        scene, paths, options = self.scene, self.paths, self.options
        points = build_gbuffer(scene, paths.rays, hits)
        random = numbers(paths, options=options)
        vertex = arrive(scene, paths, points, albedo_at(points), random, options=options)
        self.sums = gather(
            scene,
            self.per_area,
            self.sums,
            paths,
            vertex,
            self.shadows,
            blocked,
            kinds=self.kinds,
            ambient=self.ambient,
            layered=self.layered,
        )
        if self.kinds:
            lamps = pick_lamps(scene, random, kinds=self.kinds)
            aimed = aim(scene, vertex, lamps, kinds=self.kinds)
            response = answer(vertex, aimed, options=options)
            self.shadows = look_for_light(paths, vertex, aimed, response, options=options)
        sample = choose(scene, vertex, draw(vertex), options=options)
        self.paths = go_on(self.batch, paths, vertex, sample, options=options)
        return True
