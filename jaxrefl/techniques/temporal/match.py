"""Forward search: where each pixel of the key frame has its reflected point seen now.

Key frame + G-buffer of now -> image positions. Each G-buffer pixel is a small mirror; through it the reflected point is
seen at some image position. Where that position is the pixel itself, the point is really seen there:

    F(q) = project(M(R; W(q), n(q))) - q = 0.

For a plane F is linear, so one step is the closed form; for curved mirrors a few Newton steps follow. Searches that
have not ended after `steps` are compacted and go on for `late_steps`.

Source: [XWD17] §3.2.1, the distance function of Fig. 4.
Differs from the source: it searches the new image, whose G-buffer is exact, instead of the old one; the distance is in
pixels and has a direction, so Newton's method ends in 2 or 3 steps with a sub-pixel result where the published search
moves by one pixel a step. `as_published` is in `neighbourhood.py`.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera
from jaxrefl.core import together
from jaxrefl.rays import block_size, blocks_of, put_block
from jaxrefl.techniques._reproject import components
from jaxrefl.techniques.temporal.flat import Mirrors, Pose, Surfaces, Triple, mirrored, pose, seen_at, take
from jaxrefl.techniques.temporal.types import Options, ReflectionBuffer, Search

_LONGEST = 64.0
"""Longest step in pixels."""
_NEAR = 1.0
"""A search has ended when the position found lies this close to the pixel at which it was computed."""
_ENDED = 1.0e9
"""Position of a search that has left its mirror."""


def search(
    buffer: ReflectionBuffer,
    before: Search | None,
    mirrors: Mirrors,
    camera: Camera,
    within: Bool[Array, "h w"] | None = None,
    *,
    options: Options,
) -> Search:
    """Where the reflected points of a key frame are seen now.

    Args:
        buffer: The key frame.
        before: The last search in it; None: there was none.
        mirrors: The pixels of the frame to render.
        camera: Its camera.
        within: Key-frame pixels to search; None: all.
        options: `start`, `stride`, `steps`, `late_steps`, `block`.
    Returns:
        Positions of every `stride`-th pixel.
    """
    grid = _grid(buffer, camera, options.stride)
    place = grid.place if before is None or options.start == "surface" else before.place
    wanted = grid.found if within is None else grid.found & within[:: options.stride, :: options.stride]
    result = Search(jnp.copy(place), jnp.zeros_like(grid.found))
    image, owner = _flat(buffer, options.stride)
    for steps in (options.steps, options.late_steps)[: 2 if options.late_steps > 0 else 1]:
        start = jnp.copy(result.place)  # what blocks are written to is consumed
        for index in blocks_of(wanted, size=block_size(wanted.size, options.block)):
            result = put_block(index, result, _search_block(image, owner, mirrors.flat, camera, start, index, steps))
        wanted = wanted & ~result.found
    return result


@functools.partial(jax.jit, static_argnums=2)
def _grid(buffer: ReflectionBuffer, camera: Camera, stride: int) -> Search:
    """Places of the surfaces themselves, and which pixels to search."""
    p = components(buffer.p[::stride, ::stride])
    x, y, depth = seen_at(pose(camera), (p[0], p[1], p[2]), jnp.ones_like(p[0]))
    shape = buffer.t[::stride, ::stride].shape
    wanted = (buffer.valid & buffer.smooth)[::stride, ::stride] & (depth > 0).reshape(shape)
    return Search(jnp.stack([x, y], -1).reshape(*shape, 2), wanted)


@functools.partial(jax.jit, static_argnums=1)
def _flat(buffer: ReflectionBuffer, stride: int) -> tuple[tuple[Array, ...], Int[Array, "g"]]:
    """Reflected points and their reflectors on the grid, flattened once for all blocks."""
    return components(buffer.reflected[::stride, ::stride]), buffer.object[::stride, ::stride].reshape(-1)


@functools.partial(jax.jit, static_argnums=6)
def _search_block(
    image: tuple[Array, ...],
    owner: Int[Array, "g"],
    now: Surfaces,
    camera: Camera,
    place: Float[Array, "gh gw 2"],
    index: Int[Array, "n"],
    steps: int,
) -> Search:
    safe = jnp.maximum(index, 0)
    point, w = take((image[0], image[1], image[2]), safe), image[3][safe]
    start = place.reshape(-1, 2)[safe]
    x, y, found = newton(now, pose(camera), point, w, owner[safe], start, steps=steps)
    kept = jnp.where(found[:, None], jnp.stack([x, y], -1), start)
    return Search(kept, found)


def newton(
    now: Surfaces,
    camera: Pose,
    point: Triple,
    w: Float[Array, "n"],
    owner: Int[Array, "n"],
    start: Float[Array, "n 2"],
    *,
    steps: int,
) -> tuple[Float[Array, "n"], Float[Array, "n"], Bool[Array, "n"]]:
    """Image positions at which reflected points are seen.

    Args:
        now: Mirrors of the image.
        camera: Its camera.
        point: Reflected positions, or directions.
        w: 1 for positions, 0 for directions.
        owner: Object of the mirror in which to look.
        start: Positions to start from, pixels.
        steps: Newton steps.
    Returns:
        x, y in pixels, and whether the search ended within `_NEAR` pixels of where it was computed, on its mirror.
    Edge cases: a position off the mirror, or a point behind it, ends a search without a result; positions outside the
        image are taken for the border.
    """

    def image_of(index: Array) -> tuple[Array, Array, Array]:
        p, n = take(now.p, index), take(now.n, index)
        offset = mirrored(point, w, p, n)
        virtual = tuple(a + w * b for a, b in zip(offset, p, strict=True))
        return seen_at(camera, virtual, w)  # pyright: ignore[reportArgumentType]

    def centre(x: Array, y: Array) -> tuple[Array, Array]:
        """Column and row of the pixel in which a position lies, or which is nearest."""
        column = jnp.clip(jnp.floor(x), 0, now.width - 1).astype(jnp.int32)
        return column, jnp.clip(jnp.floor(y), 0, now.height - 1).astype(jnp.int32)

    def move(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        x, y = jnp.real(carry[0]), jnp.imag(carry[0])
        column, row = centre(x, y)
        here = row * now.width + column
        right, below = here + 1, here + now.width
        right_is = (column < now.width - 1) & (now.object[jnp.minimum(right, now.object.shape[0] - 1)] == owner)
        below_is = (row < now.height - 1) & (now.object[jnp.minimum(below, now.object.shape[0] - 1)] == owner)
        beside = jnp.where(right_is, right, jnp.where(column > 0, here - 1, here))
        under = jnp.where(below_is, below, jnp.where(row > 0, here - now.width, here))
        sx, sy = jnp.where(right_is, 1.0, -1.0), jnp.where(below_is, 1.0, -1.0)
        cx, cy = column.astype(jnp.float32) + 0.5, row.astype(jnp.float32) + 0.5
        x0, y0, depth = image_of(here)
        x1, y1, _ = image_of(beside)
        x2, y2, _ = image_of(under)
        # F at the three pixel centres; their own motion enters the differences as -1.
        a, b = (x1 - x0) * sx - 1, (x2 - x0) * sy
        c, d = (y1 - y0) * sx, (y2 - y0) * sy - 1
        fx, fy = x0 - cx, y0 - cy
        det = a * d - b * c
        usable = jnp.abs(det) > 1e-6
        inverse = jnp.where(usable, 1 / jnp.where(usable, det, 1), 0)
        dx, dy = -(d * fx - b * fy) * inverse, -(a * fy - c * fx) * inverse
        length = jnp.sqrt(dx * dx + dy * dy)
        shorten = jnp.minimum(1, _LONGEST / jnp.maximum(length, 1e-6))
        goes_on = (x < _ENDED) & (now.object[here] == owner) & (depth > 0) & usable
        there = together(jnp.where(goes_on, cx + dx * shorten, _ENDED), jnp.where(goes_on, cy + dy * shorten, _ENDED))
        return there, carry[0]

    # A loop, although its length is known: in unrolled steps XLA computes each step again for all that follow from it.
    first = together(start[:, 0], start[:, 1])
    last, before = jax.lax.fori_loop(0, steps, move, (first, first))
    x, y = jnp.real(last), jnp.imag(last)
    column, row = centre(jnp.real(before), jnp.imag(before))
    off = jnp.maximum(jnp.abs(x - column.astype(jnp.float32) - 0.5), jnp.abs(y - row.astype(jnp.float32) - 0.5))
    return x, y, (x < _ENDED) & (off <= _NEAR)
