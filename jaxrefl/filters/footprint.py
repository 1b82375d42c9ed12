r"""Footprint of a GGX lobe in the image: G-buffer + distances -> Gaussians in pixels.

$$ \Sigma = J \operatorname{diag}(\sigma_\parallel^2, \sigma_\perp^2) J^T,\qquad J = P\,(1 + \tau B)^{-1} $$

The deviations along and across the plane of incidence come from the lobe table and contain tau; P takes tangents at
the pixel to pixels; B is the change of the mirrored direction per change of the line of sight that the reflector's
curvature makes, 0 for planes. A convex mirror shrinks footprints as it shrinks what it shows.

Source: [RLPWSD20] §6.1, Eq. 3. Differs from the source: B, and which way a slanted reflector foreshortens (see
`footprint`).
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrefl._types import Camera, GBuffer
from jaxrefl.core import dot, frame_from_normal
from jaxrefl.core.safe import divide, normalise
from jaxrefl.filters.covariance import nearest_covariance
from jaxrefl.filters.lobe_table import LobeGaussians, LobeTable, lobe_gaussians

FORESHORTENING = ("derived", "published")
_FOCUS = 0.1
"""Least determinant of 1 + tau B: at a concave mirror's focus footprints would be infinite."""
_SMOOTH = 0.8
"""Cosine between neighbouring normals below which there is an edge, not curvature."""


class Footprint(eqx.Module):
    """Gaussians [k] that a pixel's value is a mean over, in pixels; x to the right, y down."""

    weight: Float[Array, "*b k"]
    """Weights, which sum to 1."""
    mean: Float[Array, "*b k 2"]
    """Centres relative to the pixel."""
    covariance: Float[Array, "*b k 3"]
    """(xx, xy, yy), positive semidefinite, pixels squared."""


@dataclasses.dataclass(frozen=True)
class FootprintOptions:
    """Choices of `footprint`."""

    foreshortening: str = "derived"
    """"derived": a lobe narrows across the plane of incidence, by the cosine of the viewing angle; "published": the
    frontal lobe, its variance along the plane of incidence times that cosine."""
    curvature: bool = True
    """Take the reflector's curvature into account."""

    def __post_init__(self):
        if self.foreshortening not in FORESHORTENING:
            raise ValueError(
                f"foreshortening: expected one of {', '.join(FORESHORTENING)}, got {self.foreshortening!r}"
            )


def relative_distance(t_camera: Float[Array, "*b"], t_reflected: Float[Array, "*b"]) -> Float[Array, "*b"]:
    r"""Distance to the reflected point as a share of that to its mirror image, $\tau = d_r / (d_c + d_r)$.

    Args:
        t_camera: Distance from the eye to the reflector, >= 0.
        t_reflected: Distance from the reflector to the reflected point, >= 0, or infinity.
    Returns:
        tau, in [0, 1].
    Edge cases: 1 for infinity; 0 where both are 0.
    """
    far = jnp.isinf(t_reflected)
    near = jnp.where(far, 1, t_reflected)
    return jnp.where(far, 1, divide(near, t_camera + near))


def footprint(
    table: LobeTable,
    camera: Camera,
    gbuffer: GBuffer,
    tau: Float[Array, "h w"],
    *,
    alpha: Float[Array, "h w"] | None = None,
    options: FootprintOptions = FootprintOptions(),  # noqa: B008  frozen
) -> Footprint:
    """Footprint of each pixel's lobe.

    Args:
        table: From `load_table`.
        camera: The camera.
        gbuffer: What it sees.
        tau: From `relative_distance`.
        alpha: GGX width; None: the surface's own.
        options: Foreshortening and curvature.
    Returns:
        One or two Gaussians per pixel.
    Edge cases: pixels without a surface have the footprint of a surface that faces the viewer. Concave mirrors whose
    focus is at the reflected point get a large but finite footprint.
    Differs from the source: with `foreshortening = "derived"` slanted reflectors narrow the lobe *across* the plane of
    incidence, as microfacets do, so that reflections on a floor are longer than wide.
    """
    alpha = gbuffer.alpha if alpha is None else alpha
    cosine = jnp.clip(dot(gbuffer.ns, gbuffer.wo), 0, 1)
    if options.foreshortening == "derived":
        lobe = lobe_gaussians(table, cosine, alpha, tau)
    else:
        lobe = lobe_gaussians(table, jnp.ones_like(cosine), alpha, tau)
        slant = jnp.sqrt(jnp.maximum(cosine, 1e-6))[..., None]
        lobe = LobeGaussians(lobe.weight, lobe.mean * slant, lobe.along * slant, lobe.across)
    along, across = _frame(gbuffer)
    jacobian = _pixels_from_tangents(camera, gbuffer.wo, along, across)
    if options.curvature:
        jacobian = _curved(jacobian, gbuffer, along, across, tau)
    (ax, bx), (ay, by) = ((column[..., None] for column in row) for row in jacobian)
    a2, b2 = lobe.along**2, lobe.across**2
    covariance = jnp.stack([ax * ax * a2 + bx * bx * b2, ax * ay * a2 + bx * by * b2, ay * ay * a2 + by * by * b2], -1)
    return Footprint(lobe.weight, jnp.stack([ax * lobe.mean, ay * lobe.mean], -1), covariance)


def remaining(full: Footprint, source: Footprint) -> Footprint:
    r"""Footprint that is left to filter where a source is blurred already.

    $$ \Sigma_I = \Sigma_\rho - \Sigma_{\rho'} $$

    Args:
        full: Of the surface's roughness.
        source: Of the roughness with which the source was rendered.
    Returns:
        The difference, Gaussian by Gaussian; covariances that are no longer positive semidefinite become the nearest
        ones that are.
    Edge cases: exact for one Gaussian. With two the cross terms are left out: between a source of half the
    roughness and the full one, a narrow and a wide Gaussian each lose their own.
    Source: [RLPWSD20] Eq. 3.
    """
    covariance = nearest_covariance(full.covariance - source.covariance)
    return Footprint(full.weight, full.mean - source.mean, covariance)


def plane_slope(camera: Camera, gbuffer: GBuffer) -> Float[Array, "h w 2"]:
    """Change of the inverse depth per pixel on the plane of each pixel's triangle; it is the same all over a plane.

    Args:
        camera: The camera.
        gbuffer: What it sees; `z_camera` is not None.
    Returns:
        Derivatives of 1 / z with respect to x and y; 0 where there is no surface or it is seen from the side.
    """
    rotation, z = camera.world_from_camera[:3, :3], _depth(gbuffer)
    normal = [_along_axis(gbuffer.n, rotation, axis) for axis in range(2)]
    height = -dot(gbuffer.n, gbuffer.wo) * gbuffer.t  # of the plane over the eye
    usable = gbuffer.valid & (jnp.abs(height) > 1e-3 * z)
    inverse = jnp.where(usable, 1 / jnp.where(usable, height, 1), 0)
    return jnp.stack([normal[0] * inverse / camera.focal[0], -normal[1] * inverse / camera.focal[1]], -1)


def _depth(gbuffer: GBuffer) -> Float[Array, "h w"]:
    if gbuffer.z_camera is None:
        raise ValueError("gbuffer: expected one that was built with its camera (`look`), got one without `z_camera`")
    return gbuffer.z_camera


def _along_axis(v: Float[Array, "*b 3"], rotation: Float[Array, "3 3"], axis: int) -> Float[Array, "*b"]:
    return v[..., 0] * rotation[0, axis] + v[..., 1] * rotation[1, axis] + v[..., 2] * rotation[2, axis]


def _frame(gbuffer: GBuffer) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Unit vectors across the line of sight: in the plane of incidence towards the normal, and out of it."""
    wo, tangent = gbuffer.wo, frame_from_normal(gbuffer.wo)[0]
    along = gbuffer.ns - dot(gbuffer.ns, wo)[..., None] * wo
    frontal = dot(along, along) < 1e-8
    along = normalise(jnp.where(frontal[..., None], tangent, along))
    (x, y, z), (a, b, c) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (wo, along))
    return along, jnp.stack([y * c - z * b, z * a - x * c, x * b - y * a], -1)


Matrix = tuple[tuple[Float[Array, "*b"], Float[Array, "*b"]], tuple[Float[Array, "*b"], Float[Array, "*b"]]]


def _pixels_from_tangents(
    camera: Camera, wo: Float[Array, "*b 3"], along: Float[Array, "*b 3"], across: Float[Array, "*b 3"]
) -> Matrix:
    """P: pixels (x, y) per tangent (along, across)."""
    rotation = camera.world_from_camera[:3, :3]
    x, y, z = (-_along_axis(wo, rotation, 0), -_along_axis(wo, rotation, 1), _along_axis(wo, rotation, 2))
    inverse = 1 / jnp.maximum(z, 1e-6)

    def column(e: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
        ex, ey, ez = (_along_axis(e, rotation, axis) for axis in range(3))
        nearer = ez * inverse
        return camera.focal[0] * (ex + x * nearer) * inverse, -camera.focal[1] * (ey + y * nearer) * inverse

    (ax, ay), (bx, by) = column(along), column(across)
    return (ax, bx), (ay, by)


def _curved(
    p: Matrix,
    gbuffer: GBuffer,
    along: Float[Array, "h w 3"],
    across: Float[Array, "h w 3"],
    tau: Float[Array, "h w"],
) -> Matrix:
    """J = P (1 + tau B)^-1 with B = W P, W the change of the mirrored direction per pixel."""
    cosine = dot(gbuffer.ns, gbuffer.wo)
    turned = []
    for axis in (1, 0):
        turn = _change_of_normal(gbuffer, axis)
        mirrored = 2 * (cosine[..., None] * turn - dot(gbuffer.wo, turn)[..., None] * gbuffer.ns)
        turned.append((dot(mirrored, along), dot(mirrored, across)))
    (wax, wbx), (way, wby) = turned
    (p00, p01), (p10, p11) = p
    d00, d01 = 1 + tau * (wax * p00 + way * p10), tau * (wax * p01 + way * p11)
    d10, d11 = tau * (wbx * p00 + wby * p10), 1 + tau * (wbx * p01 + wby * p11)
    determinant = d00 * d11 - d01 * d10
    size = jnp.maximum(jnp.abs(determinant), _FOCUS)
    inverse = jnp.where(determinant < 0, -1, 1) / size
    i00, i01, i10, i11 = d11 * inverse, -d01 * inverse, -d10 * inverse, d00 * inverse
    return (p00 * i00 + p01 * i10, p00 * i01 + p01 * i11), (p10 * i00 + p11 * i10, p10 * i01 + p11 * i11)


def _change_of_normal(gbuffer: GBuffer, axis: int) -> Float[Array, "h w 3"]:
    """Change of the shading normal per pixel along an axis, from neighbours on the same smooth surface."""
    n = gbuffer.ns

    def neighbour(step: int) -> tuple[Float[Array, "h w 3"], Bool[Array, "h w"]]:
        size = n.shape[axis]
        index = jnp.arange(size, dtype=jnp.int32) + step
        inside = (index >= 0) & (index < size)
        index = jnp.clip(index, 0, size - 1)
        other = jnp.take(n, index, axis)
        same = (jnp.take(gbuffer.object, index, axis) == gbuffer.object) & gbuffer.valid
        inside = inside[:, None] if axis == 0 else inside[None, :]
        same = same & jnp.broadcast_to(inside, same.shape) & (dot(other, n) > _SMOOTH)
        return other, same

    (after, has_after), (before, has_before) = neighbour(1), neighbour(-1)
    change = jnp.where(has_after[..., None], after - n, 0) + jnp.where(has_before[..., None], n - before, 0)
    count = has_after.astype(jnp.float32) + has_before.astype(jnp.float32)
    return change / jnp.maximum(count, 1)[..., None]
