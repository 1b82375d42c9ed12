"""What hangs on the nodes of a glTF file: their place in the world, their names, cameras and lights.

Input: a `Document`. Source: glTF 2.0 specification §3.5 (nodes), §3.10 (cameras) and KHR_lights_punctual (Khronos).
"""

import math
from typing import Any

import numpy as np

from jaxrefl._types import Camera
from jaxrefl.core.cameras import perspective
from jaxrefl.scene.description import PunctualLight
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.gltf_container import Document
from jaxrefl.scene.materials import unique_names

_CAMERA_HEIGHT = 540
_DEFAULT_ASPECT = 16 / 9


def world_transforms(document: Document) -> list[tuple[int, np.ndarray]]:
    """The nodes of the default scene with their world transforms.

    Args:
        document: The file.
    Returns:
        Node numbers and world-from-node matrices [4 4], parents before children, in file order.
    Raises:
        SceneError: If an index points nowhere, a node has two parents or is its own ancestor, or a transform is broken.
    Edge cases: a file without scenes shows all root nodes.
    """
    nodes = document.items("nodes")
    if document.items("scenes"):
        roots = document.item("scenes", document.json.get("scene", 0)).get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
    placed: list[tuple[int, np.ndarray]] = []
    seen: set[int] = set()
    stack = [(root, np.eye(4)) for root in reversed(roots)]
    while stack:
        index, parent = stack.pop()
        node = document.item("nodes", index)
        if index in seen:
            raise SceneError(f"{document.path}: node {index}: expected a tree of nodes, got one with two parents")
        seen.add(index)
        world = parent @ _local_transform(document, index, node)
        placed.append((index, world))
        stack += [(child, world) for child in reversed(node.get("children", []))]
    return placed


def _local_transform(document: Document, index: int, node: dict[str, Any]) -> np.ndarray:
    """Parent-from-node matrix: `matrix`, or translation * rotation * scale."""
    try:
        matrix = np.asarray(node.get("matrix", np.eye(4).reshape(-1)), np.float64).reshape(4, 4).T.copy()
        if "matrix" not in node:
            x, y, z, w = np.asarray(node.get("rotation", [0, 0, 0, 1]), np.float64)
            norm = math.sqrt(x * x + y * y + z * z + w * w)
            x, y, z, w = (c / norm for c in (x, y, z, w)) if norm > 0 else (0.0, 0.0, 0.0, 1.0)
            rotation = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
                ]
            )
            scale = np.asarray(node.get("scale", [1, 1, 1]), np.float64).reshape(1, 3)
            matrix[:3, :3] = rotation * np.where(np.isfinite(scale), scale, np.nan)
            matrix[:3, 3] = np.asarray(node.get("translation", [0, 0, 0]), np.float64).reshape(3)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{document.path}: node {index}: broken transform: {error}") from error
    if not np.isfinite(matrix).all():
        raise SceneError(f"{document.path}: node {index}: expected a finite transform, got {matrix.tolist()}")
    return matrix


def node_names(document: Document, nodes: list[int], notes: list[str]) -> dict[int, str]:
    """One distinct name per node: its own, its mesh's, or its number.

    Args:
        document: The file.
        nodes: Node numbers.
        notes: Receives how many nodes share a name with another one.
    Returns:
        The name of each node.
    """
    given = []
    for index in nodes:
        node = document.item("nodes", index)
        mesh = document.item("meshes", node["mesh"]) if "mesh" in node else {}
        given.append(str(node.get("name") or mesh.get("name") or f"node {index}"))
    names = unique_names(given)
    renamed = sum(a != b for a, b in zip(given, names, strict=True))
    if renamed:
        notes.append(f"{renamed} nodes share a name with another node; a number was added")
    return dict(zip(nodes, names, strict=True))


def read_camera(document: Document, name: str, index: int, world: np.ndarray, notes: list[str]) -> Camera | None:
    """The camera on a node.

    Args:
        document: The file.
        name: Name of the node.
        index: Number of the camera.
        world: [4 4] world-from-node transform; its scale is removed.
        notes: Receives why a camera was left out.
    Returns:
        The camera, 540 pixels high, 16:9 where the file gives no aspect ratio; None for orthographic or broken ones.
    """
    data = document.item("cameras", index)
    if data.get("type") != "perspective":
        notes.append(f"camera {name!r}: {data.get('type')} cameras are ignored")
        return None
    lens = data.get("perspective", {})
    aspect = float(lens.get("aspectRatio", _DEFAULT_ASPECT))
    size = (max(1, round(_CAMERA_HEIGHT * aspect)), _CAMERA_HEIGHT)
    try:
        return perspective(world, fov_y=math.degrees(float(lens["yfov"])), size=size)
    except (KeyError, TypeError, ValueError) as error:
        notes.append(f"camera {name!r} is ignored: {error}")
        return None


def read_light(document: Document, name: str, index: int, world: np.ndarray) -> PunctualLight:
    """The light on a node (KHR_lights_punctual).

    Args:
        document: The file.
        name: Name of the node.
        index: Number of the light.
        world: [4 4] world-from-node transform; the light shines along the node's -Z.
    Returns:
        The light. Candela and lux are taken as radiometric numbers: a point light of intensity 1 gives the
        irradiance 1 at the distance 1.
    Raises:
        SceneError: If there is no such light or its type is unknown.
    """
    lights = document.json.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    if not isinstance(index, int) or not 0 <= index < len(lights):
        raise SceneError(f"{document.path}: node {name!r}: expected a light from 0 to {len(lights) - 1}, got {index!r}")
    data = lights[index]
    kind, spot = data.get("type"), data.get("spot", {})
    if kind not in ("point", "spot", "directional"):
        raise SceneError(f"{document.path}: light {name!r}: expected point, spot or directional, got {kind!r}")
    red, green, blue = (float(c) * float(data.get("intensity", 1.0)) for c in data.get("color", [1, 1, 1]))
    axis = -world[:3, 2]
    length = float(np.linalg.norm(axis))
    x, y, z = (float(c) / length for c in axis) if length > 0 else (0.0, 0.0, -1.0)
    px, py, pz = (float(c) for c in world[:3, 3])
    inner, outer = float(spot.get("innerConeAngle", 0.0)), float(spot.get("outerConeAngle", math.pi / 4))
    return PunctualLight(
        name,
        intensity=(red, green, blue),
        position=(0.0, 0.0, 0.0) if kind == "directional" else (px, py, pz),
        direction=(x, y, z),
        directional=kind == "directional",
        cos_inner=math.cos(inner) if kind == "spot" else -1.0,
        cos_outer=math.cos(outer) if kind == "spot" else -2.0,
    )
