"""The command line's flags, made by tyro from the classes of `pipelines.job` and from the knobs of what exists.

A flag and a key of a job file are the same thing: with `--job` the file's values are the defaults of the flags.
"""

import dataclasses
import functools
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from jaxrefl.composite import Options as CompositeOptions
from jaxrefl.radiance import DirectOptions
from jaxrefl.techniques import TECHNIQUES
from pipelines.job import CameraPath, Job, Outputs, Reference, SceneSource
from pipelines.knobs import Knob, Knobs, complete, knobs_of, technique_knobs
from pipelines.toml_tables import JobError


def _optional(kind: type, metavar: str, hint: str, *, nargs: int = 1) -> Any:
    """A flag that may be absent, without tyro's `{None}|...` in its help and without its greed for later words."""
    read = (lambda words: kind(words[0])) if nargs == 1 else (lambda words: tuple(kind(w) for w in words))
    spec = tyro.constructors.PrimitiveConstructorSpec(
        nargs=nargs,
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: True,
        str_from_instance=lambda value: [str(v) for v in (value if isinstance(value, tuple) else (value,))],
    )
    return spec, tyro.conf.arg(help_behavior_hint=f"(default: {hint})")


Name = Annotated[str | None, *_optional(str, "NAME", "its first")]
Axis = Annotated[str | None, *_optional(str, "AXIS", "the file's own")]
File = Annotated[str | None, *_optional(str, "FILE", "none")]
Folder = Annotated[str | None, *_optional(str, "DIR", "none")]
Number = Annotated[float | None, *_optional(float, "NUMBER", "the file's own")]
Count = Annotated[int | None, *_optional(int, "N", "all of a camera file, otherwise 1")]
SizeFlag = Annotated[
    tuple[int, int] | None, *_optional(int, "WIDTH HEIGHT", "the camera file's, otherwise 960 540", nargs=2)
]
Samples = Annotated[int | None, *_optional(int, "N", "16 times the technique's own, at least 64")]
SceneName = Annotated[str | None, *_optional(str, "SCENE", "the job's")]
Pairs = Annotated[tuple[str, ...], tyro.conf.arg(metavar="KEY=VALUE ...", help_behavior_hint="(default: the defaults)")]
OutFolder = Annotated[Path, tyro.conf.arg(metavar="DIR", aliases=["-o"])]


@dataclass(frozen=True)
class SceneFlags:
    """Which scene."""

    scene: tyro.conf.Positional[SceneName] = None
    """A scene file, or the name of a built-in scene (see `jaxrefl scenes`)."""
    parameters: Pairs = ()
    """Parameters of a built-in scene, such as triangles=20000."""
    overrides: File = None
    """TOML file that replaces materials, lights and units by name."""
    environment: File = None
    """Environment map (.hdr, .exr) that lights the scene."""
    up: Axis = None
    """Axis that points up in the scene file, such as z."""
    units: Number = None
    """Factor on all lengths in the scene file."""
    crease_angle: Number = None
    """Degrees up to which edges are smoothed where the file has no normals."""


@dataclass(frozen=True)
class CameraFlags:
    """Where the camera goes; keyframes are for job files."""

    file: File = None
    """transforms.json with a camera-to-world matrix per frame."""
    name: Name = None
    """A camera of the scene file."""
    up: Literal["y", "z"] = "y"
    """Axis that points up in the camera file."""
    swing: float = 5.0
    """Half angle, degrees, of the loop made around a camera that stands still."""


@dataclass(frozen=True)
class RunFlags(SceneFlags):
    """What `render` and `compare` have in common."""

    out: OutFolder = field(default=tyro.MISSING)
    """Results folder; an interrupted run continues in it."""
    job: File = None
    """Job file (TOML); flags replace its values."""
    frames: Count = None
    """Frames along the camera path."""
    size: SizeFlag = None
    """Image size in pixels."""
    seed: int = 0
    """Seed of all random numbers."""
    cold: bool = False
    """Let each technique compile everything it needs, so that compile times do not depend on the order; slower."""
    scheduler: Annotated[str | None, *_optional(str, "local:N|tcp://HOST:PORT", "this process")] = None
    """Where to render: N processes of this machine, or a dask.distributed scheduler."""
    cache: Folder = None
    """Folder that keeps compiled code between runs."""
    camera: CameraFlags = field(default_factory=CameraFlags)
    outputs: Outputs = field(default_factory=Outputs)


@dataclass(frozen=True)
class RenderBase(RunFlags):
    """Render a scene along a camera path."""

    technique: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ("raytrace",)
    """Technique, or several."""


@dataclass(frozen=True)
class CompareBase(RunFlags):
    """Render a scene with several techniques and measure their errors."""

    techniques: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ("raytrace", "envmap")
    """Techniques to compare."""
    reference: str = "raytrace"
    """Technique that the errors are measured against, with knobs of its own."""
    reference_samples: Samples = None
    """Samples of the reference."""
    reference_knobs: Pairs = ()
    """Other knobs of the reference."""


def _knob_class(name: str, knobs: Mapping[str, Knob]) -> type:
    fields = []
    for knob in knobs.values():
        kind = Literal[knob.choices] if knob.choices else knob.kind  # pyright: ignore[reportInvalidTypeForm]
        fields.append((knob.name, Annotated[kind, tyro.conf.arg(help=knob.explanation)], field(default=knob.default)))
    return dataclasses.make_dataclass(name, fields, frozen=True)


@functools.cache
def knob_groups() -> dict[str, dict[str, Knob]]:
    """All groups of knobs on the command line.

    Returns:
        Knobs by name, by group: `light`, `composite`, and one group per technique.
    """
    groups = {"light": knobs_of(DirectOptions), "composite": knobs_of(CompositeOptions)}
    return groups | {name: technique_knobs(technique) for name, technique in TECHNIQUES.items()}


@functools.cache
def flags_class(base: type) -> type:
    """A command's flags with those of all knobs behind them.

    Args:
        base: `RenderBase` or `CompareBase`.
    Returns:
        A dataclass for tyro.
    """
    groups = [(name, _knob_class(name, knobs)) for name, knobs in knob_groups().items() if knobs]
    fields = [(name, kind, field(default_factory=kind)) for name, kind in groups]
    made = dataclasses.make_dataclass(base.__name__.removesuffix("Base"), fields, bases=(base,), frozen=True)
    made.__doc__ = base.__doc__
    return made


def parse(base: type, argv: Sequence[str], *, prog: str, description: str) -> tuple[Any, Job | None]:
    """Flags of a command.

    Args:
        base: `RenderBase` or `CompareBase`.
        argv: Words after the command's name.
        prog: Name for the help text.
        description: What the help text teaches.
    Returns:
        The flags, and the job file that gave their defaults, if there is one.
    Raises:
        JobError: If the job file does not fit.
        SystemExit: If a flag does not fit (code 2), or help was asked for (code 0).
    """
    from pipelines.job import read_job

    kind, path = flags_class(base), _value_of("--job", argv)
    job = None if path is None else read_job(Path(path))
    default = None if job is None else _defaults(kind, job)
    return tyro.cli(kind, args=list(argv), default=default, prog=prog, description=description), job


def _value_of(flag: str, argv: Sequence[str]) -> str | None:
    for i, word in enumerate(argv):
        if word == flag and i + 1 < len(argv):
            return argv[i + 1]
        if word.startswith(f"{flag}="):
            return word.partition("=")[2]
    return None


def _defaults(kind: type, job: Job) -> Any:
    """Flags that say what a job file says."""
    values: dict[str, Any] = {name: getattr(job, name) for name in ("frames", "size", "seed", "cold", "outputs")}
    scene = job.scene
    names = ("overrides", "environment", "up", "units", "crease_angle")
    values |= {"scene": scene.source, **{name: getattr(scene, name) for name in names}}
    values["camera"] = CameraFlags(*(getattr(job.camera, f.name) for f in dataclasses.fields(CameraFlags)))
    known = {f.name: f for f in dataclasses.fields(kind)}
    values["techniques" if "techniques" in known else "technique"] = job.techniques
    if "reference" in known and job.reference is not None:
        values["reference"] = job.reference.technique
    for name, knobs in knob_groups().items():
        given = {"light": job.light, "composite": job.composite}.get(name, job.technique.get(name, {}))
        if name in known:
            group: Any = known[name].default_factory
            values[name] = group(**complete(knobs, given, where=f"{job_label(name)}"))
    return kind(out=tyro.MISSING, **values)


def job_label(group: str) -> str:
    """Name of a group of knobs in a job file.

    Args:
        group: Name of a technique, `light` or `composite`.
    Returns:
        The table's heading.
    """
    return f"[{group}]" if group in ("light", "composite") else f"[technique.{group}]"


def job_of(flags: Any, base: Job | None) -> Job:
    """The job that flags describe.

    Args:
        flags: From `parse`.
        base: The job file they started from; what has no flag (keyframes, the reference's knobs) is taken from it.
    Returns:
        The job, not yet resolved.
    Raises:
        JobError: If no scene is named, or a knob is set of a technique that is not rendered.
    """
    names = tuple(getattr(flags, "techniques", None) or flags.technique)
    groups = {name: _group(flags, name) for name in knob_groups()}
    reference = _reference(flags, base)
    used = {*names, *(() if reference is None else (reference.technique,)), *(() if base is None else base.technique)}
    for name, knobs in groups.items():
        changed = [k for k, value in knobs.items() if value != knob_groups()[name][k].default]
        if name in TECHNIQUES and name not in used and changed:
            raise JobError(f"--{name}.{changed[0]} would have no effect: {name} is not among {', '.join(names)}")
    old = base or Job(SceneSource(source=""))
    light, composite = groups.pop("light"), groups.pop("composite")
    return dataclasses.replace(
        old,
        scene=scene_of(flags, None if base is None else base.scene),
        techniques=names,
        frames=flags.frames,
        size=flags.size,
        seed=flags.seed,
        cold=flags.cold,
        camera=_camera(flags.camera, old.camera),
        outputs=flags.outputs,
        reference=reference,
        light=light,
        composite=composite,
        technique={**old.technique, **{name: knobs for name, knobs in groups.items() if name in used}},
    )


def _group(flags: Any, name: str) -> Knobs:
    group = getattr(flags, name, None)
    return {} if group is None else dataclasses.asdict(group)


def _camera(flags: CameraFlags, old: CameraPath) -> CameraPath:
    given = {f.name: getattr(flags, f.name) for f in dataclasses.fields(CameraFlags)}
    # A camera named by a flag replaces whatever kind of path the job file has.
    for kind in ("file", "name"):
        if given[kind] is not None and given[kind] != getattr(old, kind):
            other = {"file": "name", "name": "file"}[kind]
            if given[other] == getattr(old, other):
                given[other] = None
            return CameraPath(**given)
    return dataclasses.replace(old, **given)


def _reference(flags: Any, base: Job | None) -> Reference | None:
    old = None if base is None else base.reference
    if not hasattr(flags, "reference"):
        return old
    knobs = dict(old.knobs) if old is not None and old.technique == flags.reference else {}
    knobs |= key_values(flags.reference_knobs, flag="--reference-knobs")
    if flags.reference_samples is not None:
        knobs["samples"] = flags.reference_samples
    return Reference(flags.reference, knobs)


def scene_of(flags: SceneFlags, old: SceneSource | None) -> SceneSource:
    """The scene that flags name.

    Args:
        flags: Flags of any command.
        old: The job file's scene; its parameters are kept if the scene is the same.
    Returns:
        The scene source.
    Raises:
        JobError: If no scene is named.
    """
    if not flags.scene:
        raise JobError("which scene? name a file or a built-in scene (`jaxrefl scenes` lists them), or give --job FILE")
    kept = old.parameters if old is not None and old.source == flags.scene else {}
    return SceneSource(
        source=flags.scene,
        overrides=flags.overrides,
        environment=flags.environment,
        up=flags.up,
        units=flags.units,
        crease_angle=flags.crease_angle,
        parameters={**kept, **key_values(flags.parameters, flag="--parameters")},
    )


def key_values(words: Sequence[str], *, flag: str) -> dict[str, Any]:
    """Values from KEY=VALUE words.

    Args:
        words: Such as "triangles=20000"; values are read as TOML, and as text where they are none.
        flag: Name of the flag, for messages.
    Returns:
        Values by key.
    Raises:
        JobError: If a word has no "=".
    """
    values = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not equals or not key:
            raise JobError(f"{flag}: expected KEY=VALUE, got {word!r}")
        try:
            values[key] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[key] = text
    return values
