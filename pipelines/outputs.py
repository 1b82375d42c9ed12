"""Files: PNG, EXR and JSON as bytes, and bytes to disk so that a file is either whole or not there.

Encoders return bytes that depend on the pixels and the stamp alone: no dates, no names of folders.
"""

import contextlib
import io
import json
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jax import Array

TEMPORARY = ".part"
"""End of the name of a file that is being written."""


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file under its name only when it is complete and on disk.

    Args:
        path: Final name; its folder is made if needed.
        data: Content.
    Raises:
        OSError: If the disk is full or the folder cannot be written; names the file. Nothing is left behind.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def png_bytes(srgb: np.ndarray, stamp: Mapping[str, Any]) -> bytes:
    """An 8-bit PNG.

    Args:
        srgb: [h w 3] sRGB-coded values in [0, 1].
        stamp: Goes into the text chunk `jaxrefl`, as JSON.
    Returns:
        The file's bytes.
    """
    from PIL import Image, PngImagePlugin

    pixels = np.floor(np.clip(srgb, 0, 1) * 255 + 0.5).astype(np.uint8)
    text = PngImagePlugin.PngInfo()
    text.add_itxt("jaxrefl", json_text(stamp))
    stream = io.BytesIO()
    Image.fromarray(pixels, "RGB").save(stream, "PNG", pnginfo=text, optimize=False, compress_level=6)
    return stream.getvalue()


def exr_bytes(channels: Mapping[str, np.ndarray], stamp: Mapping[str, Any]) -> bytes:
    """A float32 EXR with named channels.

    Args:
        channels: [h w] values by channel name, such as "R" or "normal.X".
        stamp: Goes into the header attribute `jaxrefl`, as JSON.
    Returns:
        The file's bytes, losslessly compressed.
    Raises:
        OSError: If there is no room for the temporary file.
    """
    import OpenEXR

    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "jaxrefl": json_text(stamp),
        "software": "jaxrefl",
    }
    planes = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    # The bindings write to a named file only.
    with tempfile.TemporaryDirectory(prefix="jaxrefl-") as folder:
        path = Path(folder) / "image.exr"
        try:
            OpenEXR.File(header, planes).write(str(path))
        except RuntimeError as error:
            raise OSError(f"temporary EXR file in {tempfile.gettempdir()}: {error}") from error
        return path.read_bytes()


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Channels of an EXR file.

    Args:
        path: The file.
    Returns:
        [h w] float32 values by channel name.
    Raises:
        OSError: If the file is missing or broken; names it.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return {name: np.array(channel.pixels, np.float32) for name, channel in file.channels().items()}
    except RuntimeError as error:
        raise OSError(f"{path}: cannot be read as EXR: {error}") from error


def json_text(value: Any) -> str:
    """Valid JSON: NaN and infinity become null, arrays and NumPy numbers become plain ones.

    Args:
        value: Nested mappings, sequences, numbers and strings.
    Returns:
        Text with a line per entry of the outermost list or mapping.
    """
    return json.dumps(_plain(value), ensure_ascii=False, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, np.generic | np.ndarray | Array):
        return _plain(value.tolist())
    return value
