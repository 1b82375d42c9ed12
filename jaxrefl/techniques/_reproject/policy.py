"""When to trace a new key frame: shared by all techniques that have them.

Source: [XWD17] §4.3.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxrefl._types import Camera
from jaxrefl.techniques._knobs import option
from jaxrefl.techniques._tracing import TraceOptions

POLICIES = ("share", "interval", "error", "balance")
"""What decides about a new key frame: pixels to trace again, frames, the error expected, or the cost so far."""


@dataclasses.dataclass(frozen=True)
class KeyOptions(TraceOptions):
    """Static knobs of techniques with key frames."""

    policy: str = option(
        "share", "New key frame by share of pixels traced again, frames, error, or least cost.", choices=POLICIES
    )
    interval: int = option(24, "Frames from one key frame to the next (interval).", low=1, high=100000)
    batch: int = option(
        48, "Frames that a batch run hands out at once, each from a key frame of its own.", low=1, high=100000
    )

    @property
    def in_order(self) -> int:
        """Frames that a batch run must render in order: whole key-frame intervals where they are fixed."""
        fixed = self.policy == "interval"
        return self.interval * max(self.batch // self.interval, 1) if fixed else self.batch


def wants_key(options: KeyOptions, age: int, share: float, spent: float, error: float, params: Any) -> bool:
    """Whether to trace a frame anew, all of it.

    Args:
        options: Policy and interval.
        age: Frames since the last key frame, >= 1.
        share: Share of the reflective pixels that would have to be traced.
        spent: Pixels traced since the last key frame, that included, before this one, in reflective images.
        error: Mean error expected of the pixels reused, relative.
        params: `threshold` (share) and `error`.
    Returns:
        True: make it a key frame.
    Edge cases: with `balance` the mean cost per frame is least when a new key frame comes as soon as a frame costs
        more than the mean of all since the last one.
    """
    if options.policy == "interval":
        return age >= options.interval
    if options.policy == "error":
        return error > float(params.error)
    if options.policy == "balance":
        return share > spent / age
    return share > float(params.threshold)


@jax.jit
def _differ(a: Camera, b: Camera) -> Array:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return jnp.stack([(x != y).any() for x, y in pairs]).any()


def same_camera(a: Camera, b: Camera) -> bool:
    """Whether two cameras are the same in every bit.

    Args:
        a: A camera.
        b: Another.
    Returns:
        True if they are; sizes count.
    """
    return (a.width, a.height) == (b.width, b.height) and not bool(_differ(a, b))
