r"""Diffuse light beneath a dielectric interface, which it passes on its way in and out (plastic, varnish, glaze).

Light from $\omega_i$ that is not reflected enters, is scattered diffusely, and is partly reflected back by the
interface from below, which goes on until it is absorbed or leaves:

$$ f_d = \frac{\rho}{\pi}\,\frac{T(\omega_o)\,T(\omega_i)}{\eta^2\,(1 - \rho\,r)},\qquad T = 1 - E $$

with the lobe's albedo E and the diffuse reflectance $r$ of the interface from below. Thermodynamics ties r to the mean
albedo $\bar E$ from above, $1 - r = (1 - \bar E) / \eta^2$, so

$$ f_d = \frac{\rho'}{\pi}\,T(\omega_o)\,\frac{T(\omega_i)}{1 - \bar E},\qquad
   \rho' = \rho\,\frac{1 - r}{1 - \rho\,r} $$

whose albedo is $\rho' T(\omega_o)$: what `composite` shows of any material with the diffuse albedo $\rho'$. Only
the dependence on $\omega_i$ is more than Lambert's law; the path tracer has it, direct light leaves it at its mean, 1.

Source: [KSK01] Kelemen and Szirmay-Kalos, "A Microfacet Based Coupled Specular-Matte BRDF Model", EG short papers
2001, §3.
"""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrefl._types import GBuffer
from jaxrefl.core import fresnel_dielectric
from jaxrefl.core.albedo import ggx_albedo, lobe_fresnel_cosine
from jaxrefl.surface.rough_interface import (
    internal_reflectance_once,
    mean_transmittance_once,
    transmittance_once,
)

_SIZE = 33
"""Rows (alpha, linear in its square root) and columns (1 - 1 / eta, linear) of the table of mean albedos."""


def interface_albedo(cos: Float[Array, "*b"], alpha: Float[Array, "*b"], eta: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Share of the light from one direction that the interface reflects (single scattering).

    Args:
        cos: Cosine between the direction and the normal, in [0, 1].
        alpha: GGX width, in [0, 1].
        eta: Index of refraction of the inside, >= 1.
    Returns:
        Albedo in [0, 1].
    """
    scale, bias = ggx_albedo(cos, alpha)
    return (scale + bias) * fresnel_dielectric(lobe_fresnel_cosine(cos, alpha), eta)


def mean_interface_albedo(alpha: Float[Array, "*b"], eta: Float[Array, "*b"]) -> Float[Array, "*b"]:
    r"""Share of diffuse light from above that the interface reflects.

    $$ \bar E = 2 \int_0^1 E(\mu)\,\mu\,\mathrm{d}\mu $$

    Bilinear in a table; errors against 512-point quadrature stay below 0.0005 for eta from 1 to 3.

    Args:
        alpha: GGX width, in [0, 1].
        eta: Index of refraction of the inside, >= 1.
    Returns:
        Mean albedo in [0, 1).
    """
    y, x = jnp.sqrt(jnp.clip(alpha, 1e-12, 1)) * (_SIZE - 1), (1 - 1 / jnp.maximum(eta, 1)) * (_SIZE - 1)
    row, column = (jnp.clip(jnp.floor(v), 0, _SIZE - 2) for v in (y, x))
    fy, fx = y - row, x - column
    first = (row * _SIZE + column).astype(jnp.int32)
    table = jnp.asarray(_mean_table().reshape(-1))
    top, bottom = (table[i] * (1 - fx) + table[i + 1] * fx for i in (first, first + _SIZE))
    return top * (1 - fy) + bottom * fy


def albedo_above(gbuffer: GBuffer) -> Float[Array, "*b 3"]:
    r"""Diffuse albedo as it is seen from above the interface.

    $$ \rho' = \rho\,\frac{1 - r}{1 - \rho\,r},\qquad r = 1 - (1 - \bar E) / \eta^2 $$

    Args:
        gbuffer: Any G-buffer.
    Returns:
        `base_colour` where the material is not coupled, rho' where it is.
    Source: [KSK01] §3, with the bounces beneath the interface of Mitsuba's `plastic` (nonlinear).
    """
    if gbuffer.coupled is None:
        return gbuffer.base_colour
    r = 1 - (1 - mean_interface_albedo(gbuffer.alpha, gbuffer.eta)) / (gbuffer.eta * gbuffer.eta)
    r = jnp.where(gbuffer.coupled, r, 0)[..., None]
    return gbuffer.base_colour * (1 - r) / (1 - gbuffer.base_colour * r)


def single_scattering_loss(gbuffer: GBuffer, cos_o: Float[Array, "*b"]) -> Float[Array, "*b 3"]:
    r"""How much darker diffuse light is where the interface scatters it once, as in Mitsuba's `roughplastic`.

    $$ \frac{T_1(\omega_o)}{1 - E_o} \cdot \frac{\bar T_1 / (\eta^2 (1 - \rho\,r_1))}{(1 - r) / (1 - \rho\,r)} $$

    with the transmittance T_1 and the reflectance r_1 of single scattering (`surface.rough_interface`), which lose what
    microfacets block.

    Args:
        gbuffer: Any G-buffer.
        cos_o: Cosine between the viewer and the shading normal.
    Returns:
        Factor on (1 - E_o) times `albedo_above`; 1 where the material is not coupled.
    """
    if gbuffer.coupled is None:
        return jnp.ones_like(gbuffer.base_colour)
    alpha, eta, rho = gbuffer.alpha, gbuffer.eta, gbuffer.base_colour
    squared = eta * eta
    r = (1 - (1 - mean_interface_albedo(alpha, eta)) / squared)[..., None]
    r1 = internal_reflectance_once(alpha, eta)[..., None]
    outward = transmittance_once(cos_o, alpha, eta) / jnp.maximum(1 - interface_albedo(cos_o, alpha, eta), 1e-3)
    inward = (mean_transmittance_once(alpha, eta) / squared)[..., None] / (1 - rho * r1) * (1 - rho * r) / (1 - r)
    return jnp.where(gbuffer.coupled[..., None], outward[..., None] * inward, 1)


def coupling(gbuffer: GBuffer, cos_i: Float[Array, "*b"], *, single: bool = False) -> Float[Array, "*b"]:
    r"""What the interface lets in from one direction, relative to the mean over all of them.

    $$ c = \frac{1 - E(\omega_i)}{1 - \bar E} $$

    Args:
        gbuffer: Any G-buffer.
        cos_i: Cosine between the incoming direction and the shading normal.
        single: True: the interface scatters light once, and loses what microfacets block.
    Returns:
        Factor on the diffuse lobe, whose cosine-weighted mean is 1; 1 where the material is not coupled.
    Source: [KSK01] Eq. 4.
    """
    if gbuffer.coupled is None:
        return jnp.ones_like(cos_i)
    cos, alpha, eta = jnp.clip(cos_i, 0, 1), gbuffer.alpha, gbuffer.eta
    if single:
        through, mean = transmittance_once(cos, alpha, eta), mean_transmittance_once(alpha, eta)
    else:
        through, mean = 1 - interface_albedo(cos, alpha, eta), 1 - mean_interface_albedo(alpha, eta)
    return jnp.where(gbuffer.coupled, through / mean, 1)


@functools.cache
def _mean_table() -> Float[np.ndarray, "m n"]:
    """Mean albedos by 64-point Gauss-Legendre quadrature in the square root of the cosine, which tames grazing."""
    import jax

    nodes, weights = np.polynomial.legendre.leggauss(64)
    root = 0.5 * (nodes + 1)
    grid = np.linspace(0, 1, _SIZE)
    alpha, eta = grid**2, 1 / (1 - np.minimum(grid, 1 - 1e-4))
    mu, a, e = np.broadcast_arrays(root**2, alpha[:, None, None], eta[:, None])
    with jax.ensure_compile_time_eval():
        albedo = np.asarray(interface_albedo(*(jnp.asarray(x, jnp.float32) for x in (mu, a, e))), np.float64)
    # 2 mu dmu with mu = root^2 is 4 root^3 droot; the nodes' interval [-1, 1] is twice as long as [0, 1].
    return ((albedo * 2 * weights * root**3).sum(-1)).astype(np.float32)
