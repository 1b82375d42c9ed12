"""One map of the surroundings per reflector, or one for the whole scene: Scene -> Captured."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrefl._types import Scene, Tracer
from jaxrefl.radiance import LightOptions
from jaxrefl.techniques._captured.capture import bounds_centre, capture, reflectors_of

SCOPES = ("object", "scene")
"""What a map is captured for."""


class Captured(eqx.Module):
    """Captured maps; row `r` is one capture. All maps are latitude-longitude, row 0 up."""

    centre: Float[Array, "r 3"]
    """Where each map was captured, world space."""
    sharp: Float[Array, "r h w 3"]
    """Captured radiance."""
    nearness: Float[Array, "r h w"]
    """One over the distance to what was captured, per world unit; 0 for the environment."""
    map_of_object: Int[Array, "o"]
    """Row of each object's map; -1 for objects that reflect nothing."""
    overflow: Int[Array, ""]
    """Reflectors that share the scene's map because there were more than wanted."""


def capture_reflectors(
    scene: Scene, tracer: Tracer, *, scope: str, most: int, height: int, light: LightOptions
) -> Captured:
    """Capture the surroundings of each reflector from its centre, without the reflector itself.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        scope: `object` or `scene`.
        most: Most reflectors with a map of their own; the rest use one captured from the middle of all of them.
        height: Rows of each map; it has twice as many columns.
        light: Diffuse light of what is captured.
    Returns:
        The maps.
    Edge cases: a scene without reflectors gets one map, captured from its centre, that nothing uses.
    """
    reflectors = reflectors_of(scene)
    kept = reflectors[:most] if scope == "object" else reflectors[:0]
    everything = np.unique(np.asarray(scene.mesh.object))
    sites = [(bounds_centre(scene, np.array([index])), int(index)) for index in kept]
    if len(kept) < len(reflectors) or not sites:
        sites.append((bounds_centre(scene, reflectors if len(reflectors) else everything), -1))
    map_of_object = np.full(len(scene.names.objects), -1, np.int32)
    map_of_object[reflectors] = len(sites) - 1
    map_of_object[kept] = np.arange(len(kept))
    captured = []
    for number, (centre, own) in enumerate(sites):
        key = jax.random.fold_in(jax.random.key(0), number)
        captured.append(capture(scene, tracer, jnp.asarray(centre, jnp.float32), own, height, key, light=light))
    return Captured(
        centre=jnp.asarray(np.stack([centre for centre, _ in sites]), jnp.float32),
        sharp=jnp.stack([radiance for radiance, _ in captured]),
        nearness=jnp.stack([near for _, near in captured]),
        map_of_object=jnp.asarray(map_of_object),
        overflow=jnp.asarray(len(reflectors) - len(kept) if scope == "object" else 0, jnp.int32),
    )
