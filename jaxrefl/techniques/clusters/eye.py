"""Where the eye of each cluster's camera goes: clusters and their mirror rays -> centres of projection.

The rays of a planar cluster all come from one point, the viewer's mirror image. Those of a curved one do not, and the
eye that sees nearly what they see lies elsewhere on the line to it: at a factor f of its distance behind the cluster.
Three ways to find it: the paper's Eq. 1, the best f by a fit, and the point that is nearest to all rays.

Source: [WXKP14] §3.3, step 3.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl.core import dot, frame_from_normal
from jaxrefl.core.safe import divide, norm
from jaxrefl.techniques.clusters.cluster import Clusters, Mirrors
from jaxrefl.techniques.clusters.segments import largest, smallest, sums

SMALLEST, LARGEST = 0.02, 4.0
"""Range of f. A cluster that gathers its rays has a negative one or none at all: its eye cannot lie behind it."""
SAMPLES = 32
"""Rays per cluster that a fit looks at."""
_PRIOR = 1e-4
"""Weight of the viewer's mirror image where the rays do not say how far away the eye is."""


def mirrored_eye(clusters: Clusters, eye: Float[Array, "3"]) -> Float[Array, "c 3"]:
    """The viewer's mirror image in each cluster's mean plane.

    Args:
        clusters: The clusters.
        eye: Position of the viewer, world space.
    Returns:
        Points behind the clusters.
    Edge cases: a viewer in the plane or behind it counts as lying a thousandth of its distance before it.
    """
    offset = jnp.broadcast_to(eye, clusters.centre.shape) - clusters.centre
    distance = norm(offset)
    height = jnp.maximum(dot(offset, clusters.normal), 1e-3 * distance)
    lateral = offset - clusters.normal * dot(offset, clusters.normal)[:, None]
    return clusters.centre + lateral - clusters.normal * height[:, None]


def displacement(near: Float[Array, "*b"], far: Float[Array, "*b"], spread: Float[Array, "*b"]) -> Float[Array, "*b"]:
    r"""Factor on the eye's distance to the cluster that makes its rays' near and far ends look equally wide.

    $$ f = \frac{d_n\,(d_F - d_f)}{d_f\,(d_F - d_n)}, \qquad e_c = P_c + f\,(e_0 - P_c) $$

    From similar triangles: an eye at the distance h before the image plane sees an extent d_F on the far plane, D
    behind it, as d_f = d_F h / (h + D); asking for d_f = d_n at the distance f h gives the equation.

    Args:
        near: d_n, diagonal of the near ends' bounding box on the image plane, seen from e_0.
        far: d_f, that of the far ends.
        spread: d_F, diagonal of the far ends' bounding box on the far plane itself.
    Returns:
        f in [`SMALLEST`, `LARGEST`].
    Edge cases: 1 for a planar cluster (d_n = d_f) and for a single pixel (0 / 0). Where the rays come together (d_F <=
        d_n) there is no such eye: the farthest one is taken.
    Source: [WXKP14] Eq. 1.
    Differs from the source: its step 3b moves the eye by f from e_0 to P_c, by which a planar cluster (f = 1) would
        have its eye on the mirror; its text and its derivation want what stands here.
    """
    alike = jnp.abs(near - far) <= 1e-4 * jnp.maximum(near, far)
    wide = spread - near > 1e-6 * jnp.maximum(spread, near)
    f = divide(near * jnp.maximum(spread - far, 0), far * jnp.where(wide, spread - near, 1), fill=1.0)
    f = jnp.where(alike, 1.0, jnp.where(wide, f, LARGEST))
    return jnp.clip(f, SMALLEST, LARGEST)


def displaced_eye(
    mirrors: Mirrors, clusters: Clusters, start: Float[Array, "c 3"], reach: Float[Array, ""]
) -> Float[Array, "c 3"]:
    """Eyes by Eq. 1.

    Args:
        mirrors: Mirror rays.
        clusters: The clusters.
        start: e_0, from `mirrored_eye`.
        reach: D, the scene's diameter.
    Returns:
        e_c.
    """
    capacity, label = clusters.pixels.shape[0], clusters.label
    right, down = frame_from_normal(clusters.normal)
    behind = -dot(start - clusters.centre, clusters.normal)

    def flat(p: Array) -> tuple[Array, Array]:
        """Position across the image plane and height above it."""
        offset = p - clusters.centre[label]
        across = jnp.stack([dot(offset, right[label]), dot(offset, down[label])], -1)
        return across, dot(offset, clusters.normal[label])

    foot, _ = flat(start[label])

    def seen(p: Array) -> tuple[Array, Array]:
        """Where a point is seen on the image plane from e_0, and where it lies across it."""
        across, height = flat(p)
        depth = height + behind[label]
        share = divide(behind[label], jnp.maximum(depth, 1e-3 * behind[label]))
        return foot + (across - foot) * share[:, None], across

    def diagonal(x: Array) -> Array:
        extent = largest(label, x, capacity) - smallest(label, x, capacity)
        return jnp.sqrt((extent * extent).sum(-1))

    rising = jnp.maximum(dot(mirrors.wi, clusters.normal[label]), 0.1)  # grazing rays never reach the far plane
    near, _ = seen(mirrors.p)
    far, spread = seen(mirrors.p + mirrors.wi * (reach / rising)[:, None])
    f = displacement(diagonal(near), diagonal(far), diagonal(spread))
    return clusters.centre + (start - clusters.centre) * f[:, None]


def nearest_point(mirrors: Mirrors, clusters: Clusters, start: Float[Array, "c 3"]) -> Float[Array, "c 3"]:
    r"""The point nearest to all rays of each cluster, taken as lines.

    $$ e_c = \arg\min_x \sum_i \lVert (I - \omega_i \omega_i^T)(x - P_i) \rVert^2 + \lambda N \lVert x - e_0 \rVert^2 $$

    Args:
        mirrors: Mirror rays.
        clusters: The clusters.
        start: e_0, which decides what the rays leave open, as those of one pixel do.
    Returns:
        e_c; for planar clusters e_0 up to rounding.
    Source: linear least squares; a departure from [WXKP14], whose eye stays on the line from P_c to e_0.
    """
    capacity, label = clusters.pixels.shape[0], clusters.label
    w, p = mirrors.wi, mirrors.p - start[label]
    along = dot(w, p)
    count = jnp.maximum(clusters.pixels, 1).astype(w.dtype)
    right_side = sums(label, p - w * along[:, None], capacity) / count[:, None]
    products = jnp.stack([w[:, i] * w[:, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))], -1)
    xx, xy, xz, yy, yz, zz = (sums(label, products, capacity) / count[:, None]).T
    moved = solve_symmetric(
        (1 - xx + _PRIOR, -xy, -xz, 1 - yy + _PRIOR, -yz, 1 - zz + _PRIOR), right_side
    )  # fmt: skip
    return start + moved


def solve_symmetric(matrix: tuple[Array, ...], b: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Solution of symmetric 3x3 systems by their cofactors.

    Args:
        matrix: The elements xx, xy, xz, yy, yz, zz, each [*b].
        b: Right-hand sides.
    Returns:
        x with A x = b; 0 where A is singular.
    """
    xx, xy, xz, yy, yz, zz = matrix
    rows = (
        (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy),
        (xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz),
        (xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy),
    )
    inverse = divide(jnp.ones_like(xx), xx * rows[0][0] + xy * rows[0][1] + xz * rows[0][2])
    return jnp.stack([(r[0] * b[..., 0] + r[1] * b[..., 1] + r[2] * b[..., 2]) * inverse for r in rows], -1)


def sampled_rays(mirrors: Mirrors, clusters: Clusters) -> tuple[Int[Array, "c s"], Bool[Array, "c s"]]:
    """Some pixels of each cluster, spread over it by a hash of their numbers.

    Args:
        mirrors: Mirror rays.
        clusters: The clusters.
    Returns:
        Numbers of pixels, and which of them are there.
    """
    capacity, n = clusters.pixels.shape[0], mirrors.valid.shape[0]
    number = jnp.arange(n, dtype=jnp.int32)
    slot = ((number.astype(jnp.uint32) * jnp.uint32(2654435769)) >> 8).astype(jnp.int32) % SAMPLES
    place = jnp.where(clusters.label < 0, capacity * SAMPLES, clusters.label * SAMPLES + slot)
    chosen = jnp.full(capacity * SAMPLES, -1, jnp.int32).at[place].max(number, mode="drop")
    chosen = chosen.reshape(capacity, SAMPLES)
    return jnp.maximum(chosen, 0), chosen >= 0


def disparity(
    f: Float[Array, ""], centre: Float[Array, "3"], start: Float[Array, "3"], normal: Float[Array, "3"],
    near: Float[Array, "s 3"], far: Float[Array, "s 3"],
) -> Float[Array, "s 2"]:  # fmt: skip
    """How far apart the two ends of rays are seen on the image plane through P_c: what a search along each must bridge.

    Args:
        f: Factor on the eye's distance.
        centre: P_c.
        start: e_0.
        normal: Normal of the image plane.
        near: Near ends.
        far: Far ends.
    Returns:
        Differences per ray, as a share of e_0's distance to the plane; for all of a camera's own rays 0. Slopes would
        not do: from far away everything looks small.
    """
    eye = centre + (start - centre) * f
    right, down = frame_from_normal(normal)

    def seen(p: Array) -> Array:
        offset = p - jnp.broadcast_to(eye, p.shape)
        z = jnp.maximum(offset @ normal, 1e-3 * f * jnp.abs((start - centre) @ normal))
        return f * jnp.stack([offset @ right / z, offset @ down / z], -1)

    return seen(far) - seen(near)


def fitted_eye(
    mirrors: Mirrors, clusters: Clusters, start: Float[Array, "c 3"], reach: Float[Array, ""]
) -> Float[Array, "c 3"]:
    """Eyes at the factor f that makes near and far ends of single rays, not of their bounding boxes, coincide best.

    Args:
        mirrors: Mirror rays.
        clusters: The clusters.
        start: e_0.
        reach: Distance of the far ends.
    Returns:
        e_c.
    Source: the exact form of what [WXKP14] Eq. 1 approximates, in one dimension, by Levenberg-Marquardt.
    """
    import optimistix  # slow to import, and only this option needs it

    index, there = sampled_rays(mirrors, clusters)
    near = mirrors.p[index]
    far = near + mirrors.wi[index] * reach

    def residual(logarithm: Array, data: tuple[Array, ...]) -> Array:
        *geometry, mask = data
        return jnp.where(mask[:, None], disparity(jnp.exp(logarithm), *geometry), 0)

    def one(*data: Array) -> Array:
        solver = optimistix.LevenbergMarquardt(rtol=1e-4, atol=1e-6)
        begin = jnp.zeros((), jnp.float32)
        found = optimistix.least_squares(residual, solver, begin, args=data, max_steps=24, throw=False)
        return jnp.clip(jnp.exp(found.value), SMALLEST, LARGEST)

    f = jax.vmap(one)(clusters.centre, start, clusters.normal, near, far, there)
    return clusters.centre + (start - clusters.centre) * jnp.where(clusters.pixels > 1, f, 1.0)[:, None]
