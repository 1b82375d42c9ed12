"""Many pinhole views at once: rays and projections of a batch of off-axis cameras that share one flat list of texels.

A view's texels lie row by row in the list, row 0 on top, and the next view's follow without a gap: an atlas that wastes
nothing, whatever the sizes of its images. Depth is kept as `1 / z` along the view's axis: it is linear in the image,
along projected lines as well as over planes, and 0 for what is infinitely far away.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrefl._types import Camera, Rays
from jaxrefl.core.safe import divide, norm


class Views(eqx.Module):
    """Pinhole views [c]; a point at `x right + y down + z forward` from the eye is seen at the slopes x / z, y / z."""

    eye: Float[Array, "c 3"]
    """Centre of projection, world space."""
    axes: Float[Array, "c 3 3"]
    """Unit vectors: right, down, forward."""
    low: Float[Array, "c 2"]
    """Slopes (x, y) at the upper left corner of the image."""
    pitch: Float[Array, "c 2"]
    """Slopes per texel (x, y), > 0."""
    size: Int[Array, "c 2"]
    """Texels (width, height); 0 for a view that shows nothing."""
    offset: Int[Array, "c"]
    """The view's first texel in the list."""
    clip: Float[Array, "c 4"]
    """Plane (n, d): only points p with n . p + d > 0 are seen; (0, 0, 0, 1) for no plane."""
    own: Int[Array, "c"]
    """Object that is not seen, or not from all sides; -1 for none."""
    unseen: Int[Array, "c"]
    """Of that object's triangles, what is not seen: 1 those that face the eye, 2 those that do not, 3 all."""


def view_of(camera: Camera) -> Views:
    """A camera as a batch of one view.

    Args:
        camera: Any camera.
    Returns:
        One view; texel number `row * width + column` is the camera's pixel.
    """
    rotation = camera.world_from_camera[:3, :3]
    axes = jnp.stack([rotation[:, 0], -rotation[:, 1], -rotation[:, 2]])
    return Views(
        eye=camera.world_from_camera[None, :3, 3],
        axes=axes[None],
        low=(-camera.centre / camera.focal)[None],
        pitch=(1 / camera.focal)[None],
        size=jnp.array([[camera.width, camera.height]], jnp.int32),
        offset=jnp.zeros(1, jnp.int32),
        clip=jnp.array([[0, 0, 0, 1]], jnp.float32),
        own=jnp.full(1, -1, jnp.int32),
        unseen=jnp.zeros(1, jnp.int32),
    )


def texel_count(views: Views) -> Int[Array, ""]:
    """Texels of all views together.

    Args:
        views: Any views.
    Returns:
        Length of the list that is in use.
    """
    return (views.size[:, 0] * views.size[:, 1]).sum()


def place_texels(views: Views, texel: Int[Array, "n"]) -> tuple[Int[Array, "n"], Int[Array, "n"], Int[Array, "n"]]:
    """Where texels of the list belong.

    Args:
        views: Views whose `offset` rises.
        texel: Numbers of texels, >= 0.
    Returns:
        View, column and row; texels behind the end of the list belong to the last view, below its last row.
    """
    ends = views.offset + views.size[:, 0] * views.size[:, 1]
    view = jnp.searchsorted(ends, texel, side="right").astype(jnp.int32)
    view = jnp.minimum(view, views.offset.shape[0] - 1)
    within, width = texel - views.offset[view], jnp.maximum(views.size[view, 0], 1)
    return view, within % width, within // width


def view_rays(views: Views, texel: Int[Array, "n"]) -> tuple[Rays, Int[Array, "n"], Bool[Array, "n"]]:
    """Rays through the centres of texels, from the clipping plane on where that lies ahead of the eye.

    Args:
        views: Any views.
        texel: Numbers of texels.
    Returns:
        Rays [n], the view of each, and whether it ever reaches the visible side of the clipping plane.
    """
    view, column, row = place_texels(views, texel)
    at = jnp.stack([column, row], -1).astype(jnp.float32) + 0.5
    slope = views.low[view] + at * views.pitch[view]
    right, down, forward = (views.axes[view, i] for i in range(3))
    direction = right * slope[:, :1] + down * slope[:, 1:] + forward
    direction = direction / norm(direction)[:, None]
    eye, plane = views.eye[view], views.clip[view]
    height = (plane[:, :3] * eye).sum(-1) + plane[:, 3]
    rising = (plane[:, :3] * direction).sum(-1)
    start = jnp.where((height < 0) & (rising > 0), divide(-height, rising), 0)
    return Rays(eye + direction * start[:, None], direction), view, (height >= 0) | (rising > 0)


def in_view(
    views: Views, view: Int[Array, "n"], p: Float[Array, "n 3"]
) -> tuple[Float[Array, "n 2"], Float[Array, "n"]]:
    """Points and directions in the frame of their view.

    Args:
        views: Any views.
        view: View of each point.
        p: World positions.
    Returns:
        Lateral offsets (x, y) from the view's axis and depth z along it, world units.
    """
    offset = p - views.eye[view]
    x, y, z = (dot_axis(views, view, offset, i) for i in range(3))
    return jnp.stack([x, y], -1), z


def dot_axis(views: Views, view: Int[Array, "n"], v: Float[Array, "n 3"], axis: int) -> Float[Array, "n"]:
    """Component of vectors along an axis of their view.

    Args:
        views: Any views.
        view: View of each vector.
        v: Vectors, world space.
        axis: 0 right, 1 down, 2 forward.
    Returns:
        Components.
    """
    unit = views.axes[view, axis]
    return v[..., 0] * unit[..., 0] + v[..., 1] * unit[..., 1] + v[..., 2] * unit[..., 2]


def seen_by(views: Views, view: Int[Array, "n"], p: Float[Array, "n 3"]) -> Bool[Array, "n"]:
    """Whether points lie within the image of their view, whatever hides them.

    Args:
        views: Any views.
        view: View of each point.
        p: World positions.
    Returns:
        True inside the frame and ahead of the eye.
    """
    lateral, z = in_view(views, view, p)
    high = views.low[view] + views.pitch[view] * views.size[view].astype(jnp.float32)
    inside = (lateral >= views.low[view] * z[:, None]) & (lateral <= high * z[:, None])
    return (z > 0) & inside.all(-1)
