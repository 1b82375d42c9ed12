"""Knobs, state and results of mirror rays followed by the gloss filter."""

import dataclasses

import equinox as eqx
from jaxtyping import Array, Float

from jaxrefl.filters import FootprintOptions, GlossOptions, GlossParams, LobeTable, TableOptions
from jaxrefl.techniques._knobs import option, tunable
from jaxrefl.techniques._shape import Info as Info
from jaxrefl.techniques._tracing import TraceOptions


class Params(eqx.Module):
    """Tunable numbers."""

    normal: Float[Array, ""] = tunable(0.8, -1.0, 1.0, "Least cosine between normals that are filtered together.")
    depth: Float[Array, ""] = tunable(
        0.1, 0.0, 10.0, "Largest distance from a pixel's plane that is filtered with it, as a share of the depth."
    )

    @property
    def gloss(self) -> GlossParams:
        """Thresholds of the filter."""
        return GlossParams(self.normal, self.depth)


@dataclasses.dataclass(frozen=True)
class Options(TraceOptions):
    """Static knobs: those of tracing, of footprints and of the filter."""

    method: str = option(
        "window",
        "How the filter is evaluated: a window of pixels, or passes along lines.",
        choices=("window", "separable", "four_pass"),
    )
    radius: int = option(6, "Pixels or taps to either side; wider footprints use coarser layers.", low=1, high=128)
    layers: int = option(10, "Most layers of the pyramid, the image included.", low=1, high=16)
    taps: str = option("nearest", "Where passes read.", choices=("nearest", "linear"))
    spread: bool = option(True, "Let neighbours count as their own distance says, not as the pixel's does.")
    lobe: str = option("two", "Gaussians that stand for the lobe.", choices=("two", "one", "moments"))
    within: str = option(
        "plane",
        "What is filtered together: all of a smooth surface, or only one material. A mirror image goes on across both.",
        choices=("plane", "material"),
    )
    surface: str = option("plane", "What is taken to be reflected.", choices=("plane", "sphere"))
    foreshortening: str = option(
        "derived", "How slanted reflectors narrow the footprint.", choices=("derived", "published")
    )
    curvature: bool = option(True, "Take the reflector's curvature into account.")

    @property
    def filter(self) -> GlossOptions:
        """Options of the filter."""
        return GlossOptions(self.method, self.radius, self.layers, self.taps, self.spread)

    @property
    def footprint(self) -> FootprintOptions:
        """Options of footprints."""
        return FootprintOptions(self.foreshortening, self.curvature)

    @property
    def table(self) -> TableOptions:
        """What is tabulated."""
        return TableOptions(self.lobe, self.surface)


class State(eqx.Module):
    """What `init` prepares; it does not change."""

    table: LobeTable | None = None
    """Gaussians for lobes; None: nothing in the scene is glossy."""
