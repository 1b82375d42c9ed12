"""`jaxrefl export`: a scene with its cameras -> the files of another renderer."""

import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from jaxrefl._types import Camera, Scene
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import SceneWarning, export_mitsuba
from pipelines.cameras import job_cameras
from pipelines.flags import CameraFlags, CameraSize, Count, SceneFlags
from pipelines.flags_to_job import scene_of
from pipelines.job import CameraPath, Job
from pipelines.resolve import resolve
from pipelines.stage import load_scene
from pipelines.toml_tables import JobError

HELP = """Write a scene for another renderer: its meshes, materials, textures, lights and cameras.

Nothing of jaxrefl is needed to render the files. What the other renderer cannot say is approximated; each approximation
is printed, and stands as a comment in the file.

Examples:
  jaxrefl export cornell --to mitsuba --out exported/cornell
  jaxrefl export scene.glb --environment sky.hdr --to mitsuba --size 960 540 --out exported/scene
  jaxrefl export cornell --to mitsuba --frames 24 --out exported/path

A folder written for Mitsuba 3 is rendered by `mitsuba DIR/scene.xml` or `mitsuba.load_file("DIR/scene.xml")`; with
several frames sensor i is that of frame i.
"""


@dataclass(frozen=True)
class ExportFlags(SceneFlags):
    """Write a scene for another renderer."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="DIR", help_behavior_hint="(required)")] = None
    """Folder to write; one that holds anything but an exported scene is refused."""
    to: Literal["mitsuba"] = "mitsuba"
    """Which renderer."""
    frames: Count = None
    """Frames along the camera path; each becomes a camera."""
    size: CameraSize = None
    """Image size in pixels."""
    samples: int = 64
    """Samples per pixel that the file asks for."""
    max_depth: int = 16
    """Longest path that the file asks for, in segments."""
    camera: CameraFlags = field(default_factory=CameraFlags)


def main(argv: Sequence[str]) -> int:
    """`jaxrefl export`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    Raises:
        ValueError: If the scene, a camera or the folder does not fit.
        OSError: If a file cannot be written.
    """
    flags: Any = tyro.cli(ExportFlags, args=list(argv), prog="jaxrefl export", description=HELP)
    if flags.out is None:
        raise JobError("where to? give --out DIR")
    path = CameraPath(**{f.name: getattr(flags.camera, f.name) for f in dataclasses.fields(CameraFlags)})
    job = resolve(Job(scene_of(flags, None), frames=flags.frames, size=flags.size, camera=path))
    scene, notes = load_scene(job.scene)
    if flags.size is None and path.file is None:
        job = dataclasses.replace(job, size=_own_size(scene, path.name) or job.size)
    cameras, more = job_cameras(job, scene, EmbreeTracer(scene.mesh))
    for note in [*notes, *more]:
        warnings.warn(note, SceneWarning, stacklevel=2)
    camera: Camera | Sequence[Camera] = cameras[0] if len(cameras) == 1 else cameras
    print(export_mitsuba(scene, flags.out, camera=camera, samples=flags.samples, max_depth=flags.max_depth))
    return 0


def _own_size(scene: Scene, name: str | None) -> tuple[int, int] | None:
    """Size of the camera that is named, or of the scene's first."""
    found = dict(zip(scene.names.cameras, scene.cameras, strict=True))
    if not found or (name is not None and name not in found):
        return None
    camera = next(iter(found.values())) if name is None else found[name]
    return camera.width, camera.height
