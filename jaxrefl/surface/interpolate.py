"""Vertex attributes at hit points: Hits + Mesh -> position, normals, texture coordinates.

Vertices are interpolated with weights (1 - u - v, u, v); a position computed this way lies on its triangle to a few
roundings of the largest coordinate, however far the ray has come, which is what bounds `p_error`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrefl._types import Hits, Mesh
from jaxrefl.core import cross, largest
from jaxrefl.core.safe import normalise
from jaxrefl.rays.offset import ERROR_PER_COORDINATE


def corner_weights(hits: Hits) -> tuple[Float[Array, "*b"], Float[Array, "*b"], Float[Array, "*b"]]:
    """Barycentric weights of the three vertices of the triangle hit.

    Args:
        hits: Any hits [*b].
    Returns:
        Weights of the first, second and third vertex; they sum to 1.
    """
    u, v = hits.barycentric[..., 0], hits.barycentric[..., 1]
    return 1 - u - v, u, v


def interpolate(attribute: Float[Array, "v c"], corners: Int[Array, "*b 3"], hits: Hits) -> Float[Array, "*b c"]:
    """A vertex attribute at hit points.

    Args:
        attribute: One row per vertex.
        corners: Vertex indices of the triangle hit.
        hits: The hits [*b].
    Returns:
        The attribute's rows, weighted barycentrically.
    """
    weights = corner_weights(hits)
    return sum(attribute[corners[..., i]] * weights[i][..., None] for i in range(3))  # pyright: ignore[reportReturnType]


def position(
    mesh: Mesh, corners: Int[Array, "*b 3"], hits: Hits
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b"], Float[Array, "*b 3"]]:
    """Position, its rounding error bound and the geometric normal at hit points.

    Args:
        mesh: The triangles.
        corners: Vertex indices of the triangle hit.
        hits: The hits [*b].
    Returns:
        Points in world space; the bound in world units; unit normals on the side from which the triangle's vertices
        are counter-clockwise.
    Edge cases: a triangle without area has the normal (0, 0, 1).
    """
    a, b, c = (mesh.vertices[corners[..., i]] for i in range(3))
    w0, w1, w2 = (w[..., None] for w in corner_weights(hits))
    p = a * w0 + b * w1 + c * w2
    coordinate = sum(largest(jnp.abs(x)) * w[..., 0] for x, w in ((a, w0), (b, w1), (c, w2)))
    return p, ERROR_PER_COORDINATE * jnp.abs(coordinate), normalise(cross(b - a, c - a))
