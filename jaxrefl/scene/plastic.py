r"""Diffuse light beneath a smooth interface: plain albedo <-> the albedo beneath it. Host code.

Light that a diffuse base scatters upwards is partly reflected back down by the interface, with the share $r$ (the
internal diffuse reflectance), and scattered again. What leaves, as a share of what entered, is
$$ \rho_e = \rho\,\frac{1 - r}{1 - \rho r} $$
with the albedo $\rho$ of the base. `coupled` materials store $\rho$, the others $\rho_e$.
"""

import functools

import numpy as np

from jaxrefl.scene.errors import SceneError


@functools.cache
def internal_reflectance(eta: float) -> float:
    r"""Share of diffuse light beneath a smooth dielectric interface that the interface reflects back down.

    $$ r = 1 - \frac{1 - r_e}{\eta^2},\qquad r_e = \int_0^1 F(c)\,2 c\,dc $$

    Args:
        eta: Index of refraction of the inside over that of the outside, >= 1.
    Returns:
        Reflectance in [0, 1).
    Raises:
        SceneError: If `eta` is below 1.
    Edge cases: 0 at eta = 1.
    Source: the $\eta^2$ law of radiance; 64 Gauss-Legendre nodes in the sine, where the integrand is smooth up to
        grazing (largest difference from 1024 nodes for eta from 1 to 4: 8e-8).
    """
    if not eta >= 1:
        raise SceneError(f"eta: expected an index >= 1, got {eta}")
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cos = np.sin(np.pi / 4 * (nodes + 1))
    weights = weights * np.pi / 4 * np.cos(np.pi / 4 * (nodes + 1))
    refracted = np.sqrt(1 - (1 - cos * cos) / eta**2)
    s = (cos - eta * refracted) / (cos + eta * refracted)
    p = (eta * cos - refracted) / (eta * cos + refracted)
    external = float((weights * 2 * cos * (s * s + p * p) / 2).sum())
    return 1 - (1 - external) / eta**2


def albedo_beneath(albedo: np.ndarray, eta: float) -> np.ndarray:
    r"""Albedo beneath an interface that looks like a given albedo from outside: $\rho_e / (1 - r + \rho_e r)$.

    Args:
        albedo: What leaves the interface, as a share of what entered it, in [0, 1].
        eta: Relative index of refraction, >= 1.
    Returns:
        Albedo of the base, in [0, 1].
    """
    r = internal_reflectance(eta)
    return albedo / (1 - r + albedo * r)


def albedo_outside(albedo: np.ndarray, eta: float) -> np.ndarray:
    """Share of the light that enters an interface which leaves it again; the inverse of `albedo_beneath`.

    Args:
        albedo: Albedo of the base, in [0, 1].
        eta: Relative index of refraction, >= 1.
    Returns:
        Albedo outside, in [0, 1].
    """
    r = internal_reflectance(eta)
    return albedo * (1 - r) / (1 - albedo * r)
