"""Lines against spheres and planes, points against triangles, and mirror images of points.

Distances are in units of the direction's length; directions are unit vectors wherever a world distance is meant.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl.core.safe import divide, norm, sqrt
from jaxrefl.core.vectors import cross, dot


def intersect_sphere(
    origin: Float[Array, "*b 3"],
    direction: Float[Array, "*b 3"],
    centre: Float[Array, "*b 3"],
    radius: Float[Array, "*b"],
) -> tuple[Float[Array, "*b"], Float[Array, "*b"], Bool[Array, "*b"]]:
    r"""Where a ray enters and leaves a sphere.

    $$ |o + t d - c|^2 = r^2 $$

    Args:
        origin: Start of the ray.
        direction: Unit direction.
        centre: Centre of the sphere.
        radius: Radius, >= 0.
    Returns:
        Distance where the line enters (negative if the ray starts inside), distance where it leaves, and whether the
        ray meets the sphere at all: a common point at t >= 0. Both distances are 0 where it does not.
    Edge cases: a tangent ray may fall on either side by rounding; where it counts as a hit its gradient is finite.
    Source: the discriminant from the distance of the centre to the line, [HGM19] Haines et al., "Precision Improvements
    for Ray/Sphere Intersection", Ray Tracing Gems 7, 2019.
    """
    to_origin = origin - centre
    closest = -dot(to_origin, direction)
    miss = to_origin + closest[..., None] * direction
    squared = radius * radius - dot(miss, miss)
    half = sqrt(squared)
    # The root of larger magnitude has no cancellation; the other follows from the product of the roots.
    product = dot(to_origin, to_origin) - radius * radius
    far_root = jnp.where(closest >= 0, closest + half, closest - half)
    near_root = divide(product, far_root)
    enter, leave = jnp.minimum(near_root, far_root), jnp.maximum(near_root, far_root)
    valid = (squared >= 0) & (leave >= 0)
    return jnp.where(valid, enter, 0), jnp.where(valid, leave, 0), valid


def intersect_plane(
    origin: Float[Array, "*b 3"],
    direction: Float[Array, "*b 3"],
    plane_point: Float[Array, "*b 3"],
    n: Float[Array, "*b 3"],
) -> tuple[Float[Array, "*b"], Bool[Array, "*b"]]:
    r"""Distance to a plane along a ray, from either side.

    $$ t = \frac{(p - o) \cdot n}{d \cdot n} $$

    Args:
        origin: Start of the ray.
        direction: Unit direction.
        plane_point: Any point of the plane.
        n: Normal of the plane, of any length but 0.
    Returns:
        Distance, and whether the plane lies ahead (t >= 0); 0 where it does not.
    Edge cases: a ray parallel to the plane does not meet it, not even when it lies in the plane.
    """
    slope = dot(direction, n)
    t = divide(dot(plane_point - origin, n), slope, fill=-1.0)
    valid = t >= 0
    return jnp.where(valid, t, 0), valid


def distance_to_triangle(
    p: Float[Array, "*b 3"], a: Float[Array, "*b 3"], b: Float[Array, "*b 3"], c: Float[Array, "*b 3"]
) -> Float[Array, "*b"]:
    """Distance of points to triangles.

    Args:
        p: The points.
        a: First corner of each triangle.
        b: Second corner.
        c: Third corner.
    Returns:
        Distance to the nearest point of the triangle, its inside included.
    Edge cases: a triangle without area is the segment, or the point, that it has become.
    """
    # In units of the largest extent, from the first corner: products of four lengths neither overflow nor vanish.
    size = jnp.maximum(jnp.maximum(norm(b - a), norm(c - a)), norm(p - a))
    p, b, c = (divide(x - a, jnp.broadcast_to(size[..., None], x.shape)) for x in (p, b, c))
    o = jnp.zeros_like(p)
    normal = cross(b, c)
    beside = [dot(cross(end - start, p - start), normal) for start, end in ((o, b), (b, c), (c, o))]
    squared = dot(normal, normal)
    above = (beside[0] >= 0) & (beside[1] >= 0) & (beside[2] >= 0) & (squared > 0)
    height = jnp.abs(divide(dot(p, normal), sqrt(squared)))
    outline = jnp.minimum(jnp.minimum(_to_segment(p, o, b), _to_segment(p, b, c)), _to_segment(p, c, o))
    return size * jnp.where(above, height, outline)


def _to_segment(p: Array, start: Array, end: Array) -> Float[Array, "*b"]:
    along = end - start
    share = jnp.clip(divide(dot(p - start, along), dot(along, along)), 0, 1)
    return norm(p - start - share[..., None] * along)


def mirror_point(
    p: Float[Array, "*b 3"], plane_point: Float[Array, "*b 3"], n: Float[Array, "*b 3"]
) -> Float[Array, "*b 3"]:
    r"""Mirror image of a point in a plane.

    $$ p' = p - 2\,((p - q) \cdot n)\,n $$

    Args:
        p: Points.
        plane_point: Any point q of the plane.
        n: Unit normal of the plane; its sign does not matter.
    Returns:
        The mirrored points. Mirroring twice gives the point back.
    """
    return p - 2 * dot(p - plane_point, n)[..., None] * n
