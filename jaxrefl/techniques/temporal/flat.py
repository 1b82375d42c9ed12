"""Vectors as three flat arrays: the layout that hot loops on a CPU want."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera, GBuffer, Rays
from jaxrefl.surface import mirror_direction
from jaxrefl.techniques._reproject import components

Triple = tuple[Array, Array, Array]


class Pose(NamedTuple):
    """A camera as numbers."""

    eye: Triple
    axes: tuple[Triple, Triple, Triple]
    focal: tuple[Array, Array]
    centre: tuple[Array, Array]


class Surfaces(eqx.Module):
    """Surfaces of an image: positions and shading normals, and which object each pixel shows."""

    p: tuple[Float[Array, "m"], Float[Array, "m"], Float[Array, "m"]]
    """World positions."""
    n: tuple[Float[Array, "m"], Float[Array, "m"], Float[Array, "m"]]
    """Unit normals."""
    object: Int[Array, "m"]
    """Object indices, -1 for none."""
    width: int = eqx.field(static=True)
    """Width of the image."""
    height: int = eqx.field(static=True)
    """Height of the image."""


class Mirrors(eqx.Module):
    """What a frame's G-buffer is to all stages, made once: each pixel is a small mirror."""

    rays: Rays
    """Surface points and mirror directions [h w]."""
    smooth: Bool[Array, "h w"]
    """Where the lobe is narrow enough to be followed as one direction."""
    flat: Surfaces
    """The surfaces as flat arrays."""


@jax.jit
def mirrors_of(gbuffer: GBuffer, sharp: Float[Array, ""]) -> Mirrors:
    """The small mirrors of a G-buffer.

    Args:
        gbuffer: Any G-buffer.
        sharp: Largest alpha of a lobe that is followed as one direction.
    Returns:
        Its pixels as mirrors, whatever they are made of.
    """
    flat = surfaces(gbuffer.p, gbuffer.ns, gbuffer.object)
    return Mirrors(Rays(gbuffer.p, mirror_direction(gbuffer)), gbuffer.alpha <= sharp, flat)


def surfaces(p: Float[Array, "h w 3"], n: Float[Array, "h w 3"], object: Int[Array, "h w"]) -> Surfaces:
    """Surfaces of an image as flat arrays.

    Args:
        p: World positions.
        n: Unit normals.
        object: Object indices.
    Returns:
        The same, flattened.
    """
    return Surfaces(components(p), components(n), object.reshape(-1), p.shape[1], p.shape[0])  # pyright: ignore[reportArgumentType]


def pose(camera: Camera) -> Pose:
    """A camera as numbers.

    Args:
        camera: Any camera.
    Returns:
        Its eye, axes, focal lengths and principal point.
    """
    m = camera.world_from_camera

    def column(i: int) -> Triple:
        return m[0, i], m[1, i], m[2, i]

    return Pose(column(3), (column(0), column(1), column(2)), tuple(camera.focal), tuple(camera.centre))  # pyright: ignore[reportArgumentType]


def split(x: Float[Array, "*b 3"]) -> Triple:
    """Vectors as three arrays.

    Args:
        x: Vectors.
    Returns:
        Their components.
    """
    return x[..., 0], x[..., 1], x[..., 2]


def take(of: Triple, index: Array) -> Triple:
    """Elements of three flat arrays.

    Args:
        of: The arrays.
        index: Which elements.
    Returns:
        Three arrays.
    """
    x, y, z = (x[index] for x in of)
    return x, y, z


def dot3(a: Triple, b: Triple) -> Array:
    """Scalar product.

    Args:
        a: A vector.
        b: A vector.
    Returns:
        a . b.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross3(a: Triple, b: Triple) -> Triple:
    """Vector product.

    Args:
        a: A vector.
        b: A vector.
    Returns:
        a x b.
    """
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def along(a: Triple, s: Array | float, b: Triple) -> Triple:
    """a + s b.

    Args:
        a: A vector.
        s: A number.
        b: A vector.
    Returns:
        The sum.
    """
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


def seen_at(pose: Pose, point: Triple, w: Array) -> tuple[Array, Array, Array]:
    """Image position of homogeneous points.

    Args:
        pose: Camera.
        point: World positions, or directions.
        w: 1 for positions, 0 for directions.
    Returns:
        x and y in pixels, and depth; x and y are the principal point where the depth is not positive.
    """
    offset = along(point, -w, pose.eye)
    x, y, depth = dot3(offset, pose.axes[0]), dot3(offset, pose.axes[1]), -dot3(offset, pose.axes[2])
    inverse = jnp.where(depth > 0, 1 / jnp.where(depth > 0, depth, 1), 0)
    return pose.centre[0] + pose.focal[0] * x * inverse, pose.centre[1] - pose.focal[1] * y * inverse, depth


def mirrored(point: Triple, w: Array, p: Triple, n: Triple) -> Triple:
    r"""Offset from a surface point to the mirror image of a reflected point.

    $$ d' = d - 2 (d \cdot n) n, \qquad d = R - w W $$

    Args:
        point: Reflected positions R, or directions.
        w: 1 for positions, 0 for directions.
        p: Surface points W.
        n: Their unit normals.
    Returns:
        d': the mirror image is W + d', or in direction d' for directions.
    """
    d = along(point, -w, p)
    return along(d, -2 * dot3(d, n), n)
