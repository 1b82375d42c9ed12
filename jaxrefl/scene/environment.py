"""Light from infinitely far away: latitude-longitude maps, their lookup and their importance sampling.

`build_environment` (host) makes the tables; `environment_radiance`, `sample_environment` and `environment_pdf` are pure
JAX functions of them. Lookup is bilinear. The sampling density is constant over each texel and proportional to the
integral of the *bilinear* radiance over it, so that it is positive wherever the radiance is. A map of one texel is a
constant sky: it costs no lookup.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrefl._types import Environment
from jaxrefl.core import apart, latlong_from_direction
from jaxrefl.scene.description import Sky
from jaxrefl.scene.distributions import distribution, invert_cdf
from jaxrefl.scene.errors import SceneError

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def build_environment(sky: Sky) -> Environment:
    r"""Tables of an environment map.

    The probability of a texel is proportional to $\Omega_{ij} \int L$, with the solid angle
    $\Omega_{ij} = \frac{2\pi}{w}\,(\cos\frac{\pi i}{h} - \cos\frac{\pi (i + 1)}{h})$ and the luminance of the
    bilinear radiance averaged over the texel.

    Args:
        sky: Radiance map and its rotation.
    Returns:
        The environment.
    Raises:
        SceneError: If the map has another shape than [eh ew 3], holds values that are not finite or negative, or the
            transform is not a rotation.
    Edge cases: a black map is sampled uniformly over the sphere.
    Source: [PBRT4] §12.5.2.
    Differs from the source: the tables are exact multiples of 2^-23; see `distributions.py`.
    """
    radiance = np.asarray(sky.radiance, np.float32)
    if radiance.ndim != 3 or radiance.shape[-1] != 3 or 0 in radiance.shape:
        raise SceneError(f"{sky.name}: expected a radiance map of shape [h w 3], got {list(radiance.shape)}")
    if not np.isfinite(radiance).all() or (radiance < 0).any():
        raise SceneError(f"{sky.name}: expected finite radiance >= 0, got {radiance.min()} to {radiance.max()}")
    rotation = np.asarray(sky.world_from_map, np.float64)
    if (
        rotation.shape != (3, 3)
        or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
        or np.linalg.det(rotation) < 0
    ):
        raise SceneError(f"{sky.name}: expected world_from_map to be a 3x3 rotation, got {rotation.tolist()}")

    luminance = _texel_means(radiance.astype(np.float64) @ _LUMINANCE)
    height, width = luminance.shape
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    weights = luminance * (edges[:-1] - edges[1:])[:, None]
    if not weights.any():
        weights = np.broadcast_to((edges[:-1] - edges[1:])[:, None], weights.shape)
    row_cdf, row_probability = distribution(weights.sum(-1))
    column_cdf, column_probability = distribution(weights)
    return Environment(
        radiance=jnp.asarray(radiance),
        world_from_map=jnp.asarray(rotation, jnp.float32),
        row_cdf=jnp.asarray(row_cdf),
        column_cdf=jnp.asarray(column_cdf),
        probability=jnp.asarray(row_probability[:, None] * column_probability),
    )


def environment_radiance(environment: Environment, direction: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Radiance from a direction, bilinear in the map.

    Args:
        environment: The map.
        direction: Unit directions away from the scene, world space.
    Returns:
        Linear radiance.
    Edge cases: columns wrap around, rows end at the poles; the result stays within the range of the map's values.
    """
    return _radiance_at(environment, _map_coordinates(environment, direction))


def sample_environment(
    environment: Environment, u: Float[Array, "*b 2"]
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"], Float[Array, "*b"]]:
    """Directions in proportion to the map's luminance.

    Args:
        environment: The map.
        u: Random numbers in [0, 1)^2; stratified ones give stratified directions.
    Returns:
        Unit directions in world space, the radiance from there, and the probability density per solid angle (> 0).
    Source: [PBRT4] §12.5.2; inversion of the marginal and the conditional table.
    """
    height, width = environment.probability.shape
    row, v = invert_cdf(environment.row_cdf, u[..., 1])
    column, x = invert_cdf(environment.column_cdf.reshape(-1), u[..., 0], start=row * width, count=width)
    # Uniform in solid angle within the texel: the squares of sin and cos of half the polar angle are linear in v.
    half_angle = np.pi / (2 * height) * np.arange(height + 1)
    sin2, cos2 = (jnp.asarray(f(half_angle) ** 2, u.dtype) for f in (np.sin, np.cos))
    sin2, cos2 = (f[row] * (1 - v) + f[row + 1] * v for f in (sin2, cos2))
    azimuth = (column.astype(x.dtype) + x) * (2 * np.pi / width) - np.pi
    sin = 2 * jnp.sqrt(sin2 * cos2)
    local = jnp.stack([sin * jnp.sin(azimuth), cos2 - sin2, -sin * jnp.cos(azimuth)], -1)
    direction = _rotate(environment.world_from_map, local)
    polar = 2 * jnp.arctan2(jnp.sqrt(sin2), jnp.sqrt(cos2))
    radiance = _radiance_at(environment, jnp.stack([0.5 + azimuth / (2 * np.pi), polar / np.pi], -1))
    return direction, radiance, _density(environment, row, column)


def environment_pdf(environment: Environment, direction: Float[Array, "*b 3"]) -> Float[Array, "*b"]:
    """Probability density with which `sample_environment` finds a direction.

    Args:
        environment: The map.
        direction: Unit directions, world space.
    Returns:
        Density per solid angle; integrates to 1 over the sphere.
    Edge cases: 0 where the map is black around the direction.
    """
    return _density_at(environment, _map_coordinates(environment, direction))


def environment_light(
    environment: Environment, direction: Float[Array, "*b 3"]
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b"]]:
    """`environment_radiance` and `environment_pdf` of the same directions, at little more than the cost of one.

    Args:
        environment: The map.
        direction: Unit directions, world space.
    Returns:
        Radiance, and density per solid angle.
    """
    uv = _map_coordinates(environment, direction)
    return _radiance_at(environment, uv), _density_at(environment, uv)


def _radiance_at(environment: Environment, uv: Float[Array, "*b 2"]) -> Float[Array, "*b 3"]:
    if environment.probability.size == 1:
        return jnp.broadcast_to(environment.radiance[0, 0], (*uv.shape[:-1], 3))
    return apart(uv[..., 0] >= 0, _bilinear, environment.radiance, uv)


def _density_at(environment: Environment, uv: Float[Array, "*b 2"]) -> Float[Array, "*b"]:
    height, width = environment.probability.shape
    column = jnp.clip((uv[..., 0] * width).astype(jnp.int32), 0, width - 1)
    row = jnp.clip((uv[..., 1] * height).astype(jnp.int32), 0, height - 1)
    return _density(environment, row, column)


def _texel_means(luminance: np.ndarray) -> np.ndarray:
    """Mean of the bilinear interpolant over each texel: (1, 6, 1) / 8 along both axes."""
    rows = np.pad(luminance, ((1, 1), (0, 0)), mode="edge")
    luminance = (rows[:-2] + 6 * rows[1:-1] + rows[2:]) / 8
    columns = np.pad(luminance, ((0, 0), (1, 1)), mode="wrap")
    return (columns[:, :-2] + 6 * columns[:, 1:-1] + columns[:, 2:]) / 8


def _density(environment: Environment, row: Int[Array, "*b"], column: Int[Array, "*b"]) -> Float[Array, "*b"]:
    height, width = environment.probability.shape
    # cos a - cos b as a product, which does not cancel near the poles.
    solid_angle = (4 * np.pi / width * np.sin(np.pi / (2 * height))) * jnp.sin(
        np.pi / height * (row.astype(jnp.float32) + 0.5)
    )
    return environment.probability.reshape(-1)[row * width + column] / solid_angle


def _bilinear(image: Float[Array, "h w c"], uv: Float[Array, "*b 2"]) -> Float[Array, "*b c"]:
    height, width, channels = image.shape
    texels = image.reshape(-1, channels)
    x, y = uv[..., 0] * width - 0.5, jnp.clip(uv[..., 1] * height - 0.5, 0, height - 1)
    column, row = jnp.floor(x).astype(jnp.int32), jnp.minimum(y.astype(jnp.int32), max(height - 2, 0))
    fx, fy = (x - column.astype(x.dtype))[..., None], (y - row.astype(y.dtype))[..., None]
    left, right = column % width, (column + 1) % width
    upper, lower = row * width, jnp.minimum(row + 1, height - 1) * width
    above = texels[upper + left] * (1 - fx) + texels[upper + right] * fx
    below = texels[lower + left] * (1 - fx) + texels[lower + right] * fx
    return above * (1 - fy) + below * fy


def _map_coordinates(environment: Environment, direction: Float[Array, "*b 3"]) -> Float[Array, "*b 2"]:
    if environment.probability.size == 1:
        return jnp.full((*direction.shape[:-1], 2), 0.5, direction.dtype)
    local = _rotate(environment.world_from_map.T, direction)
    return apart(local[..., 0] <= 2, latlong_from_direction, local)


def _rotate(rotation: Float[Array, "3 3"], v: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return jnp.stack([x * row[0] + y * row[1] + z * row[2] for row in rotation], -1)
