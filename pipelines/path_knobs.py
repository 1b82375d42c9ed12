"""The knobs of `jaxrefl reference`: the path tracer's choices under the names that job files and flags use."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jaxrefl.radiance.path_types import PathOptions
from jaxrefl.radiance.progressive import ProgressiveOptions
from jaxrefl.surface.bsdf import Scattering
from jaxrefl.techniques._knobs import check_options, option
from pipelines.knobs import build


@dataclass(frozen=True)
class PathKnobs:
    """How the reference's paths are followed."""

    pixel: str = option(
        "centre",
        "Where paths leave a pixel: at its centre, as techniques do, so that errors can be measured pixel by pixel "
        "(compare needs it), or anywhere in its box, for a picture with smooth edges.",
        choices=("centre", "box"),
    )
    bounces: int = option(15, "Most scattering events of a path; 1 is direct light.", low=0, high=PathOptions.LONGEST)
    roulette_from: int = option(
        4, "Scattering events after which dim paths are ended by chance.", low=0, high=PathOptions.LONGEST
    )
    sampler: str = option(
        "sobol", "Random numbers: low-discrepancy or independent ones.", choices=("sobol", "independent")
    )
    masking: str = option(
        "correlated", "Shadowing between microfacets; separable as in Mitsuba.", choices=("correlated", "separable")
    )
    multiple_scattering: bool = option(True, "Add the light that bounces several times between microfacets.")

    def __post_init__(self):
        check_options(self)


def progressive_options(values: Mapping[str, Any]) -> ProgressiveOptions:
    """The path tracer's options.

    Args:
        values: Values of `PathKnobs` by name.
    Returns:
        Options for `render_progressively`.
    Raises:
        JobError: If a value does not fit.
    """
    knobs: PathKnobs = build(PathKnobs, values, where="[path]")
    scattering = Scattering(masking=knobs.masking, multiple_scattering=knobs.multiple_scattering)
    path = PathOptions(
        bounces=knobs.bounces, roulette_from=knobs.roulette_from, sampler=knobs.sampler, scattering=scattering
    )
    return ProgressiveOptions(path=path, pixel=knobs.pixel)
