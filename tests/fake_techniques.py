"""Techniques that need no scene features and cost nothing, to test the runner with."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrefl.techniques import Info, Technique
from jaxrefl.techniques._knobs import check_options, option, tunable
from jaxrefl.techniques._shape import no_reflection


class Params(eqx.Module):
    level: Float[Array, ""] = tunable(0.5, 0.0, 10.0, "Radiance that is reflected.")


@dataclasses.dataclass(frozen=True)
class Options:
    noise: bool = option(True, "Add noise from the frame's key.")
    samples: int = option(1, "Rays that are pretended.", low=1, high=4096)
    mode: str = option("plain", "How to pretend.", choices=("plain", "fancy"))

    def __post_init__(self):
        check_options(self)


class State(eqx.Module):
    steps: Float[Array, ""]


def init(scene, tracer, *, options=Options()):  # noqa: B008
    return State(jnp.float32(0))


def step(state, frame, params, *, options=Options()):  # noqa: B008
    noise = jax.random.uniform(frame.key, frame.gbuffer.p.shape) / options.samples if options.noise else 0.0
    radiance = jnp.zeros_like(frame.gbuffer.p) + params.level + noise + state.steps
    reflection = dataclasses.replace(no_reflection(frame.gbuffer), radiance=radiance, valid=frame.gbuffer.valid)
    info = Info(rays=options.samples * frame.gbuffer.valid.size, seconds={"pretend": 0.25}, counts={"pixels": 7})
    return State(state.steps + 1), reflection, info


def _always_fails(state, frame, params, *, options=Options()):  # noqa: B008
    _, reflection, info = step(state, frame, params, options=options)
    return state, dataclasses.replace(reflection, radiance=reflection.radiance * jnp.nan), info


class Carrying(Technique):
    """A technique whose state must run through its frames in order, three at a time."""

    @staticmethod
    def interval(options) -> int:
        return 3


PLAIN = Technique("plain", "Constant radiance and noise.", init, step, Params, Options)
CARRYING = Carrying("carrying", "Radiance that grows with each frame of an interval.", init, step, Params, Options)
BROKEN = Technique("broken", "Nothing but NaN.", init, _always_fails, Params, Options)
FAKES = {"plain": PLAIN, "carrying": CARRYING, "broken": BROKEN}
