"""Named channels of a frame's multi-layer EXR: G-buffer, diffuse light and Reflection -> [h w] planes.

Where nothing is seen, or nothing is reflected, a channel holds the fill value of its type (0, ids -1, normals
(0, 0, 1)); `valid` and `reflected_valid` (1 or 0) say where.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxrefl._types import GBuffer, Reflection
from jaxrefl.radiance.progressive import Estimate


def rgb_channels(image: Any, *, layer: str = "") -> dict[str, np.ndarray]:
    """Three colour channels.

    Args:
        image: [h w 3].
        layer: Name of the layer; empty: the file's plain R, G and B.
    Returns:
        [h w] planes by channel name.
    """
    return _split(image, layer, "RGB")


def _split(image: Any, layer: str, axes: str) -> dict[str, np.ndarray]:
    values = np.asarray(image, np.float32)
    return {f"{layer}.{axis}" if layer else axis: values[..., i] for i, axis in enumerate(axes)}


def frame_channels(image: Any, gbuffer: GBuffer, diffuse: Any, reflection: Reflection) -> dict[str, np.ndarray]:
    """All channels of one frame.

    Args:
        image: [h w 3] composited linear radiance.
        gbuffer: What is seen.
        diffuse: [h w 3] emitted and diffusely reflected radiance.
        reflection: Incoming radiance before Fresnel and specular colour, and where it comes from.
    Returns:
        [h w] float32 planes by channel name; `motion`, `transmitted` and `emission` where the scene has them.
    """
    planes = rgb_channels(image)
    planes |= _split(reflection.radiance, "reflection", "RGB")
    planes |= _split(diffuse, "diffuse", "RGB")
    planes |= _split(gbuffer.base_colour, "albedo", "RGB")
    planes |= _split(gbuffer.ns, "normal", "XYZ")
    planes |= _split(gbuffer.p, "position", "XYZ")
    planes |= _split(reflection.p, "reflected_position", "XYZ")
    single = {
        "Z": gbuffer.z_camera,
        "valid": gbuffer.valid,
        "object_id": gbuffer.object,
        "material_id": gbuffer.material,
        "metallic": gbuffer.metallic,
        "alpha": gbuffer.alpha,
        "reflected_distance": reflection.t,
        "reflected_valid": reflection.valid,
        "source": reflection.source,
        "confidence": reflection.confidence,
    }
    planes |= {name: np.asarray(plane).astype(np.float32) for name, plane in single.items() if plane is not None}
    if reflection.transmitted is not None:
        planes |= _split(reflection.transmitted, "transmitted", "RGB")
    if gbuffer.emission is not None:
        planes |= _split(gbuffer.emission, "emission", "RGB")
    if gbuffer.motion is not None:
        planes |= _split(gbuffer.motion, "motion", "XY")
    return planes


def technique_channels(layers: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Channels of a technique's own images.

    Args:
        layers: `Info.layers`: [h w] planes, or [h w 2] vectors, by name.
    Returns:
        [h w] float32 planes by channel name; vectors as `name.X` and `name.Y`.
    """
    planes: dict[str, np.ndarray] = {}
    for name, image in layers.items():
        values = np.asarray(image, np.float32)
        planes |= {name: values} if values.ndim == 2 else _split(values, name, "XY")
    return planes


def path_channels(estimate: Estimate, *, refractive: bool) -> dict[str, np.ndarray]:
    """All channels of one frame of the reference, under the names of `frame_channels`.

    Args:
        estimate: Mean light and its standard error.
        refractive: Whether the scene refracts.
    Returns:
        [h w] float32 planes by channel name. `R G B` is the sum of `emission` (the background included),
            `diffuse_weighted`, `reflection_weighted` and `transmitted_weighted`; `error` is its standard error, where
            it is known.
    """
    light = estimate.light
    layers = {
        "": estimate.radiance,
        "emission": light.emitted,
        "diffuse": light.emitted + light.diffuse,
        "reflection": light.reflected,
        "diffuse_weighted": light.diffuse_weighted,
        "reflection_weighted": light.reflected_weighted,
        "transmitted": light.refracted if refractive else None,
        "transmitted_weighted": light.refracted_weighted if refractive else None,
        "error": estimate.error,
    }
    return {k: v for name, x in layers.items() if x is not None for k, v in _split(x, name, "RGB").items()}
