"""Depth warping: where each point that is seen now was in the image of an earlier camera.

GBuffer of now + camera and positions of the key frame -> key coordinate [h w 2]. This is what temporal reuse of diffuse
shading does; reflections that are read this way stick to their surface.

Source: [XWD17] §3.2 and §3.3, depth-based warping.
Differs from the source: it looks back from each pixel instead of drawing the old image forward, since the G-buffer of
the new image is at hand and exact.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera, GBuffer
from jaxrefl.core import project
from jaxrefl.techniques._reproject.read import SNAP, all_of, components, footprint, read


@jax.jit
def seen_before(
    gbuffer: GBuffer,
    camera: Camera,
    p: Float[Array, "kh kw 3"],
    object: Int[Array, "kh kw"],
    tolerance: Float[Array, ""],
) -> tuple[Float[Array, "h w 2"], Bool[Array, "h w"]]:
    r"""Where each visible point was in the key frame.

    $$ |(W(u, v) - W') \cdot n'| \le \varepsilon\, t' $$

    Args:
        gbuffer: What is seen now.
        camera: Camera of the key frame.
        p: Positions seen in the key frame.
        object: Objects seen in the key frame; -1 for none.
        tolerance: Distance from the point to the surface seen there that still counts as the same, as a share of the
            point's distance from its viewer.
    Returns:
        Coordinates in the key frame (fill 0), and where the point was seen there.
    Edge cases: points behind the key frame's camera, outside its image, hidden there, or beside an outline are invalid.
    """
    xy, depth = project(camera, gbuffer.p)
    uv = xy.reshape(-1, 2)
    at = footprint(uv, shape=p.shape[:2], snap=SNAP)
    there = jnp.stack(read(components(p), at), -1).reshape(gbuffer.p.shape)
    own, seen = gbuffer.object.reshape(-1), object.reshape(-1)
    # Only corners that count must show the object; on a pixel's centre that is one.
    corners = [(seen[i] == own) | (w == 0) for i, w in zip(at.corners, at.weights, strict=True)]
    same = corners[0] & corners[1] & corners[2] & corners[3]
    offset = there - gbuffer.p
    height = jnp.abs((offset * gbuffer.n).sum(-1))
    sideways = jnp.sqrt(jnp.maximum((offset * offset).sum(-1), 0))
    near = (height <= tolerance * gbuffer.t) & (sideways <= 16 * tolerance * gbuffer.t)
    valid = gbuffer.valid & (depth > 0) & (at.inside & same).reshape(depth.shape) & near
    return jnp.where(valid[..., None], xy, 0), valid


def read_reflection(
    uv: Float[Array, "h w 2"], valid: Bool[Array, "h w"], image: Float[Array, "kh kw c"], known: Bool[Array, "kh kw"]
) -> tuple[Float[Array, "h w c"], Bool[Array, "h w"]]:
    """Bilinear values of a key frame.

    Args:
        uv: Coordinates in it.
        valid: Where they mean something.
        image: What to read.
        known: Where it is known.
    Returns:
        Values (fill 0), and where all pixels that count were known.
    """
    at = footprint(uv.reshape(-1, 2), shape=known.shape, snap=SNAP)
    value = jnp.stack(read(components(image), at), -1).reshape(*valid.shape, image.shape[-1])
    good = valid & all_of(known.reshape(-1), at).reshape(valid.shape)
    return jnp.where(good[..., None], value, 0), good
