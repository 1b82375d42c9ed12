"""Knobs, state and results of naive warping."""

import dataclasses

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera
from jaxrefl.techniques import _shape
from jaxrefl.techniques._knobs import tunable
from jaxrefl.techniques._reproject import KeyOptions


class Params(eqx.Module):
    """Tunable numbers."""

    threshold: Float[Array, ""] = tunable(
        0.3, 0.0, 1.0, "Share of the reflective pixels traced again above which a frame becomes a key frame (share)."
    )
    error: Float[Array, ""] = tunable(
        0.02, 0.0, 1.0, "Mean movement of the mirror direction, radians, above which it does (error)."
    )
    tolerance: Float[Array, ""] = tunable(
        0.004, 0.0, 0.1, "Distance to the surface seen before, as a share of the distance to the viewer."
    )


@dataclasses.dataclass(frozen=True)
class Options(KeyOptions):
    """Static knobs: those of tracing and of key frames."""


class Key(eqx.Module):
    """A traced frame."""

    camera: Camera
    """Its camera."""
    vertices: Float[Array, "v 3"]
    """The scene's vertices at its time."""
    p: Float[Array, "h w 3"]
    """What was seen, world space."""
    object: Int[Array, "h w"]
    """Which object; -1 for none."""
    wi: Float[Array, "h w 3"]
    """Mirror directions."""
    radiance: Float[Array, "h w 3"]
    """Reflected radiance; fill 0."""
    reflected: Float[Array, "h w 3"]
    """Reflected points; fill 0."""
    source: Int[Array, "h w"]
    """`jaxrefl.Source` of each pixel."""
    known: Bool[Array, "h w"]
    """Where there is a reflection."""


class State(eqx.Module):
    """The last key frame, and what has been spent since."""

    key: Key | None = None
    """None: the next frame is one."""
    age: int = 0
    """Frames since the key frame."""
    spent: float = 0.0
    """Images traced since the key frame, that included."""


class Info(_shape.Info):
    """What a step tells."""

    traced: Bool[Array, "h w"]
    """Pixels traced in this frame."""
