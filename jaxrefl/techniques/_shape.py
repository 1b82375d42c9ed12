"""The one shape of every technique: what the runner can rely on."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Shaped


class Info(eqx.Module):
    """What a step tells about itself; techniques subclass it for masks of their own."""

    rays: int
    """Rays cast in this step."""
    seconds: dict[str, float]
    """Wall-clock seconds per stage; sums to the time of the step."""
    counts: dict[str, int | float | Shaped[Array, ""]]
    """The technique's own counts, by name (overflow, recomputed pixels, clusters, ...)."""


class Technique(NamedTuple):
    """A technique as the runner sees it."""

    name: str
    """Name on the command line."""
    summary: str
    """One sentence for `--help` and the report."""
    init: Callable[..., Any]
    """`init(scene, tracer, *, options) -> State`."""
    step: Callable[..., Any]
    """`step(state, frame, params, *, options) -> (State, Reflection, Info)`."""
    Params: type
    """Traced knobs."""
    Options: type
    """Static knobs."""
