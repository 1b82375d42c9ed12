"""Cluster cameras: clusters and their mirror rays -> one pinhole view each that sees both ends of all its rays.

Source: [WXKP14] §3.3.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera
from jaxrefl.core import cross, dot, frame_from_normal
from jaxrefl.core.safe import normalise
from jaxrefl.rays.views import Views, in_view
from jaxrefl.techniques.clusters.cluster import Clusters, Mirrors
from jaxrefl.techniques.clusters.eye import displaced_eye, fitted_eye, mirrored_eye, nearest_point
from jaxrefl.techniques.clusters.segments import largest, smallest, sums
from jaxrefl.techniques.clusters.types import Options, Params

NEAR_SLOPE = 3.0
"""Largest slope at which the near end of a ray may be seen; eyes too close to their cluster are moved back."""
FAR_SLOPE = 10.0
"""Largest slope at which a far end may be seen, 84 degrees off the axis; clusters with rays beyond have no camera."""
LOBE_SLOPE = 3.0
"""Slope up to which a view is widened for rough lobes, 72 degrees off the axis."""
COARSEST = 0.5
"""Largest slope per texel, 27 degrees; an image of coarser ones shows nothing that rays could be followed through."""
_SPARSEST, _SMALL = 16, 64
"""Most texels per pixel of a cluster, and the pixels that any cluster counts for at least."""
_FINEST = 4
"""How much finer texels may be than the images of pixels themselves, where their rays' far ends lie closer together."""
_TILTS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Near planes that are tried: how far from across the mean normal (0) towards across the view's axis (1)."""
MARGIN = 2
"""Texels around what the rays need: for reading between texels, and so that neighbouring clusters overlap."""


class ClusterCameras(eqx.Module):
    """Views of all clusters."""

    views: Views
    """One view per cluster; no texels for one that is not `usable`."""
    usable: Bool[Array, "c"]
    """True where there is a camera that sees all rays of the cluster, and enough pixels to be worth one."""
    reach: Float[Array, "c"]
    """Length of the rays that are followed, world units."""
    shrunk: Float[Array, ""]
    """Factor on the number of texels, below 1 where there was not room for all."""


@functools.partial(jax.jit, static_argnames=("options", "shape"))
def cluster_cameras(
    camera: Camera,
    mirrors: Mirrors,
    clusters: Clusters,
    diameter: Float[Array, ""],
    params: Params,
    *,
    options: Options,
    shape: tuple[int, int],
) -> ClusterCameras:
    """A camera for each cluster.

    Args:
        camera: The viewer's camera.
        mirrors: Mirror rays.
        clusters: The clusters.
        diameter: Diagonal of the scene, world units.
        params: `resolution`, `smallest`, `lobe`.
        options: `eye`, `axis`, `near`, `texels`.
        shape: Height and width of the image.
    Returns:
        The cameras.
    Edge cases: a cluster of one pixel has the pixel's own angular size as its pitch. An eye that would see the cluster
        too widely, or lie before it, is moved back until it does not. What no pinhole can see has no camera.
    Source: [WXKP14] §3.3.
    Differs from the source: with `axis = "rays"` the image plane faces the mean ray, not the mean normal, so that
        texels are as even as pixels on slanted mirrors too; with `near = "behind"` the clipping plane of a curved
        cluster stands before the first of its points, so that no ray starts or goes behind it. With
        `pitch = "ends"` texels are finer where an eye stands close behind a cluster that gathers its rays.
    """
    capacity, label = clusters.pixels.shape[0], clusters.label
    eye = _place_eye(camera, mirrors, clusters, diameter, options)
    forward = clusters.forward if options.axis == "rays" else clusters.normal
    used = label >= 0
    reach = _reach(clusters, diameter, params, options)
    ignored = clusters.concave if options.concave == "ignore" else jnp.zeros_like(clusters.planar)
    views = _blank_views(camera, clusters, eye, forward, ignored)

    lateral, z = in_view(views, label, mirrors.p)
    wide = jnp.abs(lateral).max(-1) / NEAR_SLOPE - z
    least = 1e-3 * clusters.distance + largest(label, -z, capacity)
    back = jnp.maximum(jnp.maximum(largest(label, wide, capacity), least), 0)
    views = dataclasses.replace(views, eye=eye - forward * back[:, None])
    z = z + back[label]
    near = lateral / jnp.where(used, z, 1)[:, None]

    far, z_far = in_view(views, label, mirrors.p + mirrors.wi * reach[label][:, None])
    ahead = z_far * FAR_SLOPE > jnp.abs(far).max(-1)
    far = far / jnp.where(ahead, z_far, 1)[:, None]
    usable = (clusters.pixels.astype(jnp.float32) >= params.smallest) & (
        smallest(label, ahead.astype(jnp.int32), capacity) > 0
    )
    low = jnp.minimum(smallest(label, near, capacity), smallest(label, far, capacity))
    high = jnp.maximum(largest(label, near, capacity), largest(label, far, capacity))
    low, high = _widened(low, high, clusters, params)
    steps = [_spacing(label, ends, capacity, shape) for ends in (near, far)]
    single = largest(label, mirrors.t / jnp.where(used, z, 1), capacity) / camera.focal[0]
    pixel = steps[0] if options.pitch == "near" else jnp.clip(steps[1], steps[0] / _FINEST, steps[0])
    pixel = jnp.where(pixel > 0, pixel, jnp.where(single > 0, single, 1))
    pitch = jnp.maximum(pixel, params.grain * clusters.alpha) / params.resolution
    extent = jnp.where(usable[:, None], high - low, 0)
    most = _SPARSEST * jnp.square(params.resolution) * jnp.maximum(clusters.pixels, _SMALL).astype(pitch.dtype)
    pitch = jnp.maximum(pitch, jnp.sqrt(extent[:, 0] * extent[:, 1] / most))
    usable = usable & (pitch <= COARSEST)
    extent = jnp.where(usable[:, None], extent, 0)
    wanted = _texels(extent, pitch, usable)
    room = options.room(shape[0] * shape[1])
    # Margins do not shrink with the texels; a little more than the exact factor leaves room for them.
    factor = jnp.where(wanted > room, 1.05 * jnp.sqrt(wanted / room), 1)
    pitch = pitch * factor
    texels = _sizes(extent, pitch, usable)
    fits = jnp.cumsum(texels[:, 0] * texels[:, 1]) <= room
    texels = jnp.where(fits[:, None], texels, 0)
    count = texels[:, 0] * texels[:, 1]
    middle = (low + high) / 2
    views = dataclasses.replace(
        views,
        low=middle - 0.5 * texels.astype(pitch.dtype) * pitch[:, None],
        pitch=jnp.stack([pitch, pitch], -1),
        size=texels,
        offset=jnp.cumsum(count) - count,
        clip=_clip(mirrors, clusters, views, options),
    )
    return ClusterCameras(views, usable & fits, reach, count.sum().astype(jnp.float32) / jnp.maximum(wanted, 1))


def _place_eye(
    camera: Camera, mirrors: Mirrors, clusters: Clusters, diameter: Array, options: Options
) -> Float[Array, "c 3"]:
    start = mirrored_eye(clusters, camera.world_from_camera[:3, 3])
    if options.eye == "equation":
        eye = displaced_eye(mirrors, clusters, start, diameter)
    elif options.eye == "fit":
        eye = fitted_eye(mirrors, clusters, start, diameter)
    else:
        eye = nearest_point(mirrors, clusters, start)
    return jnp.where(clusters.planar[:, None], start, eye)


def _reach(clusters: Clusters, diameter: Array, params: Params, options: Options) -> Float[Array, "c"]:
    """How far rays are followed; as published nearer for rough surfaces."""
    if options.far == "scene":
        return jnp.broadcast_to(diameter, clusters.alpha.shape)
    return diameter * jnp.where(clusters.alpha > 0, jnp.exp2(-clusters.alpha / params.fade), 1)


def _blank_views(camera: Camera, clusters: Clusters, eye: Array, forward: Array, all_of_it: Array) -> Views:
    """Views without an image, that do not see the reflector from behind, or all of it; x is the viewer's, mirrored."""
    capacity = clusters.pixels.shape[0]
    across = jnp.broadcast_to(camera.world_from_camera[:3, 0], eye.shape)
    across = across - clusters.normal * (2 * dot(across, clusters.normal))[:, None]
    right = across - forward * dot(across, forward)[:, None]
    other, _ = frame_from_normal(forward)
    right = jnp.where((dot(right, right) > 1e-4)[:, None], normalise(right), other)
    zero = jnp.zeros((capacity, 2), jnp.float32)
    return Views(
        eye=eye,
        axes=jnp.stack([right, cross(forward, right), forward], 1),
        low=zero,
        pitch=zero + 1,
        size=zero.astype(jnp.int32),
        offset=jnp.zeros(capacity, jnp.int32),
        clip=jnp.broadcast_to(jnp.array([0, 0, 0, 1], jnp.float32), (capacity, 4)),
        own=jnp.where(clusters.planar, -1, clusters.object),
        unseen=jnp.where(all_of_it, 3, jnp.where(clusters.outside, 2, 1)),
    )


def _widened(low: Array, high: Array, clusters: Clusters, params: Params) -> tuple[Array, Array]:
    """Bounds with room for the lobes of rough surfaces, up to `LOBE_SLOPE`.

    Source: [WXKP14] §3.5 (1).
    """
    lobe = 2 * jnp.arctan(params.lobe * clusters.alpha)[:, None]
    most = jnp.arctan(jnp.asarray(LOBE_SLOPE, jnp.float32))

    def wider(slope: Array) -> Array:
        angle = jnp.arctan(slope)
        return jnp.tan(jnp.minimum(angle + lobe, jnp.maximum(angle, most)))

    rough = (clusters.alpha > 0)[:, None]
    return jnp.where(rough, -wider(-low), low), jnp.where(rough, wider(high), high)


def _spacing(label: Array, places: Array, capacity: int, shape: tuple[int, int]) -> Float[Array, "c"]:
    """Mean distance between the images of pixels that are neighbours in the viewer's image, as slopes; 0 for none.

    Source: [WXKP14] §3.3, step 5.
    """
    total, pairs = jnp.zeros(capacity, jnp.float32), jnp.zeros(capacity, jnp.float32)
    labels, places = label.reshape(shape), places.reshape(*shape, 2)
    for axis in (0, 1):
        here, there = (jax.lax.slice_in_dim(labels, a, b, axis=axis) for a, b in ((0, -1), (1, None)))
        step = jnp.diff(places, axis=axis)
        length = jnp.sqrt((step * step).sum(-1)).reshape(-1)
        both = jnp.where(here == there, here, -1).reshape(-1)
        total = total + sums(both, length, capacity)
        pairs = pairs + sums(both, jnp.ones_like(length), capacity)
    return total / jnp.maximum(pairs, 1)


def _sizes(extent: Array, pitch: Array, usable: Array) -> Int[Array, "c 2"]:
    wide = jnp.ceil(jnp.clip(extent / pitch[:, None], 0, 16384)).astype(jnp.int32) + 2 * MARGIN
    return jnp.where(usable[:, None], wide, 0)


def _texels(extent: Array, pitch: Array, usable: Array) -> Float[Array, ""]:
    """Texels of all views; as a float: it may be more than an integer holds."""
    sizes = _sizes(extent, pitch, usable).astype(jnp.float32)
    return (sizes[:, 0] * sizes[:, 1]).sum()


def _clip(mirrors: Mirrors, clusters: Clusters, views: Views, options: Options) -> Float[Array, "c 4"]:
    """Near planes: mirrors themselves, and for curved clusters a plane behind all of their points.

    Of the planes from across the mean normal to across the view's axis the first one that all rays leave, and that has
    the eye behind it. All lie ahead of the reflector's own points by their rounding error, or behind them.
    """
    label, capacity = clusters.label, clusters.pixels.shape[0]
    level = dot(clusters.normal, clusters.centre) + 2 * clusters.p_error
    chosen = jnp.concatenate([clusters.normal, -level[:, None]], -1)
    settled = clusters.planar | (options.near == "centre")
    for share in _TILTS:
        across = normalise(clusters.normal + (views.axes[:, 2] - clusters.normal) * share)
        height = smallest(label, dot(across[label], mirrors.p - views.eye[label]), capacity)
        rising = smallest(label, dot(across[label], mirrors.wi), capacity)
        free = (rising > 0) & (height > 4 * clusters.p_error)
        level = dot(across, views.eye) + height - 2 * clusters.p_error
        plane = jnp.concatenate([across, -level[:, None]], -1)
        chosen = jnp.where((~settled & (free | (share == _TILTS[-1])))[:, None], plane, chosen)
        settled = settled | free
    return chosen
