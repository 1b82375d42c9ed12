"""What the mirror image can know of a glossy reflection: GGX rays whose hits one of its pixels shows.

A ray of the lobe that leaves a plane at p and hits q is seen where the mirror image of q stands. If the mirror ray of
that pixel hit the same place, a filter of the mirror image can have it; otherwise nothing that reads the image does.
The mean over the rays that are shown is therefore the best that any filter can do, and what is left of the error is
what one mirror ray per pixel does not know.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrefl._status import Source
from jaxrefl._types import Camera, Frame, GBuffer, Hits, Rays, Reflection
from jaxrefl.core import dot, project
from jaxrefl.surface import reflective
from jaxrefl.techniques._tracing.samples import reflected_rays

_FAR = 1e4
"""Where the environment is, in distances to the reflector."""
_PIXELS = 5.0
"""How far apart two hits on the same surface may lie, in pixels at their distance."""
_SAME_PLANE = 1e-3
"""How far from a plane its pixels may be, as a share of their distance."""


class Shown(NamedTuple):
    """The best that a filter of the mirror image can do."""

    image: np.ndarray
    """[h w 3] mean over the rays that the mirror image shows; the sharp reflection where it shows none of them."""
    share: np.ndarray
    """[h w] weight of these rays in the whole lobe."""
    outside: np.ndarray
    """[h w] weight of those that would be seen beyond the picture."""


def shown_rays(frame: Frame, sharp: Reflection, key: Array, *, samples: int) -> Shown:
    """Trace GGX rays, and look their hits up in the mirror image.

    Args:
        frame: Scene, camera, G-buffer and tracer.
        sharp: The mirror image.
        key: Random key.
        samples: GGX rays per pixel.
    Returns:
        The mean of what is shown, and how much of the lobe that is. For planar reflectors; on curved ones hits are
        looked for where the tangent plane would show them.
    """
    h, w = frame.gbuffer.t.shape
    points = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), frame.gbuffer)
    active = reflective(points)
    sums = jnp.zeros((h * w, 3), jnp.float32), jnp.zeros((3, h * w), jnp.float32)
    for number in range(samples):
        rays, weight = reflected_rays(points, active, key, jnp.asarray(number, jnp.int32))
        hits = frame.tracer.closest(rays, active=weight > 0)
        sums = _add(frame.camera, points, sharp, sums, rays, weight, hits)
    colour, (seen, outside, whole) = (np.asarray(s) for s in sums)
    mean = colour / np.maximum(seen, 1e-20)[:, None]
    own = np.asarray(sharp.radiance).reshape(-1, 3)
    image = np.where((seen > 0)[:, None], mean, own).reshape(h, w, 3)
    return Shown(image, *((part / np.maximum(whole, 1e-20)).reshape(h, w) for part in (seen, outside)))


Sums = tuple[Float[Array, "n 3"], Float[Array, "3 n"]]


@jax.jit
def _add(
    camera: Camera, points: GBuffer, sharp: Reflection, sums: Sums, rays: Rays, weight: Float[Array, "n"], hits: Hits
) -> Sums:
    h, w = sharp.t.shape
    away = jnp.where(hits.valid, hits.t, _FAR * points.t)[:, None] * rays.direction
    beyond = points.p + away - 2 * dot(away, points.n)[:, None] * points.n
    xy, depth = project(camera, beyond)
    column, row = (jnp.floor(xy[:, i]).astype(jnp.int32) for i in range(2))
    inside = (depth > 0) & (column >= 0) & (column < w) & (row >= 0) & (row < h)
    at = jnp.where(inside, row * w + column, 0)
    plane = jnp.abs(dot(points.p[at] - points.p, points.n)) < _SAME_PLANE * points.t
    plane = plane & (dot(points.n[at], points.n) > 1 - _SAME_PLANE) & reflective(points)[at]
    mirrored_t, environment = sharp.t.reshape(-1)[at], sharp.source.reshape(-1)[at] == int(Source.ENVIRONMENT)
    off = sharp.p.reshape(-1, 3)[at] - (points.p + away)
    close = dot(off, off) < (_PIXELS * (points.t[at] + mirrored_t) / camera.focal[0]) ** 2
    same = jnp.where(hits.valid, close & ~environment, environment)
    seen = jnp.where(inside & plane & same, weight, 0)
    shares = jnp.stack([seen, jnp.where(inside, 0, weight), weight])
    return sums[0] + seen[:, None] * sharp.radiance.reshape(-1, 3)[at], sums[1] + shares
