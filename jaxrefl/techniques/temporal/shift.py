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
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Frame
from jaxrefl.rays import block_size, blocks_of, put_block
from jaxrefl.techniques._reproject import GridMesh, draw
from jaxrefl.techniques.temporal.types import Options, ReflectionBuffer, Search

_INFINITE = 1.0e30


def starts(
    buffer: ReflectionBuffer, search: Search, frame: Frame, asked: Bool[Array, "h w"], *, options: Options
) -> tuple[Float[Array, "h w 2"], Bool[Array, "h w"], Int[Array, ""]]:
    """Where in the key frame each pixel's reflection probably is.

    Args:
        buffer: The key frame.
        search: Where its pixels are seen now.
        frame: The frame to render.
        asked: Pixels that need one.
        options: `stride`, `spread`, `block`.
    Returns:
        Coordinates, which pixels have one, and how many triangles were dropped as too wide.
    Source: [XWD17] §3.2.2: depth `s_d + s_r`, no triangles across discontinuities or above 16-fold area.
    """
    drawn = draw(_mesh(buffer, search, options.stride), frame.gbuffer.object, stride=options.stride)
    covered, missing = drawn.valid & asked, asked & ~drawn.valid
    start = (drawn.uv, covered)
    known = jax.tree.map(jnp.copy, start)  # what blocks are written to is consumed
    for index in blocks_of(missing, size=block_size(missing.size, options.block)) if options.spread else ():
        start = put_block(index, start, _spread_block(known, frame.gbuffer.object, index, options.spread))
    return *start, drawn.too_wide


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


@functools.partial(jax.jit, static_argnums=3)
def _spread_block(
    known: tuple[Float[Array, "h w 2"], Bool[Array, "h w"]],
    object: Int[Array, "h w"],
    index: Int[Array, "n"],
    most: int,
) -> tuple[Float[Array, "n 2"], Bool[Array, "n"]]:
    """Starts for pixels without one: that of the nearest pixel on the same mirror, moved along by what lies between."""
    uv, valid = known
    h, w = valid.shape
    safe = jnp.maximum(index, 0)
    row, column = safe // w, safe % w
    usable, owner = jnp.where(valid, object, -1).reshape(-1), object.reshape(-1)[safe]
    square = [(dy, dx) for dy in range(-most, most + 1) for dx in range(-most, most + 1) if (dy, dx) != (0, 0)]
    offsets = np.array(sorted(square, key=lambda d: d[0] ** 2 + d[1] ** 2)[::-1], np.int32)

    def look(i: Array, chosen: Array) -> Array:
        dy, dx = jnp.asarray(offsets)[i]
        y, x = row + dy, column + dx
        inside = (y >= 0) & (y < h) & (x >= 0) & (x < w)
        at = jnp.where(inside, y * w + x, 0)
        return jnp.where(inside & (usable[at] == owner), at, chosen)

    # From far to near, so that the last one that fits is the nearest.
    at = jax.lax.fori_loop(0, len(offsets), look, jnp.full(safe.shape, -1, jnp.int32))
    found, at = at >= 0, jnp.maximum(at, 0)
    moved = uv.reshape(-1, 2)[at] + jnp.stack([column - at % w, row - at // w], -1).astype(jnp.float32)
    return jnp.where(found[:, None], moved, 0), found
