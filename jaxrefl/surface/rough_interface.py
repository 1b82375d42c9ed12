r"""What a rough dielectric interface lets through and returns from below when light meets it once.

Single scattering loses the light that microfacets block: less passes than is not reflected. A renderer with that model
(Mitsuba) has darker rough plastic; its tables are computed here in the same way, so that the two can be compared.

$$ T(\mu, \alpha, \eta) = \int (1 - F)\,G_1(\omega_t)\,p(h)\,dh,\qquad
   r(\alpha, \eta) = 2 \int_0^1 \mu \int F\,G_1(\omega_r)\,p(h)\,dh\,d\mu \ \text{from inside} $$

with visible normals h. Tables are made once per process (about 1 s), and only for scenes that need them.

Source: Mitsuba 3, `eval_transmittance` and `eval_reflectance` of its microfacet distributions; [WMLT07] for the terms.
"""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_MU, _ALPHA, _ETA = 25, 21, 17
"""Nodes: the square roots of the cosine and of alpha, and 1 - 1 / eta, each evenly spaced."""
_MOST = 0.75
"""Largest 1 - 1 / eta of the tables: eta = 4."""
_NODES, _GENERATOR = 987, 610
"""Fibonacci lattice of the quadrature."""


def transmittance_once(
    cos: Float[Array, "*b"], alpha: Float[Array, "*b"], eta: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """Share of the light from one direction outside that passes the interface, by single scattering.

    Args:
        cos: Cosine between the direction and the normal, in [0, 1].
        alpha: GGX width, in [0, 1].
        eta: Index of refraction of the inside, in [1, 4].
    Returns:
        Share in [0, 1].
    """
    table = jnp.asarray(_tables()[0])
    return _look_up(table, (jnp.sqrt(jnp.clip(cos, 1e-12, 1)), *_axes(alpha, eta)))


def mean_transmittance_once(alpha: Float[Array, "*b"], eta: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Share of diffuse light from outside that passes, by single scattering.

    Args:
        alpha: GGX width, in [0, 1].
        eta: Index of refraction of the inside, in [1, 4].
    Returns:
        Share in [0, 1].
    """
    return _look_up(jnp.asarray(_tables()[1]), _axes(alpha, eta))


def internal_reflectance_once(alpha: Float[Array, "*b"], eta: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Share of diffuse light from inside that the interface returns, by single scattering.

    Args:
        alpha: GGX width, in [0, 1].
        eta: Index of refraction of the inside, in [1, 4].
    Returns:
        Share in [0, 1].
    """
    return _look_up(jnp.asarray(_tables()[2]), _axes(alpha, eta))


def _axes(alpha: Float[Array, "*b"], eta: Float[Array, "*b"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    return jnp.sqrt(jnp.clip(alpha, 1e-12, 1)), (1 - 1 / jnp.maximum(eta, 1)) / _MOST


def _look_up(table: Float[Array, "..."], coordinates: tuple[Float[Array, "*b"], ...]) -> Float[Array, "*b"]:
    """Multilinear interpolation; coordinates in [0, 1]."""
    corners = [(jnp.zeros(coordinates[0].shape, jnp.int32), jnp.ones_like(coordinates[0]))]
    for size, x in zip(table.shape, coordinates, strict=True):
        scaled = jnp.clip(x, 0, 1) * (size - 1)
        cell = jnp.clip(jnp.floor(scaled), 0, size - 2)
        weight, first = scaled - cell, cell.astype(jnp.int32)
        corners = [
            (index * size + first + step, w * (weight if step else 1 - weight))
            for index, w in corners
            for step in (0, 1)
        ]
    flat = table.reshape(-1)
    return functools.reduce(jnp.add, [flat[index] * weight for index, weight in corners])


@functools.cache
def _tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """T by (cosine, alpha, eta), its mean and r by (alpha, eta)."""
    alphas = np.maximum(np.linspace(0, 1, _ALPHA) ** 2, 1e-4)
    etas = 1 / (1 - np.linspace(0, _MOST, _ETA))
    cosines = np.maximum(np.linspace(0, 1, _MU) ** 2, 1e-4)
    passed = np.empty((_MU, _ALPHA, _ETA))
    mean, returned = np.empty((_ALPHA, _ETA)), np.empty((_ALPHA, _ETA))
    for a, alpha in enumerate(alphas):
        at_nodes = _visible_normals(cosines, alpha)
        for e, eta in enumerate(etas):
            passed[:, a, e] = _passed(cosines, alpha, eta, *at_nodes)
            mu, weights = _cosine_nodes(np.sqrt(1 - 1 / eta**2))
            seen = _visible_normals(mu, alpha)
            mean[a, e] = (_passed(mu, alpha, eta, *seen) * weights).sum()
            returned[a, e] = (_returned(mu, alpha, 1 / eta, *seen) * weights).sum()
    return passed.astype(np.float32), mean.astype(np.float32), returned.astype(np.float32)


def _cosine_nodes(critical: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for 2 mu dmu, in two parts that meet at the critical angle, where F has a kink."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    parts = []
    for low, high in ((0.0, critical), (critical, 1.0)):
        # Quadratic towards the lower end, where the transmittance falls steeply.
        t = 0.5 * (nodes + 1)
        mu, step = low + (high - low) * t * t, (high - low) * t * weights
        parts.append((mu, 2 * mu * step))
    mu, weights = (np.concatenate(x) for x in zip(*parts, strict=True))
    return np.maximum(mu, 1e-4), weights


def _visible_normals(cos_o: np.ndarray, alpha: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cosines between viewer and microfacet, those between microfacet and normal [m k], and weights [k]."""
    i = np.arange(_NODES)
    azimuth, t = 2 * np.pi * i / _NODES, ((i * _GENERATOR) % _NODES + 0.5) / _NODES
    u, weight = t**3 * (10 - 15 * t + 6 * t * t), 30 * (t * (1 - t)) ** 2 / _NODES
    cos_o = cos_o[:, None]
    sin_o = np.sqrt(1 - cos_o * cos_o)
    length = np.sqrt((alpha * sin_o) ** 2 + cos_o * cos_o)
    height = 1 + cos_o / length
    ring = np.sqrt(u * height * (2 - u * height))
    x = alpha * (ring * np.cos(azimuth) + alpha * sin_o / length)
    y, z = alpha * ring * np.sin(azimuth), (1 - u) * height
    inverse = 1 / np.sqrt(x * x + y * y + z * z)
    return (sin_o * x + cos_o * z) * inverse, z * inverse, weight


def _fresnel(cos: np.ndarray, eta: float) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance, and the cosine of the refracted ray; total reflection gives 1 and 0."""
    squared = 1 - (1 - cos * cos) / eta**2
    cos_t = np.sqrt(np.maximum(squared, 0))
    s = (cos - eta * cos_t) / np.maximum(cos + eta * cos_t, 1e-12)
    p = (eta * cos - cos_t) / np.maximum(eta * cos + cos_t, 1e-12)
    return np.where(squared > 0, 0.5 * (s * s + p * p), 1), cos_t


def _smith(cos: np.ndarray, alpha: float) -> np.ndarray:
    cos = np.maximum(cos, 0)
    return 2 * cos / np.maximum(cos + np.sqrt(cos * cos + alpha * alpha * (1 - cos * cos)), 1e-12)


def _passed(cos_o: np.ndarray, alpha: float, eta: float, cos_d: np.ndarray, cos_h: np.ndarray, weight: np.ndarray):
    """Share that passes from each direction [m]."""
    reflectance, cos_t = _fresnel(cos_d, eta)
    # wt = -wo / eta + (cos_d / eta - cos_t) h; its depth below the surface is minus its z.
    depth = cos_o[:, None] / eta - (cos_d / eta - cos_t) * cos_h
    return ((1 - reflectance) * _smith(depth, alpha) * weight).sum(-1)


def _returned(cos_o: np.ndarray, alpha: float, eta: float, cos_d: np.ndarray, cos_h: np.ndarray, weight: np.ndarray):
    """Share that is reflected from each direction [m]."""
    reflectance, _ = _fresnel(cos_d, eta)
    return (reflectance * _smith(2 * cos_d * cos_h - cos_o[:, None], alpha) * weight).sum(-1)
