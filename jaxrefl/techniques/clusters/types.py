"""Knobs, state and results of second-order feed-forward rendering, and the codes that say how each pixel was found."""

import dataclasses
import enum

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxrefl.techniques import _shape
from jaxrefl.techniques._captured import Captured
from jaxrefl.techniques._knobs import check_options, option, tunable
from jaxrefl.techniques._tracing import TraceOptions


class Found(enum.IntEnum):
    """How a mirror ray ended; the values of `Info.found`."""

    NONE = 0
    """Not a reflective surface."""
    SURFACE = 1
    """On a surface of the depth image, seen all the way."""
    SKY = 2
    """It left the scene, seen all the way."""
    PASSED = 3
    """On a surface, or out of the scene, after it had passed behind something: what is there is a guess."""
    HIDDEN = 4
    """It was last seen going behind something: disoccluded."""
    NO_CAMERA = 5
    """Its cluster has no camera: too few pixels, or too wide for a pinhole."""
    OUTSIDE = 6
    """A ray of a rough surface that left the depth image by its border."""


def is_hit(found: Int[Array, "*b"], share: Float[Array, "*b"]) -> Bool[Array, "*b"]:
    """Rays that ended on a surface.

    Args:
        found: `Found` codes.
        share: Where they ended, as a share of their length.
    Returns:
        True for those seen all the way, and those that had passed behind something.
    """
    return (found == int(Found.SURFACE)) | ((found == int(Found.PASSED)) & (share < 1))


def is_clean(found: Int[Array, "*b"]) -> Bool[Array, "*b"]:
    """Rays whose end has been seen all the way.

    Args:
        found: `Found` codes.
    Returns:
        True for those that ended on a surface or left the scene in sight.
    """
    return (found == int(Found.SURFACE)) | (found == int(Found.SKY))


class Params(eqx.Module):
    """Tunable numbers; none is a length, so scaling a scene changes nothing."""

    exponent: Float[Array, ""] = tunable(
        0.125, 0.0, 4.0, "How much coarser bins get with smaller and more reflectors; 0: never."
    )
    least: Float[Array, ""] = tunable(
        0.45, 0.0, 1.0, "Coarsest bins of any reflector, as a share of the most along each side."
    )
    disparity: Float[Array, ""] = tunable(
        0.1, 0.0, 1.0, "Angle by which rays may miss their cluster's eye, root mean square (split; radians)."
    )
    resolution: Float[Array, ""] = tunable(1.0, 0.125, 8.0, "Texels of a depth image per pixel, along each side.")
    smallest: Float[Array, ""] = tunable(4.0, 1.0, 4096.0, "Pixels below which a cluster has no depth image.")
    lobe: Float[Array, ""] = tunable(
        4.0, 0.0, 10.0, "Widening of the view for GGX lobes: tangent of the half vector's angle, in alphas."
    )
    grain: Float[Array, ""] = tunable(
        0.05, 0.0, 2.0, "Smallest texel for rough surfaces, as a slope, in alphas: lobes blur what is finer."
    )
    fade: Float[Array, ""] = tunable(
        0.1, 0.001, 10.0, "Alpha at which the far plane comes half as near (far = glossiness)."
    )


@dataclasses.dataclass(frozen=True)
class Options(TraceOptions):
    """Static knobs."""

    clusters: str = option(
        "split",
        "What clusters are made from: reflectors split where they must be, or bins of their normals.",
        choices=("split", "octahedral", "spherical"),
    )
    capacity: int = option(128, "Most clusters; what comes after them is merged.", low=1, high=4096)
    eye: str = option(
        "nearest",
        "Where cluster cameras stand: nearest to all rays, by the paper's Eq. 1, or by its exact fit.",
        choices=("nearest", "equation", "fit"),
    )
    axis: str = option("rays", "Where they look: along the mean ray, or the mean normal.", choices=("rays", "normal"))
    pitch: str = option(
        "near",
        "How fine their texels are: as pixels' near ends are seen, or as fine as their far ends if those are closer.",
        choices=("near", "ends"),
    )
    near: str = option(
        "pixels",
        "Where they begin to see: where each texel's rays start, behind all of the cluster, or at its centre.",
        choices=("pixels", "behind", "centre"),
    )
    far: str = option(
        "scene",
        "How far rough reflections reach: as far as mirrors, or less the rougher they are, faded out.",
        choices=("scene", "glossiness"),
    )
    maker: str = option(
        "rays",
        "How depth images are made: by rays, or by projection and rasterisation.",
        choices=("rays", "raster"),
    )
    concave: str = option(
        "reflector",
        "What concave clusters show of themselves: their reflector as any other thing, nothing, or their own pixels.",
        choices=("reflector", "ignore", "cluster"),
    )
    lobes: str = option(
        "ggx", "Rays of rough surfaces: from the GGX lobe, or evenly from a cone.", choices=("ggx", "cone")
    )
    glossy: str = option(
        "rays",
        "Rough surfaces: each ray meets the depth image, or one does and the others look up what is beside its hit.",
        choices=("rays", "neighbourhood"),
    )
    search: str = option(
        "steps",
        "How rays are followed through depth images: texel by texel, or past what their min-max pyramid rules out.",
        choices=("steps", "pyramid"),
    )
    texels: int = option(300, "Most texels of all depth images, percent of the image's pixels.", low=10, high=10000)
    steps: int = option(1024, "Most steps of a ray through its depth image.", low=1, high=16384)
    map_height: int = option(128, "Rows of each environment map (environment).", low=16, high=2048)
    maps: int = option(32, "Most reflectors with an environment map of their own (environment).", low=1, high=1024)
    repair: str = option(
        "trace",
        "What is done about rays without a sure answer: nothing, an environment map, or they are traced.",
        choices=("none", "environment", "trace"),
    )

    def __post_init__(self):
        check_options(self)

    def room(self, pixels: int) -> int:
        """Texels there is room for.

        Args:
            pixels: Pixels of the image.
        Returns:
            Most texels of all depth images together.
        """
        return self.texels * pixels // 100


class State(eqx.Module):
    """What `init` prepares; it does not change. Nothing at all, unless repairs need it."""

    maps: Captured | None = None
    """Environment maps, with `repair = "environment"`."""


class Info(_shape.Info):
    """What a step tells."""

    cluster: Int[Array, "h w"]
    """Cluster of each pixel; -1 for none."""
    found: Int[Array, "h w"]
    """A `Found` code per pixel, before any repair."""

    @property
    def layers(self) -> dict[str, Shaped[Array, "h w ..."]]:
        """Clusters, and the codes."""
        return {"cluster": self.cluster, "cluster_found": self.found}
