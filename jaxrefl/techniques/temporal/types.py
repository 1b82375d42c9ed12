"""Knobs, state and results of reflection reprojection, and the codes that say why a pixel was traced again."""

import dataclasses
import enum

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxrefl._types import Camera
from jaxrefl.techniques import _shape
from jaxrefl.techniques._knobs import check_options, option, tunable
from jaxrefl.techniques._reproject import KeyOptions

REACH = 4
"""Pixels around what the key frame lacks in which the frame before is searched too."""


class Reason(enum.IntEnum):
    """Why a pixel was reused or not; the values of `Info.reason`."""

    NONE = 0
    """Not a reflective surface."""
    REUSED = 1
    """Taken from a key frame."""
    KEY = 2
    """This frame is a key frame."""
    UNSEEN = 3
    """No part of the key frame came to lie here."""
    RESIDUAL = 4
    """No point of the key frame's reflection lies on this pixel's mirror ray, or the search for it did not end."""
    EDGE = 5
    """The point lies between two things, or beside the edge of what the key frame knows."""
    CONTRAST = 6
    """Colours around the point differ by so much that a value between them would be a guess."""
    HIDDEN = 7
    """Something lies between the reflector and the point."""
    CHANGING = 8
    """What is reflected is a mirror or glass, and looks different from here."""
    LOBE = 9
    """A rough reflection whose lobe has turned away."""
    MOVED = 10
    """The reflector has moved."""
    SILHOUETTE = 11
    """As published: the search ended on the outline of the reflector."""
    OUTSIDE = 12
    """As published: the search left the image."""
    STEPS = 13
    """As published: the search did not end within its steps."""


class Taken(enum.IntEnum):
    """From where a pixel was taken; the values of `Info.taken_from`."""

    NOWHERE = 0
    """It was traced, or is no reflection."""
    KEY = 1
    """The last key frame."""
    AHEAD = 2
    """The next key frame."""
    RECENT = 3
    """The frame before."""


class Params(eqx.Module):
    """Tunable numbers; none is a length, so scaling a scene changes nothing."""

    threshold: Float[Array, ""] = tunable(
        0.3, 0.0, 1.0, "Share of the reflective pixels traced again above which a frame becomes a key frame (share)."
    )
    error: Float[Array, ""] = tunable(0.004, 0.0, 1.0, "Mean expected relative error above which it does (error).")
    tolerance: Float[Array, ""] = tunable(
        0.1, 0.001, 10.0, "Distance from the mirror ray to the point found, key-frame pixels, above which to trace."
    )
    contrast: Float[Array, ""] = tunable(
        0.03, 0.0, 10.0, "Expected relative error between key-frame pixels above which to trace."
    )
    lobe: Float[Array, ""] = tunable(
        0.1, 0.0, 2.0, "Turn of a rough reflection, as a share of its lobe's width, up to which it is reused."
    )
    inner: Float[Array, ""] = tunable(
        0.015, 1e-6, 1.0, "Turn of a mirror or glass seen in a mirror up to which it is reused (radians)."
    )
    sharp: Float[Array, ""] = tunable(
        0.02, 0.0, 1.0, "Largest alpha of a rough reflection that is found again like a mirror's (alpha)."
    )
    surface: Float[Array, ""] = tunable(
        0.004, 0.0, 0.1, "Distance to the surface seen before, as a share of the distance to the viewer."
    )
    discontinuity: Float[Array, ""] = tunable(
        0.05, 0.0, 1.0, "Relative second difference of 1 / depth that counts as a discontinuity (as_published)."
    )


@dataclasses.dataclass(frozen=True)
class Options(KeyOptions):
    """Static knobs."""

    method: str = option(
        "refined", "Refined with tests of each pixel, or as published.", choices=("refined", "as_published")
    )
    recent: bool = option(True, "Also take pixels from the frame before, which has traced what the key frame lacks.")
    keys: int = option(1, "Key frames to take a pixel from: the last one, or the next one too.", low=1, high=2)
    occlusion: str = option(
        "rays", "What finds hidden points: a shadow ray, or depths alone.", choices=("rays", "depths")
    )
    edges: str = option(
        "ray",
        "Pixels at the edges of what is reflected: ask a ray what they show, or trace.",
        choices=("ray", "trace"),
    )
    start: str = option(
        "previous",
        "Where a search starts: the previous frame's result, or the surface.",
        choices=("previous", "surface"),
    )
    stride: int = option(2, "Key-frame pixels from one search for a start to the next.", low=1, high=8)
    steps: int = option(3, "Newton steps of each search; those that need more are compacted.", low=1, high=32)
    late_steps: int = option(4, "Newton steps for searches that have not ended after `steps`.", low=0, high=64)
    refine_steps: int = option(2, "Gauss-Newton steps from the start to the sub-pixel result.", low=0, high=16)
    spread: int = option(4, "Pixels over which gaps between starts are closed.", low=0, high=8)
    inner_mirrors: str = option(
        "turn",
        "Mirrors and glass seen in mirrors, if they are followed: reuse until they have turned, trace, or reuse.",
        choices=("turn", "trace", "reuse"),
    )
    noise: str = option(
        "auto",
        "Whether contrast is that of the light, or (noisy light) of base colours.",
        choices=("auto", "none", "noisy"),
    )
    moving: str = option("retrace", "Things that move: trace them, or follow them with the light they had.",
                         choices=("retrace", "follow"))  # fmt: skip
    budget: int = option(100, "Most pixels traced outside key frames, percent of the image.", low=0, high=100)
    search_steps: int = option(150, "Most steps of the neighbourhood search (as_published).", low=1, high=4096)
    block: int = option(16384, "Pixels searched or traced at a time.", low=256, high=4194304)

    def __post_init__(self):
        check_options(self)
        if self.keys == 2 and self.policy != "interval":
            raise ValueError(f"keys: 2 needs policy 'interval', got {self.policy!r}: the next key frame must be known")


class ReflectionBuffer(eqx.Module):
    """A key frame: what was seen, and what it reflected. The paper's B.1, B.3 and B.4; B.2 comes with each frame."""

    camera: Camera
    """Its camera."""
    vertices: Float[Array, "v 3"]
    """The scene's vertices at its time."""
    valid: Bool[Array, "h w"]
    """Where there is a reflection."""
    p: Float[Array, "h w 3"]
    """Reflector, world space; fill 0."""
    ns: Float[Array, "h w 3"]
    """Its unit shading normal."""
    t: Float[Array, "h w"]
    """Distance from the eye to the reflector, world units; fill 0."""
    object: Int[Array, "h w"]
    """Object of the reflector; -1 for none."""
    smooth: Bool[Array, "h w"]
    """True where the reflector is a mirror, or nearly one; False where it is rough."""
    reflected: Float[Array, "h w 4"]
    """Reflected point (x, y, z, 1), world space, or the direction (x, y, z, 0) of the environment."""
    t_reflected: Float[Array, "h w"]
    """Distance from the reflector to the reflected point, world units; fill 0."""
    radiance: Float[Array, "h w 3"]
    """Reflected radiance."""
    triangle: Int[Array, "h w"]
    """Reflected triangle; -1 for the environment."""
    changing: Bool[Array, "h w"]
    """True where what is reflected looks different from elsewhere."""
    connected: Bool[Array, "h w"]
    """True where the four pixels with this upper left corner show one smooth piece of one thing."""
    seen: Float[Array, "h w 3"]
    """What contrast is judged by: the radiance, or where that has noise the base colour of what is reflected."""
    error: Float[Array, "h w"]
    """Expected relative error of the radiance itself; 0 where it was traced."""
    steepness: Float[Array, "h w"]
    """Largest relative change of colour per world unit on what is reflected; infinite where it is not known."""
    bend_x: Float[Array, "h w"]
    """Relative second difference of colours along x in that cell."""
    bend_y: Float[Array, "h w"]
    """The same along y."""


class Search(eqx.Module):
    """Results of the forward search, for the next frame to start from."""

    place: Float[Array, "*b 2"]
    """Where each key-frame pixel's reflected point is seen now, pixels; the surface where the search failed. As
    published: the offset to the matching key-frame pixel."""
    found: Bool[Array, "*b"]
    """Where the search ended well."""


class State(eqx.Module):
    """The key frames, and what has been spent since."""

    key: ReflectionBuffer | None = None
    """The last key frame; None: the next frame is one."""
    search: Search | None = None
    """Last search in it."""
    ahead: ReflectionBuffer | None = None
    """The next key frame, with `keys = 2`."""
    search_ahead: Search | None = None
    """Last search in that."""
    recent: ReflectionBuffer | None = None
    """The frame before, with `recent`; None: that was a key frame, or there was none."""
    lacking: Bool[Array, "h w"] | None = None
    """Where that has, within `REACH` pixels, what the key frame lacks."""
    age: int = 0
    """Frames since the key frame."""
    spent: float = 0.0
    """Images traced since the key frame, that included."""


class Proposal(eqx.Module):
    """What a key frame offers for each pixel; all but `reason` mean something where that is REUSED or CONTRAST."""

    uv: Float[Array, "*b 2"]
    """Coordinate in the key frame, pixels."""
    reason: Int[Array, "*b"]
    """REUSED where the pixel may be taken, else why not."""
    error: Float[Array, "*b"]
    """Expected relative error of the radiance."""
    radiance: Float[Array, "*b 3"]
    """Reflected radiance."""
    reflected: Float[Array, "*b 4"]
    """Reflected point or direction."""
    triangle: Int[Array, "*b"]
    """Reflected triangle of the nearest pixel; -1 for the environment."""
    seen: Float[Array, "*b 3"]
    """What contrast is judged by."""


class Info(_shape.Info):
    """What a step tells."""

    reason: Int[Array, "h w"]
    """A `Reason` per pixel."""
    flow: Float[Array, "h w 2"]
    """Specular flow: where the reflected point was seen in the frame it was taken from minus where it is seen now,
    (x, y) in pixels; 0 where the pixel was not reused. At edges, to a pixel's accuracy."""
    taken_from: Int[Array, "h w"]
    """From where a pixel was taken, a `Taken` code; `flow` leads to that frame."""

    @property
    def layers(self) -> dict[str, Shaped[Array, "h w ..."]]:
        """Specular flow, and the codes."""
        return {"specular_flow": self.flow, "reuse_reason": self.reason, "taken_from": self.taken_from}
