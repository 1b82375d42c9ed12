"""What stays loaded between frames: the scene, its tracer, the cameras, and the state of each technique.

Built from a resolved job alone, so that a worker on another machine builds the same.
"""

import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxrefl._types import Camera, GBuffer, Scene, Tracer
from jaxrefl.composite import Options as CompositeOptions
from jaxrefl.radiance import LightOptions, diffuse_light
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import SceneWarning, assemble, load
from jaxrefl.surface import look
from jaxrefl.techniques import TECHNIQUES, Technique
from pipelines.cameras import job_cameras
from pipelines.job import Job, SceneSource
from pipelines.knobs import build, find_technique
from pipelines.lightmaps import wants_lightmap, with_lightmap
from pipelines.measure import timed
from pipelines.toml_tables import JobError
from scenes import BUILT_IN

REFERENCE = "reference"
"""Folder and name of what errors are measured against."""


class View(NamedTuple):
    """What all techniques share in one frame."""

    gbuffer: GBuffer
    """What is seen."""
    diffuse: jax.Array
    """[h w 3] emitted and diffusely reflected radiance."""
    seconds: dict[str, float]
    """Seconds for `surface` and `diffuse`."""


class Prepared(NamedTuple):
    """A technique that is ready to render."""

    technique: Technique
    """The technique."""
    params: Any
    """Its traced knobs."""
    options: Any
    """Its static knobs."""
    state: Any
    """What `init` made."""
    init_seconds: float
    """How long `init` took, compilation included."""


def load_scene(source: SceneSource) -> tuple[Scene, list[str]]:
    """The scene of a job.

    Args:
        source: Which scene, and what to change about it.
    Returns:
        The scene, and the warnings that came with it, one sentence each.
    Raises:
        ValueError: If the file is broken or something in it does not fit; names the file.
    """
    optional = {n: v for n in ("up", "units", "crease_angle") if (v := getattr(source, n)) is not None}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SceneWarning)
        if source.source in BUILT_IN:
            scene = _built_in(source)
        else:
            scene = load(source.source, overrides=source.overrides, environment=source.environment, **optional)
    for other in (w for w in caught if not issubclass(w.category, SceneWarning)):
        warnings.warn_explicit(other.message, other.category, other.filename, other.lineno)
    return scene, [str(w.message) for w in caught if issubclass(w.category, SceneWarning)]


def _built_in(source: SceneSource) -> Scene:
    description = BUILT_IN[source.source].build(**source.parameters)
    if source.environment is None:
        return assemble(description)
    raise JobError(f"scene: environment is for scene files; {source.source} is a built-in scene")


class Stage:
    """A loaded job.

    Args:
        job: Resolved job.
        techniques: The techniques that exist.
        folder: Results folder, which keeps the light map of jobs that name no file for it; None: it is kept nowhere.
        say: Told about the light map while it is baked; None: it is added to `notes`.
    Raises:
        ValueError: If the scene, a camera or a knob does not fit.
    """

    def __init__(
        self,
        job: Job,
        *,
        techniques: Mapping[str, Technique] = TECHNIQUES,
        folder: Path | None = None,
        say: Callable[[str], None] | None = None,
    ):
        self.job = job
        self.scene, self.notes = load_scene(job.scene)
        self.tracer: Tracer = EmbreeTracer(self.scene.mesh)
        self.cameras, notes = job_cameras(job, self.scene, self.tracer)
        self.notes += notes
        self.composite = build(CompositeOptions, job.composite, where="[composite]")
        self._light = build(LightOptions, job.light, where="[light]")
        if wants_lightmap(job):
            self.scene = with_lightmap(self.scene, self.tracer, self._light, folder, say or self.notes.append)
        self._techniques = techniques
        self._prepared: dict[str, Prepared] = {}
        self._view: tuple[int, View] | None = None

    def camera(self, frame: int) -> Camera:
        """Camera of a frame.

        Args:
            frame: Number of the frame.
        Returns:
            The camera.
        """
        return self.cameras[frame]

    def key(self, frame: int, purpose: int) -> jax.Array:
        """Random key of a frame; depends on the seed, the frame and the purpose alone, not on what was rendered before.

        Args:
            frame: Number of the frame.
            purpose: Any number from 0 to 2³² - 1; 0 is the diffuse light.
        Returns:
            The key.
        """
        return jax.random.fold_in(jax.random.fold_in(jax.random.key(self.job.seed), frame), purpose)

    def view(self, frame: int) -> View:
        """G-buffer and diffuse light of a frame; the last one is kept.

        Args:
            frame: Number of the frame.
        Returns:
            What all techniques share in the frame.
        """
        if self._view is None or self._view[0] != frame:
            self._view = None
            previous = self.cameras[max(frame - 1, 0)] if len(self.cameras) > 1 else None
            surface = timed(lambda: look(self.scene, self.tracer, self.cameras[frame], previous_camera=previous))
            gbuffer, key = surface.value, self.key(frame, 0)
            diffuse = timed(lambda: diffuse_light(self.scene, self.tracer, gbuffer, key, options=self._light))
            seconds = {"surface": surface.seconds, "diffuse": diffuse.seconds}
            self._view = frame, View(gbuffer, diffuse.value, seconds)
        return self._view[1]

    def prepared(self, name: str) -> Prepared:
        """A technique with its knobs and initial state.

        Args:
            name: Name of a technique of the job, or `REFERENCE`.
        Returns:
            The technique; `init` runs the first time only.
        """
        if name not in self._prepared:
            if self.job.cold:
                jax.clear_caches()
            technique, values = self._chosen(name)
            where = f"[technique.{name}]" if name != REFERENCE else "[reference.knobs]"
            options = build(technique.Options, values, where=where)
            params = build(technique.Params, values, where=where)
            began = time.perf_counter()
            state = jax.block_until_ready(technique.init(self.scene, self.tracer, options=options))
            self._prepared[name] = Prepared(technique, params, options, state, time.perf_counter() - began)
        return self._prepared[name]

    def _chosen(self, name: str) -> tuple[Technique, Mapping[str, Any]]:
        if name != REFERENCE:
            return find_technique(name, self._techniques), self.job.technique[name]
        if self.job.reference is None:
            raise ValueError("the job has no reference")
        return find_technique(self.job.reference.technique, self._techniques), self.job.reference.knobs
