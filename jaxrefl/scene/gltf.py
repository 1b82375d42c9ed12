"""glTF 2.0 files (`.gltf`, `.glb`) -> `Description`: nodes, instances, primitives, lights and cameras.

Everything comes out in world space; a node that mirrors (negative determinant) has its triangles turned around. Notes
name what a file holds that is ignored: animations, skins, morph targets, points and lines, unknown extensions.

Source: glTF 2.0 specification §3.7 (meshes).
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxrefl._types import Camera
from jaxrefl.scene.description import Description, Material, Part, PunctualLight
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.gltf_container import Document, read_accessor, read_document
from jaxrefl.scene.gltf_materials import MaterialReader, UvTransform
from jaxrefl.scene.gltf_nodes import node_names, read_camera, read_light, world_transforms

_READ_ATTRIBUTES = {"POSITION", "NORMAL", "TANGENT", "COLOR_0"}
_DEFAULT_MATERIAL = Material("default", metallic=1.0, alpha=1.0)
_UNUSED_LISTS = {"animations": "the scene is shown as it stands", "skins": "meshes are shown in their rest pose"}
_TREATED_ELSEWHERE = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_punctual", "KHR_mesh_quantization")


def describe_gltf(path: Path) -> Description:
    """Everything in the default scene of a glTF file.

    Args:
        path: A `.gltf` or `.glb` file.
    Returns:
        The description, in the file's own axes and units; one object per node with a mesh, named after the node.
    Raises:
        SceneError: If the file is broken, truncated, not glTF 2, compressed, or refers to something that is missing.
    Edge cases: a file without scenes shows all root nodes; a camera without an aspect ratio gets 16:9; cameras are
        540 pixels high.
    """
    document = read_document(path)
    notes: list[str] = []
    _note_unused(document, notes)
    placed = world_transforms(document)
    names = node_names(document, [node for node, _ in placed], notes)
    reader = _PartReader(document, notes)
    parts: list[Part] = []
    lights: list[PunctualLight] = []
    cameras: dict[str, Camera] = {}
    for node, world in placed:
        data, name = document.item("nodes", node), names[node]
        if "mesh" in data:
            parts += reader.read(name, data["mesh"], world)
        if "camera" in data and (camera := read_camera(document, name, data["camera"], world, notes)):
            cameras[name] = camera
        if "KHR_lights_punctual" in data.get("extensions", {}):
            lights.append(read_light(document, name, data["extensions"]["KHR_lights_punctual"]["light"], world))
        if "EXT_mesh_gpu_instancing" in data.get("extensions", {}):
            notes.append(f"node {name!r}: EXT_mesh_gpu_instancing is ignored; one instance is shown")
    return Description(path.stem, parts, lights, cameras=cameras, notes=list(dict.fromkeys(notes)))


class _PartReader:
    """Reads meshes; each primitive's arrays and each material once, however often they are instanced."""

    def __init__(self, document: Document, notes: list[str]):
        self.document, self.notes = document, notes
        self.materials = MaterialReader(document, notes)
        self._materials: dict[int, tuple[Material, UvTransform]] = {}
        self._primitives: dict[tuple[int, int], Part | None] = {}

    def read(self, name: str, mesh: int, world: np.ndarray) -> list[Part]:
        """The parts of one mesh, placed in the world."""
        parts = []
        for number in range(len(self.document.item("meshes", mesh).get("primitives", []))):
            if (mesh, number) not in self._primitives:
                self._primitives[mesh, number] = self._primitive(mesh, number)
            part = self._primitives[mesh, number]
            if part is not None:
                parts.append(_placed(part, name, world))
        return parts

    def _primitive(self, mesh: int, number: int) -> Part | None:
        data = self.document.item("meshes", mesh)
        where = f"mesh {data.get('name', mesh)!r}"
        primitive = data["primitives"][number]
        attributes = primitive.get("attributes", {})
        if (mode := primitive.get("mode", 4)) not in (4, 5, 6):
            self.notes.append(f"{where}: points and lines are ignored (primitive {number}, mode {mode})")
            return None
        if "POSITION" not in attributes:
            self.notes.append(f"{where}: primitive {number} has no positions and is ignored")
            return None
        self._refuse_compressed(where, primitive)
        self._note_ignored(where, primitive)
        material, transform = self._material(primitive.get("material"))
        vertices = self._values(attributes["POSITION"], (3,))
        uv = self._optional(attributes.get(f"TEXCOORD_{transform.set}"), (2,))
        colours = self._optional(attributes.get("COLOR_0"), (3, 4))
        return Part(
            name="",
            vertices=vertices,
            faces=_triangles(self._indices(where, primitive, len(vertices)), mode),
            material=material,
            normals=self._optional(attributes.get("NORMAL"), (3,)),
            uv=None if uv is None else transform.apply(uv),
            tangents=self._optional(attributes.get("TANGENT"), (4,)),
            colours=None if colours is None else colours[:, :3],
        )

    def _indices(self, where: str, primitive: dict[str, Any], count: int) -> np.ndarray:
        if "indices" not in primitive:
            return np.arange(count)
        indices = read_accessor(self.document, primitive["indices"])[:, 0]
        if indices.dtype.kind not in "iu":
            raise SceneError(f"{self.document.path}: {where}: expected integer indices, got {indices.dtype}")
        if len(indices) and int(indices.max()) >= count:
            raise SceneError(
                f"{self.document.path}: {where}: expected indices from 0 to {count - 1}, got {int(indices.max())}"
            )
        return indices.astype(np.int64)

    def _values(self, accessor: int, columns: tuple[int, ...]) -> np.ndarray:
        values = read_accessor(self.document, accessor)
        if values.shape[1] not in columns:
            raise SceneError(
                f"{self.document.path}: accessor {accessor}: expected {columns[0]} components, got {values.shape[1]}"
            )
        return values.astype(np.float64)

    def _optional(self, accessor: int | None, columns: tuple[int, ...]) -> np.ndarray | None:
        return None if accessor is None else self._values(accessor, columns)

    def _material(self, index: int | None) -> tuple[Material, UvTransform]:
        if index is None:
            return _DEFAULT_MATERIAL, UvTransform()
        if index not in self._materials:
            self._materials[index] = self.materials.read(index)
        return self._materials[index]

    def _refuse_compressed(self, where: str, primitive: dict[str, Any]) -> None:
        position = self.document.item("accessors", primitive["attributes"]["POSITION"])
        if "KHR_draco_mesh_compression" in primitive.get("extensions", {}) and "bufferView" not in position:
            raise SceneError(
                f"{self.document.path}: {where}: Draco-compressed geometry (KHR_draco_mesh_compression) cannot be "
                "read; save the file without compression"
            )

    def _note_ignored(self, where: str, primitive: dict[str, Any]) -> None:
        for name in primitive["attributes"]:
            known = name in _READ_ATTRIBUTES or name.startswith(("_", "TEXCOORD_", "JOINTS_", "WEIGHTS_"))
            if not known:
                self.notes.append(f"{where}: attribute {name} is ignored")
        if "targets" in primitive:
            self.notes.append(f"{where}: morph targets are ignored")
        for name in sorted(set(primitive.get("extensions", {})) - {"KHR_draco_mesh_compression"}):
            self.notes.append(f"{where}: {name} is ignored")


def _triangles(indices: np.ndarray, mode: int) -> np.ndarray:
    """Triangles [f 3] from the indices of triangles, a strip (every other one turned around) or a fan."""
    if mode == 4:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    count = max(len(indices) - 2, 0)
    if mode == 6:
        return np.stack([np.broadcast_to(indices[:1], count), indices[1 : count + 1], indices[2 : count + 2]], 1)
    faces = np.stack([indices[:count], indices[1 : count + 1], indices[2 : count + 2]], 1)
    faces[1::2] = faces[1::2, [1, 0, 2]]
    return faces


def _placed(part: Part, name: str, world: np.ndarray) -> Part:
    """A copy of a part moved to its place in the world."""
    linear = world[:3, :3]
    mirrored = np.linalg.det(linear) < 0
    # normals go with the cofactor matrix, which also exists for singular transforms
    cofactor = np.stack([np.cross(linear[(i + 1) % 3], linear[(i + 2) % 3]) for i in range(3)])
    normals, tangents = part.normals, part.tangents
    if normals is not None:
        turned = normals @ (-cofactor if mirrored else cofactor).T
        length, new_length = (np.linalg.norm(n, axis=1, keepdims=True) for n in (normals, turned))
        normals = turned * length / np.where(new_length > 0, new_length, 1.0)
    if tangents is not None:
        handedness = tangents[:, 3:] * (-1.0 if mirrored else 1.0)
        tangents = np.concatenate([tangents[:, :3] @ linear.T, handedness], 1)
        lengths = np.linalg.norm(tangents[:, :3], axis=1, keepdims=True)
        tangents[:, :3] /= np.where(lengths > 0, lengths, 1)
    with np.errstate(invalid="ignore"):  # infinite positions become NaN here and are left out, and counted, later
        vertices = part.vertices @ linear.T + world[:3, 3]
    return Part(
        name=name,
        vertices=vertices,
        faces=part.faces[:, ::-1] if mirrored else part.faces,
        material=part.material,
        normals=normals,
        uv=part.uv,
        tangents=tangents,
        colours=part.colours,
    )


def _note_unused(document: Document, notes: list[str]) -> None:
    for kind, consequence in _UNUSED_LISTS.items():
        if document.items(kind):
            notes.append(f"{kind} are ignored; {consequence}")
    if len(document.items("scenes")) > 1:
        notes.append(f"the file has {len(document.items('scenes'))} scenes; only the default one is read")
    for name in document.json.get("extensionsUsed", []):
        if not name.startswith(_TREATED_ELSEWHERE) and name not in ("EXT_mesh_gpu_instancing",):
            notes.append(f"extension {name} is ignored")
