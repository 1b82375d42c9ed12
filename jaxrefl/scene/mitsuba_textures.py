"""Colours, numbers and textures of a Mitsuba scene -> what a `Material` holds.

Input: a node and the name of one of its properties. Output: a constant factor, an 8-bit image, and the transform of
the texture coordinates, which is baked into those of the mesh. Mitsuba's bitmaps have (0, 0) at the top left, as ours.
"""

from dataclasses import dataclass, field

import numpy as np

from jaxrefl.scene.description import Image
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.images import read_image, read_radiance
from jaxrefl.scene.mitsuba_nodes import Node, Triple
from jaxrefl.scene.srgb_bytes import as_bytes, linear_from_srgb, opaque, srgb_from_linear

CHECKERBOARD = 512
"""Texels along each side of the image that stands for a checkerboard of 2 x 2 fields."""

MISSING = (0.5, 0.5, 0.5)
"""Colour in the place of a texture that cannot be read."""

_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Mitsuba's weights, with which it makes one number of a coloured bitmap."""

_BUILDERS = {"reflectance": "get_texture", "emission": "get_emissive_texture", "index": "get_unbounded_texture"}


@dataclass(frozen=True)
class Texture:
    """A colour or number that may vary over the surface."""

    factor: Triple = (1.0, 1.0, 1.0)
    """Constant factor, linear."""
    image: Image | None = None
    """What multiplies the factor: sRGB-coded for colours, linear for numbers; None: the same everywhere."""
    to_uv: np.ndarray | None = None
    """[3 3] affine transform of the texture coordinates; None: the identity, or no image."""
    attribute: str | None = None
    """Name of the vertex attribute that multiplies the factor; None: none does."""

    @property
    def mean(self) -> float:
        """Mean of the three channels of the factor."""
        return sum(self.factor) / 3


@dataclass
class TextureReader:
    """Reads the textures of one file, each image once."""

    _images: dict[tuple, Texture] = field(default_factory=dict)

    def colour(self, node: Node, key: str, default: Triple, *, meaning: str = "reflectance") -> Texture:
        """A colour.

        Args:
            node: The object that has it.
            key: Name of the property.
            default: Mitsuba's default.
            meaning: "reflectance", "emission" or "index" (any value >= 0), which decides how spectra become colours.
        Returns:
            The texture; its image is sRGB-coded.
        Raises:
            SceneError: If the value is neither a number nor a colour, spectrum or texture.
        """
        child = node.child(key)
        if child is None:
            return Texture(self._constant(node, key, default, meaning))
        if child.plugin == "bitmap":
            return self._cached(child, meaning, lambda: self._bitmap(child, meaning))
        if child.plugin == "checkerboard":
            return self._cached(child, meaning, lambda: self._checkerboard(child, meaning))
        if child.plugin == "mesh_attribute":
            name = str(child.get("name", "vertex_color"))
            scale = child.number("scale", 1.0)
            return Texture(grey(scale), attribute=name)
        settings = {k: child.props[k] for k in child.keys() if child.child(k) is None}
        try:
            value = node.scene.evaluated(node.scene.mi.load_dict({"type": child.plugin, **settings}))
        except (RuntimeError, AttributeError, TypeError):
            node.scene.notes.group("these textures are not known here and count as grey (0.5)", child.place)
            value = MISSING
        return Texture(value)

    def number(self, node: Node, key: str, default: float) -> Texture:
        """A number, such as a roughness: of a coloured bitmap its luminance, as in Mitsuba.

        Args:
            node: The object that has it.
            key: Name of the property.
            default: Mitsuba's default.
        Returns:
            The texture; its image holds linear values, the same in all three colour channels.
        Raises:
            SceneError: As for `colour`.
        """
        child = node.child(key)
        if child is None or child.plugin != "bitmap":
            found = self.colour(node, key, grey(default))
            if found.image is not None:
                levels = linear_from_srgb(found.image.rgba[..., :3] / 255) @ _LUMINANCE * found.mean
                return Texture(image=_with_levels(found.image, levels), to_uv=found.to_uv)
            return Texture(grey(found.mean))
        return self._cached(child, "number", lambda: self._bitmap(child, "number"))

    def linear(self, node: Node, key: str) -> Texture:
        """A bitmap whose channels are data, such as a normal map.

        Args:
            node: The object that has it.
            key: Name of the property.
        Returns:
            The texture; its image holds linear values. None in `image` if the child is no bitmap.
        """
        child = node.child(key)
        if child is None or child.plugin != "bitmap":
            return Texture()
        return self._cached(child, "data", lambda: self._bitmap(child, "data"))

    def _cached(self, child: Node, meaning: str, make) -> Texture:
        key = (child.index, meaning)
        if key not in self._images:
            self._images[key] = make()
        return self._images[key]

    def _constant(self, node: Node, key: str, default: Triple, meaning: str) -> Triple:
        value = node.get(key, default)
        if isinstance(value, bool | str):
            raise SceneError(f"{node.scene.path}: {node.place}: {key}: expected a colour, got {value!r}")
        if isinstance(value, int | float):
            return grey(float(value))
        try:
            red, green, blue = np.asarray(value, np.float64).reshape(3).tolist()
        except (TypeError, ValueError):  # a spectrum
            red, green, blue = node.scene.evaluated(getattr(node.props, _BUILDERS[meaning])(key))
        if meaning == "reflectance" and max(red, green, blue) > 1:
            node.scene.notes.group("colours above 1 are set to 1", node.place)
            red, green, blue = (min(c, 1.0) for c in (red, green, blue))
        return red, green, blue

    def _bitmap(self, child: Node, meaning: str) -> Texture:
        notes, filename = child.scene.notes, str(child.get("filename", ""))
        path, raw = child.scene.resolve(child, filename), bool(child.get("raw", False))
        try:
            pixels, linear = _stored_pixels(child, filename, raw)
        except SceneError as error:
            notes.add(f"texture {filename!r} left out: {error}")
            return Texture(MISSING)
        wrap = str(child.get("wrap_mode", "repeat"))
        if wrap == "mirror":
            notes.group("these textures repeat without mirroring (wrap_mode mirror is ignored)", path.name)
        if str(child.get("filter_type", "bilinear")) == "nearest":
            notes.group("these textures are filtered bilinearly (filter_type nearest is ignored)", path.name)
        scale = 1.0
        if pixels.dtype != np.uint8:
            scale = max(1.0, float(pixels.max())) if meaning == "emission" else 1.0
            notes.group("these floating-point textures are stored with 8 bits per channel", path.name)
            pixels = pixels / scale
        rgba = _converted(pixels, linear, meaning)
        image = Image(path.name, rgba, repeat=(wrap != "clamp", wrap != "clamp"))
        return Texture(grey(scale), image, _to_uv(child))

    def _checkerboard(self, child: Node, meaning: str) -> Texture:
        first = self.colour(child, "color0", (0.4, 0.4, 0.4), meaning=meaning)
        second = self.colour(child, "color1", (0.2, 0.2, 0.2), meaning=meaning)
        if first.image is not None or second.image is not None:
            child.scene.notes.group("pictures in a checkerboard count as their factors", child.place)
        child.scene.notes.group(
            f"checkerboards are images of {CHECKERBOARD}x{CHECKERBOARD} texels, so their edges are a texel wide",
            child.place,
        )
        colours = np.array([first.factor, second.factor])
        scale = max(1.0, float(colours.max()))
        upper = np.arange(CHECKERBOARD) >= CHECKERBOARD // 2
        rgb = as_bytes(srgb_from_linear(colours / scale))[(upper[:, None] != upper[None]).astype(int)]
        return Texture(grey(scale), Image(child.name or "checkerboard", opaque(rgb)), _to_uv(child))


def grey(value: float) -> Triple:
    """The same value three times."""
    return value, value, value


def mapped(image: Image, change) -> Image:
    """An sRGB-coded image with a function of its linear values.

    Args:
        image: The image.
        change: Takes and returns linear values [h w 3].
    Returns:
        The new image; alpha is kept.
    """
    levels = linear_from_srgb(np.arange(256) / 255)
    changed = as_bytes(srgb_from_linear(change(np.stack([levels] * 3, -1)[None])))[0]
    rgb = np.stack([changed[image.rgba[..., i], i] for i in range(3)], -1)
    return Image(image.name, np.concatenate([rgb, image.rgba[..., 3:]], -1), image.repeat)


def _stored_pixels(child: Node, filename: str, raw: bool) -> tuple[np.ndarray, bool]:
    """Bytes [h w 3] as stored, or floating-point values, and True if they are linear."""
    path = child.scene.resolve(child, filename)
    if path.suffix.lower() in (".exr", ".hdr", ".rgbe", ".pfm"):
        return read_radiance(path), True
    return read_image(path)[..., :3], raw


def _converted(pixels: np.ndarray, linear: bool, meaning: str) -> np.ndarray:
    """Texels [h w 4] coded as their meaning wants it: sRGB for colours, linear for numbers and data."""
    coded = meaning in ("reflectance", "emission", "index")
    if pixels.dtype == np.uint8 and meaning != "number" and coded != linear:
        return opaque(pixels)
    values = pixels / 255 if pixels.dtype == np.uint8 else pixels.astype(np.float64)
    values = values if linear else linear_from_srgb(values)
    if meaning == "number":
        values = np.repeat((values @ _LUMINANCE)[..., None], 3, -1)
    return opaque(as_bytes(srgb_from_linear(values) if coded else values))


def _with_levels(image: Image, levels: np.ndarray) -> Image:
    return Image(image.name, opaque(as_bytes(np.repeat(levels[..., None], 3, -1))), image.repeat)


def _to_uv(child: Node) -> np.ndarray | None:
    """The affine transform of the texture coordinates [3 3]; None for the identity."""
    matrix = child.matrix("to_uv")[np.ix_([0, 1, 3], [0, 1, 3])]
    return None if np.allclose(matrix, np.eye(3)) else matrix
