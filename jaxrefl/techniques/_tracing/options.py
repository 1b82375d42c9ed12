"""Static knobs of traced reflections, shared by every technique that traces pixels."""

import dataclasses

from jaxrefl.radiance.light_model import MODELS
from jaxrefl.techniques._knobs import check_options, option


@dataclasses.dataclass(frozen=True)
class TraceOptions:
    """How a reflection is traced; techniques add knobs of their own."""

    samples: int = option(1, "Rays per glossy pixel; mirrors need one and take more light samples.", low=1, high=65536)
    bounces: int = option(0, "Further mirror bounces; 0 shows mirrors by their diffuse colour.", low=0, high=16)
    interfaces: int = option(4, "Refractive interfaces a ray may pass.", low=1, high=32)
    area_samples: int = option(1, "Shadow rays to area lights at each reflected hit.", low=1, high=4096)
    environment_samples: int = option(1, "Shadow rays to the environment at each reflected hit.", low=1, high=4096)
    light: str = option("direct", "Light at reflected hits; path brings all there is.", choices=MODELS)
    path_bounces: int = option(
        15, "Most scattering events of a path, the reflector's included (path).", low=1, high=1000
    )
    block: int = option(65536, "Pixels traced at a time; bounds memory.", low=256, high=4194304)

    def __post_init__(self):
        check_options(self)
