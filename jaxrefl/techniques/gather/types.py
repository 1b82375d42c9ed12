"""Knobs and results of image-space gathering."""

import dataclasses

import equinox as eqx
from jaxtyping import Array, Float

from jaxrefl.techniques._knobs import option, tunable
from jaxrefl.techniques._shape import Info as Info
from jaxrefl.techniques._tracing import TraceOptions


class Params(eqx.Module):
    """Tunable numbers."""

    normal: Float[Array, ""] = tunable(0.8, -1.0, 1.0, "Least cosine between normals that are gathered together.")
    depth: Float[Array, ""] = tunable(
        0.1, 0.0, 10.0, "Largest distance from a pixel's plane that is gathered with it, as a share of the depth."
    )
    cone: Float[Array, ""] = tunable(
        2.0, 0.1, 8.0, "Tangent of the cone around the mirror direction, as a multiple of alpha; one deviation."
    )


@dataclasses.dataclass(frozen=True)
class Options(TraceOptions):
    """Static knobs: those of tracing and of the two searches."""

    search: int = option(0, "Pixels of the disk searched for the nearest reflected point; 0: its own.", low=0, high=256)
    radius: int = option(6, "Pixels to either side that are averaged; wider cones use coarser layers.", low=1, high=128)
    layers: int = option(10, "Most layers of the pyramid, the image included.", low=1, high=16)


class State(eqx.Module):
    """Gathering carries nothing from frame to frame."""
