"""Directions of mirror reflection and refraction at a smooth interface.

`wo` points to the viewer and `wi` to where the light comes from; both point away from the surface.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl.core.safe import sqrt
from jaxrefl.core.vectors import dot


def reflect(wo: Float[Array, "*b 3"], n: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    r"""Direction that a mirror with normal n shows to a viewer in direction wo.

    $$ \omega_i = 2\,(\omega_o \cdot n)\,n - \omega_o $$

    Args:
        wo: Unit directions to the viewer.
        n: Unit normals; their sign does not matter.
    Returns:
        Unit directions to the reflected scene. Reflecting twice gives `wo` back.
    """
    return 2 * dot(wo, n)[..., None] * n - wo


def refract(
    wo: Float[Array, "*b 3"], n: Float[Array, "*b 3"], eta: Float[Array, "*b"]
) -> tuple[Float[Array, "*b 3"], Bool[Array, "*b"]]:
    r"""Direction from which light reaches the viewer through the interface, by Snell's law.

    $$ \omega_i = -\frac{\omega_o - \cos\theta_o\,n}{\eta} - \cos\theta_t\,n,\qquad
       \cos\theta_t = \frac{1}{\eta}\sqrt{(\eta - 1)(\eta + 1) + \cos^2\theta_o} $$

    Args:
        wo: Unit directions to the viewer.
        n: Unit normals; the side of `wo` counts, whatever their sign.
        eta: Index of refraction of the far side over that of the viewer's side, > 0.
    Returns:
        Unit directions on the far side, and False at total internal reflection, where the direction is the mirror's.
    Edge cases: eta = 1 goes straight on; eta >= 1 is always valid. The gradient diverges towards the critical angle; at
    it, it is 0.
    """
    cos = dot(wo, n)
    n = jnp.where(cos[..., None] < 0, -n, n)
    cos = jnp.abs(cos)
    squared = (eta - 1) * (eta + 1) + cos * cos  # (eta cos_t)^2, without cancellation for eta close to 1
    valid = (squared > 0) | (eta >= 1)
    cos_t = sqrt(squared) / eta
    tangential = wo - cos[..., None] * n
    refracted = -tangential / eta[..., None] - cos_t[..., None] * n
    return jnp.where(valid[..., None], refracted, reflect(wo, n)), valid
