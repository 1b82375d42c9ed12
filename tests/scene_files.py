"""Small scene files for tests, written in full so that each can be broken in one place."""

import base64
import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image as PillowImage

QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
QUAD_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
QUAD_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
"""The image stands upright on the quad: v grows downwards, as glTF counts it."""

_COMPONENTS = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class GltfWriter:
    """Collects accessors into one buffer; `content` is the JSON and may be changed at will."""

    def __init__(self, **content):
        self.buffer = b""
        self.content = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], **content}

    def view(self, data: bytes, **extra) -> int:
        """Append bytes as a buffer view."""
        self.buffer += b"\0" * (-len(self.buffer) % 4)
        view = {"buffer": 0, "byteOffset": len(self.buffer), "byteLength": len(data), **extra}
        self.buffer += data
        self.content["bufferViews"].append(view)
        return len(self.content["bufferViews"]) - 1

    def accessor(self, array, **extra) -> int:
        """Append an array as an accessor."""
        array = np.ascontiguousarray(array)
        columns = array.shape[1] if array.ndim > 1 else 1
        accessor = {
            "bufferView": self.view(array.tobytes()),
            "componentType": _COMPONENTS[array.dtype.char],
            "type": _TYPES[columns],
            "count": len(array),
            **extra,
        }
        self.content["accessors"].append(accessor)
        return len(self.content["accessors"]) - 1

    def image(self, rgba: np.ndarray) -> dict:
        """An image inside the file."""
        file = io.BytesIO()
        PillowImage.fromarray(rgba).save(file, "png")
        return {"bufferView": self.view(file.getvalue()), "mimeType": "image/png"}

    def write(self, path: Path) -> Path:
        """Write as `.glb` or, with the buffer as a data URI, as `.gltf`."""
        if path.suffix == ".glb":
            self.content["buffers"] = [{"byteLength": len(self.buffer)}]
            text = json.dumps(self.content).encode()
            text += b" " * (-len(text) % 4)
            binary = self.buffer + b"\0" * (-len(self.buffer) % 4)
            chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942)
            body = chunks + binary
            path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
        else:
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.buffer).decode()
            self.content.setdefault("buffers", [{"byteLength": len(self.buffer), "uri": uri}])
            path.write_text(json.dumps(self.content))
        return path


def quad_gltf(material: dict | None = None, *, node: dict | None = None, normals: bool = True, **content) -> GltfWriter:
    """A unit square facing +Z with texture coordinates and, if wanted, a material."""
    gltf = GltfWriter(**content)
    attributes = {"POSITION": gltf.accessor(QUAD), "TEXCOORD_0": gltf.accessor(QUAD_UV)}
    if normals:
        attributes["NORMAL"] = gltf.accessor(np.tile(np.array([0, 0, 1], np.float32), (4, 1)))
    primitive = {"attributes": attributes, "indices": gltf.accessor(QUAD_FACES.reshape(-1))}
    if material is not None:
        gltf.content["materials"] = [{"name": "paint", **material}]
        primitive["material"] = 0
    gltf.content["meshes"] = [{"name": "square", "primitives": [primitive]}]
    gltf.content["nodes"] = [{"name": "panel", "mesh": 0, **(node or {})}]
    gltf.content["scenes"] = [{"nodes": [0]}]
    gltf.content["scene"] = 0
    return gltf


CUBE_OBJ = """
o cube
v -1 -1 -1
v 1 -1 -1
v 1 1 -1
v -1 1 -1
v -1 -1 1
v 1 -1 1
v 1 1 1
v -1 1 1
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 3 4 8 7
f 2 3 7 6
f 1 5 8 4
"""


def write_obj(folder: Path, text: str = CUBE_OBJ, *, mtl: str | None = None, name: str = "scene.obj") -> Path:
    """An OBJ file and, if wanted, its material library beside it."""
    path = folder / name
    if mtl is not None:
        text = f"mtllib {path.stem}.mtl\n{text}"
        path.with_suffix(".mtl").write_text(mtl)
    path.write_text(text)
    return path


def checker(low: int = 0, high: int = 255) -> np.ndarray:
    """A 2x2 RGBA image."""
    grey = np.array([[low, high], [high, low]], np.uint8)
    return np.stack([grey, grey, grey, np.full((2, 2), 255, np.uint8)], -1)
