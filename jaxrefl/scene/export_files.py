"""Files beside an exported scene: binary PLY meshes, and textures with what Mitsuba cannot say baked in.

Input: arrays of a `Scene`. Output: files in a folder, and their names relative to it.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxrefl._types import Textures
from jaxrefl.scene.errors import SceneError


def write_ply(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    uv: np.ndarray | None = None,
    colours: np.ndarray | None = None,
) -> None:
    """Write a binary PLY mesh as Mitsuba reads it.

    Args:
        path: The file.
        vertices: [v 3] positions.
        faces: [f 3] indices.
        normals: [v 3] unit normals; None: none.
        uv: [v 2] texture coordinates, (0, 0) at the top left, as Mitsuba has them; None: none.
        colours: [v 3] linear colours, which become the attribute `vertex_color`; None: none.
    Raises:
        OSError: If the file cannot be written.
    """
    columns = {"x y z": vertices, "nx ny nz": normals, "u v": uv, "r g b": colours}
    given = {names: values for names, values in columns.items() if values is not None}
    names = [name for group in given for name in group.split()]
    table = np.concatenate(list(given.values()), 1).astype("<f4")
    rows = np.empty(len(faces), [("count", "u1"), ("index", "<i4", 3)])
    rows["count"], rows["index"] = 3, faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + table.tobytes() + rows.tobytes())


def file_name(name: str, taken: set[str]) -> str:
    """A file name for an object or material.

    Args:
        name: Any text.
        taken: Names that are in use; receives the new one.
    Returns:
        Letters, digits, ".", "-" and "_" only, different from those taken whatever the case of its letters.
    """
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._")[:60] or "unnamed"
    candidate, number = plain, 1
    while candidate.lower() in taken:
        number += 1
        candidate = f"{plain}_{number}"
    taken.add(candidate.lower())
    return candidate


@dataclass
class TextureFiles:
    """Writes the textures of one scene, each distinct picture once."""

    folder: Path
    """Folder of the scene file; pictures go to `textures` in it."""
    textures: Textures | None
    """The images of the scene."""
    _written: dict[bytes, str] = field(default_factory=dict)
    _taken: set[str] = field(default_factory=set)

    def texels(self, row: int) -> np.ndarray:
        """One image [h w 4] uint8, as stored."""
        if self.textures is None:
            raise SceneError(f"textures: expected image {row}, got a scene without textures")
        t = self.textures
        start, width, height = (int(column[row]) for column in (t.offset, t.width, t.height))
        return np.asarray(t.texels)[start : start + width * height].reshape(height, width, 4)

    def wrap_mode(self, row: int) -> tuple[str, bool]:
        """Mitsuba's wrap mode, and True if it holds for both directions."""
        u, v = (bool(r) for r in self.textures.repeat[row]) if self.textures is not None else (True, True)
        return ("repeat" if u else "clamp"), u == v

    def write_png(self, name: str, pixels: np.ndarray) -> str:
        """Write a picture.

        Args:
            name: What to call it.
            pixels: [h w] or [h w 3] uint8.
        Returns:
            File name relative to the scene file; that of an earlier one if the pixels are the same.
        """
        from PIL import Image

        key = repr(pixels.shape).encode() + pixels.tobytes()
        return self._once(key, name, ".png", lambda path: Image.fromarray(pixels).save(path))

    def write_exr(self, name: str, radiance: np.ndarray) -> str:
        """Write linear values.

        Args:
            name: What to call it.
            radiance: [h w 3] linear values.
        Returns:
            File name relative to the scene file.
        """
        values = np.ascontiguousarray(radiance, np.float32)
        key = b"exr" + repr(values.shape).encode() + values.tobytes()
        return self._once(key, name, ".exr", lambda path: _save_exr(path, values))

    def _once(self, key: bytes, name: str, suffix: str, save) -> str:
        if key not in self._written:
            path = self.folder / "textures" / (file_name(name, self._taken) + suffix)
            path.parent.mkdir(exist_ok=True)
            save(path)
            self._written[key] = f"textures/{path.name}"
        return self._written[key]


def _save_exr(path: Path, values: np.ndarray) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {name: np.ascontiguousarray(values[..., i]) for i, name in enumerate("RGB")}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
