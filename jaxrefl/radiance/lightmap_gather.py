"""Light at the texels of an atlas by path tracing, block by block: Places -> mean light of each texel.

At each place four paths start, in a cosine distribution over the hemisphere, and each kind of light is sampled four
times. What the paths find emitted right where they arrive first belongs to the direct light (`lightmap_direct`), the
rest is indirect.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from jaxrefl._types import GBuffer, Hits, Rays, Scene, Tracer
from jaxrefl.core import cosine_hemisphere, cross, dot, hash_words, owen_sobol, safe
from jaxrefl.radiance.lightmap_atlas import GRID, Atlas, Places
from jaxrefl.radiance.lightmap_direct import lamp_light, other_light
from jaxrefl.radiance.path import path_light
from jaxrefl.radiance.path_types import PathLight, PathOptions
from jaxrefl.rays.offset import offset_origin
from jaxrefl.surface.coupling import coupling
from jaxrefl.surface.gbuffer import build_gbuffer

PER_PLACE = 4
"""Paths and light samples of each kind at each place."""
PLACES = 2
"""Places per texel that one call looks at."""
MOST_ROWS = 2**14
"""Most texels per block."""


class Gathered(NamedTuple):
    """Light at texels, before the albedo, from each half of the samples."""

    direct: Float[np.ndarray, "2 n 3"]
    """From emitters, without a bounce in between."""
    indirect: Float[np.ndarray, "2 n 3"]
    """All other light."""
    seen: Float[np.ndarray, "n"]
    """Share of the places that are not inside a solid object; the others do not count."""
    p: Float[np.ndarray, "n 3"]
    """Mean position of its places, world space."""
    n: Float[np.ndarray, "n 3"]
    """Mean shading normal, not normalised."""


def gather_light(
    scene: Scene,
    tracer: Tracer,
    atlas: Atlas,
    places: Places,
    *,
    inner: Bool[np.ndarray, "2 f"],
    side: int,
    effort: tuple[int, int],
    rows: int,
    progress: Callable[[int], None],
) -> Gathered:
    """Mean light at texels.

    Args:
        scene: The scene, without normal maps.
        tracer: Ray queries against `scene.mesh`.
        atlas: Where the triangles lie.
        places: The texels to look at.
        inner: Inner sides of solid objects.
        side: 0: the side the triangles face, 1: the other.
        effort: Number of the first of the `PLACES` places of each texel that are looked at, and scattering events.
        rows: Texels per block; each value compiles anew.
        progress: Called with the number of paths so far.
    Returns:
        One row per texel.
    Edge cases: a texel of which nothing is seen has no light.
    """
    first, bounces = effort
    solid = jnp.asarray(inner) if inner.any() else None
    uv = jnp.asarray(atlas.uv)
    options = PathOptions(bounces=bounces - 1)
    parts = []
    for start in range(0, len(places.texel), rows):
        block = Places(*(_padded(x[start : start + rows], rows) for x in places))
        index = np.arange(first, first + PLACES) % places.triangle.shape[1]
        spots = _Spots(block.texel.astype(np.int32), block.triangle[:, index], block.place[:, index])
        points, sequence = _look_at(scene, uv, spots, width=atlas.width, side=side)
        more, rays, weight, numbers = _ways(points, sequence, jnp.asarray(first, jnp.int32))
        hits = tracer.closest(rays)
        key = jax.random.fold_in(jax.random.key(side), start + first * len(places.texel))
        direct = other_light(scene, tracer, points, key, PER_PLACE)
        lamps = lamp_light(scene, tracer, more, numbers, rays, weight, hits)
        enclosed = None if solid is None else _enclosed(scene, rays, hits, solid)
        light = path_light(scene, tracer, rays, *numbers, options=options)
        block_sums = _means(points, (direct, lamps), weight, light, enclosed)
        kept = len(places.texel) - start
        parts.append([np.asarray(x)[..., :kept, :] if x.ndim > 1 else np.asarray(x)[:kept] for x in block_sums])
        progress(min(start + rows, len(places.texel)) * PLACES * PER_PLACE)
    if not parts:
        empty = np.zeros((0, 3), np.float32)
        return Gathered(empty[None].repeat(2, 0), empty[None].repeat(2, 0), empty[:, 0], empty, empty)
    direct, indirect, seen, p, n = (list(x) for x in zip(*parts, strict=True))
    direct, indirect = (np.concatenate(x, axis=1) for x in (direct, indirect))
    return Gathered(direct, indirect, np.concatenate(seen), np.concatenate(p), np.concatenate(n))


def together(a: Gathered, b: Gathered, share: float) -> Gathered:
    """Two sets of samples of the same texels as one.

    Args:
        a: One set.
        b: Another one.
        share: Share of the samples that is in `a`.
    Returns:
        Weighted means; places that are not seen do not count.
    """
    wa, wb = share * a.seen, (1 - share) * b.seen
    total = np.maximum(wa + wb, 1e-9)
    wa, wb = (wa / total)[:, None], (wb / total)[:, None]
    direct, indirect = (x * wa + y * wb for x, y in zip(a[:2], b[:2], strict=True))
    return Gathered(direct, indirect, total * (total > 1e-8), a.p * wa + b.p * wb, a.n * wa + b.n * wb)


class _Spots(NamedTuple):
    """Texels with some of their places."""

    texel: np.ndarray
    triangle: np.ndarray
    place: np.ndarray


def _padded(x: np.ndarray, rows: int) -> np.ndarray:
    return x if len(x) == rows else np.concatenate([x, np.repeat(x[:1], rows - len(x), axis=0)])


@eqx.filter_jit
def _look_at(
    scene: Scene, uv: Float[Array, "f 3 2"], spots: _Spots, *, width: int, side: int
) -> tuple[GBuffer, UInt32[Array, "n"]]:
    """Surface points as seen from straight above, and the sequence of numbers of each texel's side."""
    texel, triangle = jnp.asarray(spots.texel), jnp.asarray(spots.triangle)
    place = jnp.asarray(spots.place)
    x = (texel % width).astype(jnp.float32)[:, None] + ((place % GRID).astype(jnp.float32) + 0.5) / GRID
    y = (texel // width).astype(jnp.float32)[:, None] + ((place // GRID).astype(jnp.float32) + 0.5) / GRID
    a, b, c = (uv[triangle, i] for i in range(3))
    ab, ac = b - a, c - a
    px, py = x - a[..., 0], y - a[..., 1]
    area = ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]
    u = jnp.clip(safe.divide(px * ac[..., 1] - py * ac[..., 0], area), 0, 1)
    v = jnp.clip(safe.divide(ab[..., 0] * py - ab[..., 1] * px, area), 0, 1)
    over = jnp.maximum(u + v, 1)
    flat = triangle.reshape(-1)
    barycentric = jnp.stack([u / over, v / over], -1).reshape(-1, 2)
    corners = scene.mesh.vertices[scene.mesh.faces[flat]]
    normal = safe.normalise(cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    down = -normal if side == 0 else normal
    zero = jnp.zeros(flat.shape, jnp.float32)
    hits = Hits(jnp.ones(flat.shape, bool), zero, flat, barycentric)
    points = build_gbuffer(scene, Rays(jnp.zeros_like(down), down), hits)
    sequence = hash_words(texel.astype(jnp.uint32), side)
    return points, jnp.repeat(sequence, triangle.shape[1])


@eqx.filter_jit
def _ways(
    points: GBuffer, sequence: UInt32[Array, "n"], first: Array
) -> tuple[GBuffer, Rays, Float[Array, "k"], tuple[UInt32[Array, "k"], UInt32[Array, "k"]]]:
    """Places, paths that start there, their weights, and sequence and number of each."""
    count = sequence.shape[0]
    pass_number = (jnp.arange(count, dtype=jnp.int32) % PLACES + first).astype(jnp.uint32)
    four = jnp.arange(PER_PLACE, dtype=jnp.uint32)
    number = (pass_number[:, None] * jnp.uint32(PER_PLACE) + four[None]).reshape(-1)
    more = jax.tree.map(lambda x: jnp.repeat(x, PER_PLACE, axis=0), points)
    repeated = jnp.repeat(sequence, PER_PLACE)
    u = jnp.stack(owen_sobol(repeated, number, jnp.zeros_like(number)), -1)
    wi = cosine_hemisphere(u, more.ns)
    above = dot(more.n, wi) > 0
    weight = jnp.where(above, coupling(more, dot(more.ns, wi)), 0)
    return more, Rays(offset_origin(more.p, more.n, more.p_error, wi), wi), weight, (repeated, number)


@jax.jit
def _enclosed(scene: Scene, rays: Rays, hits: Hits, inner: Bool[Array, "2 f"]) -> Bool[Array, "k"]:
    """Whether a ray meets the inner side of a solid object, in which it must then have started."""
    corners = scene.mesh.vertices[scene.mesh.faces[hits.triangle]]
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    back = (dot(normal, rays.direction) > 0).astype(jnp.int32)
    return hits.valid & inner[back, hits.triangle]


@eqx.filter_jit
def _means(
    points: GBuffer,
    direct: tuple[Float[Array, "n 3"], Float[Array, "k 3"]],
    weight: Float[Array, "k"],
    light: PathLight,
    enclosed: Bool[Array, "k"] | None,
) -> tuple[Array, ...]:
    """Means over the places of each texel that are not enclosed."""
    free = jnp.ones(direct[0].shape[0], bool)
    if enclosed is not None:
        free = ~(enclosed & (weight > 0)).reshape(-1, PER_PLACE).any(-1)
    each = weight[:, None] * (light.diffuse_weighted + light.reflected_weighted + light.refracted_weighted)
    each = each.reshape(-1, PER_PLACE, 3).mean(1)
    share = free.astype(jnp.float32).reshape(-1, PLACES)

    def halves(x: Float[Array, "n c"]) -> Float[Array, "2 t c"]:
        """Means of the even places and of the odd ones; of those there are, where one half sees nothing."""
        x = jnp.where(free[:, None], x, 0).reshape(-1, PLACES, x.shape[-1])
        sums = jnp.stack([x[:, i::2].sum(1) for i in range(2)])
        count = jnp.stack([share[:, i::2].sum(1) for i in range(2)])[..., None]
        both = sums.sum(0) / jnp.maximum(count.sum(0), 1)
        return jnp.where(count > 0, sums / jnp.maximum(count, 1), jnp.broadcast_to(both, sums.shape))

    seen = share.mean(-1)
    whole = [x.reshape(-1, PLACES, 3).mean(1) for x in (points.p, points.ns)]
    return (halves(direct[0] + direct[1].reshape(-1, PER_PLACE, 3).mean(1)), halves(each), seen, *whole)
