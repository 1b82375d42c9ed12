"""Everything that emits: Description + Mesh + Materials -> Lights.

Host code of `assemble`: the table of emissive triangles with a distribution proportional to their power, the arrays of
punctual lights, the environment map, the ambient term. What a scene does not have is None.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrefl._types import AreaLights, Lights, Materials, Mesh, PunctualLights, Textures
from jaxrefl.scene.description import Description, PunctualLight
from jaxrefl.scene.distributions import distribution
from jaxrefl.scene.environment import build_environment
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.textures import DECODED, texture_rgba

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_FLOOR = 0.1
"""Share of its emission texture's overall mean that every triangle is given, so that a bright spot that the points of
`_texture_means` miss is still sampled."""


def build_lights(
    description: Description, mesh: Mesh, materials: Materials, *, textures: Textures | None = None
) -> Lights:
    """The lights of a scene.

    Args:
        description: Its `lights`, `sky` and `ambient` are read.
        mesh: All triangles; those whose material emits become area lights.
        materials: The table `mesh.material` points into.
        textures: The images `materials.emission_texture` points into; None if there are none.
    Returns:
        The lights; a kind that does not occur, or only with zero power, is None.
    Raises:
        SceneError: If a light or the ambient term has values that are not finite, negative or out of range, the sky is
            not valid, or a material has an emission texture and `textures` is None.
    """
    ambient = np.asarray(description.ambient, np.float64)
    if ambient.shape != (3,) or not np.isfinite(ambient).all() or (ambient < 0).any():
        raise SceneError(
            f"scene {description.name!r}: expected a finite ambient colour >= 0, got {description.ambient}"
        )
    return Lights(
        ambient=jnp.asarray(ambient, jnp.float32),
        area=_area_lights(mesh, materials, textures),
        punctual=_punctual_lights([_checked(light) for light in description.lights]),
        environment=None if description.sky is None else build_environment(description.sky),
    )


def _area_lights(mesh: Mesh, materials: Materials, textures: Textures | None) -> AreaLights | None:
    r"""Emissive triangles with probability proportional to area times mean emitted luminance."""
    emission = np.asarray(materials.emission, np.float64)
    material = np.asarray(mesh.material)
    triangle = np.flatnonzero((emission.max(axis=1) > 0)[material])
    material = material[triangle]
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)[triangle]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1) / 2
    power = area * (emission[material] * _texture_factors(mesh, materials, textures, triangle) @ _LUMINANCE)

    kept = power > 0
    if not kept.any():
        return None
    if kept.sum() > 2**22:
        raise SceneError(f"lights: expected at most {2**22} emissive triangles, got {kept.sum()}")
    cdf, probability = distribution(power[kept])
    return AreaLights(
        triangle=jnp.asarray(triangle[kept], jnp.int32),
        cdf=jnp.asarray(cdf),
        probability=jnp.asarray(probability),
        area=jnp.asarray(area[kept], jnp.float32),
        textured=bool((np.asarray(materials.emission_texture)[material[kept]] >= 0).any()),
    )


def _texture_factors(mesh: Mesh, materials: Materials, textures: Textures | None, triangle: np.ndarray) -> np.ndarray:
    """Mean of the emission texture over each emissive triangle: [e 3], 1 without a texture."""
    factors = np.ones((len(triangle), 3))
    material = np.asarray(mesh.material)[triangle]
    texture = np.asarray(materials.emission_texture)[material]
    textured = np.flatnonzero(texture >= 0)
    if not len(textured):
        return factors
    if textures is None or mesh.uv is None:
        missing = "textures" if textures is None else "texture coordinates"
        raise SceneError(f"lights: a material has an emission texture, but the scene has no {missing}")
    corner_uv = np.asarray(mesh.uv)[np.asarray(mesh.faces)[triangle[textured]]]
    texture = texture[textured]
    own = (1 - _FLOOR) * _texture_means(textures, texture, corner_uv)
    for index in np.unique(texture).tolist():
        same = texture == index
        image = _texels(textures, index)
        dark = _all_dark(image, corner_uv[same])
        own[same] = np.where(dark[:, None], 0, own[same] + _FLOOR * _image_mean(image, bool(textures.srgb[index])))
    factors[textured] = own
    return factors


def _texels(textures: Textures, index: int) -> np.ndarray:
    """RGB of one image: [h w 3] uint8."""
    start, width, height = (int(x[index]) for x in (textures.offset, textures.width, textures.height))
    return np.asarray(textures.texels)[start : start + width * height, :3].reshape(height, width, 3)


def _image_mean(image: np.ndarray, srgb: bool) -> np.ndarray:
    """Mean linear colour [3] of an image; positive if any texel is."""
    counts = np.stack([np.bincount(image[..., channel].ravel(), minlength=256) for channel in range(3)])
    table = DECODED[256:] if srgb else DECODED[:256]
    return counts @ table.astype(np.float64) / counts[0].sum()


def _all_dark(image: np.ndarray, corner_uv: np.ndarray) -> np.ndarray:
    """Which triangles [e 3 2] lie where their image is exactly black: they never shine and need no samples.

    All texels are checked that bilinear filtering may touch within the triangle's bounding box; a box that leaves the
    image counts as not dark.
    """
    h, w, _ = image.shape
    count = np.pad(image.any(-1).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    texel = corner_uv * (w, h) - 0.5
    (x0, y0), (x1, y1) = np.floor(texel.min(1)).astype(int).T, np.floor(texel.max(1)).astype(int).T + 2
    within = (x0 >= 0) & (y0 >= 0) & (x1 <= w) & (y1 <= h)
    x0, x1, y0, y1 = (np.clip(x, 0, most) for x, most in ((x0, w), (x1, w), (y0, h), (y1, h)))
    return within & (count[y1, x1] - count[y0, x1] - count[y1, x0] + count[y0, x0] == 0)


def _texture_means(textures: Textures, texture: np.ndarray, corner_uv: np.ndarray) -> np.ndarray:
    """Texture colour averaged over 16 points of each triangle [e 3 2]: the centres of 16 congruent parts of it."""
    third = 1 / 12
    parts = [(i / 4 + third, j / 4 + third) for i in range(4) for j in range(4 - i)]
    parts += [(i / 4 + 2 * third, j / 4 + 2 * third) for i in range(3) for j in range(3 - i)]
    lookup = eqx.filter_jit(texture_rgba)
    index, total = jnp.asarray(texture, jnp.int32), np.zeros((len(texture), 3))
    for u, v in parts:
        uv = corner_uv[:, 0] * (1 - u - v) + corner_uv[:, 1] * u + corner_uv[:, 2] * v
        total += np.asarray(lookup(textures, index, jnp.asarray(uv, jnp.float32)))[:, :3]
    return total / len(parts)


def _checked(light: PunctualLight) -> PunctualLight:
    """Refuse a light that has no meaning."""
    where = f"light {light.name!r}"
    for field in ("intensity", "position", "direction"):
        value = np.asarray(getattr(light, field), np.float64)
        if value.shape != (3,) or not np.isfinite(value).all():
            raise SceneError(f"{where}: expected {field} to be three finite numbers, got {getattr(light, field)}")
    if min(light.intensity) < 0:
        raise SceneError(f"{where}: expected an intensity >= 0, got {light.intensity}")
    if not any(light.direction):
        raise SceneError(f"{where}: expected a direction, got the zero vector")
    if not -2 <= light.cos_outer <= light.cos_inner <= 1:
        raise SceneError(f"{where}: expected cos_outer <= cos_inner <= 1, got {light.cos_outer} and {light.cos_inner}")
    if not 0 <= light.angular_radius < np.pi / 2:
        raise SceneError(f"{where}: expected an angular radius from 0 to pi/2 (excluded), got {light.angular_radius}")
    return light


def _punctual_lights(lights: list[PunctualLight]) -> PunctualLights | None:
    lights = [light for light in lights if any(light.intensity)]
    if not lights:
        return None
    direction = np.array([light.direction for light in lights], np.float64)
    direction /= np.abs(direction).max(-1, keepdims=True)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)

    def column(field: str):
        return jnp.asarray([getattr(light, field) for light in lights], jnp.float32)

    directional = jnp.asarray([light.directional for light in lights])
    return PunctualLights(
        position=jnp.where(directional[:, None], 0, column("position")),
        direction=jnp.asarray(direction, jnp.float32),
        intensity=column("intensity"),
        directional=directional,
        cos_inner=column("cos_inner"),
        cos_outer=column("cos_outer"),
        angular_radius=column("angular_radius"),
    )
