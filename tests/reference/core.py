"""Slow float64 references for `jaxrefl.core`, written from the textbook formulae and not from the library's code."""

import numpy as np


def fresnel(cos: np.ndarray, eta: np.ndarray, k: np.ndarray | float = 0.0) -> np.ndarray:
    """Reflectance from the complex amplitudes of both polarisations, with Snell's law for a complex index."""
    cos, index = np.asarray(cos, np.complex128), np.asarray(eta, np.float64) + 1j * np.asarray(k, np.float64)
    cos_t = np.sqrt(1 - (1 - cos**2) / index**2)
    r_s = (cos - index * cos_t) / (cos + index * cos_t)
    r_p = (index * cos - cos_t) / (index * cos + cos_t)
    return 0.5 * (np.abs(r_s) ** 2 + np.abs(r_p) ** 2)


def transmittance(cos: np.ndarray, cos_t: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Refracted share of the energy, from the amplitudes of the transmitted wave."""
    t_s = 2 * cos / (cos + eta * cos_t)
    t_p = 2 * cos / (eta * cos + cos_t)
    return 0.5 * eta * cos_t / cos * (t_s**2 + t_p**2)


def ggx(cos_h: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """GGX distribution of normals, [WMLT07] Eq. 33 with its tangent."""
    tan2 = (1 - cos_h**2) / cos_h**2
    return np.where(cos_h > 0, alpha**2 / (np.pi * cos_h**4 * (alpha**2 + tan2) ** 2), 0)


def smith_lambda(cos: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Smith's Lambda for GGX, [Hei14] Eq. 72."""
    return (np.sqrt(1 + alpha**2 * (1 - cos**2) / cos**2) - 1) / 2


def microfacet_grid(alpha: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals [count 2count 3] at the midpoints of cells of the hemisphere, and the solid angle of each cell.

    The cells are equal in the azimuth and in s, where 1 - s^2 is the share of D cos(theta) inside the polar angle
    theta; so they follow the lobe, however narrow.
    """
    s = (np.arange(count) + 0.5) / count
    tan = alpha * np.sqrt(1 - s * s) / s
    theta, azimuth = np.arctan(tan), np.pi * (np.arange(2 * count) + 0.5) / count
    edges = np.arange(count + 1) / count
    with np.errstate(divide="ignore"):
        edge_cos = 1 / np.sqrt(1 + (alpha * np.sqrt(1 - edges * edges) / edges) ** 2)
    solid_angle = np.diff(edge_cos) * np.pi / count
    normals = np.stack(
        [
            np.outer(np.sin(theta), np.cos(azimuth)),
            np.outer(np.sin(theta), np.sin(azimuth)),
            np.outer(np.cos(theta), 0 * azimuth + 1),
        ],
        -1,
    )
    return normals, np.broadcast_to(solid_angle[:, None], normals.shape[:-1])


def sample_visible_normals(wo: np.ndarray, alpha: float, u: np.ndarray) -> np.ndarray:
    """Visible normals [n 3] by projecting half disks: Heitz 2018, the method before spherical caps."""
    v = wo * [alpha, alpha, 1]
    v = v / np.linalg.norm(v)
    t1 = np.cross([0, 0, 1], v) if v[2] < 0.9999 else np.array([1.0, 0, 0])
    t1 = t1 / np.linalg.norm(t1)
    t2 = np.cross(v, t1)
    radius, azimuth = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    a, b = radius * np.cos(azimuth), radius * np.sin(azimuth)
    s = (1 + v[2]) / 2
    b = (1 - s) * np.sqrt(1 - a * a) + s * b
    h = a[:, None] * t1 + b[:, None] * t2 + np.sqrt(np.maximum(0, 1 - a * a - b * b))[:, None] * v
    h = h * [alpha, alpha, 1]
    return h / np.linalg.norm(h, axis=1, keepdims=True)


def lobe(cos_o: float, alpha: float, rng: np.random.Generator, side: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """Monte Carlo samples [n] of a lobe: cosine between viewer and microfacet, and weight; `side` squared strata."""
    cell = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), -1).reshape(-1, 2)
    u = (cell + rng.random(cell.shape)) / side
    wo = np.array([np.sqrt(1 - cos_o**2), 0, cos_o])
    h = sample_visible_normals(wo, alpha, u)
    cos_d = h @ wo
    cos_i = 2 * cos_d * h[:, 2] - cos_o
    above = cos_i > 0
    lambda_o, lambda_i = smith_lambda(cos_o, alpha), smith_lambda(np.where(above, cos_i, 1), alpha)
    weight = np.where(above, (1 + lambda_o) / (1 + lambda_o + lambda_i), 0)
    return cos_d, weight
