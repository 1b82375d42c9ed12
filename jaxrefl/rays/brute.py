"""Every ray against every triangle, in JAX: Rays -> Hits. The oracle for `rays.embree`; for small scenes only.

Rays are tested by signed volumes in a ray-centred frame, so that two triangles that share an edge compute the same
value for it with opposite sign: a ray cannot slip between them.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import Hits, Mesh, Rays

_BLOCK = 256


class BruteTracer:
    """Ray queries against a mesh by testing all triangles; same protocol as `EmbreeTracer`.

    Args:
        mesh: The triangles; their order is the meaning of `Hits.triangle`.
    """

    def __init__(self, mesh: Mesh):
        self.rays = 0
        self._corners = mesh.vertices[mesh.faces]

    def closest(self, rays: Rays, *, active: Bool[Array, "*b"] | None = None) -> Hits:
        """Closest hit of each ray.

        Args:
            rays: Rays [*b].
            active: Which rays to cast; the others come back as misses. None: all.
        Returns:
            Hits [*b], at distances from 0 on as Embree has them; of two triangles at exactly the same distance the one
                with the lower index.
        """
        if active is None:
            active = jnp.ones(rays.origin.shape[:-1], bool)
        self.rays += int(active.sum())
        return _closest(self._corners, rays, active)

    def closest_rows(self, rays: Rays, first: int, count: int) -> Hits:
        """Closest hits of some rows of an image of rays.

        Args:
            rays: Rays [h w].
            first: First row.
            count: Number of rows.
        Returns:
            Hits [count w].
        """
        rows = slice(first, first + count)
        return self.closest(Rays(rays.origin[rows], rays.direction[rows]))

    def occluded(self, rays: Rays, t_max: Float[Array, "*b"]) -> Bool[Array, "*b"]:
        """Whether something lies between the origin and `t_max`.

        Args:
            rays: Rays [*b].
            t_max: Distance up to which to look, world units; rays with `t_max <= 0` count as free.
        Returns:
            True where the ray is blocked.
        """
        self.rays += int((t_max > 0).sum())
        hits = _closest(self._corners, rays, t_max > 0)
        return hits.valid & (hits.t < t_max)


@jax.jit
def _closest(corners: Float[Array, "f 3 3"], rays: Rays, active: Bool[Array, "*b"]) -> Hits:
    shape = rays.origin.shape[:-1]
    origin, direction = rays.origin.reshape(-1, 3), rays.direction.reshape(-1, 3)

    def one_ray(ray: tuple[Array, Array]) -> tuple[Array, ...]:
        t, u, v, hit = _intersect(corners, *ray)
        best = jnp.argmin(jnp.where(hit, t, jnp.inf))
        return hit[best], t[best], best.astype(jnp.int32), u[best], v[best]

    hit, t, triangle, u, v = jax.lax.map(one_ray, (origin, direction), batch_size=_BLOCK)
    hit = hit & active.reshape(-1)
    keep = lambda x: jnp.where(hit, x, 0).reshape(shape)  # noqa: E731
    return Hits(hit.reshape(shape), keep(t), keep(triangle), jnp.stack([keep(u), keep(v)], -1))


def _intersect(corners: Float[Array, "f 3 3"], origin: Float[Array, "3"], direction: Float[Array, "3"]):
    """Distance, barycentric weights and hit flag of one ray against all triangles ([Woop et al. 2013], watertight)."""
    z = jnp.argmax(jnp.abs(direction))
    x, y = (z + 1) % 3, (z + 2) % 3
    local = corners - jnp.broadcast_to(origin, corners.shape)
    depth = local[..., z] / direction[z]
    px, py = local[..., x] - direction[x] * depth, local[..., y] - direction[y] * depth
    (x0, x1, x2), (y0, y1, y2) = (px[:, i] for i in range(3)), (py[:, i] for i in range(3))
    w0, w1, w2 = _edge(x2, y2, x1, y1), _edge(x0, y0, x2, y2), _edge(x1, y1, x0, y0)
    inside = ((w0 >= 0) & (w1 >= 0) & (w2 >= 0)) | ((w0 <= 0) & (w1 <= 0) & (w2 <= 0))
    total = w0 + w1 + w2
    proper = total != 0
    inverse = 1 / jnp.where(proper, total, 1)
    t = (w0 * depth[:, 0] + w1 * depth[:, 1] + w2 * depth[:, 2]) * inverse
    return t, w1 * inverse, w2 * inverse, inside & proper & (t >= 0)


def _edge(ax: Array, ay: Array, bx: Array, by: Array) -> Array:
    """Signed area of an edge and the ray, the exact negative of that of the same edge seen from the next triangle.

    The ends are put in one order first: the compiler may round one of the two products and not the other, which must
    happen to the same product in both triangles.
    """
    swap = (ax > bx) | ((ax == bx) & (ay > by))
    ax, bx, ay, by = jnp.where(swap, bx, ax), jnp.where(swap, ax, bx), jnp.where(swap, by, ay), jnp.where(swap, ay, by)
    area = ax * by - ay * bx
    return jnp.where(swap, -area, area)
