"""Words of the command line -> flags -> Job.

A flag and a key of a job file are the same thing: with `--job` the file's values are the defaults of the flags.
"""

import dataclasses
import os
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro

from jaxrefl.techniques import TECHNIQUES
from pipelines.flags import CameraFlags, SceneFlags, flags_class, knob_groups
from pipelines.job import CameraPath, Job, Reference, SceneSource, read_job
from pipelines.knobs import Knobs, complete
from pipelines.toml_tables import JobError


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
    kind, path = flags_class(base), value_of("--job", argv)
    job = None if path is None else read_job(Path(path))
    default = None if job is None else _defaults(kind, job)
    return tyro.cli(kind, args=list(argv), default=default, prog=prog, description=description), job


def value_of(flag: str, argv: Sequence[str]) -> str | None:
    """The word after a flag, before the words are parsed.

    Args:
        flag: The flag.
        argv: Words after the command's name.
    Returns:
        The word, or None if the flag is not there.
    """
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
        values["reference"] = job.reference.folder or job.reference.technique
    for name, knobs in knob_groups().items():
        given = {"light": job.light, "composite": job.composite}.get(name, job.technique.get(name, {}))
        if name in known:
            group: Any = known[name].default_factory
            values[name] = group(**complete(knobs, given, where=f"{job_label(name)}"))
    return kind(**values)


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
        camera=camera_of(flags.camera, old.camera),
        outputs=flags.outputs,
        reference=reference,
        light=light,
        composite=composite,
        technique={**old.technique, **{name: knobs for name, knobs in groups.items() if name in used}},
    )


def _group(flags: Any, name: str) -> Knobs:
    group = getattr(flags, name, None)
    return {} if group is None else dataclasses.asdict(group)


def camera_of(flags: CameraFlags, old: CameraPath) -> CameraPath:
    """The camera path that flags describe.

    Args:
        flags: The flags `--camera.*`.
        old: That of the job file.
    Returns:
        The path.
    """
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
    word = flags.reference
    if word not in TECHNIQUES and (Path(word).is_dir() or os.sep in word):
        if flags.reference_samples is not None or flags.reference_knobs:
            raise JobError(f"--reference-samples and --reference-knobs would have no effect: {word} is a folder")
        return Reference(folder=word)
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
