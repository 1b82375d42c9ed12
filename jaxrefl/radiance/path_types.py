"""Knobs, state and results of the path tracer; see `path`."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from jaxrefl._types import GBuffer, PunctualLights, Rays
from jaxrefl.radiance.light_points import EmissivePoint
from jaxrefl.surface.bsdf import Lobes, Scattering

EMITTED, DIFFUSE, REFLECTED, REFRACTED = 0, 1, 2, 3
"""Layers: light that reaches the first surface's viewer by emission (or from the background), or by the lobe that sends
it there. The lobes of `surface.bsdf` are one less."""
PAIRS = 4
"""Pairs of random numbers per vertex; pair 0 of a sequence is left to whoever makes the rays."""
LIGHT, DIRECTION, LOBE, ROULETTE = range(PAIRS)
"""What each pair of a vertex decides: the place on a light; the direction; the lobe, and reflection or refraction; the
roulette, and the kind of light."""
CHANNELS = 7
"""Sums per ray with layers: the four layers, then the last three of them again with their weight."""


@dataclasses.dataclass(frozen=True)
class PathOptions:
    """How paths are followed; static."""

    LONGEST: ClassVar[int] = 1000

    bounces: int = 15
    """Most scattering events of a path; 1 is direct light. Mitsuba's `max_depth` is one more."""
    roulette_from: int = 4
    """Scattering events after which dim paths are ended by Russian roulette; those that stay are weighed up for it."""
    sampler: str = "sobol"
    """"sobol" (Owen-scrambled, low discrepancy) or "independent" (random) numbers."""
    scattering: Scattering = Scattering()
    """Which model of rough surfaces."""
    block: int = 65536
    """Paths that are followed at the same time, twice: while one block is shaded the other's rays are cast."""

    def __post_init__(self):
        for name, low, high in (("bounces", 0, self.LONGEST), ("roulette_from", 0, self.LONGEST), ("block", 64, 2**22)):
            value = getattr(self, name)
            if not isinstance(value, int) or not low <= value <= high:
                raise ValueError(f"{name}: expected a whole number from {low} to {high}, got {value!r}")
        if self.sampler not in ("sobol", "independent"):
            raise ValueError(f"sampler: expected 'sobol' or 'independent', got {self.sampler!r}")


class PathLight(eqx.Module):
    """Light that arrives along rays, apart by what its first surface does with it ([RLPWSD20]'s split and more)."""

    emitted: Float[Array, "*b 3"]
    """Emission of the first surface, or the background."""
    diffuse: Float[Array, "*b 3"]
    """Diffusely reflected light, L(S|D)*DE, without the share that the specular lobe takes; `composite`'s L_d - L_e."""
    reflected: Float[Array, "*b 3"]
    """Mean radiance of the specular lobe, L(S|D)*SE, before its weight; `Reflection.radiance`."""
    refracted: Float[Array, "*b 3"]
    """Radiance from behind the first surface, before its weight; `Reflection.transmitted`."""
    diffuse_weighted: Float[Array, "*b 3"]
    """Diffuse light as it reaches the viewer."""
    reflected_weighted: Float[Array, "*b 3"]
    """Specular light as it reaches the viewer, Fresnel and specular colour applied direction by direction."""
    refracted_weighted: Float[Array, "*b 3"]
    """Refracted light as it reaches the viewer."""

    @property
    def radiance(self) -> Float[Array, "*b 3"]:
        """All light together."""
        return self.emitted + self.diffuse_weighted + self.reflected_weighted + self.refracted_weighted


class Batch(eqx.Module):
    """The rays to follow, and which random numbers each uses."""

    rays: Rays
    """Rays [r]."""
    sequence: UInt32[Array, "r"]
    """Sequence of each ray (`core.sequences`)."""
    number: UInt32[Array, "r"]
    """Number of each ray's point in its sequence."""


class Paths(eqx.Module):
    """A block of paths on their way; a slot whose path ends is given the next ray of the batch."""

    job: Int[Array, "n"]
    """Which ray of the batch; -1: the slot is empty."""
    rays: Rays
    """Where the paths go next [n]."""
    throughput: Float[Array, "n 3"]
    """Weight of what is found there, without `factor`."""
    factor: Float[Array, "n 3"]
    """The part of the weight that came from the first surface: what `composite` applies."""
    density: Float[Array, "n"]
    """Density with which the direction was sampled, 1/sr; 0 for a delta and for the batch's own rays."""
    depth: Int[Array, "n"]
    """Scattering events so far."""
    layer: Int[Array, "n"]
    """EMITTED before the first surface, then the layer the path contributes to."""
    eta_scale: Float[Array, "n"]
    """Compression of radiance by the media that the path has entered, for the roulette."""
    sequence: UInt32[Array, "n"]
    """Sequence of random numbers of each path."""
    number: UInt32[Array, "n"]
    """Number of its point in that sequence."""
    next_job: Int[Array, ""]
    """First ray of the batch that no slot has had yet."""


class Shadows(eqx.Module):
    """Light samples whose shadow rays are under way, and what they bring to each of two layers if nothing is there."""

    rays: Rays
    """Shadow rays [n]."""
    t_max: Float[Array, "n"]
    """Distance to the light; 0: nothing to cast."""
    job: Int[Array, "n"]
    """Which ray of the batch; -1: none."""
    layers: tuple[Int[Array, "n"], Int[Array, "n"]]
    """Where the two contributions go."""
    light: tuple[Float[Array, "n 3"], Float[Array, "n 3"]]
    """Contributions before the first surface's weight."""
    factors: tuple[Float[Array, "n 3"], Float[Array, "n 3"]]
    """That weight."""


class Vertex(eqx.Module):
    """Where paths have arrived."""

    points: GBuffer
    """What they hit [n]."""
    lobes: Lobes
    """Its lobes."""
    numbers: Float[Array, "8 n"]
    """Random numbers of this vertex."""
    throughput: Float[Array, "n 3"]
    """With the absorption on the way here."""
    stays: Bool[Array, "n"]
    """True where the path meets the surface, False where it passes a cut-out, misses, or the slot is empty."""


class Lamps(eqx.Module):
    """One candidate of each kind of light per path, whoever looks at it."""

    kind: Int[Array, "n"]
    """Which of the kinds is meant."""
    area: EmissivePoint | None
    """A point on the emissive triangles."""
    sky: tuple[Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "n"]] | None
    """A direction to the environment, the radiance from there and its density."""
    punctual: PunctualLights | None
    """A punctual light [n]."""


def empty_shadows(count: int) -> Shadows:
    """No shadow rays.

    Args:
        count: Slots.
    Returns:
        Shadows that bring nothing.
    """
    zero, vector = jnp.zeros((count,), jnp.float32), jnp.zeros((count, 3), jnp.float32)
    nobody = jnp.full((count,), -1, jnp.int32)
    up = jnp.broadcast_to(jnp.array([0, 0, 1], jnp.float32), (count, 3))
    none = jnp.zeros((count,), jnp.int32)
    return Shadows(Rays(vector, up), zero, nobody, (none, none), (vector, vector), (vector, vector))


def pair_of(random: Float[Array, "8 n"], pair: int) -> Float[Array, "n 2"]:
    """One pair of the random numbers of a vertex.

    Args:
        random: Numbers of the vertex.
        pair: LIGHT, DIRECTION, LOBE or ROULETTE.
    Returns:
        The pair.
    """
    return jnp.stack([random[2 * pair], random[2 * pair + 1]], -1)


def own_layer(
    paths: Paths, layer: int, light: Float[Array, "n 3"], factor: Float[Array, "n 3"]
) -> tuple[Int[Array, "n"], Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Where what a lobe scatters belongs: at the first surface to the lobe's own layer, later to that of the path.

    Args:
        paths: The paths.
        layer: The lobe's layer.
        light: Light before the lobe's weight.
        factor: The lobe's weight, as `composite` applies it.
    Returns:
        Layers, light, and the first surface's weight.
    """
    first = paths.layer == EMITTED
    own = first[:, None]
    layers = jnp.where(first, jnp.full_like(paths.layer, layer), paths.layer)
    return layers, jnp.where(own, light, light * factor), jnp.where(own, factor, paths.factor)
