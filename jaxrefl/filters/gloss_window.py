"""Eq. 4 as it stands: every pixel of a window, one Gaussian. Atlas -> filtered planes.

Source: [RLPWSD20] §6.2, Eq. 4.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl.filters.gloss_atlas import TILE
from jaxrefl.filters.gloss_layers import Layer, Limits, Values, agree, normalised

SHARP = 1e-3
"""Variance in pixels squared that is added to all: below it a Gaussian is one pixel."""
ENOUGH = 1.6
"""Standard deviations that a window reaches at least; at twice as many a finer layer takes its place. Reaching further
costs more than it brings: coarser layers blur the shorter axis of long footprints."""
_NEVER = -1e4
_RATIO = 8.0
"""Most that the spread of a neighbour may differ from the pixel's own."""


def precision(
    covariance: Float[Array, "3 *b"],
) -> tuple[Float[Array, "*b"], Float[Array, "*b"], Float[Array, "*b"]]:
    """Half the inverse of covariances, for the exponent of a Gaussian.

    Args:
        covariance: (xx, xy, yy).
    Returns:
        (a, b, c) with exponent -(a x^2 + 2 b x y + c y^2).
    Edge cases: singular ones count as `SHARP` wide in the direction that is missing; finite at any condition number.
    """
    xx, xy, yy = covariance[0] + SHARP, covariance[1], covariance[2] + SHARP
    # The determinant of c + SHARP is at least SHARP (trace + SHARP), c being positive semidefinite; rounding aside.
    determinant = jnp.maximum(xx * yy - xy * xy, SHARP * (xx + yy - SHARP))
    half = 0.5 / determinant
    return yy * half, -xy * half, xx * half


def window(
    atlas: Layer,
    covariance: Float[Array, "3 ah aw"],
    active: Bool[Array, "ty tx"],
    limits: Limits,
    *,
    radius: int,
    layers: int,
    spread: bool,
) -> Values:
    """Weighted means over windows.

    Args:
        atlas: What to filter, in whole tiles with a margin of `radius`.
        covariance: Of the Gaussians; without the margin.
        active: Which tiles to filter; the others come back 0.
        limits: Thresholds.
        radius: Half the width of the window, pixels.
        layers: How many there are in the atlas; a remainder of the ids says which of them a pixel belongs to.
        spread: Let each neighbour weigh as its own distance says: near things stay sharp before far ones.
    Returns:
        Means of the colour, and the sum of the weights, 0 where nothing was found.
    """
    rows, columns = TILE
    wide = columns + 2 * radius
    size, span = rows * wide, 2 * radius + 1
    mean = atlas.mean[:, radius : -radius or None, radius : -radius or None]
    own_only = jnp.concatenate([jnp.stack(precision(covariance)), mean])

    def tile(y: Array, x: Array) -> Float[Array, "p r c"]:
        def local(plane: Array, fill: float = 0) -> Array:
            flat = jax.lax.dynamic_slice(plane, (y, x), (rows + 2 * radius, wide)).reshape(-1)
            return jnp.pad(flat, (0, 2 * radius), constant_values=fill)

        def inner(plane: Array) -> Array:
            part = jax.lax.dynamic_slice(plane, (y, x), (rows, columns))
            return jnp.pad(part, ((0, 0), (0, 2 * radius))).reshape(-1)

        # Flat arrays, one per plane: the loop over taps runs four times as fast as on images.
        ids, around = local(atlas.id, -1), tuple(local(p) for p in atlas.data[:11])
        whole = jax.lax.dynamic_slice(atlas.id, (y + radius, x + radius), TILE).max() % layers
        ids = jnp.where(ids % layers == whole, ids, -1)  # beside a layer lies another: nothing for this one
        trust = jnp.where(ids >= 0, around[10], 0)
        values = jnp.stack([*(p * trust for p in around[6:9]), trust])  # in one stack: the weight serves all
        a, b, c, mx, my = (inner(p) for p in own_only)

        def shifted(tap: Array) -> tuple[Layer, Array]:
            start = (tap // span) * wide + tap % span
            cut = lambda p: jax.lax.dynamic_slice_in_dim(p, start, size, axis=p.ndim - 1)  # noqa: E731
            return Layer(cut(ids), tuple(cut(p) for p in around)), cut(values)

        own, _ = shifted(jnp.asarray(radius * span + radius, jnp.int32))
        narrower = spread_ratio(own)

        def add(sums: Array, tap: Array, *, one_plane: bool) -> tuple[Array, None]:
            there, seen = shifted(tap)
            dx, dy = (tap % span - radius).astype(jnp.float32), (tap // span - radius).astype(jnp.float32)
            ux, uy = dx - mx, dy - my
            ratio = jnp.ones_like(a)
            if spread:
                ratio = narrower(there.image)
                ux, uy = dx * ratio - mx, dy * ratio - my
            # Far off the middle of long, narrow Gaussians these terms cancel, and rounding may leave less than 0.
            exponent = -jnp.maximum(a * ux * ux + 2 * b * ux * uy + c * uy * uy, 0)
            if not one_plane:
                exponent = jnp.where(agree(own, there, dx, dy, limits), exponent, _NEVER)
            return sums + (jnp.exp(exponent) * (ratio * ratio))[None] * seen, None

        def loop(one_plane: bool) -> Array:
            taps = jnp.arange(span * span, dtype=jnp.int32)
            step = jax.checkpoint(functools.partial(add, one_plane=one_plane))
            return jax.lax.scan(step, jnp.zeros((4, size), jnp.float32), taps)[0]

        alike = all_agree(Layer(ids, around), wide, radius, limits)
        sums = jax.lax.cond(alike, lambda: loop(True), lambda: loop(False))
        return jnp.where(own.id >= 0, normalised(list(sums[:3]), sums[3]), 0).reshape(4, rows, wide)[:, :, :columns]

    return over_tiles(tile, active)


def all_agree(tile: Layer, wide: int, radius: int, limits: Limits) -> Bool[Array, ""]:
    """Whether any two surfaces of a tile agree that a window can bring together: then no pair need be asked.

    Args:
        tile: Flat planes, row by row.
        wide: Pixels per row.
        radius: Of the window.
        limits: Thresholds.
    Returns:
        True: all of them do; False: some may not. Pixels without a surface do not count.
    """
    some = tile.id >= 0
    index = jnp.arange(tile.id.shape[0], dtype=jnp.int32)
    x, y = (i.astype(jnp.float32) for i in (index % wide, index // wide))

    def least(v: Array) -> Array:
        return jnp.where(some, v, jnp.inf).min()

    def mean(v: Array) -> Array:
        return jnp.where(some, v, 0).sum() / jnp.maximum(some.astype(v.dtype).sum(), 1)

    def width(v: Array) -> Array:
        return -least(-v) - least(v)

    # Normals within half the angle of their mean are within the whole of each other.
    middle = [mean(n) for n in tile.normal]
    cosine = tile.normal[0] * middle[0] + tile.normal[1] * middle[1] + tile.normal[2] * middle[2]
    length = jnp.sqrt(jnp.maximum(sum(m * m for m in middle), 1e-12))
    turned = least(cosine) > jnp.sqrt(jnp.maximum((1 + limits.normal) / 2, 0)) * length + 1e-4
    # The distance of one from the other's plane: what both are off a common plane, and their slopes over a window.
    off = tile.inverse - mean(tile.slope[0]) * x - mean(tile.slope[1]) * y
    tilt = width(tile.slope[0]) + width(tile.slope[1])
    near = width(off) + radius * tilt < (limits.depth - 1e-4) * least(tile.inverse)
    one = jnp.where(some, tile.id, tile.id.max()).min() == tile.id.max()
    return one & turned & near


def spread_ratio(own: Layer) -> Callable[[Float[Array, "*b"]], Float[Array, "*b"]]:
    r"""How much narrower the Gaussian of what a neighbour shows is than the pixel's own.

    $$ \frac{\tau}{\tau_i},\qquad \tau_i = 1 - \frac{z}{Z_i} $$

    with the depths z of the pixel's reflector and $Z_i$ of the neighbour's mirror image: the lobe's rays start at the
    pixel's own point, also where the reflector is slanted and the neighbour's point is nearer or farther.

    Args:
        own: The pixels.
    Returns:
        Inverse depth of what their neighbours show -> the ratio, within `_RATIO`.
    """
    least, depth = 1e-4, 1 / jnp.where(own.inverse > 0, own.inverse, 1)

    def tau(image: Float[Array, "*b"]) -> Float[Array, "*b"]:
        return jnp.maximum(1 - depth * image, 0) + least

    mine = tau(own.image)
    return lambda image: jnp.clip(mine / tau(image), 1 / _RATIO, _RATIO)


def over_tiles(tile: Callable[[Array, Array], Float[Array, "4 r c"]], active: Bool[Array, "ty tx"]) -> Values:
    """Run a function on the tiles that need it.

    Args:
        tile: First row and column of a tile -> its result.
        active: Which tiles.
    Returns:
        The whole atlas, 0 where nothing was done.
    """
    down, across = active.shape
    rows, columns = TILE
    y, x = jnp.meshgrid(
        rows * jnp.arange(down, dtype=jnp.int32), columns * jnp.arange(across, dtype=jnp.int32), indexing="ij"
    )

    def one(at: tuple[Array, Array, Array]) -> Array:
        nothing = jnp.zeros((4, rows, columns), jnp.float32)
        return jax.lax.cond(at[2], lambda: tile(at[0], at[1]), lambda: nothing)

    tiles = jax.lax.map(one, (y.reshape(-1), x.reshape(-1), active.reshape(-1)))
    whole = tiles.reshape(down, across, 4, rows, columns).transpose(2, 0, 3, 1, 4)
    return whole.reshape(4, down * rows, across * columns)
