"""Pixel matching as published: neighbourhood search in the key frame for the mirror that shows a point to a new eye.

Key frame + new eye -> offset per key-frame pixel, and why a search failed. Each pixel of the key frame is a small
mirror with a tangent plane; a candidate is the better the nearer the line from the mirror image M through its surface
point W comes to the new eye E:

    d(n) = |(E - W_n) x m| / |m|,   m = W_n - M = mirrored offset of R.

Source: [XWD17] §3.2.1, Algorithm 2.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera
from jaxrefl.core import together
from jaxrefl.core.safe import divide
from jaxrefl.rays import block_size, blocks_of, put_block
from jaxrefl.techniques._reproject import components
from jaxrefl.techniques.temporal.flat import Surfaces, Triple, along, dot3, mirrored, pose, surfaces, take
from jaxrefl.techniques.temporal.types import Options, Params, Reason, ReflectionBuffer, Search

_RING = ((-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1))
"""The hollow square of neighbours, row by row; of equal ones the first wins."""


def match_pixels(
    buffer: ReflectionBuffer, before: Search | None, camera: Camera, params: Params, *, options: Options
) -> tuple[Search, Int[Array, "h w"]]:
    """The best matching key-frame pixel of each key-frame pixel.

    Args:
        buffer: The key frame.
        before: The last offsets; None, or `start = "surface"`: start at the pixel itself.
        camera: The new camera; only its position matters.
        params: `discontinuity`.
        options: `search_steps`, `block`.
    Returns:
        Offsets (x, y) in whole pixels, and a `Reason` per pixel: REUSED where a match was found.
    Edge cases: candidates of another object, or outside the buffer, cannot win; a search that ends on the image's
        border counts as having left it.
    Source: [XWD17] Algorithm 2.
    """
    shape = (*buffer.t.shape, 2)
    start = jnp.zeros(shape, jnp.float32) if before is None or options.start == "surface" else before.place
    outline = silhouette(buffer, params)
    mirrors = surfaces(buffer.p, buffer.ns, jnp.where(buffer.valid, buffer.object, -1))
    result = (
        Search(jnp.zeros(shape, jnp.float32), jnp.zeros_like(buffer.valid)),
        jnp.zeros(buffer.valid.shape, jnp.int32),
    )
    image, wanted = jax.jit(components)(buffer.reflected), buffer.valid & buffer.smooth
    for index in blocks_of(wanted, size=block_size(wanted.size, options.block)):
        block = _match_block(image, mirrors, outline, start, camera, index, options.search_steps)
        result = put_block(index, result, block)
    return result


@jax.jit
def silhouette(buffer: ReflectionBuffer, params: Params) -> Bool[Array, "h w"]:
    r"""Pixels on the outline of their reflector.

    $$ |1/t_{-1} - 2/t_0 + 1/t_{+1}| > \varepsilon / t_0 $$

    Args:
        buffer: The key frame.
        params: `discontinuity`, the paper's depth discontinuity, made relative.
    Returns:
        True beside another object, beside the image's border, and at discontinuities of depth.
    Source: [XWD17] §3.2.1.
    """
    near = jnp.where(buffer.t > 0, 1 / jnp.where(buffer.t > 0, buffer.t, 1), 0)
    owner = jnp.where(buffer.valid, buffer.object, -1)
    h, w = owner.shape
    rows, columns = jnp.arange(h)[:, None], jnp.arange(w)[None, :]
    border = (rows == 0) | (rows == h - 1) | (columns == 0) | (columns == w - 1)
    found = border
    for axis in (0, 1):
        before, after = jnp.roll(near, 1, axis), jnp.roll(near, -1, axis)
        found = found | (jnp.roll(owner, 1, axis) != owner) | (jnp.roll(owner, -1, axis) != owner)
        found = found | (jnp.abs(before - 2 * near + after) > params.discontinuity * near)
    return found


@functools.partial(jax.jit, static_argnums=6)
def _match_block(
    image: tuple[Array, ...],
    mirrors: Surfaces,
    outline: Bool[Array, "h w"],
    start: Float[Array, "h w 2"],
    camera: Camera,
    index: Int[Array, "n"],
    steps: int,
) -> tuple[Search, Int[Array, "n"]]:
    safe = jnp.maximum(index, 0)
    width, height = mirrors.width, mirrors.height
    point, w = take((image[0], image[1], image[2]), safe), image[3][safe]
    owner, eye = mirrors.object[safe], pose(camera).eye
    own_x, own_y = safe % width, safe // width
    offset = start.reshape(-1, 2)[safe].astype(jnp.int32)

    def distance_at(x: Array, y: Array) -> Array:
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        at = jnp.clip(y, 0, height - 1) * width + jnp.clip(x, 0, width - 1)
        allowed = inside & (mirrors.object[at] == owner)
        return jnp.where(allowed, distance(eye, point, w, take(mirrors.p, at), take(mirrors.n, at)), jnp.inf)

    def ring(x: Array, y: Array) -> Array:
        """The smallest distance around a place, and the number of the neighbour that has it, as one result."""
        best, chosen = jnp.full(owner.shape, jnp.inf), jnp.zeros(owner.shape)
        for number, (dx, dy) in enumerate(_RING):
            d = distance_at(x + dx, y + dy)
            best, chosen = jnp.where(d < best, d, best), jnp.where(d < best, float(number), chosen)
        return together(best, chosen)

    def move(carry: tuple[Array, ...]) -> tuple[Array, ...]:
        step, x, y, former, running = carry
        found = ring(x, y)
        best, chosen = jnp.real(found), jnp.imag(found).astype(jnp.int32)
        goes = running & (best <= former)
        dx, dy = (jnp.array(d)[chosen] for d in zip(*_RING, strict=True))
        return (step + 1, jnp.where(goes, x + dx, x), jnp.where(goes, y + dy, y), jnp.where(goes, best, former), goes)

    def unfinished(carry: tuple[Array, ...]) -> Array:
        return (carry[0] < steps) & carry[4].any()

    x, y = own_x + offset[:, 0], own_y + offset[:, 1]
    first = (jnp.zeros((), jnp.int32), x, y, distance_at(x, y), index >= 0)
    _, x, y, _, running = jax.lax.while_loop(unfinished, move, first)
    at = jnp.clip(y, 0, height - 1) * width + jnp.clip(x, 0, width - 1)
    border = (x <= 0) | (x >= width - 1) | (y <= 0) | (y >= height - 1)
    reason = jnp.where(outline.reshape(-1)[at], int(Reason.SILHOUETTE), int(Reason.REUSED))
    reason = jnp.where(border, int(Reason.OUTSIDE), jnp.where(running, int(Reason.STEPS), reason)).astype(jnp.int32)
    found = reason == int(Reason.REUSED)
    moved = jnp.stack([x - own_x, y - own_y], -1).astype(jnp.float32)
    return Search(jnp.where(found[:, None], moved, 0), found), reason


def distance(eye: Triple, point: Triple, w: Float[Array, "n"], p: Triple, n: Triple) -> Float[Array, "n"]:
    """How near the reflected ray of a small mirror comes to an eye.

    Args:
        eye: Position of the eye.
        point: Reflected positions, or directions.
        w: 1 for positions, 0 for directions.
        p: Surface points.
        n: Their unit normals.
    Returns:
        Distance from the eye to the line through mirror image and surface point, world units.
    Edge cases: a reflected point on the surface itself is its own mirror image: distance to the surface point.
        Gradients with respect to the eye are finite everywhere, and 0 where the distance is.
    Source: [XWD17] §3.2.1, Fig. 4.
    """
    m, to_eye = mirrored(point, w, p, n), along(eye, -1.0, p)
    share = divide(dot3(to_eye, m), dot3(m, m))
    off = along(to_eye, -share, m)
    squared = dot3(off, off)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1)), 0)
