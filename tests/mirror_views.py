"""Views of analytic mirrors in a hollow world: exact G-buffers and reflection buffers without a scene or a tracer.

Every mirror is a function from a line to the surface point and normal, written in JAX so that a root finder can
differentiate it. The world is the inside of a large sphere, so each reflected point has a closed form too.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import Array

from jaxrefl._types import Camera, GBuffer
from jaxrefl.core import look_at
from jaxrefl.rays import camera_rays
from jaxrefl.techniques.temporal.types import ReflectionBuffer

SIZE = (64, 48)
WORLD = 12.0
"""Radius of the world around the origin."""
Mirror = Callable[[Array, Array], tuple[Array, Array, Array]]
"""(origin [3], direction [3]) -> (distance, unit normal [3], whether it is met)."""


def _sphere(origin: Array, direction: Array, centre: Array, radius: float, far: bool) -> tuple[Array, Array]:
    to = origin - centre
    b = to @ direction
    inside = b * b - to @ to + radius * radius
    root = jnp.sqrt(jnp.maximum(inside, 1e-12))
    return (-b + root if far else -b - root), inside > 0


def plane(origin: Array, direction: Array) -> tuple[Array, Array, Array]:
    """The mirror y = 0."""
    t = -origin[1] / jnp.where(jnp.abs(direction[1]) > 1e-6, direction[1], 1e-6)
    return t, jnp.array([0.0, 1.0, 0.0]), (direction[1] < -1e-3) & (t < 8)


def ball(origin: Array, direction: Array) -> tuple[Array, Array, Array]:
    """A convex mirror of radius 1.2 around the origin."""
    t, met = _sphere(origin, direction, jnp.zeros(3), 1.2, False)
    return t, (origin + t * direction) / 1.2, met


def cylinder(origin: Array, direction: Array) -> tuple[Array, Array, Array]:
    """A convex mirror of radius 1 around the y axis."""
    flat = jnp.array([1.0, 0.0, 1.0])
    d = direction * flat
    length = jnp.sqrt(d @ d)
    s, met = _sphere(origin * flat, d / length, jnp.zeros(3), 1.0, False)
    t = s / length
    return t, (origin + t * direction) * flat, met


def bowl(origin: Array, direction: Array) -> tuple[Array, Array, Array]:
    """A concave mirror: the far side of a sphere of radius 5 that bulges away from the viewer."""
    centre = jnp.array([0.0, 0.0, 4.0])
    t, met = _sphere(origin, direction, centre, 5.0, True)
    p = origin + t * direction
    return t, (centre - p) / 5.0, met & (jnp.abs(p[0]) < 1.5) & (jnp.abs(p[1]) < 1.2)


MIRRORS: dict[str, Mirror] = {"plane": plane, "ball": ball, "cylinder": cylinder, "bowl": bowl}


def camera_at(step: float) -> Camera:
    """Camera number `step` of a path that sways and comes nearer."""
    return look_at((0.25 * step, 1.2 + 0.05 * step, 3.4 - 0.08 * step), (0.0, 0.2, 0.0), size=SIZE, fov_y=45)


def reflected_point(mirror: Mirror, origin: Array, direction: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Surface point, normal, reflected point in the world, distance of it, and whether there is a mirror."""
    t, n, met = mirror(origin, direction)
    p = origin + t * direction
    wi = direction - 2 * (direction @ n) * n
    reach, _ = _sphere(p, wi, jnp.zeros(3), WORLD, True)
    return p, n, p + reach * wi, reach, met


def view(mirror: Mirror, camera: Camera) -> tuple[GBuffer, ReflectionBuffer]:
    """What a camera sees of a mirror, exactly. Colours are smooth functions of the reflected point."""
    rays = camera_rays(camera)
    over = jax.vmap(jax.vmap(lambda o, d: reflected_point(mirror, o, d)))
    p, n, r, reach, met = over(rays.origin, rays.direction)
    shape, zero = met.shape, jnp.zeros(met.shape, jnp.float32)
    t = jnp.sqrt(((p - rays.origin) ** 2).sum(-1))
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), p.shape)
    m = met[..., None]
    p, n, r = jnp.where(m, p, 0), jnp.where(m, n, up), jnp.where(m, r, 0)
    number = jnp.where(met, 0, -1).astype(jnp.int32)
    gbuffer = GBuffer(
        valid=met,
        p=p,
        p_error=zero + 1e-5,
        n=n,
        ns=n,
        wo=-rays.direction,
        t=jnp.where(met, t, 0),
        z_camera=None,
        base_colour=jnp.ones_like(p),
        metallic=jnp.where(met, 1.0, 0.0),
        alpha=zero,
        eta=zero + 1,
        outside=jnp.ones(shape, bool),
        object=number,
        material=number,
        triangle=number,
    )
    colour = jnp.where(m, 0.5 + 0.3 * jnp.sin(r / 3), 0)
    buffer = ReflectionBuffer(
        camera=camera,
        vertices=jnp.zeros((3, 3)),
        valid=met,
        p=p,
        ns=n,
        t=gbuffer.t,
        object=number,
        smooth=jnp.ones(shape, bool),
        reflected=jnp.concatenate([r, jnp.where(met, 1.0, 0.0)[..., None]], -1),
        t_reflected=jnp.where(met, reach, 0),
        radiance=colour,
        triangle=number,
        changing=jnp.zeros(shape, bool),
        connected=met & jnp.roll(met, -1, 0) & jnp.roll(met, -1, 1) & jnp.roll(met, (-1, -1), (0, 1)),
        seen=colour,
        error=zero,
        steepness=zero,
        bend_x=zero,
        bend_y=zero,
    )
    return gbuffer, buffer


def true_places(mirror: Mirror, camera: Camera, points: Array, start: Array) -> tuple[Array, Array]:
    """Where a camera sees points [n 3] in a mirror, by a root finder from `start` [n 2]; and whether it converged."""

    def towards(q: Array) -> tuple[Array, Array]:
        x, y = (q[0] - camera.centre[0]) / camera.focal[0], (camera.centre[1] - q[1]) / camera.focal[1]
        d = camera.world_from_camera[:3, :3] @ jnp.stack([x, y, -jnp.ones_like(x)])
        return camera.world_from_camera[:3, 3], d / jnp.sqrt(d @ d)

    def off(q: Array, point: Array) -> Array:
        p, n, _, _, _ = reflected_point(mirror, *towards(q))
        d = point - p
        _, direction = towards(q)
        wi = direction - 2 * (direction @ n) * n
        a = jnp.cross(wi, jnp.array([0.3, 0.9, 0.31]))
        b = jnp.cross(wi, a)
        return jnp.stack([d @ a, d @ b]) / jnp.sqrt(d @ d)

    @eqx.filter_jit
    def solve(points: Array, start: Array) -> tuple[Array, Array]:
        solver = optx.Newton(rtol=1e-5, atol=1e-5)

        def one(point: Array, q: Array) -> tuple[Array, Array]:
            found = optx.root_find(off, solver, q, point, max_steps=64, throw=False).value
            _, _, _, _, met = reflected_point(mirror, *towards(found))
            return found, met & (jnp.abs(off(found, point)).max() < 1e-4)

        return jax.vmap(one)(points, start)

    return solve(points, start)
