r"""The whole scattering function of a surface: lobes, their evaluation towards a light, and sampling a new direction.

Three lobes, each estimated on its own so that light can be told apart by the lobe that reflects it:

$$ f \cos\theta_i = \underbrace{(1 - E_o)\,\tfrac{\rho'}{\pi}\,c(\omega_i) \cos\theta_i}_{\text{diffuse}}
   + \underbrace{F(h)\,b\,\tfrac{D\,G_2}{4 \cos\theta_o}}_{\text{reflection}}
   + \underbrace{(1 - F(h))\,b_t\,\tau\,(\dots)}_{\text{refraction}} $$

with the lobe's albedo $E_o$, the diffuse albedo $\rho'$, the coupling $c$ of `surface.coupling`, the compensation for
several bounces between microfacets $b = 1 + F_0 (1/E_{ss} - 1)$ and the share $\tau$ of refracted light. Integrals are
those of `surface.specular`, so the images agree with `composite` up to the average of F over the lobe.

At alpha 0 the specular lobes are Dirac deltas: their evaluation is 0 and their samples have the density 0, which marks
directions that no light sample can find.

Sources: [WMLT07] §5.2; [Turquin19] for b; `surface.coupling` for c.
"""

import dataclasses
import functools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import GBuffer
from jaxrefl.core import (
    apart,
    disk,
    dot,
    lerp,
    luminance,
    reflect,
    reflection_pdf,
    reflection_weight,
    refract,
    sample_visible_normal,
    smith_g1,
    to_local,
    to_world,
)
from jaxrefl.core.safe import divide, normalise, sqrt
from jaxrefl.surface.coupling import coupling, single_scattering_loss
from jaxrefl.surface.rough_interface import transmittance_once
from jaxrefl.surface.specular import (
    LobeAlbedo,
    dielectric_fresnel,
    diffuse_albedo,
    keep_above,
    metal_fresnel,
    reflective,
    relative_eta,
    specular_colour,
    weight_of_albedo,
)

DIFFUSE, REFLECTED, REFRACTED, STRAIGHT = 0, 1, 2, 3
"""Lobes of a sample; STRAIGHT passes a cut-out surface as if it were not there."""


@dataclasses.dataclass(frozen=True)
class Scattering:
    """Which of several models of a rough surface; static."""

    masking: str = "correlated"
    """"correlated" (height-correlated Smith), or "separable" as in Mitsuba: a few per cent darker when rough."""
    multiple_scattering: bool = True
    """Add the light that leaves after several bounces between microfacets."""

    def __post_init__(self):
        if self.masking not in ("correlated", "separable"):
            raise ValueError(f"masking: expected 'correlated' or 'separable', got {self.masking!r}")


class Lobes(eqx.Module):
    """What depends on the surface and the viewer alone."""

    wo: Float[Array, "n 3"]
    """Unit direction to the viewer, local."""
    specular: Float[Array, "n 3"]
    """Directional albedo of the reflection, E."""
    boost: Float[Array, "n 3"]
    """Compensation b for what single scattering loses, times `single`: the factor from F to the lobe's weight."""
    single: Float[Array, "n"]
    """Albedo of the lobe for F = 1, E_ss: what the lobe's mean radiance is an average over."""
    diffuse: Float[Array, "n 3"]
    """Diffuse albedo rho', without the factor (1 - E) that `composite` applies."""
    refracted: Float[Array, "n 3"] | None
    """Share and colour of what is refracted, tau b_t; None: nothing is refractive."""
    p_diffuse: Float[Array, "n"]
    """Probability with which a sample is drawn from the diffuse lobe."""


class Scattered(eqx.Module):
    """A sampled direction."""

    wi: Float[Array, "n 3"]
    """Unit direction, world space."""
    weight: Float[Array, "n 3"]
    """Scattered radiance per incoming radiance, over the density; 0: the path ends. Without `fresnel`."""
    fresnel: Float[Array, "n 3"]
    """The rest of the weight of specular samples: what turns the lobe's mean radiance into what leaves; else 1."""
    density: Float[Array, "n"]
    """Density per solid angle with which its lobe is sampled, the choice of the lobe included; 0 for a delta."""
    lobe: Int[Array, "n"]
    """DIFFUSE, REFLECTED, REFRACTED or STRAIGHT."""
    eta_scale: Float[Array, "n"]
    """Squared relative index of a refraction, 1 elsewhere: `weight` is divided by it, as radiance is smaller outside a
    dense medium than inside; it recovers where the path leaves."""


class Response(eqx.Module):
    """Scattered radiance per incoming radiance, cosine included, and the densities of the lobes."""

    diffuse: Float[Array, "n 3"]
    """Diffuse lobe, without the factor (1 - E) that `composite` applies."""
    reflected: Float[Array, "n 3"]
    """Specular reflection relative to E_ss, without `fresnel`: what it adds to the lobe's mean radiance."""
    fresnel: Float[Array, "n 3"]
    """F(h) b E_ss: the lobe's weight in this direction."""
    diffuse_density: Float[Array, "n"]
    """Density of diffuse samples, 1/sr."""
    reflected_density: Float[Array, "n"]
    """Density of specular samples, 1/sr."""


def lobes_of(points: GBuffer, albedo: LobeAlbedo, model: Scattering) -> Lobes:
    """The lobes of each surface as its viewer sees them.

    Args:
        points: Points [n].
        albedo: Their `surface.lobe_albedo`.
        model: Which model of rough surfaces.
    Returns:
        Albedos and probabilities.
    Edge cases: a point that reflects nothing has zero albedos and `p_diffuse` 1.
    """
    wo = to_local(points.wo, points.ns)
    wo = jnp.stack([wo[:, 0], wo[:, 1], jnp.maximum(wo[:, 2], 1e-4)], -1)
    wo = normalise(wo)
    seen = points.valid
    weigh = functools.partial(weight_of_albedo, multiple_scattering=model.multiple_scattering)
    specular = apart(seen, weigh, points, albedo)
    single = jnp.maximum(albedo.scale + albedo.bias, 1e-3)
    boost = jnp.broadcast_to(single[:, None], specular.shape)
    if model.multiple_scattering:
        boost = boost * (1 + apart(seen, specular_colour, points) * (1 / single - 1)[:, None])
    rest = 1 - specular
    diffuse = apart(seen, diffuse_albedo, points)
    if points.coupled is not None and not model.multiple_scattering:
        diffuse = diffuse * apart(points.coupled, single_scattering_loss, points, wo[:, 2], fill=1.0)
    refracted, into = None, 0.0
    if points.transmission is not None:
        share = points.transmission * (1 - points.metallic)
        refracted = points.base_colour * share[:, None]
        if model.multiple_scattering:
            refracted = refracted * apart(share > 0, _refraction_boost, points, wo[:, 2], rest, fill=1.0)[:, None]
        into = luminance(rest * points.base_colour) * share
    upper, lower = luminance(specular) + into, luminance(diffuse * rest)
    # Neither lobe below a tenth while it is there at all: what the luminance misses in one channel stays bounded.
    share = jnp.clip(divide(lower, upper + lower), 0.1, 0.9)
    p_diffuse = jnp.where(upper <= 0, 1.0, jnp.where(lower <= 0, 0.0, share))
    return Lobes(wo, specular, boost, single, diffuse, refracted, p_diffuse)


def _refraction_boost(points: GBuffer, cos_o: Float[Array, "n"], rest: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """Compensation for the refracted light that single scattering loses, so that with the reflection all is there.

    From inside there is none: the average Fresnel term of `specular_weight` is too poor there to divide by.
    """
    boost = divide(rest[:, 1], transmittance_once(cos_o, points.alpha, points.eta), fill=1.0)
    return jnp.where(points.outside & (points.alpha > 0), jnp.clip(boost, 1, 4), 1)


def respond(points: GBuffer, lobes: Lobes, wi: Float[Array, "n 3"], model: Scattering) -> Response:
    r"""What a surface makes of light from a direction.

    Args:
        points: Points [n].
        lobes: From `lobes_of`.
        wi: Unit directions to the light, world space.
        model: Which model of rough surfaces.
    Returns:
        Radiance towards the viewer per incoming radiance, by lobe. Refraction is not evaluated: its samples find light
        on their own.
    Edge cases: 0 for light from below the shading or the geometric normal, and for specular lobes at alpha 0.
    """
    local = to_local(wi, points.ns)
    cos_i = local[:, 2]
    above = points.valid & (cos_i > 0) & (dot(points.n, wi) > 0)
    density = jnp.where(above, jnp.maximum(cos_i, 0) / jnp.pi, 0)
    single = not model.multiple_scattering
    diffuse = lobes.diffuse * (density * _coupling(points, cos_i, single))[:, None]

    h = normalise(lobes.wo + local, fill=(0, 0, 1))
    cos_h = dot(lobes.wo, h)
    fresnel = apart(points.valid, _fresnel, points, cos_h) * lobes.boost
    glossy = jnp.where(above & reflective(points), reflection_pdf(lobes.wo, local, points.alpha), 0)
    reflected = glossy * _masked(lobes.wo[:, 2], cos_i, points.alpha, model) / lobes.single
    chosen = (1 - lobes.p_diffuse) * _p_reflect(points, lobes, fresnel)
    return Response(
        diffuse=diffuse,
        reflected=jnp.broadcast_to(reflected[:, None], diffuse.shape),
        fresnel=fresnel,
        diffuse_density=lobes.p_diffuse * density,
        reflected_density=chosen * glossy,
    )


class Draws(eqx.Module):
    """Random directions, before a lobe is chosen."""

    diffuse: Float[Array, "n 3"]
    """Unit direction from the cosine lobe, local."""
    h: Float[Array, "n 3"]
    """Unit normal of a visible microfacet, local."""


def draw_directions(points: GBuffer, lobes: Lobes, u: Float[Array, "n 2"]) -> Draws:
    """One direction from each lobe.

    Args:
        points: Points [n].
        lobes: From `lobes_of`.
        u: Uniform numbers; both lobes share them, since one of the two is used.
    Returns:
        The directions.
    """
    point = disk(u)
    x, y = point[:, 0], point[:, 1]
    cosine = jnp.stack([x, y, sqrt(1 - x * x - y * y)], -1)
    return Draws(cosine, sample_visible_normal(lobes.wo, points.alpha, u))


def scatter(
    points: GBuffer,
    lobes: Lobes,
    draws: Draws,
    thin: Bool[Array, "n"] | None,
    choice: Float[Array, "n 2"],
    model: Scattering,
) -> Scattered:
    """A direction in which a path goes on.

    Args:
        points: Points [n].
        lobes: From `lobes_of`.
        draws: From `draw_directions`.
        thin: True where the material is a pane without volume; None: nothing is refractive.
        choice: Uniform numbers that choose the lobe, and between reflection and refraction.
        model: Which model of rough surfaces.
    Returns:
        Directions with weights and densities.
    Edge cases: specular directions below the geometric surface are bent to graze it, and count as deltas; directions
        that microfacets mask have the weight 0.
    """
    is_diffuse = choice[:, 0] < lobes.p_diffuse
    wd, h = to_world(draws.diffuse, points.ns), draws.h
    cos_d = draws.diffuse[:, 2]
    lit = jnp.where(dot(points.n, wd) > 0, _coupling(points, cos_d, not model.multiple_scattering), 0)

    cos_h = dot(lobes.wo, h)
    local = reflect(lobes.wo, h)
    fresnel = apart(points.valid, _fresnel, points, cos_h) * lobes.boost
    p_reflect = apart(points.valid, _p_reflect, points, lobes, fresnel)
    reflects = choice[:, 1] < p_reflect
    free = to_world(local, points.ns)
    wr = keep_above(free, points.n)
    bent = dot(points.n, free) <= 0
    masked = _masked(lobes.wo[:, 2], local[:, 2], points.alpha, model) / lobes.single
    chosen = (1 - lobes.p_diffuse) * p_reflect
    density = jnp.where(bent, 0, chosen * reflection_pdf(lobes.wo, local, points.alpha))

    one = jnp.ones_like(wd)
    pick = is_diffuse[:, None]
    wi = jnp.where(pick, wd, wr)
    # Diffuse weights leave out (1 - E) like `Response.diffuse`; it is the `fresnel` of the diffuse lobe.
    weight = jnp.where(
        pick,
        lobes.diffuse * divide(lit, lobes.p_diffuse)[:, None],
        one * divide(masked, chosen)[:, None],
    )
    factor = jnp.where(pick, 1 - lobes.specular, fresnel)
    density = jnp.where(is_diffuse, lobes.p_diffuse * cos_d / jnp.pi, density)
    lobe = jnp.where(is_diffuse, DIFFUSE, REFLECTED)
    eta_scale = jnp.ones_like(cos_d)
    if lobes.refracted is not None and thin is not None:
        through = ~is_diffuse & ~reflects
        into, seen, eta_scale = apart(through, _refraction, points, h, thin)
        p_through = (1 - lobes.p_diffuse) * (1 - p_reflect)
        wi = jnp.where(through[:, None], into, wi)
        weight = jnp.where(through[:, None], one * divide(seen, p_through)[:, None], weight)
        factor = jnp.where(through[:, None], _transmitted(points, lobes, cos_h), factor)
        density = jnp.where(through, 0, density)
        lobe = jnp.where(through, REFRACTED, lobe)
        eta_scale = jnp.where(through, eta_scale, 1)
    return Scattered(wi, weight, factor, density, lobe.astype(jnp.int32), eta_scale)


def _refraction(
    points: GBuffer, h: Float[Array, "n 3"], thin: Bool[Array, "n"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n"], Float[Array, "n"]]:
    """Directions through microfacets with the local normal h, their weights, and the squared relative index."""
    eta = relative_eta(points)
    into, possible = refract(points.wo, to_world(h, points.ns), eta)
    into = jnp.where(thin[:, None], -points.wo, -keep_above(-into, points.n))
    # The two sides are masked by different microfacets: G2 is a product whatever the model, so G2 / G1 is one G1.
    seen = smith_g1(jnp.abs(dot(points.ns, into)), points.alpha)
    eta_scale = jnp.where(thin, 1, eta * eta)
    return into, jnp.where(thin, 1, jnp.where(possible, seen, 0)) / eta_scale, eta_scale


def _coupling(points: GBuffer, cos_i: Float[Array, "n"], single: bool) -> Float[Array, "n"]:
    if points.coupled is None:
        return jnp.ones_like(cos_i)
    return apart(points.coupled, functools.partial(coupling, single=single), points, cos_i, fill=1.0)


def _fresnel(points: GBuffer, cos_h: Float[Array, "n"]) -> Float[Array, "n 3"]:
    dielectric = jnp.broadcast_to(dielectric_fresnel(points, cos_h)[:, None], points.base_colour.shape)
    return lerp(dielectric, metal_fresnel(points, cos_h), points.metallic)


def _transmitted(points: GBuffer, lobes: Lobes, cos_h: Float[Array, "n"]) -> Float[Array, "n 3"]:
    """(1 - F) tau b_t."""
    if lobes.refracted is None:
        return jnp.zeros_like(points.base_colour)
    return lobes.refracted * (1 - dielectric_fresnel(points, cos_h))[:, None]


def _p_reflect(points: GBuffer, lobes: Lobes, fresnel: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """Probability that a specular sample is reflected rather than refracted; 1 on opaque surfaces."""
    if lobes.refracted is None or points.transmission is None:
        return jnp.ones_like(points.alpha)
    reflected = luminance(fresnel)
    refracted = luminance(lobes.refracted * jnp.maximum(1 - fresnel, 0))
    return divide(reflected, reflected + refracted, fill=1.0)


def _masked(
    cos_o: Float[Array, "n"], cos_i: Float[Array, "n"], alpha: Float[Array, "n"], model: Scattering
) -> Float[Array, "n"]:
    """G2 / G1 of reflection: 0 below the surface."""
    if model.masking == "separable":
        return smith_g1(cos_i, alpha)
    return reflection_weight(cos_o, cos_i, alpha)
