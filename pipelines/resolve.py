"""Resolving a job: nothing left open, so that it can be kept beside its results and rendered again. Job -> Job.

Every default is written out, every path is absolute, every input file has its digest, and everything it names exists.
"""

import dataclasses
import hashlib
import inspect
from collections.abc import Mapping
from pathlib import Path

from jaxrefl.composite import Options as CompositeOptions
from jaxrefl.radiance import LightOptions
from jaxrefl.techniques import TECHNIQUES, Technique
from pipelines.camera_files import camera_file_facts
from pipelines.job import Job, Reference, SceneSource, with_paths
from pipelines.knobs import Knobs, complete, find_technique, knobs_of, technique_knobs
from pipelines.path_knobs import PathKnobs
from pipelines.reference_folder import check_reference
from pipelines.toml_tables import JobError, suggestion
from scenes import BUILT_IN

DEFAULT_SIZE = (960, 540)
"""Image size where neither the job nor the camera file names one."""


def resolve(job: Job, *, techniques: Mapping[str, Technique] = TECHNIQUES) -> Job:
    """The job with nothing left open: defaults written out, paths absolute, input files digested.

    Args:
        job: Any job; paths count from the working folder.
        techniques: The techniques that exist.
    Returns:
        The resolved job; resolving it again changes nothing.
    Raises:
        JobError: If something the job names does not exist or does not fit, or if an input file is not the one
            the job was resolved with.
    """
    job = with_paths(job, lambda p: str(Path(p).expanduser().absolute()))
    parameters = _scene_parameters(job.scene)
    facts = camera_file_facts(Path(job.camera.file)) if job.camera.file is not None else None
    knobs = {
        name: complete(
            technique_knobs(find_technique(name, techniques)), job.technique.get(name, {}), where=f"[technique.{name}]"
        )
        for name in (*job.techniques, *job.technique)
    }
    resolved = dataclasses.replace(
        job,
        scene=dataclasses.replace(job.scene, parameters=parameters),
        frames=job.frames or (facts.frames if facts else 1),
        size=job.size or (facts.size if facts else None) or DEFAULT_SIZE,
        light=complete(knobs_of(LightOptions), job.light, where="[light]") if job.techniques else {},
        composite=complete(knobs_of(CompositeOptions), job.composite, where="[composite]") if job.techniques else {},
        path=None if job.techniques else complete(knobs_of(PathKnobs), job.path or {}, where="[path]"),
        technique={name: knobs[name] for name in job.techniques},
        reference=None if job.reference is None else _resolve_reference(job, job.reference, techniques),
        digests=input_digests(job),
    )
    if resolved.reference is not None and resolved.reference.folder is not None:
        images = check_reference(resolved, Path(resolved.reference.folder))
        resolved = dataclasses.replace(resolved, digests={**resolved.digests, **images})
    for path, digest in job.digests.items():
        if resolved.digests.get(path, digest) != digest:
            raise JobError(f"{path}: is not the file this job was made with; remove it from [digests] to use it anyway")
    return resolved


def _scene_parameters(scene: SceneSource) -> Knobs:
    """Parameters of a built-in scene, with defaults; none for a file, which must exist."""
    if scene.source not in BUILT_IN:
        path = Path(scene.source)
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "does not exist"
            raise JobError(f"scene {scene.source}: {what}, and no built-in scene: {suggestion(path.name, BUILT_IN)}")
        if scene.parameters:
            raise JobError(
                f"scene: {scene.source} is a file; parameters are for built-in scenes: {', '.join(BUILT_IN)}"
            )
        return {}
    for name in ("overrides", "up", "units", "crease_angle"):
        if getattr(scene, name) is not None:
            raise JobError(f"scene: {name} is for scene files; {scene.source} is a built-in scene")
    known = inspect.signature(BUILT_IN[scene.source].build).parameters
    for name in scene.parameters:
        if name not in known:
            raise JobError(f"scene {scene.source}: unknown parameter {name!r}; {suggestion(name, known)}")
    defaults = {name: p.default for name, p in known.items() if isinstance(p.default, bool | int | float | str)}
    return {**defaults, **scene.parameters}


def _resolve_reference(job: Job, reference: Reference, techniques: Mapping[str, Technique]) -> Reference:
    if reference.folder is not None:
        if reference.knobs:
            raise JobError(
                f"[reference]: {', '.join(reference.knobs)} would have no effect: its images come from a folder"
            )
        return Reference("", {}, reference.folder)
    known = technique_knobs(find_technique(reference.technique, techniques))
    given = dict(reference.knobs)
    # Whoever names no samples for the reference wants one that is clearly better than what it judges.
    if "samples" in known and "samples" not in given:
        own = int(job.technique.get(reference.technique, {}).get("samples", known["samples"].default))
        given["samples"] = int(min(max(64, 16 * own), known["samples"].high or 2**31 - 1))
    return Reference(reference.technique, complete(known, given, where="[reference.knobs]"))


def input_digests(job: Job) -> dict[str, str]:
    """SHA-256 of every file the job names.

    Args:
        job: A job with absolute paths.
    Returns:
        Hexadecimal digests by path.
    Raises:
        JobError: If a file cannot be read.
    """
    scene = job.scene
    files = (None if scene.source in BUILT_IN else scene.source, scene.overrides, scene.environment, job.camera.file)
    digests = {}
    for path in (p for p in files if p is not None):
        try:
            with open(path, "rb") as stream:
                digests[path] = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as error:
            raise JobError(f"{path}: cannot be read: {error.strerror}") from error
    return digests
