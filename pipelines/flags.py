"""The flags of the command line: classes for tyro, from those of `pipelines.job` and the knobs of what exists."""

import dataclasses
import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from jaxrefl.composite import Options as CompositeOptions
from jaxrefl.radiance import LightMapOptions, LightOptions
from jaxrefl.techniques import TECHNIQUES
from pipelines.job import Outputs
from pipelines.knobs import Knob, knobs_of, technique_knobs


def optional_flag(kind: type, metavar: str, hint: str, *, nargs: int = 1) -> Any:
    """A flag that may be absent, without tyro's `{None}|...` in its help and without its greed for later words.

    Args:
        kind: Reads one word.
        metavar: What the help shows for the value.
        hint: What the help says about the default.
        nargs: How many words.
    Returns:
        Annotations for tyro.
    """
    read = (lambda words: kind(words[0])) if nargs == 1 else (lambda words: tuple(kind(w) for w in words))
    spec = tyro.constructors.PrimitiveConstructorSpec(
        nargs=nargs,
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: True,
        str_from_instance=lambda value: [str(v) for v in (value if isinstance(value, tuple) else (value,))],
    )
    return spec, tyro.conf.arg(help_behavior_hint=f"(default: {hint})")


Name = Annotated[str | None, *optional_flag(str, "NAME", "its first")]
Axis = Annotated[str | None, *optional_flag(str, "AXIS", "the file's own")]
File = Annotated[str | None, *optional_flag(str, "FILE", "none")]
Folder = Annotated[str | None, *optional_flag(str, "DIR", "none")]
Number = Annotated[float | None, *optional_flag(float, "NUMBER", "the file's own")]
Count = Annotated[int | None, *optional_flag(int, "N", "all of a camera file, otherwise 1")]
SizeFlag = Annotated[
    tuple[int, int] | None, *optional_flag(int, "WIDTH HEIGHT", "the camera file's, otherwise 960 540", nargs=2)
]
CameraSize = Annotated[tuple[int, int] | None, *optional_flag(int, "WIDTH HEIGHT", "the camera's", nargs=2)]
Samples = Annotated[int | None, *optional_flag(int, "N", "16 times the technique's own, at least 64")]
SceneName = Annotated[str | None, *optional_flag(str, "SCENE", "the job's")]
Pairs = Annotated[tuple[str, ...], tyro.conf.arg(metavar="KEY=VALUE ...", help_behavior_hint="(default: the defaults)")]
OutFolder = Annotated[
    Path | None,
    optional_flag(Path, "DIR", "")[0],
    tyro.conf.arg(aliases=["-o"], help_behavior_hint="(default: results/NAME, after the job file or the scene)"),
]
OutFile = Annotated[
    Path | None,
    optional_flag(Path, "FILE", "")[0],
    tyro.conf.arg(aliases=["-o"], help_behavior_hint="(default: results/NAME.lightmap.npz, after the scene)"),
]


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
class BakeFlags(SceneFlags):
    """Bake a light map."""

    out: OutFile = None
    """File to write."""
    texels: int = LightMapOptions.texels
    """Texels that cover the surfaces together, about."""
    samples: int = LightMapOptions.samples
    """Paths per texel and side."""
    bounces: int = LightMapOptions.bounces
    """Most scattering events, that at the texel included."""


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

    out: OutFolder = None
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
    scheduler: Annotated[str | None, *optional_flag(str, "local:N|tcp://HOST:PORT", "this process")] = None
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
    """What the errors are measured against: a technique with knobs of its own, or a folder of `jaxrefl reference`."""
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
    groups = {"light": knobs_of(LightOptions), "composite": knobs_of(CompositeOptions)}
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
