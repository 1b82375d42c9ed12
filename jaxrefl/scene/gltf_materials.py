"""Materials of a glTF file -> `Material`s, with a note for each field that is present and ignored.

Covers the metallic-roughness model and KHR_materials_emissive_strength, _ior, _transmission, _volume and _unlit, and
KHR_texture_transform. alpha is perceptual roughness squared.

Source: glTF 2.0 specification §3.9 and the extensions' specifications (Khronos).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxrefl.scene.description import Image, Material
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.gltf_container import Document, read_buffer_view, read_uri
from jaxrefl.scene.images import decode_image

_READ = {
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_materials_unlit",
}
_SLOTS = ("base_colour_texture", "metallic_roughness_texture", "normal_texture", "emission_texture")


@dataclass(frozen=True)
class UvTransform:
    """Which texture coordinates a material uses, and what is done to them (KHR_texture_transform)."""

    set: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)

    def apply(self, uv: np.ndarray) -> np.ndarray:
        """Transformed coordinates [v 2]: offset + rotation * (scale * uv), counter-clockwise seen on the image."""
        s, c = math.sin(self.rotation), math.cos(self.rotation)
        scaled = uv * np.asarray(self.scale)
        return scaled @ np.array([[c, s], [-s, c]]).T + np.asarray(self.offset)


@dataclass
class MaterialReader:
    """Reads the materials of one document, each image once."""

    document: Document
    notes: list[str]

    def __post_init__(self) -> None:
        self._images: dict[tuple[int, int | None], Image | None] = {}

    def read(self, index: int) -> tuple[Material, UvTransform]:
        """One material and the transform of its texture coordinates.

        Args:
            index: Number of the material in the file.
        Returns:
            The material, and the transform that all its textures share.
        Raises:
            SceneError: If a value has the wrong type or an index points nowhere.
        """
        data = self.document.item("materials", index)
        name = str(data.get("name") or f"material {index}")
        try:
            return self._read(name, data)
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, SceneError):
                raise
            raise SceneError(f"{self.document.path}: material {name!r}: broken value: {error!r}") from error

    def _read(self, name: str, data: dict[str, Any]) -> tuple[Material, UvTransform]:
        surface = data.get("pbrMetallicRoughness", {})
        extensions = data.get("extensions", {})
        textures = dict(
            zip(
                _SLOTS,
                (
                    surface.get("baseColorTexture"),
                    surface.get("metallicRoughnessTexture"),
                    data.get("normalTexture"),
                    data.get("emissiveTexture"),
                ),
                strict=True,
            )
        )
        base = _numbers(surface.get("baseColorFactor", [1, 1, 1, 1]), 4)
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        emission = [max(0.0, e * strength) for e in _numbers(data.get("emissiveFactor", [0, 0, 0]), 3)]
        images = {slot: self._texture(name, info) for slot, info in textures.items()}
        if not any(emission):
            images["emission_texture"] = None
        eta = self._eta(name, extensions)
        roughness = self._clamped(name, "roughnessFactor", float(surface.get("roughnessFactor", 1.0)))
        material = Material(
            name,
            base_colour=_three(self._clamped(name, "baseColorFactor", b) for b in base[:3]),
            metallic=self._clamped(name, "metallicFactor", float(surface.get("metallicFactor", 1.0))),
            alpha=roughness * roughness,
            eta=eta,
            emission=_three(emission),
            normal_scale=float((data.get("normalTexture") or {}).get("scale", 1.0)),
            **images,
            **self._transmission(name, extensions),
        )
        if "KHR_materials_unlit" in extensions:
            self.notes.append(f"material {name!r}: KHR_materials_unlit: made an emitter of its base colour")
            material = material.replace(
                emission=material.base_colour,
                emission_texture=material.base_colour_texture,
                base_colour=(0.0, 0.0, 0.0),
                base_colour_texture=None,
                metallic_roughness_texture=None,
                metallic=0.0,
                eta=1.0,
            )
        self._note_ignored(name, data, base[3], material)
        used = {slot: info for slot, info in textures.items() if info is not None and images[slot] is not None}
        return material, self._uv_transform(name, used)

    def _eta(self, name: str, extensions: dict[str, Any]) -> float:
        eta = float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5))
        if eta >= 1:
            return eta
        self.notes.append(f"material {name!r}: KHR_materials_ior: expected an index >= 1, got {eta:g}; set to 1")
        return 1.0

    def _transmission(self, name: str, extensions: dict[str, Any]) -> dict[str, Any]:
        """Transmission, absorption and whether the surface is a thin pane."""
        transmission = extensions.get("KHR_materials_transmission", {})
        volume = extensions.get("KHR_materials_volume", {})
        amount = self._clamped(name, "transmissionFactor", float(transmission.get("transmissionFactor", 0.0)))
        if "transmissionTexture" in transmission:
            self.notes.append(f"material {name!r}: transmissionTexture is ignored; its factor {amount:g} is used")
        thick = float(volume.get("thicknessFactor", 0.0)) > 0
        if "thicknessTexture" in volume:
            self.notes.append(f"material {name!r}: thicknessTexture is ignored; rays find the thickness themselves")
        attenuation = (0.0, 0.0, 0.0)
        distance = float(volume.get("attenuationDistance", math.inf))
        if thick and 0 < distance < math.inf:
            # transmittance colour^(t / distance) = exp(-coefficient t); black is kept finite
            colour = [max(c, 1e-6) for c in _numbers(volume.get("attenuationColor", [1, 1, 1]), 3)]
            attenuation = _three(max(0.0, -math.log(c) / distance) for c in colour)
        return {"transmission": amount, "attenuation": attenuation, "thin": amount > 0 and not thick}

    def _texture(self, name: str, info: dict[str, Any] | None) -> Image | None:
        if info is None:
            return None
        texture = self.document.item("textures", info["index"])
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
        source = webp.get("source", texture.get("source"))
        if source is None:
            names = ", ".join(texture.get("extensions", {})) or "no image"
            self.notes.append(f"material {name!r}: texture {info['index']} ({names}) cannot be read; left out")
            return None
        key = (source, texture.get("sampler"))
        if key not in self._images:
            self._images[key] = self._image(*key)
        return self._images[key]

    def _image(self, source: int, sampler: int | None) -> Image | None:
        data = self.document.item("images", source)
        uri = data.get("uri", "")
        name = str(data.get("name") or (uri if uri and not uri.startswith("data:") else f"image {source}"))
        try:
            content = read_uri(self.document, uri) if uri else read_buffer_view(self.document, data["bufferView"])
            rgba = decode_image(content, name=name)
        except ValueError as error:
            self.notes.append(f"texture {name!r} left out: {error}")
            return None
        settings = self.document.item("samplers", sampler) if sampler is not None else {}
        wraps = [settings.get(key, 10497) for key in ("wrapS", "wrapT")]
        if 33648 in wraps:
            self.notes.append(f"texture {name!r}: MIRRORED_REPEAT is ignored; it repeats without mirroring")
        if settings.get("magFilter") == 9728:
            self.notes.append(f"texture {name!r}: NEAREST is ignored; textures are filtered bilinearly")
        return Image(name, rgba, repeat=(wraps[0] != 33071, wraps[1] != 33071))

    def _uv_transform(self, name: str, textures: dict[str, dict[str, Any]]) -> UvTransform:
        """The transform that all textures of a material share; the first one's where they differ."""
        transforms = {slot: _read_transform(info) for slot, info in textures.items()}
        if not transforms:
            return UvTransform()
        first_slot, first = next(iter(transforms.items()))
        for slot, transform in transforms.items():
            if transform != first:
                self.notes.append(
                    f"material {name!r}: {slot} has texture coordinates of its own, which are ignored; "
                    f"those of {first_slot} are used"
                )
        return first

    def _note_ignored(self, name: str, data: dict[str, Any], opacity: float, material: Material) -> None:
        for extension in sorted(set(data.get("extensions", {})) - _READ):
            self.notes.append(f"material {name!r}: {extension} is ignored")
        if "occlusionTexture" in data:
            self.notes.append(f"material {name!r}: occlusionTexture is ignored; rays find the occlusion themselves")
        mode, image = data.get("alphaMode", "OPAQUE"), material.base_colour_texture
        transparent = opacity < 1 or (image is not None and bool((image.rgba[..., 3] < 255).any()))
        if mode != "OPAQUE" and transparent:
            self.notes.append(f"material {name!r}: alphaMode {mode} is ignored; the surface is opaque")

    def _clamped(self, name: str, field: str, value: float) -> float:
        result = min(max(value, 0.0), 1.0)
        if result != value:
            self.notes.append(f"material {name!r}: {field}: expected 0 to 1, got {value:g}; set to {result:g}")
        return result


def _read_transform(info: dict[str, Any]) -> UvTransform:
    data = info.get("extensions", {}).get("KHR_texture_transform", {})
    u, v = _numbers(data.get("offset", [0, 0]), 2)
    x, y = _numbers(data.get("scale", [1, 1]), 2)
    uv_set = int(data.get("texCoord", info.get("texCoord", 0)))
    return UvTransform(uv_set, (u, v), float(data.get("rotation", 0.0)), (x, y))


def _numbers(values: Any, count: int) -> list[float]:
    numbers = [float(v) for v in values]
    if len(numbers) != count or not all(math.isfinite(n) for n in numbers):
        raise ValueError(f"expected {count} finite numbers, got {values!r}")
    return numbers


def _three(values: Any) -> tuple[float, float, float]:
    a, b, c = values
    return a, b, c
