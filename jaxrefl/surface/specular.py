"""The specular side of a surface: which pixels have one, where it looks, and how much of it is seen.

The specular lobe is GGX with Smith masking. Techniques estimate the *mean radiance* within the lobe; what that mean
weighs in the image depends on the surface and the viewer alone and is computed here, once, for the composite as for
hits seen in reflections.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import GBuffer
from jaxrefl.core import (
    dot,
    f0_from_eta,
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_schlick,
    lerp,
    reflect,
    reflection_weight,
    refract,
    sample_visible_normal,
    to_local,
    to_world,
)
from jaxrefl.core.albedo import ggx_albedo, lobe_fresnel_cosine
from jaxrefl.core.safe import normalise
from jaxrefl.surface.coupling import albedo_above

GRAZING = 1e-3
"""Smallest sine by which a reflected direction stays above the geometric surface."""

FOLDED = 1e-3
"""Weight of a sampled direction that the surface itself would block."""


def reflective(gbuffer: GBuffer) -> Bool[Array, "*b"]:
    """Which points have a specular lobe: metals, and dielectrics whose index differs from 1.

    Args:
        gbuffer: Any G-buffer.
    Returns:
        True where there is something to reflect.
    """
    return gbuffer.valid & ((gbuffer.metallic > 0) | (gbuffer.eta != 1))


def refractive(gbuffer: GBuffer) -> Bool[Array, "*b"]:
    """Which points let light through.

    Args:
        gbuffer: Any G-buffer.
    Returns:
        True where some of the light that enters the surface is refracted.
    """
    if gbuffer.transmission is None:
        return jnp.zeros_like(gbuffer.valid)
    return gbuffer.valid & (gbuffer.transmission * (1 - gbuffer.metallic) > 0)


def specular_colour(gbuffer: GBuffer) -> Float[Array, "*b 3"]:
    """Reflectance at normal incidence, F0.

    $$ F_0 = (1 - m) \\left(\\frac{\\eta - 1}{\\eta + 1}\\right)^2 + m\\, c $$

    Args:
        gbuffer: Any G-buffer.
    Returns:
        F0 per channel, in [0, 1].
    Source: glTF 2.0 appendix B.
    """
    dielectric = jnp.broadcast_to(f0_from_eta(gbuffer.eta)[..., None], gbuffer.base_colour.shape)
    metal = _at_complex_index(gbuffer, jnp.ones_like(gbuffer.eta), gbuffer.base_colour)
    return lerp(dielectric, metal, gbuffer.metallic)


def metal_fresnel(gbuffer: GBuffer, cos: Float[Array, "*b"]) -> Float[Array, "*b 3"]:
    """Reflectance of a metal's microfacet: exact where the complex index is known, Schlick's elsewhere.

    Args:
        gbuffer: Any G-buffer.
        cos: Cosine between the viewer and the microfacet's normal.
    Returns:
        Reflectance per channel, in [0, 1].
    """
    return _at_complex_index(gbuffer, cos, fresnel_schlick(cos[..., None], gbuffer.base_colour))


def _at_complex_index(gbuffer: GBuffer, cos: Float[Array, "*b"], other: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The reflectance of metals whose complex index is known, and that of the `other` ones."""
    if (metal := gbuffer.conductor) is None:
        return other
    exact = gbuffer.base_colour * fresnel_conductor(cos[..., None], metal.eta, metal.k)
    return jnp.where(metal.known[..., None], exact, other)


def dielectric_fresnel(gbuffer: GBuffer, cos: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Reflectance of a dielectric's microfacet, from whichever side it is seen.

    Args:
        gbuffer: Any G-buffer.
        cos: Cosine between the viewer and the microfacet's normal.
    Returns:
        Reflectance in [0, 1]; 1 beyond the critical angle.
    """
    return fresnel_dielectric(cos, relative_eta(gbuffer))


def relative_eta(gbuffer: GBuffer) -> Float[Array, "*b"]:
    """Index of refraction of the far side over that of the viewer's side.

    Args:
        gbuffer: Any G-buffer.
    Returns:
        `eta` from outside, its inverse from inside.
    """
    return jnp.where(gbuffer.outside, gbuffer.eta, 1 / gbuffer.eta)


def diffuse_albedo(gbuffer: GBuffer) -> Float[Array, "*b 3"]:
    """Share of the light entering the surface that is scattered diffusely.

    Args:
        gbuffer: Any G-buffer.
    Returns:
        Albedo per channel: base colour of what is neither metal nor transparent; of a coupled material what its base
        colour leaves after the bounces beneath the interface.
    """
    share = 1 - gbuffer.metallic
    if gbuffer.transmission is not None:
        share = share * (1 - gbuffer.transmission)
    return albedo_above(gbuffer) * share[..., None]


def mirror_direction(gbuffer: GBuffer) -> Float[Array, "*b 3"]:
    """The mirror direction of the viewer about the shading normal, kept above the geometric surface.

    Args:
        gbuffer: Any G-buffer.
    Returns:
        Unit directions `wi`, pointing away from the surface.
    Edge cases: where a shading normal would send the reflection into the surface, it is bent to graze it.
    """
    return keep_above(reflect(gbuffer.wo, gbuffer.ns), gbuffer.n)


def keep_above(wi: Float[Array, "*b 3"], n: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Bend directions that point into a surface so that they graze it.

    Args:
        wi: Unit directions.
        n: Geometric unit normals.
    Returns:
        Unit directions with `dot(wi, n)` of at least about `GRAZING`; others unchanged.
    """
    height = dot(wi, n)
    lifted = normalise(wi + n * (GRAZING - height)[..., None], fill=(0, 0, 1))
    return jnp.where((height < GRAZING)[..., None], lifted, wi)


class LobeAlbedo(NamedTuple):
    """What the table of `core.albedo` says of each point's lobe; looked up once, used by all that depends on it."""

    scale: Float[Array, "*b"]
    """A: factor of F0 in the lobe's albedo under Schlick's Fresnel term."""
    bias: Float[Array, "*b"]
    """B: its constant part; A + B is the albedo for F = 1."""
    cosine: Float[Array, "*b"]
    """Cosine at which any other Fresnel term equals its average over the lobe."""


def lobe_albedo(gbuffer: GBuffer) -> LobeAlbedo:
    """The lobe's albedo as a function of its Fresnel term.

    Args:
        gbuffer: Any G-buffer.
    Returns:
        Scale, bias and the effective cosine.
    """
    cos_o = jnp.clip(dot(gbuffer.ns, gbuffer.wo), 1e-4, 1)
    return LobeAlbedo(*ggx_albedo(cos_o, gbuffer.alpha), lobe_fresnel_cosine(cos_o, gbuffer.alpha))


def specular_weight(
    gbuffer: GBuffer, *, fresnel: str = "exact", multiple_scattering: bool = True
) -> Float[Array, "*b 3"]:
    """Share of the mean radiance of the lobe that reaches the viewer: the lobe's directional albedo.

    $$ E = E_{ss}(\\mu, \\alpha)\\, \\bar F \\,\\bigl(1 + F_0\\,(1 / E_{ss} - 1)\\bigr) $$

    Args:
        gbuffer: Any G-buffer.
        fresnel: "exact" dielectric equations, or "schlick" as in glTF and most game engines; metals use Schlick.
        multiple_scattering: Add the light that leaves after several bounces between microfacets. Without it a rough
            white metal loses about half, as it does in renderers with single scattering.
    Returns:
        Weight per channel, in [0, 1]; 0 where the surface is not reflective.
    Raises:
        ValueError: If `fresnel` is neither of the two.
    Edge cases: seen from the inside, beyond the critical angle, the weight of a smooth surface is 1.
    Source: [Karis13] for the split of albedo and radiance, [Turquin19] §3 for multiple scattering.
    """
    if fresnel not in ("exact", "schlick"):
        raise ValueError(f"fresnel: expected 'exact' or 'schlick', got {fresnel!r}")
    return weight_of_albedo(gbuffer, lobe_albedo(gbuffer), fresnel=fresnel, multiple_scattering=multiple_scattering)


def weight_of_albedo(
    gbuffer: GBuffer, albedo: LobeAlbedo, *, fresnel: str = "exact", multiple_scattering: bool = True
) -> Float[Array, "*b 3"]:
    """`specular_weight` where the lobe's albedo has been looked up before.

    Args:
        gbuffer: Any G-buffer.
        albedo: Its `lobe_albedo`.
        fresnel: As for `specular_weight`.
        multiple_scattering: As for `specular_weight`.
    Returns:
        Weight per channel, in [0, 1].
    """
    scale, bias, cosine = albedo
    single = scale + bias
    f0 = specular_colour(gbuffer)
    if fresnel == "exact":
        dielectric = single * dielectric_fresnel(gbuffer, cosine)
    else:
        dielectric = f0_from_eta(gbuffer.eta) * scale + bias
    metal = gbuffer.base_colour * scale[..., None] + bias[..., None]
    if gbuffer.conductor is not None:
        exact = single[..., None] * metal_fresnel(gbuffer, cosine)
        metal = jnp.where(gbuffer.conductor.known[..., None], exact, metal)
    weight = lerp(jnp.broadcast_to(dielectric[..., None], metal.shape), metal, gbuffer.metallic)
    if multiple_scattering:
        weight = weight * (1 + f0 * (1 / jnp.maximum(single, 1e-3) - 1)[..., None])
    return jnp.where(reflective(gbuffer)[..., None], jnp.clip(weight, 0, 1), 0)


def transmission_weight(gbuffer: GBuffer, specular: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Share of the radiance behind a refractive surface that reaches the viewer.

    Args:
        gbuffer: Any G-buffer.
        specular: Its `specular_weight`.
    Returns:
        Weight per channel: what is not reflected, times transmission and base colour; 0 for opaque surfaces.
    """
    if gbuffer.transmission is None:
        return jnp.zeros_like(specular)
    share = gbuffer.transmission * (1 - gbuffer.metallic)
    return (1 - specular) * gbuffer.base_colour * share[..., None]


def sample_reflection(gbuffer: GBuffer, u: Float[Array, "*b 2"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b"]]:
    """A direction from the specular lobe, by its visible normals.

    $$ w = G_2 / G_1 $$

    Args:
        gbuffer: Any G-buffer.
        u: Uniform numbers in [0, 1).
    Returns:
        Unit directions `wi`, and the weight of the radiance that arrives along them: the lobe's mean radiance is
        `sum(w L) / sum(w)`, its single-scattering albedo for F = 1 is `mean(w)`.
    Edge cases: at alpha 0 always the mirror direction with weight 1. Directions below the surface, which microfacets
        mask, are folded up and weigh `FOLDED`: they count where a pixel has no better sample, and nowhere else.
    Source: [Heitz18] for visible normals.
    """
    wo = to_local(gbuffer.wo, gbuffer.ns)
    wi = reflect(wo, sample_visible_normal(wo, gbuffer.alpha, u))
    ratio = reflection_weight(wo[..., 2], wi[..., 2], gbuffer.alpha)
    smooth = gbuffer.alpha == 0
    masked = wi[..., 2] <= 0
    folded = jnp.stack([wi[..., 0], wi[..., 1], jnp.abs(wi[..., 2])], -1)
    direction = keep_above(to_world(folded, gbuffer.ns), gbuffer.n)
    direction = jnp.where(smooth[..., None], mirror_direction(gbuffer), direction)
    return direction, jnp.where(smooth, 1, jnp.where(masked, FOLDED, jnp.maximum(ratio, FOLDED)))


def sample_refraction(gbuffer: GBuffer, thin: Bool[Array, "*b"], u: Float[Array, "*b 2"]) -> Float[Array, "*b 3"]:
    """A direction through a refractive surface, by its visible normals.

    Args:
        gbuffer: Any G-buffer.
        thin: True where the material is a pane without volume, which light passes straight through.
        u: Uniform numbers in [0, 1).
    Returns:
        Unit directions on the far side of the surface.
    Edge cases: beyond the critical angle the direction is the mirror direction, on the near side.
    """
    wo = to_local(gbuffer.wo, gbuffer.ns)
    h = to_world(sample_visible_normal(wo, gbuffer.alpha, u), gbuffer.ns)
    through, possible = refract(gbuffer.wo, h, relative_eta(gbuffer))
    through = -keep_above(-through, gbuffer.n)
    inward = jnp.where(possible[..., None], through, keep_above(reflect(gbuffer.wo, h), gbuffer.n))
    return jnp.where(thin[..., None], -gbuffer.wo, inward)
