"""Putting the layers together: GBuffer + diffuse + Reflection -> image."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl._types import GBuffer, Reflection
from jaxrefl.surface.specular import specular_weight, transmission_weight


@dataclasses.dataclass(frozen=True)
class Options:
    """How layers are weighed; static."""

    fresnel: str = dataclasses.field(
        default="exact",
        metadata={"help": "Fresnel equations of dielectrics: exact or schlick.", "choices": ("exact", "schlick")},
    )
    multiple_scattering: bool = dataclasses.field(
        default=True, metadata={"help": "Add the energy of several bounces between microfacets of rough surfaces."}
    )

    def __post_init__(self):
        if self.fresnel not in ("exact", "schlick"):
            raise ValueError(f"composite.fresnel: expected 'exact' or 'schlick', got {self.fresnel!r}")


@functools.partial(jax.jit, static_argnames="options")
def blend(
    gbuffer: GBuffer,
    diffuse: Float[Array, "h w 3"],
    reflection: Reflection,
    *,
    options: Options = Options(),  # noqa: B008  frozen
) -> Float[Array, "h w 3"]:
    """Image from its layers.

    $$ I = L_e + (1 - E)\\, L_d + E\\, L_r + T\\, L_t $$

    Args:
        gbuffer: What is seen at each pixel.
        diffuse: Emitted plus diffusely reflected radiance, linear, and the background where no surface is seen
            (`radiance.direct_light`).
        reflection: Incoming radiance before Fresnel and specular colour, from any technique.
        options: Fresnel model and energy compensation.
    Returns:
        Linear radiance [h w 3].
    Edge cases: pixels whose reflection is not valid show none: the weight of L_r is 0, and L_d keeps its (1 - E).
    """
    specular = specular_weight(gbuffer, fresnel=options.fresnel, multiple_scattering=options.multiple_scattering)
    emission = jnp.zeros_like(diffuse) if gbuffer.emission is None else gbuffer.emission
    image = emission + (1 - specular) * (diffuse - emission)
    image = image + jnp.where(reflection.valid[..., None], specular * reflection.radiance, 0)
    if reflection.transmitted is not None:
        image = image + transmission_weight(gbuffer, specular) * reflection.transmitted
    return jnp.where(gbuffer.valid[..., None], image, diffuse)
