"""glTF files as bytes: the JSON, the binary buffers, and arrays from accessors.

Input: a `.gltf` or `.glb` file, version 2. Output: a `Document`, from which `gltf.py` reads geometry, `gltf_nodes.py`
lights and cameras and `gltf_materials.py` materials. trimesh reads glTF too, but drops tangents, texture coordinates
without a material, second texture coordinate sets, sparse and normalised accessors, samplers and most cameras, so the
few structures that a scene needs are read here; tests compare the geometry with trimesh's.

Source: glTF 2.0 specification (Khronos), §3.6 (buffers and accessors), §4 (GLB).
"""

import base64
import binascii
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from jaxrefl.scene.errors import SceneError

_TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_REFUSED = {
    "KHR_draco_mesh_compression": "Draco-compressed geometry",
    "EXT_meshopt_compression": "meshopt-compressed geometry",
    "KHR_meshopt_compression": "meshopt-compressed geometry",
}
_HINT = "save the file without compression, for example with `gltf-transform copy in.glb out.glb`"


@dataclass(frozen=True)
class Document:
    """A glTF file."""

    path: Path
    json: dict[str, Any]
    """The parsed JSON."""
    binary: bytes | None
    """The binary chunk of a `.glb`."""

    def items(self, kind: str) -> list[dict[str, Any]]:
        """A top-level list such as "meshes"; empty where the file has none."""
        value = self.json.get(kind, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise SceneError(f"{self.path}: {kind}: expected a list of objects")
        return value

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """Element of a top-level list.

        Raises:
            SceneError: If there is no such element.
        """
        items = self.items(kind)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(items):
            raise SceneError(f"{self.path}: {kind}: expected an index from 0 to {len(items) - 1}, got {index!r}")
        return items[index]


def read_document(path: Path) -> Document:
    """The JSON and the binary chunk of a glTF file.

    Args:
        path: A `.gltf` or `.glb` file; told apart by their first bytes.
    Returns:
        The document; external buffers are read when an accessor needs them.
    Raises:
        SceneError: If the file is not glTF 2, is broken or truncated, or needs an extension that hides its geometry.
    """
    data = path.read_bytes()
    text, binary = (data, None) if data[:4] != b"glTF" else _glb_chunks(path, data)
    try:
        content = json.loads(text)
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise SceneError(f"{path}: expected glTF: a GLB header or JSON text; the file is broken ({error})") from error
    if not isinstance(content, dict) or not isinstance(content.get("asset"), dict):
        raise SceneError(f"{path}: expected glTF JSON with an `asset`, got none")
    version = str(content["asset"].get("version", ""))
    if version.split(".")[0] != "2":
        raise SceneError(f"{path}: expected glTF version 2, got {version or 'none'}")
    for name in content.get("extensionsRequired", []):
        if name in _REFUSED:
            raise SceneError(f"{path}: {_REFUSED[name]} ({name}) cannot be read; {_HINT}")
    return Document(path, content, binary)


def read_accessor(document: Document, index: Any) -> np.ndarray:
    """The values of an accessor.

    Args:
        document: The file.
        index: Number of the accessor.
    Returns:
        [count columns] in the stored type, or float32 in [0, 1] or [-1, 1] where the accessor is normalised.
    Raises:
        SceneError: If the accessor or its buffer view does not exist, reaches beyond its buffer, or is compressed.
    Edge cases: accessors without a buffer view are zero, apart from their sparse part, as the specification says.
    """
    where = f"{document.path}: accessor {index!r}"
    accessor = document.item("accessors", index)
    try:
        dtype = np.dtype(_TYPES[accessor["componentType"]]).newbyteorder("<")
        columns, count = _COLUMNS[accessor["type"]], int(accessor["count"])
    except (KeyError, TypeError, ValueError) as error:
        raise SceneError(f"{where}: missing or unknown {error}") from error
    if "bufferView" in accessor:
        offset = accessor.get("byteOffset", 0)
        values = _view_array(document, accessor["bufferView"], offset, count, columns, dtype, where)
    else:
        values = np.zeros((count, columns), dtype)
    if "sparse" in accessor:
        values = values.copy()
        sparse, n = accessor["sparse"], int(accessor["sparse"]["count"])
        rows, replaced = sparse["indices"], sparse["values"]
        row_type = np.dtype(_TYPES[rows["componentType"]]).newbyteorder("<")
        at = _view_array(document, rows["bufferView"], rows.get("byteOffset", 0), n, 1, row_type, where)[:, 0]
        if n and int(at.max()) >= count:
            raise SceneError(f"{where}: expected sparse indices below {count}, got {int(at.max())}")
        offset = replaced.get("byteOffset", 0)
        values[at] = _view_array(document, replaced["bufferView"], offset, n, columns, dtype, where)
    if accessor.get("normalized") and dtype.kind in "iu":
        scaled = values.astype(np.float32) / np.iinfo(dtype).max
        return np.maximum(scaled, -1.0)
    return values


def read_buffer_view(document: Document, index: Any) -> bytes:
    """The bytes of a buffer view, for images inside a file.

    Args:
        document: The file.
        index: Number of the buffer view.
    Returns:
        Its bytes.
    Raises:
        SceneError: If it does not exist, reaches beyond its buffer, or is compressed.
    """
    where = f"{document.path}: buffer view {index!r}"
    view = document.item("bufferViews", index)
    for name in view.get("extensions", {}):
        if name in _REFUSED and document.item("buffers", view.get("buffer")).get("uri") is None:
            raise SceneError(f"{where}: {_REFUSED[name]} ({name}) cannot be read; {_HINT}")
    data = _buffer(document, view.get("buffer"))
    start, length = int(view.get("byteOffset", 0)), int(view.get("byteLength", 0))
    if start < 0 or length < 0 or start + length > len(data):
        raise SceneError(f"{where}: expected bytes {start} to {start + length}, but its buffer ends at {len(data)}")
    return data[start : start + length]


def read_uri(document: Document, uri: str) -> bytes:
    """The bytes behind a `data:` URI or a file beside the document.

    Args:
        document: The file the URI stands in.
        uri: The URI.
    Returns:
        The bytes.
    Raises:
        SceneError: If the file is missing or the data is not base64.
    """
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.split(",", 1)[1], validate=True)
        except (IndexError, binascii.Error) as error:
            raise SceneError(f"{document.path}: broken data URI {uri[:40]}...: {error}") from error
    file = document.path.parent / unquote(uri)
    try:
        return file.read_bytes()
    except OSError as error:
        raise SceneError(f"{document.path}: needs {file.name}, which cannot be read: {error.strerror}") from error


def _buffer(document: Document, index: Any) -> bytes:
    buffer = document.item("buffers", index)
    if "uri" in buffer:
        data = read_uri(document, buffer["uri"])
    elif index == 0 and document.binary is not None:
        data = document.binary
    else:
        raise SceneError(f"{document.path}: buffer {index}: expected a `uri` or the binary chunk of a GLB, got neither")
    if len(data) < int(buffer.get("byteLength", 0)):
        raise SceneError(
            f"{document.path}: buffer {index}: expected {buffer['byteLength']} bytes, got {len(data)}; truncated?"
        )
    return data


def _view_array(
    document: Document, view: int, offset: int, count: int, columns: int, dtype: np.dtype, where: str
) -> np.ndarray:
    data = read_buffer_view(document, view)
    item = columns * dtype.itemsize
    stride = int(document.item("bufferViews", view).get("byteStride", 0)) or item
    needed = offset + (count - 1) * stride + item if count else 0
    if count < 0 or offset < 0 or stride < item or needed > len(data):
        raise SceneError(
            f"{where}: expected {count} x {columns} values ({needed} bytes), but its buffer view has {len(data)}"
        )
    if not count:
        return np.zeros((0, columns), dtype)
    return np.ndarray((count, columns), dtype, data, offset, (stride, dtype.itemsize)).copy()


def _glb_chunks(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    if len(data) < 20:
        raise SceneError(f"{path}: truncated: a GLB header has 20 bytes, the file {len(data)}")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise SceneError(f"{path}: expected GLB version 2, got {version}")
    if length > len(data):
        raise SceneError(f"{path}: truncated: expected {length} bytes, got {len(data)}")
    text, binary, at = None, None, 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        chunk = data[at + 8 : at + 8 + size]
        if len(chunk) < size:
            raise SceneError(f"{path}: truncated: a chunk of {size} bytes ends after {len(chunk)}")
        if kind == 0x4E4F534A and text is None:
            text = chunk
        elif kind == 0x004E4942 and binary is None:
            binary = chunk
        at += 8 + size
    if text is None:
        raise SceneError(f"{path}: expected a JSON chunk in the GLB, got none")
    return text, binary
