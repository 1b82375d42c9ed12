"""Knobs and results of brute-force ray tracing."""

import dataclasses

import equinox as eqx

from jaxrefl.techniques._shape import Info as Info
from jaxrefl.techniques._tracing import TraceOptions


class Params(eqx.Module):
    """Ray tracing has no tunable numbers."""


@dataclasses.dataclass(frozen=True)
class Options(TraceOptions):
    """Static knobs: those of tracing, and no others."""


class State(eqx.Module):
    """Ray tracing carries nothing from frame to frame."""
