r"""Baked diffuse light: Scene -> a texture of the light at every diffuse surface, and its look-up from a G-buffer.

$$ L_d(p) = \rho(p)\,B(p),\qquad B = \frac{1}{\pi} \int c(\omega_i)\,L_i(\omega_i) \cos\theta_i\,\mathrm{d}\omega_i $$

B, with all bounces of all kinds (Heckbert's L(S|D)*D), does not depend on the viewer, nor on the surface's own colour:
it is stored before the albedo, which stays as sharp as its textures. With the diffuse albedo $\rho$ this is
`path_light`'s `diffuse`, the light without the share that the specular lobe takes.

Each texel is an average over places within itself. From a place, light samples find the emitters, and paths in cosine
distribution bring everything but what is emitted towards it, so that no light counts twice.

Sources: [Arvo86] "Backward ray tracing", for illumination maps; [Heckbert90]; [PBRT4] §13 for the paths.
Lost: what is finer than a texel; tilts of normal maps (B is that of the interpolated normal); anything that moves.
"""

import dataclasses
import json
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxrefl._types import GBuffer, LightMap, Scene, Tracer
from jaxrefl.core import cross, dot, safe
from jaxrefl.radiance.lightmap_atlas import Atlas, Places, make_atlas, places_of
from jaxrefl.radiance.lightmap_file import scene_fingerprint
from jaxrefl.radiance.lightmap_fill import filled
from jaxrefl.radiance.lightmap_gather import MOST_ROWS, PER_PLACE, PLACES, Gathered, gather_light, together
from jaxrefl.radiance.lightmap_sides import Sides, sides_of
from jaxrefl.radiance.lightmap_smooth import Surface, scattered, smoothed
from jaxrefl.rays.blocks import block_size
from jaxrefl.surface.specular import diffuse_albedo


def _count(default: int, low: int, high: int, help: str) -> Any:
    return dataclasses.field(default=default, metadata={"low": low, "high": high, "help": help})


@dataclasses.dataclass(frozen=True)
class LightMapOptions:
    """How a light map is baked; static."""

    MOST: ClassVar[int] = 2**24
    """Most texels."""

    texels: int = _count(2**18, 16, MOST, "Texels that cover the surfaces together, about.")
    """Texels that cover the surfaces together, about; their density is the same everywhere."""
    samples: int = _count(32, 8, 65536, "Paths per texel and side.")
    """Paths per texel and side, rounded up to a multiple of 8; each comes with a sample of each kind of light."""
    bounces: int = _count(15, 1, 1000, "Most scattering events, that at the texel included.")
    """Most scattering events, that at the texel included; 1 is direct light alone."""
    smoothing: bool = dataclasses.field(
        default=True, metadata={"help": "Smooth the light where it differs by noise alone."}
    )
    """Smooth the light where neighbouring texels differ by their noise alone; see `lightmap_smooth`."""

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value, meta = getattr(self, field.name), field.metadata
            if "low" in meta and (type(value) is not int or not meta["low"] <= value <= meta["high"]):
                raise ValueError(
                    f"{field.name}: expected a whole number from {meta['low']} to {meta['high']}, got {value!r}"
                )


def bake(
    scene: Scene,
    tracer: Tracer,
    *,
    options: LightMapOptions = LightMapOptions(),  # noqa: B008  frozen
    progress: Callable[[int, int], None] | None = None,
) -> LightMap:
    """Diffuse light at all surfaces of a scene, from all lights and with all bounces.

    Args:
        scene: The scene; a map that it may already have is not used.
        tracer: Ray queries against `scene.mesh`.
        options: Size and effort.
        progress: Called with the paths traced so far and their expected number.
    Returns:
        The map; `dataclasses.replace(scene, lightmap=...)` makes it the scene's.
    Raises:
        ValueError: If objects of the scene move.
    Edge cases: inner sides of solid objects (see `lightmap_sides`) are not baked and read 0. A texel all of whose
        places lie within a solid object, such as the floor beneath a crate, takes its light from its neighbours, so
        that no shadow leaks out. A side of an object on which none of the first samples finds light stays dark.
    """
    if scene.features.moving:
        raise ValueError("scene: light maps are for static scenes only, and objects of this one move")
    scene = dataclasses.replace(
        scene, lightmap=None, features=dataclasses.replace(scene.features, normal_mapped=False), cameras=scene.cameras
    )
    atlas, sides = make_atlas(scene, options.texels), sides_of(scene)
    places = places_of(atlas)
    layers = 2 if sides.baked[1, atlas.placed].any() else 1
    work = _Work(scene, tracer, atlas, places, sides, options, progress, layers)
    light = np.stack([_layer(work, side) for side in range(layers)])
    return LightMap(
        light=jnp.asarray(light),
        uv=jnp.asarray(atlas.uv),
        fingerprint=scene_fingerprint(scene),
        options=json.dumps(dataclasses.asdict(options)),
    )


@dataclasses.dataclass
class _Work:
    scene: Scene
    tracer: Tracer
    atlas: Atlas
    places: Places
    sides: Sides
    options: LightMapOptions
    progress: Callable[[int, int], None] | None
    layers: int


def _layer(work: _Work, side: int) -> Float[np.ndarray, "lh lw 3"]:
    """The texture of one side."""
    atlas, places, options = work.atlas, work.places, work.options
    shape = (atlas.height, atlas.width)
    owner = np.asarray(work.scene.mesh.object)[places.triangle[:, 0]]
    chosen = np.flatnonzero(work.sides.baked[side, places.triangle[:, 0]])
    if not len(chosen):
        return np.zeros((*shape, 3), np.float32)
    found = _gather(work, side, chosen, 0)
    total = np.bincount(owner[chosen], weights=(found.direct + found.indirect).sum((0, 2)))
    lit = total[owner[chosen]] > 0
    chosen, found = chosen[lit], Gathered(*(x[..., lit, :] if x.ndim > 1 else x[lit] for x in found))
    for number in range(1, -(-options.samples // (PLACES * PER_PLACE))):
        found = together(found, _gather(work, side, chosen, number), number / (number + 1))
    if not len(chosen):
        return np.zeros((*shape, 3), np.float32)
    texel = places.texel[chosen]
    known = scattered(found.seen[:, None], texel, shape)[..., 0]
    if options.smoothing:
        position = scattered((found.p - found.p.mean(0)) * atlas.density, texel, shape)
        normal = scattered(found.n, texel, shape)
        normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
        surface = Surface(position, normal, known)
        parts = (np.stack([scattered(half, texel, shape) for half in part]) for part in (found.direct, found.indirect))
        light = np.sum([smoothed(part, surface) for part in parts], axis=0)
    else:
        light = scattered((found.direct + found.indirect).mean(0), texel, shape)
    return filled(light, known > 0)


def _gather(work: _Work, side: int, chosen: np.ndarray, number: int) -> Gathered:
    """Call number `number` for the same texels, each with places and random numbers of its own."""

    def progress(done: int) -> None:
        if work.progress is not None:
            call = len(work.places.texel) * PLACES * PER_PLACE
            each = -(-work.options.samples // (PLACES * PER_PLACE)) * call
            work.progress(side * each + number * call + done, work.layers * each)

    found = gather_light(
        work.scene,
        work.tracer,
        work.atlas,
        Places(*(x[chosen] for x in work.places)),
        inner=work.sides.inner,
        side=side,
        effort=(number * PLACES, work.options.bounces),
        rows=block_size(len(work.places.texel), MOST_ROWS),
        progress=progress,
    )
    progress(len(work.places.texel) * PLACES * PER_PLACE)
    return found


@jax.jit
def baked_light(scene: Scene, gbuffer: GBuffer) -> Float[Array, "*b 3"]:
    """Diffusely reflected light from the scene's map.

    Args:
        scene: A scene with a `lightmap`.
        gbuffer: Points [*b] on its surfaces.
    Returns:
        Radiance without emission and without the factor (1 - E) of the specular lobe, as `composite.blend` wants it;
        0 where the G-buffer is not valid.
    Raises:
        ValueError: If the scene has no map, or that of another mesh.
    Edge cases: differentiable in the map, the albedo and the position within a texel; beyond the edge of its triangle a
        point reads the edge.
    """
    lightmap = scene.lightmap
    if lightmap is None:
        raise ValueError("scene: has no light map; bake one and put it into `lightmap`")
    if lightmap.uv.shape[0] != scene.mesh.faces.shape[0]:
        raise ValueError(
            f"scene: its light map is for {lightmap.uv.shape[0]} triangles, the mesh has {scene.mesh.faces.shape[0]}"
        )
    triangle = jnp.maximum(gbuffer.triangle, 0)
    corners = scene.mesh.vertices[scene.mesh.faces[triangle]]
    u, v = _barycentric(gbuffer.p, corners)
    place = lightmap.uv[triangle]
    uv = place[..., 0, :] + u[..., None] * (place[..., 1, :] - place[..., 0, :])
    uv = uv + v[..., None] * (place[..., 2, :] - place[..., 0, :])
    light = _bilinear(lightmap.light, uv, gbuffer.outside)
    return jnp.where(gbuffer.valid[..., None], diffuse_albedo(gbuffer) * light, 0)


def _barycentric(
    p: Float[Array, "*b 3"], corners: Float[Array, "*b 3 3"]
) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Weights of the second and third corner, held within the triangle."""
    a, b, c = (corners[..., i, :] for i in range(3))
    ab, ac, ap = b - a, c - a, p - a
    normal = cross(ab, ac)
    square = dot(normal, normal)
    u = jnp.clip(safe.divide(dot(cross(ap, ac), normal), square), 0, 1)
    v = jnp.clip(safe.divide(dot(cross(ab, ap), normal), square), 0, 1)
    over = jnp.maximum(u + v, 1)
    return u / over, v / over


def _bilinear(
    light: Float[Array, "s lh lw 3"], uv: Float[Array, "*b 2"], outside: Bool[Array, "*b"]
) -> Float[Array, "*b 3"]:
    """Light between the four texels around a place; 0 on a side that has no layer."""
    layers, height, width, _ = light.shape
    flat = light.reshape(-1, 3)
    x, y = uv[..., 0] - 0.5, uv[..., 1] - 0.5
    x0, y0 = jnp.floor(x), jnp.floor(y)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    first = jnp.where(outside, 0, (layers - 1) * height * width)
    column = [jnp.clip(x0.astype(jnp.int32) + i, 0, width - 1) for i in (0, 1)]
    row = [first + jnp.clip(y0.astype(jnp.int32) + i, 0, height - 1) * width for i in (0, 1)]
    top, bottom = (flat[r + column[0]] * (1 - fx) + flat[r + column[1]] * fx for r in row)
    found = top * (1 - fy) + bottom * fy
    return found if layers == 2 else jnp.where(outside[..., None], found, 0)
