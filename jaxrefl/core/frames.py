"""Tangent frames: directions between world space and the local space in which the normal is +Z.

Source: [DBC17] Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017, listing 3.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core.vectors import dot


def frame_from_normal(n: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Tangent and bitangent that make a right-handed orthonormal frame with n.

    Args:
        n: Unit normals.
    Returns:
        Tangent and bitangent, with tangent x bitangent = n.
    Edge cases: finite for any n; orthonormal only where n is a unit vector. The frame turns abruptly where n.z changes
    its sign (no smooth frame exists on the whole sphere).
    Source: [DBC17] listing 3.
    """
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    sign = jnp.copysign(jnp.ones_like(z), z)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    bitangent = jnp.stack([b, sign + y * y * a, -y], -1)
    return tangent, bitangent


def to_world(v: Float[Array, "*b 3"], n: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """World direction of a vector given in the frame of n.

    Args:
        v: Vectors in local space, +Z along the normal.
        n: Unit normals, world space.
    Returns:
        The same vectors in world space, as long as before.
    Edge cases: as `frame_from_normal`.
    """
    tangent, bitangent = frame_from_normal(n)
    return v[..., 0:1] * tangent + v[..., 1:2] * bitangent + v[..., 2:3] * n


def to_local(v: Float[Array, "*b 3"], n: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Components of a world vector in the frame of n; the inverse of `to_world`.

    Args:
        v: Vectors in world space.
        n: Unit normals, world space.
    Returns:
        The same vectors in local space, +Z along the normal.
    Edge cases: as `frame_from_normal`.
    """
    tangent, bitangent = frame_from_normal(n)
    return jnp.stack([dot(v, tangent), dot(v, bitangent), dot(v, n)], -1)
