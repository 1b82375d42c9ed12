"""Where the image of each texel begins: mirror rays and their views -> 1 / z of what is nearest in it.

A pinhole behind a reflector sees what lies between itself and the reflector: other walls of the same cup, its handle. A
plane behind all of a cluster keeps out what is behind all of it, not what its farther parts have behind them. But where
rays start is known, pixel by pixel.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import Rays
from jaxrefl.techniques.clusters.cameras import ClusterCameras
from jaxrefl.techniques.clusters.cluster import Clusters, Mirrors
from jaxrefl.techniques.clusters.traverse import project_rays


@functools.partial(jax.jit, static_argnames="room")
def begin_texels(cameras: ClusterCameras, clusters: Clusters, mirrors: Mirrors, *, room: int) -> Float[Array, "m"]:
    """1 / z at which the nearest ray starts that starts in a texel or beside it.

    Args:
        cameras: The clusters' cameras.
        clusters: The clusters.
        mirrors: The rays.
        room: Length of the list of texels.
    Returns:
        1 / z; infinite where no ray starts, and in views of planar clusters: these begin at the clipping plane.
    """
    label, views = jnp.maximum(clusters.label, 0), cameras.views
    lines, ahead = project_rays(views, label, Rays(mirrors.p, mirrors.wi), cameras.reach[label])
    active = ahead & (clusters.label >= 0) & (cameras.usable & ~clusters.planar)[label]
    column, row = jnp.floor(lines.start).astype(jnp.int32).T
    nearest = jnp.zeros(room, jnp.float32)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            x, y = column + dx, row + dy
            inside = active & (x >= 0) & (y >= 0) & (x < lines.size[:, 0]) & (y < lines.size[:, 1])
            place = jnp.where(inside, lines.offset + y * lines.size[:, 0] + x, room)
            nearest = nearest.at[place].max(lines.start_z, mode="drop")
    return jnp.where(nearest > 0, nearest, jnp.inf)
