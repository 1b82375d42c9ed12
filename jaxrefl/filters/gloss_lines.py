"""Eq. 4 as one-dimensional passes along the principal axes of each pixel's covariance.

Two passes are exact where the footprint is the same everywhere and nothing is cut off. Four, with half the covariance
each, forgive edges that do not lie along the axes: what the first two could not reach around a corner the others can.

Source: [RLPWSD20] §6.3; [GO11] for splitting passes.
Differs from the source: a bounded number of taps, further apart where the Gaussian is wide; off-centre Gaussians.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl.filters.covariance import principal_axes
from jaxrefl.filters.gloss_atlas import TILE
from jaxrefl.filters.gloss_layers import Layer, Limits, Values, agree, normalised
from jaxrefl.filters.gloss_window import SHARP, over_tiles, spread_ratio

TAPS = ("nearest", "linear")
REACH = 2.5
"""Standard deviations that the taps of a line reach, at least."""


def lines(
    atlas: Layer,
    covariance: Float[Array, "3 ah aw"],
    active: Bool[Array, "ty tx"],
    limits: Limits,
    *,
    radius: int,
    taps: str,
    spread: bool,
    pairs: int,
) -> Values:
    """Means over lines along the larger, then the smaller axis of each pixel's Gaussian, `pairs` times.

    Args:
        atlas: What to filter, in whole tiles.
        covariance: Of the Gaussians.
        active: Which tiles to filter: what is wanted and its neighbours, as passes read each other's results.
        limits: Thresholds.
        radius: Taps to either side.
        taps: "nearest" pixel of the line, or "linear" between two.
        spread: As for `window`.
        pairs: 1: two passes; 2: four.
    Returns:
        Means of the colour, and the sum of the weights, 0 where nothing was found.
    """
    axes = principal_axes(jnp.moveaxis(covariance, 0, -1))
    along = atlas.mean[0] * axes.cos + atlas.mean[1] * axes.sin
    beside = atlas.mean[1] * axes.cos - atlas.mean[0] * axes.sin
    share = pairs**-0.5
    major = (axes.cos, axes.sin, axes.major * share, along / pairs)
    minor = (-axes.sin, axes.cos, axes.minor * share, beside / pairs)
    both = tuple(jnp.stack(pair) for pair in zip(major, minor, strict=True))

    def one_pass(state: Values, number: Array) -> tuple[Values, None]:
        line = tuple(x[number % 2] for x in both)
        return _pass(atlas, state, line, active, limits, radius=radius, taps=taps, spread=spread), None

    start = jnp.concatenate([atlas.colour, atlas.trust[None]])
    state, _ = jax.lax.scan(one_pass, start, jnp.arange(2 * pairs, dtype=jnp.int32))
    return state


def _pass(
    atlas: Layer,
    state: Values,
    line: tuple[Float[Array, "ah aw"], ...],
    active: Bool[Array, "ty tx"],
    limits: Limits,
    *,
    radius: int,
    taps: str,
    spread: bool,
) -> Values:
    rows, columns = TILE
    height, width = atlas.id.shape
    # One flat array per plane; the values are those of the pass before.
    planes = (*atlas.data[:6], *state[:3], atlas.image, state[3])
    flat = Layer(atlas.id.reshape(-1), tuple(p.reshape(-1) for p in planes))

    def tile(top: Array, left: Array) -> Float[Array, "p r c"]:
        def inner(plane: Array) -> Array:
            return jax.lax.dynamic_slice(plane, (top, left), TILE).reshape(-1)

        own = Layer(inner(atlas.id), tuple(inner(p) for p in planes))
        cos, sin, sigma, shift = (inner(x) for x in line)
        index = jnp.arange(rows * columns, dtype=jnp.int32)
        x, y = left + index % columns, top + index // columns
        steep = jnp.abs(sin) > jnp.abs(cos)
        unit = 1 / jnp.maximum(jnp.abs(cos), jnp.abs(sin))
        # Whole steps along the steeper coordinate, as many pixels as it takes to reach far enough.
        stride = jnp.ceil((REACH * sigma + jnp.abs(shift)) / (radius * unit) - 1e-3)
        stride = jax.lax.stop_gradient(jnp.maximum(stride, 1))
        half = 0.5 / (sigma * sigma + SHARP)

        narrower = spread_ratio(own)

        def add(sums: list[Array], tap: Array) -> tuple[list[Array], None]:
            step = tap.astype(jnp.float32) * stride
            fx, fy = step * cos * unit, step * sin * unit
            if taps == "nearest":
                ends = [(jnp.round(fx), jnp.round(fy), jnp.ones_like(fx))]
            else:
                lx, ly = jnp.where(steep, jnp.floor(fx), jnp.round(fx)), jnp.where(steep, jnp.round(fy), jnp.floor(fy))
                part = jnp.where(steep, fx - lx, fy - ly)
                ux, uy = jnp.where(steep, 1.0, 0.0), jnp.where(steep, 0.0, 1.0)
                ends = [(lx, ly, 1 - part), (lx + ux, ly + uy, part)]
            for dx, dy, amount in ends:
                there, inside = _read(flat, x + dx.astype(jnp.int32), y + dy.astype(jnp.int32), height, width)
                distance = dx * cos + dy * sin if taps == "nearest" else step * unit
                ratio = narrower(there.image) if spread else jnp.ones_like(cos)
                good = inside & agree(own, there, dx, dy, limits)
                exponent = -half * (distance * ratio - shift) ** 2
                weight = jnp.exp(jnp.where(good, exponent, -1e4)) * amount * ratio
                trusted = weight * there.trust
                sums = [sums[0] + weight, sums[1] + trusted] + [
                    s + trusted * v for s, v in zip(sums[2:], there.colour, strict=True)
                ]
            return sums, None

        zero = [jnp.zeros(rows * columns, jnp.float32) for _ in range(5)]
        steps = jnp.arange(-radius, radius + 1, dtype=jnp.int32)
        sums, _ = jax.lax.scan(jax.checkpoint(add), zero, steps)
        total, trusted, *colour = sums
        means = normalised(colour, trusted)
        trust = jnp.where(total > 0, trusted / jnp.where(total > 0, total, 1), 0)
        return jnp.concatenate([means[:3], trust[None]]).reshape(4, rows, columns)

    return over_tiles(tile, active)


def _read(flat: Layer, x: Array, y: Array, height: int, width: int) -> tuple[Layer, Bool[Array, "n"]]:
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    at = jnp.clip(y, 0, height - 1) * width + jnp.clip(x, 0, width - 1)
    return jax.tree.map(lambda p: p.at[at].get(mode="promise_in_bounds"), flat), inside
