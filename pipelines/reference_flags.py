"""The flags of `jaxrefl reference`, and the job and the goal they describe."""

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from jaxrefl.radiance.progressive import Goal
from pipelines.flags import CameraFlags, Count, File, Folder, SceneFlags, SizeFlag, optional_flag
from pipelines.flags_to_job import camera_of, scene_of, value_of
from pipelines.job import Job, Outputs, SceneSource, read_job
from pipelines.knobs import complete, knobs_of
from pipelines.path_knobs import PathKnobs
from pipelines.reference import GOAL
from pipelines.toml_tables import JobError

_NONE = f"none; {GOAL.spp} samples or an error of {GOAL.error} if nothing is asked for"
OutFolder = Annotated[
    Path | None,
    optional_flag(Path, "DIR", "")[0],
    tyro.conf.arg(aliases=["-o"], help_behavior_hint="(default: results/NAME-reference, after the job or the scene)"),
]
Spp = Annotated[int | None, *optional_flag(int, "N", _NONE)]
Share = Annotated[float | None, *optional_flag(float, "REL", _NONE)]
Seconds = Annotated[float | None, *optional_flag(float, "SECONDS", "none")]


@dataclass(frozen=True)
class ReferenceBase(SceneFlags):
    """Path trace images that errors can be measured against."""

    out: OutFolder = None
    """Results folder; an interrupted run continues in it, and so does one that is asked for more."""
    job: File = None
    """Job file (TOML), such as that of a comparison; flags replace its values."""
    spp: Spp = None
    """Stop at so many samples per pixel."""
    error: Share = None
    """Stop at this relative error: root mean square of the standard error over the mean luminance; 0.01 is 1 %."""
    time: Seconds = None
    """Stop after so many seconds per frame, all runs of it together."""
    frames: Count = None
    """Frames along the camera path."""
    size: SizeFlag = None
    """Image size in pixels."""
    seed: int = 0
    """Seed of all random numbers."""
    keep_state: bool = True
    """Keep what it takes to go on with finished frames, 180 bytes per pixel."""
    cache: Folder = None
    """Folder that keeps compiled code between runs."""
    camera: CameraFlags = field(default_factory=CameraFlags)
    outputs: Outputs = field(default_factory=Outputs)


@functools.cache
def reference_flags() -> type:
    """The flags with those of the path tracer's knobs behind them.

    Returns:
        A dataclass for tyro.
    """
    fields = []
    for knob in knobs_of(PathKnobs).values():
        kind = Literal[knob.choices] if knob.choices else knob.kind  # pyright: ignore[reportInvalidTypeForm]
        fields.append((knob.name, Annotated[kind, tyro.conf.arg(help=knob.explanation)], field(default=knob.default)))
    return dataclasses.make_dataclass("ReferenceFlags", fields, bases=(ReferenceBase,), frozen=True)


def parse_reference(argv: Sequence[str], *, description: str) -> tuple[Any, Job, Goal]:
    """What the words of `jaxrefl reference` ask for.

    Args:
        argv: Words after the command.
        description: What the help text teaches.
    Returns:
        The flags, the job, not yet resolved, and when to stop.
    Raises:
        JobError: If the job file does not fit, no scene is named, or the goal makes no sense.
        SystemExit: If a flag does not fit (code 2), or help was asked for (code 0).
    """
    kind, path = reference_flags(), value_of("--job", argv)
    base = None if path is None else read_job(Path(path))
    default = None if base is None else _defaults(kind, base)
    flags: Any = tyro.cli(kind, args=list(argv), default=default, prog="jaxrefl reference", description=description)
    wanted = {"spp": flags.spp, "error": flags.error, "seconds": flags.time}
    try:
        goal = GOAL if all(value is None for value in wanted.values()) else Goal(**wanted)
    except ValueError as error:
        raise JobError(f"--{str(error).replace('seconds:', 'time:', 1)}") from error
    old = base or Job(SceneSource(source=""))
    job = dataclasses.replace(
        old,
        scene=scene_of(flags, None if base is None else base.scene),
        frames=flags.frames,
        size=flags.size,
        seed=flags.seed,
        camera=camera_of(flags.camera, old.camera),
        outputs=flags.outputs,
        path={name: getattr(flags, name) for name in knobs_of(PathKnobs)},
    )
    return flags, job, goal


def _defaults(kind: type, job: Job) -> Any:
    """Flags that say what a job file says."""
    values: dict[str, Any] = {name: getattr(job, name) for name in ("frames", "size", "seed", "outputs")}
    names = ("overrides", "environment", "up", "units", "crease_angle")
    values |= {"scene": job.scene.source, **{name: getattr(job.scene, name) for name in names}}
    values["camera"] = CameraFlags(*(getattr(job.camera, f.name) for f in dataclasses.fields(CameraFlags)))
    return kind(**values, **complete(knobs_of(PathKnobs), job.path or {}, where="[path]"))
