"""Knobs, state and results of classic environment mapping."""

import dataclasses

import equinox as eqx
from jaxtyping import Array, Float, Int

from jaxrefl.radiance.light_model import MODELS, LightOptions
from jaxrefl.techniques._captured import SCOPES
from jaxrefl.techniques._knobs import check_options, option
from jaxrefl.techniques._shape import Info as Info


class Params(eqx.Module):
    """Environment mapping has no tunable numbers."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Static knobs."""

    scope: str = option("object", "One map per reflector, or one for the whole scene.", choices=SCOPES)
    height: int = option(256, "Rows of each captured map; it has twice as many columns.", low=16, high=2048)
    rough_height: int = option(64, "Rows of the prefiltered maps for rough surfaces.", low=8, high=128)
    levels: int = option(6, "Prefiltered maps between alpha 0.05 and 1.", low=2, high=16)
    reflectors: int = option(32, "Most reflectors with a map of their own; the rest use the scene's.", low=1, high=1024)
    area_samples: int = option(4, "Shadow rays to area lights at each captured point.", low=1, high=4096)
    environment_samples: int = option(4, "Shadow rays to the environment at each captured point.", low=1, high=4096)

    light: str = option("direct", "Diffuse light of the captured surroundings.", choices=MODELS)
    path_samples: int = option(16, "Paths at each captured point (path).", low=1, high=65536)

    def __post_init__(self):
        check_options(self)

    @property
    def captured(self) -> LightOptions:
        """Diffuse light of the captured surroundings."""
        return LightOptions(
            model=self.light,
            area_samples=self.area_samples,
            environment_samples=self.environment_samples,
            path_samples=self.path_samples,
        )


class State(eqx.Module):
    """Captured and prefiltered maps; row `r` is one capture. All maps are latitude-longitude, row 0 up."""

    centre: Float[Array, "r 3"]
    """Where each map was captured, world space."""
    sharp: Float[Array, "r h w 3"]
    """Captured radiance."""
    nearness: Float[Array, "r hr wr"]
    """One over the distance to what was captured, averaged over a wide lobe, per world unit; 0 for the environment."""
    rough: Float[Array, "r l hr wr 3"]
    """Radiance convolved with GGX lobes of rising alpha."""
    alpha: Float[Array, "l"]
    """Alpha of each rough level, rising."""
    map_of_object: Int[Array, "o"]
    """Row of each object's map; -1 for objects that reflect nothing."""
    overflow: Int[Array, ""]
    """Reflectors that share the scene's map because there were more than `Options.reflectors`."""
    rays: Int[Array, ""]
    """Rays cast by `init`."""
