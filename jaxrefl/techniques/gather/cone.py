r"""The disk that a cone of mirror directions covers in the image: G-buffer + distances -> footprint.

$$ r = f\, c\, \alpha\, \min_{\text{disk}} \tau $$

With `search`, the nearest reflected point within the pixel's own disk decides, so that contacts stay sharp; it also
makes patches whose outlines are those of the disks.

Source: [RS09] §3.
"""

import functools
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import Camera, GBuffer
from jaxrefl.filters import Footprint
from jaxrefl.surface import reflective
from jaxrefl.techniques.gather.types import Params

_GOLDEN = math.pi * (3 - math.sqrt(5))


@functools.partial(jax.jit, static_argnames="search")
def cone_footprint(
    camera: Camera, gbuffer: GBuffer, tau: Float[Array, "h w"], params: Params, *, search: int
) -> Footprint:
    """One round Gaussian per pixel.

    Args:
        camera: The camera.
        gbuffer: What it sees.
        tau: Relative distance of what the mirror ray hit.
        params: `cone`.
        search: Pixels of the disk that are looked at; 0: the pixel's own distance decides.
    Returns:
        Footprint whose deviation is the disk's radius; without slant or curvature, as published.
    """
    h, w = tau.shape
    scale = params.cone * gbuffer.alpha * camera.focal.mean()
    shiny = reflective(gbuffer)
    ids, distances = jnp.where(shiny, gbuffer.material, -1).reshape(-1), tau.reshape(-1)
    y, x = (jnp.broadcast_to(i, (h, w)) for i in (jnp.arange(h)[:, None], jnp.arange(w)[None, :]))
    own = scale * tau

    def look(nearest: Float[Array, "h w"], number: Array) -> tuple[Float[Array, "h w"], None]:
        part = jnp.sqrt((number + 0.5) / max(search, 1)) * own
        angle = _GOLDEN * number
        there_x = jnp.clip(x + jnp.round(part * jnp.cos(angle)).astype(x.dtype), 0, w - 1)
        there_y = jnp.clip(y + jnp.round(part * jnp.sin(angle)).astype(y.dtype), 0, h - 1)
        at = there_y * w + there_x
        same = ids[at] == ids.reshape(h, w)
        return jnp.where(same, jnp.minimum(nearest, distances[at]), nearest), None

    nearest, _ = jax.lax.scan(look, tau, jnp.arange(search, dtype=jnp.float32))
    variance = (scale * nearest) ** 2
    covariance = jnp.stack([variance, jnp.zeros_like(variance), variance], -1)[..., None, :]
    return Footprint(jnp.ones((h, w, 1), tau.dtype), jnp.zeros((h, w, 1, 2), tau.dtype), covariance)
