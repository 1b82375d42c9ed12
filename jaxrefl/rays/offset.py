"""Ray origins that cannot hit the surface they start on, at any size and position of the scene.

The rounding error of a hit point grows with the coordinates of the triangle it lies on, not with the size of the scene
or with 1. `surface.build_gbuffer` bounds it for every point (`GBuffer.p_error`); here that bound is the step away from
the surface. Both are homogeneous of degree one, so scaling a scene by a power of two changes no bit of the image.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

ERROR_PER_COORDINATE = 48 * float(jnp.finfo(jnp.float32).eps)
"""Offset as a share of the triangle's coordinates.

Barycentric interpolation errs by at most 6 half-ulps of the largest coordinate; the rest is for the intersection test,
which subtracts the origin from the vertices. `tests/test_rays_offset.py` measures the share of self-hits at this value
(none) and at a 48th of it (many).
"""


def offset_origin(
    p: Float[Array, "*b 3"], n: Float[Array, "*b 3"], p_error: Float[Array, "*b"], direction: Float[Array, "*b 3"]
) -> Float[Array, "*b 3"]:
    """Move ray origins off their surface, to the side the ray leaves on.

    $$ o = p \\pm e\\, n $$

    Args:
        p: Points on surfaces, world space.
        n: Geometric unit normals.
        p_error: Bound on the error of `p`, world units (`GBuffer.p_error`).
        direction: Directions of the rays; only their side of the surface matters.
    Returns:
        Ray origins.
    Edge cases: a direction within the surface leaves on the side of `n`.
    Source: [PBRT4] §6.8.6, with a scalar bound instead of one per axis.
    """
    below = n[..., 0] * direction[..., 0] + n[..., 1] * direction[..., 1] + n[..., 2] * direction[..., 2] < 0
    step = jnp.where(below, -p_error, p_error)
    return p + n * step[..., None]
