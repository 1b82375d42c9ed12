"""Closest hits and occlusion by Embree: Rays -> Hits. The only file that imports embreex.

Everything embreex reports is translated here, once: misses (`primID == -1`, `tfar == 1e37`) become `valid == False`
with zeros, the unnormalised normal is dropped (the G-buffer computes its own from the vertices), and `tfar`, which
counts in lengths of the direction, is a distance because `Rays.direction` is unit. Embree runs in its robust mode,
which is watertight along shared edges.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxrefl._types import Hits, Mesh, Rays


class EmbreeTracer:
    """Ray queries against a mesh, on the host.

    Args:
        mesh: The triangles; their order is the meaning of `Hits.triangle`.
    Raises:
        ImportError: If embreex has no wheel for this platform; `BruteTracer` serves tiny scenes there.
    """

    def __init__(self, mesh: Mesh):
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise ImportError(
                "embreex cannot be imported; it has wheels for Linux and Windows on x86-64 and for macOS, "
                "but none for Linux on Arm. BruteTracer works everywhere, for small scenes."
            ) from error
        self.rays = 0
        self._scene = EmbreeScene(robust=True)
        vertices = np.ascontiguousarray(mesh.vertices, np.float32)
        TriangleMesh(self._scene, vertices, np.ascontiguousarray(mesh.faces, np.int32))
        # The first query builds the acceleration structure: do it now rather than inside somebody's timing.
        self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    def cast(self, origin: np.ndarray, direction: np.ndarray) -> dict[str, np.ndarray]:
        """Embree's own answer, untranslated: what everything else is measured against.

        Args:
            origin: [n 3] float32, contiguous.
            direction: [n 3] float32, contiguous, unit.
        Returns:
            `primID` (-1 for a miss), `geomID`, `tfar`, `u`, `v`, `Ng`.
        """
        self.rays += len(origin)
        return self._scene.run(origin, direction, query="INTERSECT", output=True)

    def closest(self, rays: Rays, *, active: Bool[Array, "*b"] | None = None) -> Hits:
        """Closest hit of each ray.

        Args:
            rays: Rays [*b].
            active: Which rays to cast; the others come back as misses. None: all.
        Returns:
            Hits [*b].
        """
        origin, direction = _flat(rays.origin), _flat(rays.direction)
        return self._closest(origin, direction, rays.origin.shape[:-1], active)

    def closest_rows(self, rays: Rays, first: int, count: int) -> Hits:
        """Closest hits of some rows of an image of rays.

        The caller can go on working on these on the device while the next rows are cast here on the host.

        Args:
            rays: Rays [h w].
            first: First row.
            count: Number of rows.
        Returns:
            Hits [count w].
        """
        rows = slice(first, first + count)
        origin, direction = np.asarray(rays.origin)[rows], np.asarray(rays.direction)[rows]
        return self._closest(_flat(origin), _flat(direction), origin.shape[:-1], None)

    def _closest(self, origin: np.ndarray, direction: np.ndarray, shape: tuple[int, ...], active: Array | None) -> Hits:
        cast = None if active is None else np.flatnonzero(active)
        if cast is not None and len(cast) == len(origin):
            cast = None
        if cast is not None:
            origin, direction = origin.take(cast, axis=0), direction.take(cast, axis=0)
        found = self.cast(origin, direction)
        fields = (found["primID"], found["tfar"], found["u"], found["v"])
        if cast is not None:
            fields = tuple(_spread(x, cast, math.prod(shape)) for x in fields)
        return _hits(*(x.reshape(shape) for x in fields))

    def occluded(self, rays: Rays, t_max: Float[Array, "*b"]) -> Bool[Array, "*b"]:
        """Whether something lies between the origin and `t_max`.

        Args:
            rays: Rays [*b].
            t_max: Distance up to which to look, world units; rays with `t_max <= 0` are not cast and count as free.
        Returns:
            True where the ray is blocked.
        """
        distance = np.array(t_max, np.float32).reshape(-1)  # a copy: embreex wants to be able to write
        origin, direction = _flat(rays.origin), _flat(rays.direction)
        cast = np.flatnonzero(distance > 0)
        blocked = np.zeros(len(distance), bool)
        if len(cast) == len(distance):
            blocked = self._blocked(origin, direction, distance)
        elif len(cast):
            # `take` is four times as fast as indexing with a mask.
            chosen = (x.take(cast, axis=0) for x in (origin, direction, distance))
            blocked[cast] = self._blocked(*chosen)
        return jnp.asarray(blocked.reshape(rays.origin.shape[:-1]))

    def _blocked(self, origin: np.ndarray, direction: np.ndarray, distance: np.ndarray) -> np.ndarray:
        self.rays += len(origin)
        return self._scene.run(origin, direction, distance, query="OCCLUDED") != -1


def _flat(x: Array | np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(x, np.float32).reshape(-1, 3)


def _spread(x: np.ndarray, where: np.ndarray, count: int) -> np.ndarray:
    """Results of the rays that were cast at their places among all rays; -1 (a miss) elsewhere."""
    full = np.full(count, -1, x.dtype)
    full[where] = x
    return full


@jax.jit
def _hits(triangle: Array, t: Array, u: Array, v: Array) -> Hits:
    """Embree's fields as `Hits`; NumPy arrays go straight into the compiled call."""
    valid = triangle >= 0
    barycentric = jnp.stack([jnp.where(valid, u, 0), jnp.where(valid, v, 0)], -1)
    return Hits(valid, jnp.where(valid, t, 0), jnp.where(valid, triangle, 0), barycentric)
