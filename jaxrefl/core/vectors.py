"""Products and interpolation of vectors; sums are written out so that they fuse instead of becoming reductions."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def dot(a: Float[Array, "*b 3"], b: Float[Array, "*b 3"]) -> Float[Array, "*b"]:
    """Scalar product of a and b.

    Args:
        a: Vectors.
        b: Vectors.
    Returns:
        a . b, in the product of their units.
    """
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def cross(a: Float[Array, "*b 3"], b: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Vector product of a and b, right-handed.

    Args:
        a: Vectors.
        b: Vectors.
    Returns:
        a x b: perpendicular to both, as long as the parallelogram between them is large.
    """
    (ax, ay, az), (bx, by, bz) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (a, b))
    return jnp.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def lerp(a: Float[Array, "*b c"], b: Float[Array, "*b c"], t: Float[Array, "*b"]) -> Float[Array, "*b c"]:
    """Linear interpolation (1 - t) a + t b.

    Args:
        a: Result at t = 0, exactly.
        b: Result at t = 1, exactly.
        t: Weight, usually in [0, 1]; beyond it extrapolates.
    Returns:
        The interpolated vectors or colours.
    """
    t = t[..., None]
    return (1 - t) * a + t * b


def largest(v: Float[Array, "*b 3"]) -> Float[Array, "*b"]:
    """Largest component of each vector; several times faster than a reduction over an axis of 3.

    Args:
        v: Vectors or colours.
    Returns:
        The largest of the three components.
    """
    return jnp.maximum(jnp.maximum(v[..., 0], v[..., 1]), v[..., 2])
