"""Job files: what to render, how, and against what; the command line fills the same classes. TOML <-> Job."""

import dataclasses
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipelines.toml_tables import JobError, read_table, toml_text, write_table
from scenes import BUILT_IN


@dataclass(frozen=True)
class SceneSource:
    """Which scene, and what to change about it."""

    source: str
    """A scene file, or the name of a built-in scene (`jaxrefl scenes` lists them)."""
    overrides: str | None = None
    """TOML file that replaces materials, lights, units and the like, by name."""
    environment: str | None = None
    """Environment map, .hdr or .exr, that lights the scene from infinitely far away."""
    up: str | None = None
    """Axis that points up in the file, such as "z"; scenes are +Y up after loading."""
    units: float | None = None
    """Factor on all lengths in the file."""
    crease_angle: float | None = None
    """Degrees up to which edges are smoothed where the file has no normals."""
    parameters: dict[str, bool | int | float | str] = field(default_factory=dict)
    """Parameters of a built-in scene, such as triangles = 20000."""


@dataclass(frozen=True)
class Keyframe:
    """A camera at a time; either `target` or `rotation` says where it looks."""

    position: tuple[float, float, float]
    """Camera position, world space."""
    target: tuple[float, float, float] | None = None
    """Point in the middle of the image."""
    rotation: tuple[float, float, float, float] | None = None
    """Camera-to-world rotation as a quaternion (w, x, y, z)."""
    time: float | None = None
    """Any increasing numbers; None: the keyframe's number."""
    fov_y: float = 45.0
    """Vertical field of view, degrees."""
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Direction that points up in the image; used with `target`."""


@dataclass(frozen=True)
class CameraPath:
    """Where the camera goes: a file, keyframes, a camera of the scene, or the scene's own path."""

    file: str | None = None
    """transforms.json in the NeRF and Blender convention: camera-to-world matrices, looking along -Z."""
    name: str | None = None
    """A camera of the scene file; None: its first."""
    keyframes: tuple[Keyframe, ...] = ()
    """Keyframes, joined by splines."""
    closed: bool = False
    """True: the keyframes form a loop."""
    up: str = "y"
    """Axis that points up in the camera file or the keyframes: "y", or "z" as in Blender's world."""
    swing: float = 5.0
    """Half angle in degrees of the loop that is made around a camera that stands still; 0: it stands still."""

    def __post_init__(self):
        given = [n for n in ("file", "name", "keyframes") if getattr(self, n)]
        if len(given) > 1:
            raise JobError(f"camera: expected one of file, name and keyframes, got {' and '.join(given)}")
        if self.up not in ("y", "z"):
            raise JobError(f"camera: up: expected 'y' or 'z', got {self.up!r}")
        if not 0 <= self.swing <= 90:
            raise JobError(f"camera: swing: expected degrees from 0 to 90, got {self.swing}")


@dataclass(frozen=True)
class Outputs:
    """Which files each frame leaves, and how bright."""

    png: bool = True
    """8-bit sRGB picture."""
    exr: bool = True
    """Linear RGB, float32. The reference always has one, because errors are measured against it."""
    layers: bool = True
    """Multi-layer EXR: reflection, diffuse, albedo, normals, positions, ids, ..., float32."""
    exposure: float = 0.0
    """Stops by which PNGs, and the errors measured on them, are brightened."""


@dataclass(frozen=True)
class Reference:
    """What errors are measured against."""

    technique: str = "raytrace"
    """Any technique, with knobs of its own; left aside with `folder`."""
    knobs: dict[str, bool | int | float | str] = field(default_factory=dict)
    """Its knobs; without `samples`, a technique that has samples gets 16 times those of its own table, at least 64."""
    folder: str | None = None
    """A folder made by `jaxrefl reference`, whose images are used instead of rendering any; None: `technique`."""


@dataclass(frozen=True)
class Job:
    """Everything that decides what the images look like."""

    scene: SceneSource
    techniques: tuple[str, ...] = ("raytrace",)
    """Names of the techniques to render with."""
    frames: int | None = None
    """How many frames; None: all of a camera file, otherwise one."""
    size: tuple[int, int] | None = None
    """Width and height in pixels; None: the camera file's, otherwise 960 by 540."""
    seed: int = 0
    """Seed of all random numbers."""
    cold: bool = False
    """True: each technique compiles everything it needs, so that compile times do not depend on the order; slower."""
    camera: CameraPath = field(default_factory=CameraPath)
    outputs: Outputs = field(default_factory=Outputs)
    reference: Reference | None = None
    """None: errors are not measured."""
    light: dict[str, Any] = field(default_factory=dict)
    """Knobs of diffuse light (`jaxrefl.radiance.LightOptions`), shared by all techniques."""
    composite: dict[str, Any] = field(default_factory=dict)
    """Knobs of `jaxrefl.composite.Options`, shared by all techniques."""
    technique: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Knobs by technique."""
    path: dict[str, Any] | None = None
    """Knobs of the path tracer (`pipelines.path_knobs.PathKnobs`), for `jaxrefl reference`; None: their defaults."""
    digests: dict[str, str] = field(default_factory=dict)
    """SHA-256 of each input file; written on resolving, checked when it is there."""

    def __post_init__(self):
        if not self.techniques and self.path is None:
            raise JobError("techniques: expected at least one")
        if len(set(self.techniques)) < len(self.techniques):
            raise JobError(f"techniques: one is named twice: {', '.join(self.techniques)}")
        if self.frames is not None and self.frames < 1:
            raise JobError(f"frames: expected at least 1, got {self.frames}")
        if self.size is not None and min(self.size) < 1:
            raise JobError(f"size: expected a width and height of at least 1 pixel, got {self.size[0]} {self.size[1]}")
        if not 0 <= self.seed < 2**32:
            raise JobError(f"seed: expected a whole number from 0 to {2**32 - 1}, got {self.seed}")


def read_job(path: Path) -> Job:
    """A job from its file; paths in it count from the file's folder.

    Args:
        path: TOML file.
    Returns:
        The job, not yet resolved.
    Raises:
        JobError: If the file is missing, is no TOML, or holds a key or value that does not fit.
    """
    return parse_job(_read_text(path), name=str(path), folder=path.resolve().parent)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise JobError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise JobError(f"{path}: expected UTF-8 text: {error}") from error


def parse_job(text: str, *, name: str = "job", folder: Path | None = None) -> Job:
    """A job from TOML text.

    Args:
        text: TOML.
        name: Name for messages.
        folder: Folder from which relative paths count; None: they are kept.
    Returns:
        The job, not yet resolved.
    Raises:
        JobError: If it is no TOML, or holds a key or value that does not fit.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise JobError(f"{name}: is not valid TOML: {error}") from error
    if isinstance(table.get("scene"), str):
        table["scene"] = {"source": table["scene"]}
    job: Job = read_table(Job, table, where=name)
    return job if folder is None else with_paths(job, lambda p: str((folder / p).resolve()))


def with_paths(job: Job, change: Callable[[str], str]) -> Job:
    """A job with other paths.

    Args:
        job: Any job.
        change: Applied to every path in the job; names of built-in scenes are none.
    Returns:
        The changed job.
    """
    scene, camera = job.scene, job.camera
    source = scene.source if scene.source in BUILT_IN else change(scene.source)
    optional = {n: change(p) for n in ("overrides", "environment") if (p := getattr(scene, n)) is not None}
    scene = dataclasses.replace(scene, source=source, **optional)
    if camera.file is not None:
        camera = dataclasses.replace(camera, file=change(camera.file))
    reference = job.reference
    if reference is not None and reference.folder is not None:
        reference = dataclasses.replace(reference, folder=change(reference.folder))
    light = job.light
    if light.get("lightmap"):
        light = {**light, "lightmap": change(light["lightmap"])}
    return dataclasses.replace(job, scene=scene, camera=camera, reference=reference, light=light)


def job_text(job: Job) -> str:
    """The job as TOML.

    Args:
        job: Any job.
    Returns:
        Text that `parse_job` reads back to the same job.
    """
    return toml_text(write_table(job))
