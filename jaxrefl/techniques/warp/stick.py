"""Key frames of warping: Frame + traced image -> Key, and Key + Frame -> the reflections that stick.

Source: [XWD17] §4, the control.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._status import Source
from jaxrefl._types import Camera, Frame, GBuffer, Mesh, Reflection
from jaxrefl.core import dot
from jaxrefl.core.safe import arccos, norm
from jaxrefl.surface import mirror_direction, reflective
from jaxrefl.techniques._reproject import read_reflection, seen_before
from jaxrefl.techniques._tracing import Traced
from jaxrefl.techniques.warp.types import Key, Params


def keep(frame: Frame, image: Traced) -> Key:
    """What later frames need of a traced one.

    Args:
        frame: The frame.
        image: Its reflections, all traced.
    Returns:
        The key frame.
    """
    return _keep(frame.camera, frame.scene.mesh.vertices, frame.gbuffer, image.reflection)


@jax.jit
def _keep(camera: Camera, vertices: Float[Array, "v 3"], gbuffer: GBuffer, reflection: Reflection) -> Key:
    return Key(
        camera=camera,
        vertices=vertices,
        p=gbuffer.p,
        object=gbuffer.object,
        wi=mirror_direction(gbuffer),
        radiance=reflection.radiance,
        reflected=reflection.p,
        source=reflection.source,
        known=reflection.valid,
    )


def warp(key: Key, frame: Frame, params: Params) -> tuple[Reflection, Float[Array, ""]]:
    """The key frame's reflections at this frame's points.

    Args:
        key: The key frame.
        frame: The frame to render.
        params: `tolerance`.
    Returns:
        Reflections where the surface was seen before, and how far their mirror directions have turned on average,
        radians. The confidence is 1 where they have not and 1/2 at 0.02 radians.
    Edge cases: points of triangles that have moved are invalid; what has moved in a reflection goes unnoticed, as in
        the source.
    """
    return _warp(key, frame.scene.mesh, frame.gbuffer, params)


@jax.jit
def _warp(key: Key, mesh: Mesh, gbuffer: GBuffer, params: Params) -> tuple[Reflection, Float[Array, ""]]:
    uv, valid = seen_before(gbuffer, key.camera, key.p, key.object, params.tolerance)
    valid = valid & reflective(gbuffer) & ~_has_moved(key, mesh, gbuffer)
    kept = jnp.concatenate([key.radiance, key.wi, key.reflected], -1)
    kept, valid = read_reflection(uv, valid, kept, key.known)
    radiance, wi, reflected = kept[..., :3], kept[..., 3:6], kept[..., 6:]
    turned = arccos(dot(wi, mirror_direction(gbuffer)))
    pixel = uv.astype(jnp.int32)
    source = key.source[pixel[..., 1], pixel[..., 0]]
    hit = valid & (source == int(Source.TRACED))
    reflection = Reflection(
        radiance=radiance,
        valid=valid,
        source=jnp.where(valid, int(Source.REUSED), int(Source.NONE)).astype(jnp.int32),
        confidence=jnp.where(valid, 1 / (1 + turned / 0.02), 0),
        p=jnp.where(hit[..., None], reflected, 0),
        t=jnp.where(hit, norm(reflected - gbuffer.p), 0),
    )
    return reflection, jnp.where(valid, turned, 0).sum() / jnp.maximum(valid.sum(), 1).astype(jnp.float32)


def _has_moved(key: Key, mesh: Mesh, gbuffer: GBuffer) -> Bool[Array, "h w"]:
    """Pixels whose triangle is not where it was."""
    corners = mesh.faces[jnp.maximum(gbuffer.triangle, 0)]
    return (mesh.vertices[corners] != key.vertices[corners]).any((-1, -2))
