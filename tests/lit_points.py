"""Squares, points and what lights them: what several tests of direct light use."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrefl import GBuffer, Rays, Scene
from jaxrefl.radiance.direct import DirectOptions, direct_light
from jaxrefl.radiance.light_samples import sample_lights
from jaxrefl.rays.offset import ERROR_PER_COORDINATE
from jaxrefl.scene import Description, Part, assemble, emitter, matte

UNIT = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], np.float64)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
GREY = matte("grey", (0.5, 0.5, 0.5))

sample = eqx.filter_jit(sample_lights)


class Clear:
    """A tracer that finds nothing in the way and counts the rays it is given."""

    def __init__(self):
        self.rays = 0

    def closest(self, rays, *, active=None):
        raise NotImplementedError

    closest_rows = closest

    def occluded(self, rays: Rays, t_max: jax.Array) -> jax.Array:
        self.rays += int((t_max > 0).sum())
        return jnp.zeros(t_max.shape, bool)


def square(name: str, material, *, size: float = 1.0, centre=(0.0, 0.0, 0.0), uv: np.ndarray | None = None) -> Part:
    """A horizontal square, facing down."""
    return Part(name, (UNIT - [0.5, 0, 0.5]) * size + np.asarray(centre), FACES, material, uv=uv)


FAR_AWAY = square("far away", GREY, centre=(0.0, -1e3, 0.0))
"""A scene needs a triangle."""


def scene_of(*parts: Part, **fields) -> Scene:
    return assemble(Description("test", list(parts or [FAR_AWAY]), **fields))


def points(p, n=(0.0, 1.0, 0.0), *, albedo: float = 1.0, largest: float = 1.0) -> GBuffer:
    """A G-buffer of matte points on triangles with coordinates up to `largest`."""
    p = np.asarray(p, np.float32)
    n = np.broadcast_to(np.asarray(n, np.float32), p.shape)
    one, shape = np.ones(p.shape[:-1], np.float32), p.shape[:-1]
    return GBuffer(
        valid=jnp.ones(shape, bool),
        p=jnp.asarray(p),
        p_error=jnp.asarray(ERROR_PER_COORDINATE * largest * one),
        n=jnp.asarray(n),
        ns=jnp.asarray(n),
        wo=jnp.asarray(n),
        t=jnp.asarray(one),
        z_camera=None,
        base_colour=jnp.full(p.shape, albedo),
        metallic=jnp.asarray(0 * one),
        alpha=jnp.asarray(one),
        eta=jnp.asarray(one),
        outside=jnp.ones(shape, bool),
        object=jnp.zeros(shape, jnp.int32),
        material=jnp.zeros(shape, jnp.int32),
        triangle=jnp.zeros(shape, jnp.int32),
    )


def grid(count: int = 5, *, extent: float = 2.0) -> np.ndarray:
    x, z = np.meshgrid(*2 * [np.linspace(-extent, extent, count)], indexing="ij")
    return np.stack([x, 0 * x, z], -1).reshape(-1, 3)


def irradiance_of(scene: Scene, gbuffer: GBuffer, key: jax.Array, **options) -> np.ndarray:
    """Unoccluded irradiance: pi times the radiance of a white surface."""
    return np.pi * np.asarray(direct_light(scene, Clear(), gbuffer, key, options=DirectOptions(**options)))


def half_shadow(scale: float, shift: float = 0.0) -> tuple[Scene, GBuffer]:
    """A floor in the light of a small square lamp, half of it in the shadow of a blind; and points on the floor."""
    at = lambda *x: tuple(scale * np.array(x) + shift)  # noqa: E731
    lamp = square("lamp", emitter("lamp", (1, 1, 1)), size=0.2 * scale, centre=at(0, 2, 0))
    blind = square("blind", GREY, size=4 * scale, centre=at(-2, 1, 0))
    floor = square("floor", GREY, size=9 * scale, centre=at(0, 0, 0))
    p = np.array([at(x, 0, 0.3) for x in (-1.5, -0.5, -0.2, 0.2, 0.5, 1.5)])
    return scene_of(floor, blind, lamp), points(p, albedo=0.5, largest=4.5 * scale + shift)
