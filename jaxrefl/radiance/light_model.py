"""Which diffuse light surfaces have, wherever it is asked for: GBuffer + Scene -> radiance towards the viewer.

The one place that knows the models: `direct` (lights and ambient term, no bounces), `baked` (all bounces, read from the
scene's light map) and `path` (all bounces, traced from each point). All leave out the share (1 - E) that the specular
lobe takes, as `composite.blend` expects.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from jaxrefl._types import GBuffer, Rays, Scene, Tracer
from jaxrefl.core import pixel_sequences, seed_of
from jaxrefl.radiance.direct import background, direct_light
from jaxrefl.radiance.light_samples import DirectOptions
from jaxrefl.radiance.lightmap import LightMapOptions, baked_light
from jaxrefl.radiance.path import path_light
from jaxrefl.radiance.path_types import PathLight, PathOptions
from jaxrefl.rays.blocks import block_size, blocks_of, put_block, take_block

MODELS = ("direct", "baked", "path")
"""The light models, the quickest first."""

_PATHS_PER_BLOCK = 2**18


def _count(default: int, high: int, help: str, *, low: int = 1) -> Any:
    return dataclasses.field(default=default, metadata={"low": low, "high": high, "help": help})


@dataclasses.dataclass(frozen=True)
class LightOptions:
    """Which model of diffuse light, and how much effort; static."""

    model: str = dataclasses.field(
        default="direct",
        metadata={"choices": MODELS, "help": "Diffuse light: without bounces, from a light map, or by path tracing."},
    )
    """`direct`, `baked` or `path`."""
    area_samples: int = _count(4, DirectOptions.MOST, "Shadow rays per point to emissive triangles (direct).")
    """`direct`: shadow rays per point to emissive triangles."""
    environment_samples: int = _count(
        4, DirectOptions.MOST, "Shadow rays per point to the environment or sky (direct)."
    )
    """`direct`: shadow rays per point to the environment map or sky."""
    punctual_samples: int = _count(1, 256, "Shadow rays per point to each point, spot and directional light (direct).")
    """`direct`: shadow rays per point to each point, spot and directional light."""
    path_samples: int = _count(16, 65536, "Paths per point (path).")
    """`path`: paths per point."""
    bounces: int = _count(15, PathOptions.LONGEST, "Most scattering events; 1 is direct light (path, baked).")
    """`path` and `baked`: most scattering events, that at the point included."""
    texels: int = _count(2**18, LightMapOptions.MOST, "Texels that cover the surfaces, about (baked).", low=16)
    """`baked`: texels that cover the surfaces together, about."""
    bake_samples: int = _count(32, 65536, "Paths per texel and side (baked).", low=8)
    """`baked`: paths per texel and side."""
    lightmap: str = dataclasses.field(
        default="",
        metadata={"help": "File that keeps the light map; without one it lies in the results folder (baked)."},
    )
    """`baked`: file that keeps the light map; used by `jaxrefl render`, not by the library."""

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value, meta = getattr(self, field.name), field.metadata
            if "choices" in meta and value not in meta["choices"]:
                raise ValueError(f"{field.name}: expected one of {', '.join(meta['choices'])}, got {value!r}")
            if "low" in meta and (type(value) is not int or not meta["low"] <= value <= meta["high"]):
                raise ValueError(
                    f"{field.name}: expected a whole number from {meta['low']} to {meta['high']}, got {value!r}"
                )

    @property
    def direct(self) -> DirectOptions:
        """The counts of direct light."""
        return DirectOptions(self.area_samples, self.environment_samples, self.punctual_samples)

    @property
    def map(self) -> LightMapOptions:
        """How to bake the map."""
        return LightMapOptions(texels=self.texels, samples=self.bake_samples, bounces=self.bounces)


def diffuse_light(
    scene: Scene,
    tracer: Tracer,
    gbuffer: GBuffer,
    key: Array,
    *,
    options: LightOptions = LightOptions(),  # noqa: B008  frozen
) -> Float[Array, "*b 3"]:
    """Radiance from each point towards the viewer without its reflection: emission and diffuse light.

    Args:
        scene: The scene; with the model `baked` it must have a `lightmap`.
        tracer: Ray queries against `scene.mesh`.
        gbuffer: Points [*b].
        key: Random key; the same key gives the same noise.
        options: Model and effort.
    Returns:
        Linear radiance; where the G-buffer is not valid, the background in that direction.
    Raises:
        ValueError: If the model is `baked` and the scene has no light map.
    Edge cases: `path` looks at each point from half way to its viewer, or from very near where `gbuffer.t` is 0.
    """
    if options.model == "direct":
        return direct_light(scene, tracer, gbuffer, key, options=options.direct)
    if options.model == "baked":
        return _baked(scene, gbuffer)
    return _traced(scene, tracer, gbuffer, key, options)


@jax.jit
def _baked(scene: Scene, gbuffer: GBuffer) -> Float[Array, "*b 3"]:
    light = baked_light(scene, gbuffer)
    if gbuffer.emission is not None:
        light = light + gbuffer.emission
    return jnp.where(gbuffer.valid[..., None], light, background(scene.lights, -gbuffer.wo))


def _traced(scene: Scene, tracer: Tracer, gbuffer: GBuffer, key: Array, options: LightOptions) -> Float[Array, "*b 3"]:
    image = background(scene.lights, -gbuffer.wo)
    dims, seed = gbuffer.valid.ndim, seed_of(key)
    size = block_size(gbuffer.valid.size, max(_PATHS_PER_BLOCK // options.path_samples, 1))
    paths = PathOptions(bounces=options.bounces)
    for index in blocks_of(gbuffer.valid, size=size):
        points = take_block(gbuffer, index, batch_dims=dims)
        rays, sequence, number = _rays_at(points, index, seed, options.path_samples)
        light = _mean(path_light(scene, tracer, rays, sequence, number, options=paths))
        image = put_block(index, image, light, batch_dims=dims)
    return image


def _rays_at(
    points: GBuffer, index: Array, seed: UInt32[Array, ""], samples: int
) -> tuple[Rays, UInt32[Array, "s n"], UInt32[Array, "s n"]]:
    """Rays that meet the points as their viewers do."""
    distance = jnp.maximum(0.5 * points.t, 64 * points.p_error)
    origin = points.p + points.wo * distance[..., None]
    shape = (samples, index.shape[0])
    rays = Rays(*(jnp.broadcast_to(x, (samples, *x.shape)) for x in (origin, -points.wo)))
    sequence = jnp.broadcast_to(pixel_sequences(seed, index), shape)
    number = jnp.broadcast_to(jnp.arange(samples, dtype=jnp.uint32)[:, None], shape)
    return rays, sequence, number


@jax.jit
def _mean(light: PathLight) -> Float[Array, "n 3"]:
    return (light.emitted + light.diffuse).mean(0)
