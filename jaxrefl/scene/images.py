"""Image files -> NumPy arrays: 8-bit textures (`read_image`) and linear radiance maps (`read_radiance`).

Host code of the first stage. Pillow decodes the 8-bit formats and OpenEXR the `.exr` files, both imported on first use;
Radiance `.hdr` lives in `radiance_hdr.py`. Row 0 is the top row. Every error is a `SceneError` that names the file.
"""

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.radiance_hdr import decode_hdr

if TYPE_CHECKING:
    import PIL.Image


def read_image(path: str | Path) -> np.ndarray:
    """Read an 8-bit RGBA image from a file that Pillow understands (PNG, JPEG, TGA, BMP, WebP, ...).

    Args:
        path: Image file.
    Returns:
        [h w 4] uint8, row 0 on top, values as stored (no colour conversion).
    Raises:
        SceneError: If the file is missing, broken, truncated, not an image, or holds floating-point values.
    Edge cases: see `rgba_from_pillow`; of an animation the first frame is read.
    """
    return decode_image(_read_bytes(Path(path)), name=str(path))


def decode_image(data: bytes, *, name: str = "image") -> np.ndarray:
    """Decode an image file that is already in memory, for example one embedded in a GLB.

    Args:
        data: The whole file.
        name: What to call the image in errors.
    Returns:
        [h w 4] uint8, row 0 on top.
    Raises:
        SceneError: If the data is broken, truncated, not an image, or holds floating-point values.
    Edge cases: an image of more than about 180 million pixels is refused (Pillow's guard against decompression bombs).
    """
    import PIL.Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)
            with PIL.Image.open(io.BytesIO(data)) as image:
                image.load()
                return rgba_from_pillow(image, name=name)
    except PIL.UnidentifiedImageError as error:
        raise SceneError(f"{name}: not an image in a format that Pillow reads") from error
    except (OSError, SyntaxError, EOFError, PIL.Image.DecompressionBombError) as error:
        raise SceneError(f"{name}: cannot decode the image: {error}") from error


def rgba_from_pillow(image: "PIL.Image.Image", *, name: str = "image") -> np.ndarray:
    """Convert a Pillow image of any mode to 8-bit RGBA.

    Grey becomes R = G = B, a missing alpha 255, palettes are resolved (their transparency too) and
    16-bit values become `round(v / 257)`.

    Args:
        image: A loaded image.
        name: What to call the image in errors.
    Returns:
        [h w 4] uint8, row 0 on top.
    Raises:
        SceneError: For floating-point images (mode F), which have no 8-bit meaning.
    Edge cases: of 16-bit colour Pillow itself keeps only the upper 8 bits.
    """
    import PIL.Image

    if image.mode == "F":
        raise SceneError(f"{name}: expected an image with 8 or 16 bits per channel, got floating-point values")
    if image.mode == "I" or image.mode.startswith("I;16"):
        values = np.clip(np.asarray(image).astype(np.int64), 0, 65535)
        image = PIL.Image.fromarray(((values + 128) // 257).astype(np.uint8))
    return np.array(image.convert("RGBA"), np.uint8)


def read_radiance(path: str | Path) -> np.ndarray:
    """Read linear radiance from a Radiance `.hdr`/`.pic` or an OpenEXR `.exr` file.

    Args:
        path: Image file; the format is told from its first bytes, not from its name.
    Returns:
        [h w 3] float32 linear RGB, row 0 on top, finite and >= 0.
    Raises:
        SceneError: If the file is missing, broken, of another format, has no RGB or Y channels, or holds values that
            are not finite. Negative values are an error too, as radiance has none.
    Edge cases: an EXR with a single Y channel is grey; of several parts the first with colour is read; see `decode_hdr`
        for what is read of `.hdr`.
    """
    path = Path(path)
    data = _read_bytes(path)
    if data[:2] == b"#?":
        radiance = decode_hdr(data, name=str(path))
    elif data[:4] == b"\x76\x2f\x31\x01":
        radiance = _read_exr(path)
    else:
        raise SceneError(
            f"{path}: expected a Radiance (.hdr) or OpenEXR (.exr) file, got one that starts with {data[:4]!r}"
        )
    for what, wrong in (("not finite", ~np.isfinite(radiance)), ("negative", radiance < 0)):
        if wrong.any():
            raise SceneError(
                f"{path}: expected finite radiance >= 0, got {int(wrong.any(-1).sum())} pixels that are {what}"
            )
    return radiance


def _read_bytes(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot read the image: {error.strerror or error}") from error
    if not data:
        raise SceneError(f"{path}: cannot read the image: the file is empty")
    return data


def _read_exr(path: Path) -> np.ndarray:
    import OpenEXR

    try:
        file = OpenEXR.File(str(path), separate_channels=True)
    except Exception as error:  # the bindings raise bare RuntimeError, ValueError and TypeError
        raise SceneError(f"{path}: cannot decode the OpenEXR file: {error}") from error
    with file:
        parts = [(part.channels, part.header) for part in file.parts]
        for channels, header in parts:
            names = ("R", "G", "B") if {"R", "G", "B"} <= channels.keys() else ("Y", "Y", "Y")
            if not set(names) <= channels.keys() or {"RY", "BY"} & channels.keys():
                continue
            window, display = (np.asarray(header[key]).tolist() for key in ("dataWindow", "displayWindow"))
            if window != display:
                raise SceneError(f"{path}: expected the whole image, got the data window {window} of {display}")
            return np.stack([np.asarray(channels[name].pixels, np.float32) for name in names], -1)
        found = sorted({name for channels, _ in parts for name in channels})
    raise SceneError(f"{path}: expected channels R, G and B (or Y), got {', '.join(found) or 'none'}")
