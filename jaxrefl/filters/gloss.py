r"""The gloss filter: sharp reflections + footprints -> glossy reflections.

$$ \hat C(x) = \frac{1}{Z(x)} \sum_{x_i} G(x_i - x)\, w_r(x, x_i)\, c(x_i)\, C(x_i) $$

with the lobe's footprint G, the range weight $w_r$ (1 on the same smooth surface, 0 elsewhere) and the confidence c.

Source: [RLPWSD20] §6.2 and §6.3, Eq. 4.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera, GBuffer
from jaxrefl.core import apart
from jaxrefl.filters.covariance import principal_axes
from jaxrefl.filters.footprint import Footprint, plane_slope
from jaxrefl.filters.gloss_atlas import TILE, Place, cut, enlarge, layout, neighbours, pack
from jaxrefl.filters.gloss_layers import Layer, Limits, Others, Values, grown, pyramid
from jaxrefl.filters.gloss_lines import REACH, TAPS, lines
from jaxrefl.filters.gloss_window import ENOUGH, window

METHODS = ("window", "separable", "four_pass")
_MARGIN = 0.25
"""By how much more than it takes layers are filtered, for reading between pixels whose footprints differ."""


class Guides(eqx.Module):
    """What tells surfaces apart."""

    id: Int[Array, "h w"]
    """Surface or material; -1 where there is none."""
    normal: Float[Array, "h w 3"]
    """Unit normals."""
    depth: Float[Array, "h w"]
    """Depth along the camera's axis, > 0, any unit; fill 0."""
    slope: Float[Array, "h w 2"]
    """Change of 1 / depth per pixel (x, y) on the plane of each pixel; 0: depths themselves are compared."""


class GlossParams(eqx.Module):
    """Thresholds of the range weight."""

    normal: Float[Array, ""] = eqx.field(converter=lambda x: jnp.asarray(x, jnp.float32), default=0.8)
    """Least cosine between normals."""
    depth: Float[Array, ""] = eqx.field(converter=lambda x: jnp.asarray(x, jnp.float32), default=0.1)
    """Largest distance from the pixel's plane, as a share of the depth."""


@dataclasses.dataclass(frozen=True)
class GlossOptions:
    """How Eq. 4 is evaluated."""

    method: str = "window"
    """"window": every pixel of a square; "separable": two passes along the principal axes; "four_pass": four with half
    the covariance each, as published."""
    radius: int = 6
    """Pixels (window) or taps (passes) to either side; wider footprints are filtered on coarser layers."""
    layers: int = 10
    """Most layers of the pyramid, the image included; 1: none, and what `radius` cuts off is lost."""
    taps: str = "nearest"
    """Where passes read: the "nearest" pixel of the line, or "linear" between the two beside it."""
    spread: bool = True
    """Neighbours count as their own distance says, not as the pixel's does."""

    def __post_init__(self):
        for name, value, known in (("method", self.method, METHODS), ("taps", self.taps, TAPS)):
            if value not in known:
                raise ValueError(f"{name}: expected one of {', '.join(known)}, got {value!r}")
        for name, value in (("radius", self.radius), ("layers", self.layers)):
            if value < 1:
                raise ValueError(f"{name}: expected at least 1, got {value}")


def guides_of(camera: Camera, gbuffer: GBuffer, *, ids: Int[Array, "h w"] | None = None) -> Guides:
    """Guides of a G-buffer.

    Args:
        camera: Its camera.
        gbuffer: What it sees.
        ids: What must be equal, -1 for none; None: the material.
    Returns:
        Ids, shading normal, depth and the planes of the triangles.
    """
    slope = plane_slope(camera, gbuffer)
    depth = gbuffer.t if gbuffer.z_camera is None else gbuffer.z_camera
    return Guides(jnp.where(gbuffer.valid, gbuffer.material, -1) if ids is None else ids, gbuffer.ns, depth, slope)


@functools.partial(jax.jit, static_argnames="options")
def gloss(
    radiance: Float[Array, "h w 3"],
    confidence: Float[Array, "h w"],
    tau: Float[Array, "h w"],
    guides: Guides,
    footprint: Footprint,
    params: GlossParams,
    *,
    options: GlossOptions = GlossOptions(),  # noqa: B008  frozen
) -> tuple[Float[Array, "h w 3"], Bool[Array, "h w"]]:
    """Mean of the radiance over each pixel's footprint, on its own surface.

    Args:
        radiance: Sharp or partly blurred reflections.
        confidence: Their weights, >= 0; 0 where the radiance is not known.
        tau: Relative distance of what each pixel reflects (`relative_distance`), for `spread`; else of no effect.
        guides: What tells surfaces apart.
        footprint: Gaussians, from `footprint` or `remaining`.
        params: Thresholds.
        options: How to evaluate.
    Returns:
        Radiance within the range of its input (fill 0), and where it is known: on surfaces, with something known within
        the footprint or at the pixel itself.
    Edge cases: a footprint of 0 leaves the pixel as it is, also if it is unknown. Unknown pixels are filled from what
    is known around them and never spread.
    Source: [RLPWSD20] Eq. 4. Differs from the source: the depth is compared with the pixel's plane; a pyramid; two
    Gaussians; `spread`.
    """
    h, w = guides.id.shape
    count = max(min(options.layers, max(h, w).bit_length()), 1)
    limits = Limits(params.normal, params.depth)
    surface = guides.id >= 0
    inverse = jnp.where(surface, 1 / jnp.where(guides.depth > 0, guides.depth, 1), 0)
    colour = jnp.where((confidence > 0)[..., None], radiance, 0)
    trust = jnp.where(surface, confidence, 0)
    parts = [*_planes(guides.normal), inverse, *_planes(guides.slope), *_planes(colour), (1 - tau) * inverse, trust]
    size = (-(-h // 8) * 8, -(-w // 8) * 8)

    def one(gaussian: Float[Array, "5 h w"]) -> Values:
        layer = Layer(guides.id, jnp.concatenate([jnp.stack(parts), gaussian]))
        return _one_gaussian(grown(layer, size), count, limits, options)[:, :h, :w]

    gaussians = jnp.stack(
        [jnp.moveaxis(p, -1, 0) for p in (*_planes(footprint.mean), *_planes(footprint.covariance))], 1
    )
    values = jax.lax.map(one, gaussians)
    weights = jnp.where(values[:, 3] > 0, jnp.moveaxis(footprint.weight, -1, 0), 0)
    total, share, known = (weights[:, None] * values[:, :3]).sum(0), weights.sum(0), (values[:, 3] > 0).any(0)
    scale = jnp.where(share > 0, 1 / jnp.where(share > 0, share, 1), 0)
    own = surface & (confidence > 0)
    result = jnp.where(known[..., None], jnp.moveaxis(total * scale[None], 0, -1), 0)
    result = jnp.where((own & ~known)[..., None], radiance, result)
    return jnp.where(surface[..., None], result, 0), surface & (known | own)


def _planes(x: Float[Array, "*b c"]) -> list[Float[Array, "*b"]]:
    """Components one by one: interleaving them all in one array first takes longer than the filter."""
    return [x[..., i] for i in range(x.shape[-1])]


def _one_gaussian(image: Layer, count: int, limits: Limits, options: GlossOptions) -> Values:
    """Filter every layer where its resolution suits the footprint, and put the layers together."""
    h, w = image.id.shape
    places, size = layout(h, w, count)
    finest = _level(image.covariance, jnp.zeros_like(image.id), count, options)
    deepest = jnp.where(image.id >= 0, finest, -1).max() + 1.5 + _MARGIN
    if count == 1:
        return _filter([image], places, size, limits, options)[:, :h, :w]
    second, rest = pyramid(image, count, limits, deepest)
    layers = [image, second, *(jax.tree.map(lambda x, n=n: x[n], rest) for n in range(count - 2))]
    filtered = _filter(layers, places, size, limits, options)
    quarter = (rest.id.shape[1], rest.id.shape[2])

    def up(below: tuple[Layer, Others], part: tuple[Layer, Values, Array]) -> tuple[tuple[Layer, Array], None]:
        fine, own, number = part
        return (fine, _join(fine, own, below, number, count, limits, options)), None

    nothing = Layer(jnp.full(quarter, -1, jnp.int32), jnp.zeros((image.data.shape[0], *quarter), jnp.float32))
    below = (nothing, jnp.zeros((4, *quarter), jnp.float32))
    if count > 2:
        here = jnp.stack([cut(filtered, place, quarter) for place in places[2:]])
        below, _ = jax.lax.scan(up, below, (rest, here, jnp.arange(2, count, dtype=jnp.int32)), reverse=True)
    for number, fine in ((1, second), (0, image)):
        own = cut(filtered, places[number], (fine.id.shape[0], fine.id.shape[1]))
        below, _ = up(below, (fine, own, jnp.asarray(number, jnp.int32)))
    return below[1]


def _join(
    fine: Layer,
    own: Values,
    below: tuple[Layer, Others],
    number: Int[Array, ""],
    count: int,
    limits: Limits,
    options: GlossOptions,
) -> Values:
    """A filtered layer and what the coarser ones make of it, each where it suits the footprint."""
    level = _level(fine.covariance, jnp.broadcast_to(number, fine.id.shape), count, options)
    coarser = jnp.clip(2 * (level - number.astype(jnp.float32)) + 1, 0, 1)  # 1 before the window cuts anything off
    above = apart((coarser > 0) & (fine.id >= 0), enlarge, fine, *below, limits)
    has_own, has_above = own[3] > 0, above[3] > 0
    blend = jnp.where(has_above, jnp.where(has_own, coarser, 1), 0)
    colour = (1 - blend)[None] * own[:3] + blend[None] * above[:3]
    weight = jnp.where(has_own, own[3] * (1 - blend), 0) + above[3] * blend
    return jnp.concatenate([colour, weight[None]])


def _filter(
    layers: list[Layer], places: list[Place], size: tuple[int, int], limits: Limits, options: GlossOptions
) -> Values:
    """Filter the tiles of an atlas whose resolution suits their footprints."""
    count, margin = len(places), options.radius if options.method == "window" else 0
    atlas = pack(layers, places, size, margin)
    inner = jax.tree.map(lambda x: x[..., margin : margin + size[0], margin : margin + size[1]], atlas)
    number = jnp.where(inner.id >= 0, inner.id % count, -1)
    beyond = _level(inner.covariance, number, count, options) - number.astype(jnp.float32)
    wanted = (beyond < _MARGIN) & (beyond > -1.5 - _MARGIN) & (inner.id >= 0)
    active = wanted.reshape(size[0] // TILE[0], TILE[0], -1, TILE[1]).any((1, 3))
    left = _without_resampling(inner.covariance, number)
    if options.method == "window":
        return window(atlas, left, active, limits, radius=options.radius, layers=count, spread=options.spread)
    pairs, active = 2 if options.method == "four_pass" else 1, neighbours(active, places)
    return lines(
        atlas, left, active, limits, radius=options.radius, taps=options.taps, spread=options.spread, pairs=pairs
    )  # fmt: skip


def _level(
    covariance: Float[Array, "3 *b"], number: Int[Array, "*b"], count: int, options: GlossOptions
) -> Float[Array, "*b"]:
    """The finest layer that holds a footprint, which is given in pixels of layer `number`; not rounded."""
    axes = principal_axes(jnp.moveaxis(covariance, 0, -1))
    if options.method == "window":
        most = (options.radius + 0.5) / ENOUGH
    else:
        passes = 2.0 if options.method == "four_pass" else 1.0
        most = passes**0.5 * options.radius / REACH
    wide = jnp.log2(jnp.maximum(axes.major, 1e-6) / most)
    return jnp.clip(jax.lax.stop_gradient(wide) + number.astype(wide.dtype), -1, count - 1.25)


def _without_resampling(covariance: Float[Array, "3 *b"], number: Int[Array, "*b"]) -> Float[Array, "3 *b"]:
    """What a layer still has to blur: averaging pixels and reading between them has blurred by 1/12 and 1/6 already."""
    done = (1 - 4.0 ** -jnp.maximum(number, 0).astype(jnp.float32)) / 12 + 1 / 6
    axes = principal_axes(jnp.moveaxis(covariance, 0, -1))
    a, b = (jnp.maximum(sd * sd - done, 0.02) for sd in (axes.major, axes.minor))
    c, s = axes.cos, axes.sin
    narrowed = jnp.stack([a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c])
    return jnp.where((number > 0)[None], narrowed, covariance)
