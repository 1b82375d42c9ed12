"""From searched pixels to every pixel: the key frame as a grid mesh, drawn where its reflected points are seen now.

Search -> key-frame coordinate per pixel. The reflection that is nearer along the whole way, eye to mirror to point, is
in front, as in a mirror.

Source: [XWD17] §3.2.2 and §3.3.
Differs from the source: shifting and warping are one drawing, since the search ends in the new image. What is drawn is
only where the exact search of each pixel starts, so a coarser grid (`stride`) and closed gaps (`spread`) do no harm.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Frame
from jaxrefl.surface import reflective
from jaxrefl.techniques._reproject import GridMesh, draw
from jaxrefl.techniques.temporal.types import Options, ReflectionBuffer, Search

_INFINITE = 1.0e30


def starts(
    buffer: ReflectionBuffer, search: Search, frame: Frame, *, options: Options
) -> tuple[Float[Array, "h w 2"], Bool[Array, "h w"], Int[Array, ""]]:
    """Where in the key frame each pixel's reflection probably is.

    Args:
        buffer: The key frame.
        search: Where its pixels are seen now.
        frame: The frame to render.
        options: `stride`, `spread`.
    Returns:
        Coordinates, where there is one, and how many triangles were dropped as too wide.
    Source: [XWD17] §3.2.2: depth `s_d + s_r`, no triangles across discontinuities or above 16-fold area.
    """
    mesh = _mesh(buffer, search, options.stride)
    drawn = draw(mesh, frame.gbuffer.object, stride=options.stride)
    uv, valid = drawn.uv, drawn.valid & reflective(frame.gbuffer)
    for _ in range(options.spread):
        uv, valid = _spread(uv, valid, frame.gbuffer.object)
    return uv, valid, drawn.too_wide


@functools.partial(jax.jit, static_argnums=2)
def _mesh(buffer: ReflectionBuffer, search: Search, stride: int) -> GridMesh:
    def grid(x: Array) -> Array:
        return x[::stride, ::stride]

    owner, far = grid(buffer.object), grid(buffer.reflected[..., 3]) == 0
    depth = jnp.where(far, _INFINITE, grid(buffer.t) + grid(buffer.t_reflected))

    def alike(x: Array) -> Bool[Array, "gh gw"]:
        corners = (jnp.roll(x, -1, 0), jnp.roll(x, -1, 1), jnp.roll(x, (-1, -1), (0, 1)))
        return (x == corners[0]) & (x == corners[1]) & (x == corners[2])

    found = search.found & grid(buffer.smooth)
    return GridMesh(search.place, depth, alike(owner) & alike(far) & found & alike(found), owner)


@jax.jit
def _spread(
    uv: Float[Array, "h w 2"], valid: Bool[Array, "h w"], object: Int[Array, "h w"]
) -> tuple[Float[Array, "h w 2"], Bool[Array, "h w"]]:
    """Give pixels without a start the one of a neighbour on the same mirror, moved along by the pixel between them."""
    h, w = valid.shape
    result, known = uv, valid
    rows, columns = jnp.arange(h)[:, None], jnp.arange(w)[None, :]
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        inside = (rows + dy >= 0) & (rows + dy < h) & (columns + dx >= 0) & (columns + dx < w)

        def beside(x: Array, dy: int = dy, dx: int = dx) -> Array:
            return jnp.roll(x, (-dy, -dx), (0, 1))

        usable = inside & beside(valid) & (beside(object) == object) & ~known
        moved = beside(uv) - jnp.array([dx, dy], jnp.float32)[None, None, :]
        result = jnp.where(usable[..., None], moved, result)
        known = known | usable
    return result, known
