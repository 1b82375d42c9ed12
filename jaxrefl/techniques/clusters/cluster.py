"""Mirror rays of pixels, and what is known of clusters of them: GBuffer -> Mirrors, labels -> Clusters.

Source: [WXKP14] §3.3, step 1.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import GBuffer
from jaxrefl.core import dot
from jaxrefl.core.safe import normalise
from jaxrefl.surface import mirror_direction, reflective
from jaxrefl.techniques.clusters.segments import first_pixel, largest, sums

FLAT = 1e-6
"""Squared difference of unit normals up to which a cluster has one normal."""
LEVEL = 1e-4
"""Distance between parallel planes, as a share of their distance to the eye, up to which they are one."""


class Mirrors(eqx.Module):
    """The mirror ray of each pixel [n]."""

    valid: Bool[Array, "n"]
    """True where there is one; what else is here means nothing elsewhere."""
    p: Float[Array, "n 3"]
    """Its start on the reflector, world space."""
    wi: Float[Array, "n 3"]
    """Its unit direction."""
    normal: Float[Array, "n 3"]
    """Unit normal that would reflect the viewer into `wi`: the shading normal, unless that was bent."""
    t: Float[Array, "n"]
    """Distance to the eye, world units."""
    object: Int[Array, "n"]
    """The reflector."""
    p_error: Float[Array, "n"]
    """Bound on the rounding error of `p`, world units."""
    outside: Bool[Array, "n"]
    """True where the viewer is on the side that the reflector's triangle faces."""
    alpha: Float[Array, "n"]
    """GGX width of the reflector."""
    flat: Bool[Array, "n"]
    """True where the normal is that of the triangle."""


class Clusters(eqx.Module):
    """Clusters [c]; an unused one has no pixels."""

    label: Int[Array, "n"]
    """Cluster of each pixel; -1 for none."""
    pixels: Int[Array, "c"]
    """Pixels in each."""
    centre: Float[Array, "c 3"]
    """Mean position, world space; fill 0."""
    normal: Float[Array, "c 3"]
    """Unit mean normal; of a pixel of the cluster where the mean is zero; fill (0, 0, 1)."""
    forward: Float[Array, "c 3"]
    """Unit mean of the mirror directions, in the same way."""
    bend: Float[Array, "c"]
    """Change of the normal along the surface, mean of dn . dp: positive for convex, negative for concave clusters."""
    planar: Bool[Array, "c"]
    """True where all pixels lie in one plane and have its normal."""
    object: Int[Array, "c"]
    """The reflector; -1 for unused ones."""
    outside: Bool[Array, "c"]
    """True where the viewer is on the side that the reflector's triangles face, for most of the pixels."""
    p_error: Float[Array, "c"]
    """Largest rounding error of a pixel's position, world units."""
    alpha: Float[Array, "c"]
    """Largest GGX width."""
    distance: Float[Array, "c"]
    """Largest distance of a pixel to the eye, world units."""

    @property
    def concave(self) -> Bool[Array, "c"]:
        """Clusters whose rays may meet their own reflector again."""
        return (self.bend < 0) & ~self.planar


@jax.jit
def mirrors_of(gbuffer: GBuffer) -> Mirrors:
    """Mirror rays of all pixels.

    Args:
        gbuffer: G-buffer of the frame.
    Returns:
        One ray per pixel [h * w].
    """
    wi = mirror_direction(gbuffer)
    normal = normalise(gbuffer.wo + wi)
    fields = {
        "valid": reflective(gbuffer),
        "p": gbuffer.p,
        "wi": wi,
        "normal": normal,
        "t": gbuffer.t,
        "object": jnp.maximum(gbuffer.object, 0),
        "p_error": gbuffer.p_error,
        "outside": gbuffer.outside,
        "alpha": gbuffer.alpha,
        "flat": dot(normal, gbuffer.n) > 1 - FLAT,
    }
    return Mirrors(**{name: x.reshape(-1, *x.shape[2:]) for name, x in fields.items()})


@functools.partial(jax.jit, static_argnames="capacity")
def describe(mirrors: Mirrors, label: Int[Array, "n"], *, capacity: int) -> Clusters:
    """Means over the pixels of each cluster.

    Args:
        mirrors: Mirror rays.
        label: Cluster of each pixel, -1 for none.
        capacity: How many clusters there are room for.
    Returns:
        The clusters.
    Edge cases: means of opposite normals are zero; the normal of the cluster's first pixel stands in for them.
    Source: [WXKP14] §3.3, step 1.
    """
    pixels = sums(label, jnp.ones(label.shape, jnp.int32), capacity)
    first = first_pixel(label, capacity)
    inverse = 1 / jnp.maximum(pixels, 1).astype(jnp.float32)
    # Relative to a pixel of the cluster: far from the origin sums of positions would lose their digits.
    offset = mirrors.p - mirrors.p[first][label]
    mean = sums(label, offset, capacity) * inverse[:, None]
    normal = _mean_direction(mirrors.normal, label, first, pixels)
    forward = _mean_direction(mirrors.wi, label, first, pixels)
    turned, moved = mirrors.normal - normal[label], offset - mean[label]
    bend = sums(label, dot(turned, moved), capacity) * inverse
    height = jnp.abs(dot(normal[label], moved))
    flat = (largest(label, dot(turned, turned), capacity) < FLAT) & (
        largest(label, height, capacity) <= LEVEL * largest(label, mirrors.t, capacity)
    )
    used, up = pixels > 0, jnp.broadcast_to(jnp.array([0, 0, 1], jnp.float32), normal.shape)
    return Clusters(
        label=label,
        pixels=pixels,
        centre=jnp.where(used[:, None], mirrors.p[first] + mean, 0),
        normal=jnp.where(used[:, None], normal, up),
        forward=jnp.where(used[:, None], forward, up),
        bend=bend,
        planar=used & flat,
        object=jnp.where(used, mirrors.object[first], -1),
        outside=2 * sums(label, mirrors.outside.astype(jnp.int32), capacity) >= pixels,
        p_error=largest(label, mirrors.p_error, capacity),
        alpha=largest(label, mirrors.alpha, capacity),
        distance=largest(label, mirrors.t, capacity),
    )


def _mean_direction(v: Array, label: Array, first: Array, pixels: Array) -> Float[Array, "c 3"]:
    total = sums(label, v, pixels.shape[0])
    weak = dot(total, total) < (0.05 * pixels.astype(total.dtype)) ** 2
    return normalise(jnp.where(weak[:, None], v[first], total))
