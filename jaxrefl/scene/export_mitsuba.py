"""`Scene` -> a Mitsuba 3 scene file with its meshes and textures, to be rendered by others or as a reference.

    DIR/scene.xml        version 3.0.0; `mitsuba.load_file(path, spp=256)` sets the samples
    DIR/meshes/*.ply     one per object and material
    DIR/textures/*       what the materials and the sky refer to

Every approximation is a note: a `SceneWarning`, and a comment in the file. Mitsuba itself is not needed here.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from jaxrefl._types import Camera, Scene
from jaxrefl.scene.errors import SceneError, warn_notes
from jaxrefl.scene.export_bsdfs import BsdfWriter, element, rgb
from jaxrefl.scene.export_files import TextureFiles
from jaxrefl.scene.export_shapes import coloured_materials, mirrored_materials, plain_id, write_shapes
from jaxrefl.scene.materials import unique_names
from jaxrefl.scene.notes import Notes

MARK = "Written by jaxrefl"
"""Begins the first comment of an exported scene; a folder whose scene.xml has it may be written again."""

_AXES = np.diag([-1.0, 1.0, -1.0, 1.0])
_HALF_TURN = np.diag([-1.0, 1.0, -1.0])


def export_mitsuba(
    scene: Scene,
    folder: str | Path,
    *,
    camera: Camera | Sequence[Camera] | None = None,
    samples: int = 64,
    max_depth: int = 16,
) -> Path:
    """Write a scene for Mitsuba 3.

    Args:
        scene: Any scene.
        folder: Where to; made if needed.
        camera: The camera, or one per frame; None: those of the scene.
        samples: Samples per pixel, >= 1; the file's default, which `mitsuba.load_file(path, spp=...)` replaces.
        max_depth: Longest path, in segments, >= 1; likewise `max_depth=...`.
    Returns:
        The scene file, `folder/scene.xml`.
    Raises:
        SceneError: If the folder holds something else, a number is out of range, or there is no camera.
        OSError: If a file cannot be written.
    Edge cases: triangles that shine from both sides get a second, black mesh that shines from the back, as Mitsuba's
        shine from the front alone; reading the file again puts the two together.
    """
    folder = Path(folder)
    for name, value in (("samples", samples), ("max_depth", max_depth)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise SceneError(f"{name}: expected a whole number >= 1, got {value!r}")
    cameras = _named_cameras(scene, camera)
    _claim(folder)
    # Everything below reads single rows, which is slow in JAX.
    scene, cameras = jax.tree.map(np.asarray, (scene, cameras))
    notes = Notes()
    root = element(None, "scene", version="3.0.0")
    element(root, "default", name="spp", value=samples)
    element(root, "default", name="max_depth", value=max_depth)
    absorbs = bool((np.asarray(scene.materials.attenuation) > 0).any())
    integrator = element(root, "integrator", type="volpath" if absorbs else "path")
    element(integrator, "integer", name="max_depth", value="$max_depth")
    sensors = [_write_camera(root, name, one, notes) for name, one in cameras.items()]
    files = TextureFiles(folder, scene.textures)
    taken = _write_materials_and_shapes(root, scene, folder, files, notes)
    ids = unique_names([*taken, *(plain_id(name) for name in cameras)])[len(taken) :]
    for sensor, id in zip(sensors, ids, strict=True):
        sensor.set("id", id)
    _write_lights(root, scene, files, notes)
    path = folder / "scene.xml"
    path.write_text(_text(root, scene, notes), encoding="utf-8")
    warn_notes(notes.sentences(), path.name)
    return path


def _named_cameras(scene: Scene, camera: Camera | Sequence[Camera] | None) -> dict[str, Camera]:
    if camera is None:
        found = dict(zip(scene.names.cameras, scene.cameras, strict=True))
    elif isinstance(camera, Camera):
        found = {"camera": camera}
    else:
        found = {f"frame_{i:04d}": one for i, one in enumerate(camera)}
    if not found:
        raise SceneError("camera: expected a camera, got none, and the scene has none either")
    return found


def _claim(folder: Path) -> None:
    """Make the folder, unless something of others is in it."""
    if folder.is_file():
        raise SceneError(f"{folder}: expected a folder, got a file")
    if folder.is_dir() and any(folder.iterdir()):
        path = folder / "scene.xml"
        own = path.is_file() and MARK in path.read_text(encoding="utf-8", errors="replace")[:1000]
        if not own:
            raise SceneError(f"{folder}: is not empty and holds no exported scene; name another folder or empty it")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meshes").mkdir(exist_ok=True)


def _write_materials_and_shapes(
    root: ET.Element, scene: Scene, folder: Path, files: TextureFiles, notes: Notes
) -> list[str]:
    """Add them, and return the ids they have taken, which materials, shapes and cameras share."""
    names = scene.names.materials
    ids = unique_names([plain_id(name) for name in names])
    writer = BsdfWriter(scene.materials, names, files, notes, coloured_materials(scene.mesh), mirrored_materials(scene))
    for row in np.unique(np.asarray(scene.mesh.material)).tolist():
        writer.write(root, row, id=ids[row])
    return ids + write_shapes(root, scene, folder, writer, ids)


def _write_camera(root: ET.Element, name: str, camera: Camera, notes: Notes) -> ET.Element:
    sensor = element(root, "sensor", type="perspective")
    fx, fy = (float(f) for f in camera.focal)
    if abs(fx - fy) > 1e-4 * fy:
        notes.group("cameras with pixels that are not square keep their vertical field of view", name)
    element(sensor, "string", name="fov_axis", value="y")
    element(sensor, "float", name="fov", value=math.degrees(2 * math.atan(0.5 * camera.height / fy)))
    for axis, centre, extent in zip("xy", camera.centre, (camera.width, camera.height), strict=True):
        offset = 0.5 - float(centre) / extent
        if offset != 0:
            element(sensor, "float", name=f"principal_point_offset_{axis}", value=offset)
    _transform(sensor, np.asarray(camera.world_from_camera, np.float64) @ _AXES)
    film = element(sensor, "film", type="hdrfilm")
    element(film, "integer", name="width", value=camera.width)
    element(film, "integer", name="height", value=camera.height)
    element(film, "string", name="pixel_format", value="rgb")
    element(film, "string", name="component_format", value="float32")
    element(film, "rfilter", type="box")
    element(element(sensor, "sampler", type="independent"), "integer", name="sample_count", value="$spp")
    return sensor


def _write_lights(root: ET.Element, scene: Scene, files: TextureFiles, notes: Notes) -> None:
    lights = scene.lights
    if float(np.max(lights.ambient)) > 0:
        notes.add("the ambient term, which casts no shadows, has no counterpart in Mitsuba; it is left out")
    if lights.punctual is not None:
        for i in range(len(lights.punctual.directional)):
            _write_punctual(root, scene, i, notes)
    if lights.environment is None:
        return
    radiance = np.asarray(lights.environment.radiance)
    if radiance.shape[:2] == (1, 1):
        rgb(element(root, "emitter", type="constant"), "radiance", radiance[0, 0])
        return
    sky = element(root, "emitter", type="envmap")
    element(sky, "string", name="filename", value=files.write_exr("sky", radiance))
    matrix = np.eye(4)
    matrix[:3, :3] = np.asarray(lights.environment.world_from_map, np.float64) @ _HALF_TURN
    _transform(sky, matrix)
    notes.add("Mitsuba stretches the rows of an environment map by half a row at either pole")


def _write_punctual(root: ET.Element, scene: Scene, i: int, notes: Notes) -> None:
    p = scene.lights.punctual
    if p is None:
        return
    position, direction, intensity = (np.asarray(x[i], np.float64) for x in (p.position, p.direction, p.intensity))
    if bool(p.directional[i]):
        light = element(root, "emitter", type="directional")
        element(light, "vector", name="direction", value=", ".join(f"{x:.9g}" for x in direction))
        rgb(light, "irradiance", intensity)
        if float(p.angular_radius[i]) > 0:
            notes.group("suns are points in Mitsuba, with hard shadows", f"light {i}")
        return
    if float(p.cos_outer[i]) < -1:
        light = element(root, "emitter", type="point")
        element(light, "point", name="position", value=", ".join(f"{x:.9g}" for x in position))
        rgb(light, "intensity", intensity)
        return
    light = element(root, "emitter", type="spot")
    rgb(light, "intensity", intensity)
    outer, inner = (math.degrees(math.acos(min(max(float(c[i]), -1), 1))) for c in (p.cos_outer, p.cos_inner))
    element(light, "float", name="cutoff_angle", value=outer)
    element(light, "float", name="beam_width", value=inner)
    helper = np.eye(3)[np.abs(direction).argmin()]
    left = np.cross(helper, direction)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = left, np.cross(direction, left), direction, position
    _transform(light, matrix)
    text = "between its inner and outer angle a spot fades linearly with the angle, here with the cosine's square"
    notes.group(text, f"light {i}")


def _transform(parent: ET.Element, matrix: np.ndarray) -> None:
    transform = element(parent, "transform", name="to_world")
    element(transform, "matrix", value=" ".join(f"{x:.9g}" for x in matrix.reshape(-1)))


def _text(root: ET.Element, scene: Scene, notes: Notes) -> str:
    sentences = notes.sentences()
    head = f" {MARK} from the scene {scene.names.scene!r}. " + ("What differs from it: " if sentences else "")
    for i, line in enumerate([head, *(f" - {text} " for text in sentences)]):
        root.insert(i, ET.Comment(line.replace("--", "- -")))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
