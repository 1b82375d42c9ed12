"""Texture images: packing them into one list of texels, and bilinear lookup.

`build_textures` (host) concatenates 8-bit images; `texture_rgba` looks them up inside jit, any mixture of images in one
call.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrefl._types import Textures
from jaxrefl.scene.description import Image
from jaxrefl.scene.errors import SceneError


def build_textures(images: Sequence[tuple[Image, bool]]) -> Textures:
    """Pack images into one list of texels.

    Args:
        images: Images with, for each, whether its colours are sRGB-coded (colours are, data such as normals are not).
    Returns:
        The textures, in the order of `images`.
    Raises:
        SceneError: If there is no image, one is not [h w 4] uint8 or empty, or there are more than 2^31 - 1 texels.
    """
    if not images:
        raise SceneError("images: expected at least one texture, got none; a scene without textures has None")
    for image, _ in images:
        if image.rgba.ndim != 3 or image.rgba.shape[2] != 4 or image.rgba.dtype != np.uint8 or not image.rgba.size:
            shape, dtype = list(image.rgba.shape), image.rgba.dtype
            raise SceneError(f"{image.name}: expected a texture of shape [h w 4] and dtype uint8, got {shape} {dtype}")
    sizes = np.array([image.rgba.shape[:2] for image, _ in images], np.int64)
    ends = np.cumsum(sizes[:, 0] * sizes[:, 1])
    if ends[-1] > np.iinfo(np.int32).max:
        raise SceneError(f"images: expected at most 2^31 - 1 texels in all textures, got {ends[-1]}")
    return Textures(
        texels=jnp.asarray(np.concatenate([image.rgba.reshape(-1, 4) for image, _ in images])),
        offset=jnp.asarray(ends - sizes[:, 0] * sizes[:, 1], jnp.int32),
        width=jnp.asarray(sizes[:, 1], jnp.int32),
        height=jnp.asarray(sizes[:, 0], jnp.int32),
        srgb=jnp.asarray([bool(srgb) for _, srgb in images]),
        repeat=jnp.asarray([image.repeat for image, _ in images], bool),
    )


def texture_rgba(textures: Textures, index: Int[Array, "*b"], uv: Float[Array, "*b 2"]) -> Float[Array, "*b 4"]:
    """Bilinearly filtered texture values.

    sRGB-coded channels are decoded *before* filtering; alpha never is. The centre of the texel in column i and row j is
    at `uv = ((i + 0.5) / width, (j + 0.5) / height)`.

    Args:
        textures: The images.
        index: Row in `textures` for each lookup, -1 for none.
        uv: Texture coordinates, (0, 0) at the top left corner of the image; outside [0, 1] they repeat or clamp.
    Returns:
        Linear RGBA in [0, 1]; all ones where `index` is -1.
    Edge cases: coordinates that are not finite count as 0.
    Source: glTF 2.0 §3.8 (wrap modes, linear filter).
    """
    image = jnp.maximum(index, 0)
    width, height = textures.width[image], textures.height[image]
    uv = jnp.where(jnp.isfinite(uv), uv, 0)
    left, right, fx = _taps(uv[..., 0], width, textures.repeat[image, 0])
    upper, lower, fy = _taps(uv[..., 1], height, textures.repeat[image, 1])
    upper, lower = (textures.offset[image] + row * width for row in (upper, lower))
    # One table for both codings: entry 256 * is_srgb + byte.
    coding = jnp.where(textures.srgb[image], 256, 0)
    offsets = jnp.stack([coding, coding, coding, jnp.zeros_like(coding)], -1)
    table = jnp.asarray(DECODED)

    def texel(row: Array, column: Array) -> Array:
        return table[textures.texels[row + column].astype(jnp.int32) + offsets]

    fx, fy = fx[..., None], fy[..., None]
    above = texel(upper, left) * (1 - fx) + texel(upper, right) * fx
    below = texel(lower, left) * (1 - fx) + texel(lower, right) * fx
    return jnp.where((index >= 0)[..., None], above * (1 - fy) + below * fy, 1)


def _taps(coordinate: Float[Array, "*b"], size: Int[Array, "*b"], repeat: Array) -> tuple[Array, Array, Array]:
    """Indices of the two neighbouring texels along one axis and the weight of the second."""
    # Reduced to [0, 1] before it is scaled, so that far-away coordinates keep their precision and fit an integer.
    wrapped = jnp.where(repeat, coordinate - jnp.floor(coordinate), jnp.clip(coordinate, 0, 1))
    x = wrapped * size.astype(wrapped.dtype) - 0.5
    first = jnp.floor(x).astype(jnp.int32)
    second, last = first + 1, size - 1
    weight = x - first.astype(x.dtype)
    first = jnp.where(first < 0, jnp.where(repeat, last, 0), first)
    second = jnp.where(second > last, jnp.where(repeat, 0, last), second)
    return jnp.minimum(first, last), second, weight


def _decoding_table() -> np.ndarray:
    """Linear values of all bytes: 256 linear ones, then 256 sRGB-coded ones (IEC 61966-2-1)."""
    linear = np.arange(256) / 255
    decoded = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    return np.concatenate([linear, decoded]).astype(np.float32)


DECODED = _decoding_table()
"""Linear values of the bytes 0 to 255: first as they are, then sRGB-coded."""
