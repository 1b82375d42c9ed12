"""The one shape of every technique: what the runner can rely on."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Shaped

from jaxrefl._status import Source
from jaxrefl._types import GBuffer, Reflection


class Info(eqx.Module):
    """What a step tells about itself; techniques subclass it for masks of their own."""

    rays: int
    """Rays cast in this step."""
    seconds: dict[str, float]
    """Wall-clock seconds per stage; sums to the time of the step."""
    counts: Mapping[str, int | float | Shaped[Array, ""]]
    """The technique's own counts, by name (overflow, recomputed pixels, clusters, ...)."""

    @property
    def layers(self) -> dict[str, Shaped[Array, "h w ..."]]:
        """Images of its own that belong beside the picture, by layer name: [h w], or [h w 2] for vectors (x, y)."""
        return {}


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
    interval: Callable[[Any], int] | None = None
    """`interval(options)`: after so many frames in order a run starts afresh from `init`; None: frames are independent
    of each other, and `State` carries nothing."""
    ahead: Callable[[Any], int] | None = None
    """`ahead(options)`: of how many frames one is a key frame; the frames before it are told its camera, as
    `Frame.ahead`. 0 or None: they are not."""


@jax.jit
def no_reflection(gbuffer: GBuffer) -> Reflection:
    """A reflection that is invalid everywhere: what a technique starts from.

    Args:
        gbuffer: G-buffer of the frame.
    Returns:
        Fill values of the G-buffer's shape.
    """
    zero = jnp.zeros_like(gbuffer.t)
    return Reflection(
        radiance=jnp.zeros_like(gbuffer.p),
        valid=jnp.zeros_like(gbuffer.valid),
        source=jnp.full(gbuffer.t.shape, int(Source.NONE), jnp.int32),
        confidence=zero,
        p=jnp.zeros_like(gbuffer.p),
        t=zero,
        transmitted=None if gbuffer.transmission is None else jnp.zeros_like(gbuffer.p),
    )
