"""Primary rays: Camera -> Rays."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import Camera, Rays


def camera_rays(camera: Camera, *, jitter: Float[Array, "h w 2"] | None = None) -> Rays:
    """One ray through each pixel.

    Args:
        camera: Any camera.
        jitter: Position inside each pixel, in [0, 1); None: the pixel's centre, (0.5, 0.5).
    Returns:
        Rays [h w] from the camera's position.
    """
    column = jnp.arange(camera.width, dtype=jnp.float32)[None, :]
    row = jnp.arange(camera.height, dtype=jnp.float32)[:, None]
    dx, dy = (0.5, 0.5) if jitter is None else (jitter[..., 0], jitter[..., 1])
    shape = (camera.height, camera.width)
    x = jnp.broadcast_to((column + dx - camera.centre[0]) / camera.focal[0], shape)
    y = jnp.broadcast_to((camera.centre[1] - row - dy) / camera.focal[1], shape)
    inverse = 1 / jnp.sqrt(x * x + y * y + 1)
    rotation = camera.world_from_camera[:3, :3]
    direction = [(rotation[i, 0] * x + rotation[i, 1] * y - rotation[i, 2]) * inverse for i in range(3)]
    origin = jnp.broadcast_to(camera.world_from_camera[:3, 3], (*shape, 3))
    return Rays(origin, jnp.stack(direction, -1))
