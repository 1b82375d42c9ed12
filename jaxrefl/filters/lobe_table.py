r"""Table of the Gaussians that stand for a GGX lobe, and its differentiable look-up.

A lobe's image depends on alpha, on the cosine of the viewing angle and on tau (see `filters.lobe`), so one table serves
every camera and every scale. What is stored is divided by $2 \alpha \tau$, and across the plane of incidence by a
factor of foreshortening too, so that it is smooth down to alpha = 0, where the footprint vanishes linearly. Near
grazing a lobe's shape depends on cos / alpha; one axis therefore is $s = \cos (1 + \alpha) / (\cos + \alpha)$.

Source: [RLPWSD20] §6.1. Differs from the source: relative distances and any viewing angle instead of metres and frontal
views; values normalised.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core.safe import sqrt
from jaxrefl.filters.lobe import SURFACES, lobe_directions, offsets, profile_of, shares_below
from jaxrefl.filters.lobe_fit import METHODS, PLACES, SPAN, fit_profiles, window_moments, window_of

LEAST = 1e-3
"""Alpha of the table's first row; narrower lobes have the same shape."""
_ACROSS = 0.3
"""Share of alpha that keeps the lobe's width across the plane of incidence from vanishing at grazing."""


@dataclasses.dataclass(frozen=True)
class TableOptions:
    """What is tabulated."""

    method: str = "two"
    """"two" Gaussians or "one", fitted to edge profiles, or one with the "moments" of the lobe, as published."""
    surface: str = "plane"
    """What is taken to be reflected: a "plane" across the line of sight, for which tau is an exact factor and needs no
    axis, or a "sphere" around the reflecting point."""
    size: int = 32
    """Entries along each axis."""

    def __post_init__(self):
        for name, value, known in (("method", self.method, METHODS), ("surface", self.surface, SURFACES)):
            if value not in known:
                raise ValueError(f"{name}: expected one of {', '.join(known)}, got {value!r}")
        if self.size < 2:
            raise ValueError(f"size: expected at least 2, got {self.size}")


class LobeGaussians(eqx.Module):
    """Gaussians for GGX lobes as the viewer sees them, on a plane across the line of sight at distance 1."""

    weight: Float[Array, "*b k"]
    """Weights, which sum to 1."""
    mean: Float[Array, "*b k"]
    """Means along the plane of incidence, towards the projected normal; those across it are 0."""
    along: Float[Array, "*b k"]
    """Standard deviations along the plane of incidence, >= 0."""
    across: Float[Array, "*b k"]
    """Standard deviations perpendicular to it, >= 0."""


class LobeTable(eqx.Module):
    """Normalised Gaussians [tau, alpha, s]; tau has one entry where it is a factor."""

    gaussians: LobeGaussians
    """One lobe per entry."""


def _axes(size: int, surface: str) -> tuple[Float[Array, "t"], Float[Array, "a"], Float[Array, "s"]]:
    """Nodes: tau dense where it is near 1, alpha where it is near 0 (power 2), s even."""
    step = jnp.linspace(0, 1, size, dtype=jnp.float32)
    tau = 1 - (1 - step) ** 2 if surface == "sphere" else jnp.ones(1, jnp.float32)
    return tau, jnp.maximum(step * step, LEAST), step


def _foreshortening(cosine: Float[Array, "*#b"], alpha: Float[Array, "*#b"]) -> Float[Array, "*#b"]:
    return (cosine + _ACROSS * alpha) / (1 + _ACROSS * alpha)


def _entry(
    tau: Float[Array, ""], alpha: Float[Array, ""], s: Float[Array, ""], *, options: TableOptions
) -> LobeGaussians:
    # Not below alpha / 100: nothing is seen of a surface from the side.
    cosine = jnp.minimum(jnp.maximum(s * alpha / (1 + alpha - s), 1e-2 * alpha), 1)
    fine = options.surface == "plane"
    directions, weights = lobe_directions(cosine, alpha, rows=64 if fine else 24, columns=96 if fine else 48)
    along, across, weights = offsets(directions, weights, tau, surface=options.surface)
    along, across = along / (2 * alpha), across / (2 * alpha * _foreshortening(cosine, alpha))
    profiles = profile_of(along, weights), profile_of(across, weights)
    (middle, scale), (_, scale_across) = (window_of(p) for p in profiles)
    if options.method == "moments":
        mean, deviation = window_moments(along, weights, middle, scale)
        _, deviation_across = window_moments(across, weights, jnp.zeros_like(middle), scale_across)
        return LobeGaussians(jnp.ones(1, jnp.float32), mean[None], deviation[None], deviation_across[None])
    places = jnp.linspace(-SPAN, SPAN, PLACES, dtype=jnp.float32)
    shares = (
        shares_below(profiles[0], middle + scale * places),
        shares_below(profiles[1], scale_across * places),
    )
    weight, mean, sigma = fit_profiles(places, *shares, method=options.method)
    return LobeGaussians(weight, middle + scale * mean, scale * sigma[0], scale_across * sigma[1])


@functools.partial(jax.jit, static_argnames="options")
def build_table(*, options: TableOptions) -> LobeTable:
    """Fit Gaussians to lobes on the whole grid.

    Args:
        options: What is tabulated.
    Returns:
        The table.
    """
    tau, alpha, s = _axes(options.size, options.surface)
    grid = jnp.meshgrid(tau, alpha, s, indexing="ij")
    shape = grid[0].shape
    entry = functools.partial(_entry, options=options)
    flat = jax.lax.map(lambda x: entry(*x), tuple(x.reshape(-1) for x in grid), batch_size=32)
    return LobeTable(jax.tree.map(lambda x: x.reshape(*shape, -1), flat))


def lobe_gaussians(
    table: LobeTable, cosine: Float[Array, "*b"], alpha: Float[Array, "*b"], tau: Float[Array, "*b"]
) -> LobeGaussians:
    r"""Gaussians of the lobe that each point shows.

    Args:
        table: From `build_table` or `load_table`.
        cosine: Cosine between viewer and normal, in [0, 1].
        alpha: GGX width, in [0, 1].
        tau: $d_r / (d_c + d_r)$, in [0, 1].
    Returns:
        Their weights, means and deviations in tangents; times the focal length they are pixels.
    Edge cases: alpha = 0 and tau = 0 give deviations and means of 0, with finite gradients. Arguments out of range
    count as the nearest in it.
    """
    cosine, alpha, tau = (jnp.clip(x, 0, 1) for x in (cosine, alpha, tau))
    stored = table.gaussians.weight.shape
    wide = jnp.maximum(alpha, LEAST)
    s = cosine * (1 + wide) / (cosine + wide)
    coordinates = (1 - sqrt(1 - tau), sqrt(alpha), s)
    corners: list[tuple[Array, Array]] = [(jnp.zeros(cosine.shape, jnp.int32), jnp.ones_like(cosine))]
    for axis, place in enumerate(coordinates):
        size = stored[axis]
        if size == 1:
            continue
        at = jnp.clip(place, 0, 1) * (size - 1)
        low = jnp.clip(at.astype(jnp.int32), 0, size - 2)
        share = at - low.astype(at.dtype)
        corners = [
            (index * size + low + step, weight * (share if step else 1 - share))
            for index, weight in corners
            for step in (0, 1)
        ]

    def read(values: Float[Array, "t a s k"]) -> Float[Array, "*b k"]:
        columns = values.reshape(-1, values.shape[-1])
        return jnp.stack(
            [sum(weight * columns[:, i][index] for index, weight in corners) for i in range(columns.shape[1])], -1
        )

    found = jax.tree.map(read, table.gaussians)
    unit = (2 * alpha * tau)[..., None]
    narrowed = unit * _foreshortening(cosine, alpha)[..., None]
    return LobeGaussians(found.weight, found.mean * unit, found.along * unit, found.across * narrowed)
