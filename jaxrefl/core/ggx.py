"""The isotropic GGX microfacet model: distribution, Smith masking, sampling of visible normals, densities.

`alpha` in [0, 1] is the width; at alpha = 0 the surface is a perfect mirror, whose distribution is a Dirac delta. No
array can hold that, so densities are 0 there, while masking, sampling and weights take their limits: sampling returns
the normal itself and a technique needs no second code path. "Local" vectors live in the frame whose +Z is the normal.

Sources: [WMLT07] Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007;
[Hei14] Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 3(2), 2014;
[DB23] Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", HPG 2023.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.core.safe import divide, normalise, sqrt
from jaxrefl.core.vectors import dot


def ggx_distribution(cos_h: Float[Array, "*#b"], alpha: Float[Array, "*#b"]) -> Float[Array, "*#b"]:
    r"""Density of microfacet normals.

    $$ D = \frac{\alpha^2}{\pi\,(\cos^2\theta_h\,(\alpha^2 - 1) + 1)^2},\qquad \int D \cos\theta_h\, d\omega_h = 1 $$

    Args:
        cos_h: Cosine between the microfacet's normal and the surface's, in [-1, 1].
        alpha: GGX width, in [0, 1].
    Returns:
        Area of microfacets per surface area and solid angle, 1/sr, >= 0.
    Edge cases: 0 below the surface and at alpha = 0. float32 cosines cannot resolve lobes with alpha < 1e-3: the
    functions that take local vectors can, because they have the sine.
    Source: [WMLT07] Eq. 33.
    """
    return _distribution((1 - cos_h) * (1 + cos_h), cos_h, alpha)


def smith_g1(cos: Float[Array, "*#b"], alpha: Float[Array, "*#b"]) -> Float[Array, "*#b"]:
    r"""Visible share of the microfacets that face a direction (Smith masking).

    $$ G_1 = \frac{2}{1 + \sqrt{1 + \alpha^2 \tan^2\theta}},\qquad
       \int G_1(\omega_o)\, \max(0, \omega_o \cdot h)\, D(h)\, dh = \cos\theta_o $$

    Args:
        cos: Cosine between the direction and the surface's normal, in [-1, 1].
        alpha: GGX width, in [0, 1].
    Returns:
        Share in [0, 1].
    Edge cases: 0 below the surface; at grazing 0 for alpha > 0 and 1 for alpha = 0, where nothing is masked.
    Source: [WMLT07] Eq. 34.
    """
    above = jnp.maximum(cos, 0)
    return jnp.where(cos < 0, 0, divide(above, _projected_area(above, (1 - above) * (1 + above), alpha), fill=1.0))


def smith_g2(cos_o: Float[Array, "*#b"], cos_i: Float[Array, "*#b"], alpha: Float[Array, "*#b"]) -> Float[Array, "*#b"]:
    r"""Share of the microfacets that both directions see, with height-correlated masking and shadowing.

    $$ G_2 = \frac{1}{1 + \Lambda_o + \Lambda_i} = \frac{G_o\,G_i}{G_o + G_i - G_o\,G_i},\qquad \Lambda = 1/G_1 - 1 $$

    Args:
        cos_o: Cosine between the viewer and the normal, in [-1, 1].
        cos_i: Cosine between the reflected direction and the normal, in [-1, 1].
        alpha: GGX width, in [0, 1].
    Returns:
        Share in [0, 1], symmetric in the two directions.
    Edge cases: 0 if a direction is below the surface; 1 above it at alpha = 0.
    Source: [Hei14] Eq. 99.
    """
    g_o, g_i = smith_g1(cos_o, alpha), smith_g1(cos_i, alpha)
    return divide(g_o * g_i, g_o + g_i - g_o * g_i)


def sample_visible_normal(
    wo_local: Float[Array, "*b 3"], alpha: Float[Array, "*b"], u: Float[Array, "*b 2"]
) -> Float[Array, "*b 3"]:
    r"""Microfacet normal, drawn with the density with which the viewer sees it.

    On the unit sphere that alpha stretches to GGX, the reflection of a fixed direction over the visible half is uniform
    on a spherical cap; so draw from the cap, take the half vector and stretch.

    Args:
        wo_local: Unit directions to the viewer, local, z >= 0.
        alpha: GGX width, in [0, 1].
        u: Two uniform numbers in [0, 1): azimuth and height on the cap.
    Returns:
        Unit microfacet normals, local, z >= 0, with density `visible_normal_pdf`.
    Edge cases: at alpha = 0 the normal (0, 0, 1) itself.
    Source: [DB23] listing 3.
    Differs from the source: the height above the cap's base is computed without cancellation, for grazing viewers.
    """
    stretched = normalise(jnp.stack([alpha * wo_local[..., 0], alpha * wo_local[..., 1], wo_local[..., 2]], -1))
    azimuth = 2 * jnp.pi * u[..., 0]
    height = 1 + stretched[..., 2]  # of the cap z in (-stretched.z, 1]
    sin = sqrt(u[..., 1] * height * (2 - u[..., 1] * height))  # of the point with 1 - z = u height
    x = sin * jnp.cos(azimuth) + stretched[..., 0]
    y = sin * jnp.sin(azimuth) + stretched[..., 1]
    z = (1 - u[..., 1]) * height
    return normalise(jnp.stack([alpha * x, alpha * y, z], -1))


def visible_normal_pdf(
    wo_local: Float[Array, "*b 3"], h_local: Float[Array, "*b 3"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    r"""Density of `sample_visible_normal`.

    $$ p(h) = \frac{G_1(\omega_o)\, \max(0, \omega_o \cdot h)\, D(h)}{\cos\theta_o} $$

    Args:
        wo_local: Unit directions to the viewer, local, z >= 0.
        h_local: Unit microfacet normals, local.
        alpha: GGX width, in [0, 1].
    Returns:
        Density in 1/sr; integrates to 1 over the sphere for alpha > 0.
    Edge cases: 0 for normals below the surface or turned away from the viewer, and at alpha = 0 (a delta). Finite for a
    grazing viewer.
    Source: [Hei14] Eq. 16.
    """
    return jnp.maximum(dot(wo_local, h_local), 0) * _density_over_area(wo_local, h_local, alpha)


def reflection_pdf(
    wo_local: Float[Array, "*b 3"], wi_local: Float[Array, "*b 3"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    r"""Density of the mirror direction about a normal drawn by `sample_visible_normal`.

    $$ p(\omega_i) = \frac{p(h)}{4\,\omega_o \cdot h} = \frac{G_1(\omega_o)\, D(h)}{4 \cos\theta_o},\qquad
       h = \frac{\omega_o + \omega_i}{|\omega_o + \omega_i|} $$

    Args:
        wo_local: Unit directions to the viewer, local, z >= 0.
        wi_local: Unit directions to the reflected scene, local; may lie below the surface, as some samples do.
        alpha: GGX width, in [0, 1].
    Returns:
        Density in 1/sr; integrates to 1 over the whole sphere for alpha > 0.
    Edge cases: 0 at alpha = 0 (a delta) and for opposite directions, which have no half vector above the surface.
    Source: [WMLT07] Eq. 14 with [Hei14] Eq. 16.
    """
    h = normalise(wo_local + wi_local, fill=(0.0, 0.0, -1.0))
    return 0.25 * _density_over_area(wo_local, h, alpha)


def reflection_weight(
    cos_o: Float[Array, "*#b"], cos_i: Float[Array, "*#b"], alpha: Float[Array, "*#b"]
) -> Float[Array, "*#b"]:
    r"""Reflected radiance that a sample of `sample_visible_normal` carries, per unit of Fresnel and incoming radiance.

    $$ w = \frac{f\,\cos\theta_i}{F\,p(\omega_i)} = \frac{G_2}{G_1(\omega_o)} $$

    Args:
        cos_o: Cosine between the viewer and the normal, in [0, 1].
        cos_i: Cosine between the sampled direction and the normal, in [-1, 1].
        alpha: GGX width, in [0, 1].
    Returns:
        Weight in [0, 1].
    Edge cases: 0 below the surface; 1 above it at alpha = 0; finite for a grazing viewer.
    Source: [Hei18] Heitz, "Sampling the GGX Distribution of Visible Normals", JCGT 7(4), 2018, Eq. 19.
    """
    g_o, g_i = smith_g1(cos_o, alpha), smith_g1(cos_i, alpha)
    return divide(g_i, g_o + g_i - g_o * g_i)


def _distribution(
    sin2_h: Float[Array, "*#b"], cos_h: Float[Array, "*#b"], alpha: Float[Array, "*#b"]
) -> Float[Array, "*#b"]:
    """D from sine and cosine; the square comes last, so that a narrow lobe does not overflow."""
    above = jnp.maximum(cos_h, 0)
    root = divide(alpha, sin2_h + (alpha * above) ** 2)
    return jnp.where(cos_h > 0, root * root / jnp.pi, 0)


def _projected_area(
    cos: Float[Array, "*#b"], sin2: Float[Array, "*#b"], alpha: Float[Array, "*#b"]
) -> Float[Array, "*#b"]:
    """Area of all microfacets that face a direction, per surface area, seen from it: cos / G1."""
    return 0.5 * (cos + sqrt(cos * cos + alpha * alpha * sin2))


def _density_over_area(
    wo_local: Float[Array, "*b 3"], h_local: Float[Array, "*b 3"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """D(h) G1(wo) / cos wo, or 0 if the viewer is behind the microfacet."""
    (ox, oy, oz), (hx, hy, hz) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (wo_local, h_local))
    density = divide(_distribution(hx * hx + hy * hy, hz, alpha), _projected_area(oz, ox * ox + oy * oy, alpha))
    return jnp.where(dot(wo_local, h_local) > 0, density, 0)
