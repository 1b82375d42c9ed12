r"""The GGX lobe as it is seen in a mirror image: alpha, viewing angle, distances -> offsets in the image.

A mirror shows the scene where its mirror image stands, on the same line of sight at the distance $d_c + d_r$. A rough
mirror shows a mean of that image around the line of sight; how far around is what this file says. Directions of the
lobe, mirrored at the surface, have coordinates (along, across) on the plane across the line of sight at distance 1:
"along" points to where the normal projects, "across" is perpendicular to it. From the eye the offset is smaller by

$$ \tau = \frac{d_r}{d_c + d_r} $$

which is 0 at the contact and 1 for what is infinitely far away. Lengths do not matter beyond that.

Derived here; [RLPWSD20] §6.1 has the set-up for frontal views.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core import reflection_weight, sample_visible_normal
from jaxrefl.core.safe import divide, sqrt

WIDEST = 3.0
"""Largest offset that counts: an image shows nothing further from its middle than a tangent of about 2."""
SURFACES = ("plane", "sphere")
"""What is taken to be reflected: a plane across the mirrored line of sight, or a sphere around the reflecting point."""


def lobe_directions(
    cosine: Float[Array, ""], alpha: Float[Array, ""], *, rows: int, columns: int
) -> tuple[Float[Array, "n 3"], Float[Array, "n"]]:
    """Directions of a lobe relative to the mirrored line of sight, on a regular grid of its visible normals.

    Args:
        cosine: Cosine between viewer and normal, in (0, 1].
        alpha: GGX width, in (0, 1].
        rows: Heights on the cap of visible normals.
        columns: Azimuths; the result is symmetric across the plane of incidence.
    Returns:
        Unit directions (along, across, ahead), and weights that sum to 1; 0 for what the surface itself blocks.
    """
    u, v = (jnp.arange(n, dtype=jnp.float32) / n + 0.5 / n for n in (rows, columns))
    height, azimuth = jnp.meshgrid(u, v, indexing="ij")
    grid = jnp.stack([azimuth.reshape(-1), height.reshape(-1)], -1)
    sine = sqrt((1 - cosine) * (1 + cosine))
    viewer = jnp.broadcast_to(jnp.stack([sine, jnp.zeros_like(sine), cosine]), (grid.shape[0], 3))
    width = jnp.broadcast_to(alpha, grid.shape[:1])
    x, y, z = (sample_visible_normal(viewer, width, grid)[:, i] for i in range(3))
    toward = 2 * (sine * x + cosine * z)
    wi_x, wi_y, wi_z = toward * x - sine, toward * y, toward * z - cosine
    weight = jnp.where(wi_z > 0, reflection_weight(jnp.broadcast_to(cosine, wi_z.shape), wi_z, width), 0)
    # Mirrored at the surface (z changes sign); the line of sight is (-sine, 0, -cosine) there.
    along, ahead = -cosine * wi_x - sine * wi_z, -sine * wi_x + cosine * wi_z
    return jnp.stack([along, wi_y, ahead], -1), divide(weight, weight.sum())


def offsets(
    directions: Float[Array, "n 3"], weights: Float[Array, "n"], tau: Float[Array, ""], *, surface: str
) -> tuple[Float[Array, "n"], Float[Array, "n"], Float[Array, "n"]]:
    r"""Where the viewer sees what lies in these directions, as tangents, divided by tau.

    $$ \frac{x_{\text{along}}}{x_{\text{ahead}}} \ \text{(plane)},\qquad
       \frac{x_{\text{along}}}{(1 - \tau) + \tau\,x_{\text{ahead}}} \ \text{(sphere)} $$

    Args:
        directions: Unit directions (along, across, ahead).
        weights: Their weights.
        tau: Distance to the reflected point over that to its mirror image, in [0, 1]; a plane's result has no need
            of it.
        surface: One of `SURFACES`.
    Returns:
        Offsets along and across, and weights: 0 for what is further than `WIDEST` from the line of sight, or behind
        the viewer, where no image can show it.
    """
    along, across, ahead = (directions[:, i] for i in range(3))
    depth = ahead if surface == "plane" else (1 - tau) + tau * ahead
    seen = (depth > 0) & (along * along + across * across < (WIDEST * depth) ** 2)
    depth = jnp.where(seen, depth, 1)
    return jnp.where(seen, along / depth, 0), jnp.where(seen, across / depth, 0), jnp.where(seen, weights, 0)


class Profile(NamedTuple):
    """Samples of a lobe in rising order: the profile of a step edge under it."""

    places: Float[Array, "n"]
    """Offsets, rising."""
    below: Float[Array, "n"]
    """Share of the lobe below each."""


def profile_of(values: Float[Array, "n"], weights: Float[Array, "n"]) -> Profile:
    """Profile of a step edge.

    Args:
        values: Offsets of the samples.
        weights: Their weights, >= 0.
    Returns:
        The profile.
    """
    places, weights = jax.lax.sort((values, weights), num_keys=1)
    upto = jnp.cumsum(weights)
    # A sample counts half at its own place, so that a symmetric lobe has exactly 1/2 at 0.
    return Profile(places, divide(upto - 0.5 * weights, upto[-1]))


def shares_below(profile: Profile, at: Float[Array, "p"]) -> Float[Array, "p"]:
    """Share of the lobe below each place.

    Args:
        profile: From `profile_of`.
        at: Where to evaluate.
    Returns:
        Shares in [0, 1].
    """
    return jnp.interp(at, profile.places, profile.below, left=0.0, right=1.0)


def place_of(profile: Profile, share: float) -> Float[Array, ""]:
    """Where an edge must lie for a share of the lobe to be below it; the inverse of `shares_below`.

    Args:
        profile: From `profile_of`.
        share: In (0, 1).
    Returns:
        The place.
    """
    return jnp.interp(jnp.asarray(share, profile.below.dtype), profile.below, profile.places)
