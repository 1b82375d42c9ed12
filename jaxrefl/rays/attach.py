"""Hits as a differentiable function of their rays: the triangle is known, its intersection is computed again in JAX."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import Hits, Mesh, Rays
from jaxrefl.core import cross, dot
from jaxrefl.core.safe import divide


def attach_hits(mesh: Mesh, rays: Rays, hits: Hits) -> Hits:
    r"""Distance and barycentric weights of known hits, with gradients with respect to rays and vertices.

    $$ (t, u, v) = \frac{(e_2 \cdot q,\ s \cdot p,\ d \cdot q)}{e_1 \cdot p},
       \qquad p = d \times e_2,\ s = o - v_0,\ q = s \times e_1 $$

    Which triangle a ray hits stays as it is: moving outlines and shadows do not contribute to the gradient.

    Args:
        mesh: The triangles.
        rays: Rays [*b].
        hits: Their hits, from a tracer.
    Returns:
        The same hits [*b] up to rounding.
    Edge cases: rays within the plane of their triangle keep the tracer's values, without a gradient.
    Source: [MT97], without its culling.
    """
    corners = mesh.faces[hits.triangle]
    a, b, c = (mesh.vertices[corners[..., i]] for i in range(3))
    e1, e2, s = b - a, c - a, rays.origin - a
    p, q = cross(rays.direction, e2), cross(s, e1)
    determinant = dot(e1, p)
    usable = hits.valid & (determinant != 0)
    inverse = divide(jnp.ones_like(determinant), jnp.where(usable, determinant, 1))

    def value(numerator: Float[Array, "*b"], traced: Float[Array, "*b"]) -> Float[Array, "*b"]:
        return jnp.where(usable, numerator * inverse, jax.lax.stop_gradient(traced))

    u = value(dot(s, p), hits.barycentric[..., 0])
    v = value(dot(rays.direction, q), hits.barycentric[..., 1])
    return Hits(hits.valid, value(dot(e2, q), hits.t), hits.triangle, jnp.stack([u, v], -1))
