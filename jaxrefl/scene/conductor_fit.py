r"""Complex index of refraction whose reflectance is that of a coloured mirror under Schlick's approximation. Host code.

All indices with the reflectance $r$ at normal incidence lie on a curve with one parameter $g$ (the edge tint):
$$ \eta = g\,\frac{1 - r}{1 + r} + (1 - g)\,\frac{1 + \sqrt r}{1 - \sqrt r},\qquad
   k^2 = \frac{r\,(\eta + 1)^2 - (\eta - 1)^2}{1 - r} $$
The fit takes the $g$ whose curve over the angle comes closest to Schlick's.

Source: Gulbrandsen, "Artist Friendly Metallic Fresnel", JCGT 3(4), 2014, §3; the fit is ours.
"""

import numpy as np

_COSINES = np.linspace(0, 1, 182)[1:]
_TINTS = 1 - np.linspace(0, 1, 401) ** 3
"""Denser close to 1, where bright metals lie."""


def fitted_conductor(f0: float) -> tuple[float, float, float]:
    """The complex index that comes closest to Schlick's reflectance.

    Args:
        f0: Reflectance at normal incidence, in [0, 1].
    Returns:
        eta, k, and the largest difference of the reflectance over the angle: up to 0.03 for f0 from 0.02 to 0.94,
        less above, 0 at 1; below, metals cannot follow Schlick's curve (0.16 at 0.001).
    Edge cases: 1 gives (0, 1), which reflects everything; below 1e-4 the reflectance at normal incidence is 1e-4.
    """
    if f0 >= 1:
        return 0.0, 1.0, 0.0
    r = max(f0, 1e-4)
    root = np.sqrt(r)
    eta = _TINTS * (1 - r) / (1 + r) + (1 - _TINTS) * (1 + root) / (1 - root)
    k = np.sqrt(np.maximum(r * (eta + 1) ** 2 - (eta - 1) ** 2, 0) / (1 - r))
    schlick = f0 + (1 - f0) * (1 - _COSINES) ** 5
    error = np.abs(_reflectance(_COSINES[:, None], eta, k) - schlick[:, None]).max(0)
    best = int(error.argmin())
    return float(eta[best]), float(k[best]), float(error[best])


def _reflectance(cos: np.ndarray, eta: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Exact reflectance of a conductor, as `core.fresnel_conductor` in float64."""
    cos2 = cos * cos
    sin2 = 1 - cos2
    difference = eta * eta - k * k - sin2
    length = np.sqrt(difference * difference + 4 * eta * eta * k * k)
    cross = 2 * cos * np.sqrt(np.maximum(0.5 * (length + difference), 0))
    s = (length + cos2 - cross) / (length + cos2 + cross)
    p = s * (cos2 * length + sin2 * sin2 - cross * sin2) / (cos2 * length + sin2 * sin2 + cross * sin2)
    return 0.5 * (s + p)
