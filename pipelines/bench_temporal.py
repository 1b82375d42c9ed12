"""Reprojected reflections against tracing, naive warping and environment maps, along camera paths.

Errors are measured where light has no noise: from a light map, one mirror ray per pixel, over the pixels that reflect,
on the picture as displayed. Times are taken in the same run for three kinds of light: that map, one direct light
sample, and 16 paths per pixel. Every step is run again if JAX compiled during it, so times are those of steady running.
"""

import dataclasses
import statistics
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Frame, GBuffer, Rays, Reflection
from jaxrefl.composite import blend
from jaxrefl.metrics import mae255
from jaxrefl.radiance import LightOptions, diffuse_light
from jaxrefl.surface import look, reflective
from jaxrefl.techniques import TECHNIQUES
from jaxrefl.techniques.temporal import Reason
from pipelines.job import Job, SceneSource
from pipelines.measure import timed
from pipelines.resolve import resolve
from pipelines.stage import Stage

Rows = list[dict[str, Any]]

SAMPLES = 16
"""Paths per pixel of the expensive light."""
BAKED = {"light": "baked"}
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "temporal": ("temporal", {}),
    "temporal, key every 40": ("temporal", {"policy": "interval", "interval": 40}),
    "temporal, as published": ("temporal", {"method": "as_published"}),
    "warp": ("warp", {}),
    "envmap": ("envmap", {}),
}
"""What is compared with ray tracing, and its knobs."""
NOISE = "raytrace, other samples"
"""Ray tracing against itself: the noise of rough reflections, which no method can go below."""
PLAIN: dict[str, dict[str, Any]] = {"temporal": {}}
INNER = PLAIN | {"temporal, inner mirrors reused": {"inner_mirrors": "reuse"}}
"""Variants whose time is taken: as it is, and with mirrors in mirrors reused as in the paper."""
SWEEP: dict[str, tuple[Any, ...]] = {
    "contrast": (0.01, 0.03, 0.1, 0.3),
    "tolerance": (0.02, 0.1, 0.5),
    "threshold": (0.15, 0.3, 0.5),
    "steps": (1, 3, 6),
    "refine_steps": (0, 1, 2, 4),
    "stride": (1, 2, 4),
    "start": ("previous", "surface"),
    "occlusion": ("rays", "depths"),
    "edges": ("ray", "trace"),
    "recent": (True, False),
    "spread": (0, 2, 4, 8),
    "search_steps": (4, 16, 150),
    "discontinuity": (0.01, 0.05, 0.2),
    "method": ("refined", "as_published"),
}
"""Knobs of `temporal` and the values they are tried with, one at a time."""
PUBLISHED = ("search_steps", "discontinuity")
"""Knobs of the published method."""


class Route(NamedTuple):
    """A camera path through a loaded scene."""

    stage: Stage
    """The scene with its light map, and the cameras."""
    frames: tuple[int, ...]
    """Numbers of the cameras that are rendered."""


class Looked(NamedTuple):
    """One frame as all techniques get it."""

    frame: Frame
    """The frame."""
    diffuse: jax.Array
    """[h w 3] diffuse light, for the picture."""
    motion: float
    """Mean movement of what is seen since the frame before, pixels."""


def open_path(name: str, size: tuple[int, int], frames: int, loop: int, *, texels: int) -> Route:
    """Load a scene with a light map and its path.

    Args:
        name: Built-in scene, or scene file.
        size: (width, height) in pixels.
        frames: Frames to render, from the start of the path.
        loop: Frames of the whole path; more of them mean less motion per frame.
        texels: Size of the light map.
    Returns:
        The path.
    """
    light = {"model": "baked", "texels": texels, "bake_samples": 16}
    job = Job(SceneSource(name), techniques=("raytrace",), frames=loop, size=size, light=light)
    return Route(Stage(resolve(job)), tuple(range(min(frames, loop))))


def _looked(path: Route) -> Iterator[Looked]:
    stage = path.stage
    for number in path.frames:
        camera, before = stage.camera(number), stage.camera(max(number - 1, 0))
        gbuffer = look(stage.scene, stage.tracer, camera, previous_camera=before)
        key = stage.key(number, 1)
        diffuse = diffuse_light(stage.scene, stage.tracer, gbuffer, key, options=LightOptions(model="baked"))
        moved = np.linalg.norm(np.asarray(gbuffer.motion), axis=-1)[np.asarray(gbuffer.valid)]
        frame = Frame(stage.scene, camera, gbuffer, key, stage.tracer)
        yield Looked(frame, diffuse, float(moved.mean()) if moved.size else 0.0)


def _frames(path: Route) -> Iterator[Frame]:
    stage = path.stage
    for number in path.frames:
        camera = stage.camera(number)
        yield Frame(stage.scene, camera, look(stage.scene, stage.tracer, camera), stage.key(number, 1), stage.tracer)


class _Runner:
    """One technique with its knobs, as it goes along a path."""

    def __init__(self, path: Route, name: str, knobs: Mapping[str, Any]):
        technique = TECHNIQUES[name]
        known = {field.name for field in dataclasses.fields(technique.Options)}
        self.technique = technique
        self.options = technique.Options(**{k: v for k, v in knobs.items() if k in known})
        self.params = technique.Params(**{k: v for k, v in knobs.items() if k not in known})
        self.state = technique.init(path.stage.scene, path.stage.tracer, options=self.options)
        self.seconds: list[float] = []
        self.infos: list[Any] = []

    def step(self, frame: Frame) -> Reflection:
        call = lambda: self.technique.step(self.state, frame, self.params, options=self.options)  # noqa: E731
        done = timed(call)
        self.state, reflection, info = done.value
        self.seconds.append(done.seconds)
        self.infos.append(info)
        return reflection

    def row(self, label: str) -> dict[str, Any]:
        counts = [info.counts for info in self.infos]
        keys = sum(c.get("key_frame", 0) for c in counts)
        share = [c["share"] for c in counts if "share" in c and not c["key_frame"]]
        return {
            "method": label,
            "ms per frame": 1e3 * statistics.fmean(self.seconds),
            "recomputed, between key frames": statistics.fmean(share) if share else None,
            "recomputed, all": statistics.fmean(c["share"] for c in counts) if "share" in counts[0] else None,
            "frames per key frame": len(counts) / keys if keys else None,
        }

    def stages(self) -> dict[str, float]:
        """Mean milliseconds of each stage over the frames that are no key frames."""
        between = [i for i in self.infos if not i.counts["key_frame"]] or self.infos
        names = dict.fromkeys(name for info in self.infos[::-1] for name in info.seconds)
        return {name: 1e3 * statistics.fmean(i.seconds.get(name, 0.0) for i in between) for name in names}


class _Errors:
    """Errors of pictures against traced ones, averaged over frames."""

    def __init__(self) -> None:
        self.all: list[float] = []
        self.mirrors: list[float] = []

    def add(self, seen: Looked, mine: Reflection, traced: Reflection) -> None:
        gbuffer = seen.frame.gbuffer
        image, truth = (np.asarray(blend(gbuffer, seen.diffuse, r)) for r in (mine, traced))
        for found, mask in ((self.all, reflective(gbuffer)), (self.mirrors, _mirrors(gbuffer))):
            if np.asarray(mask).any():
                found.append(mae255(image, truth, np.asarray(mask)))

    def columns(self) -> dict[str, float | None]:
        names = {"MAE of 255": self.all, "MAE of 255, mirrors": self.mirrors}
        return {name: statistics.fmean(x) if x else None for name, x in names.items()}


def _mirrors(gbuffer: GBuffer) -> jax.Array:
    return reflective(gbuffer) & (gbuffer.alpha == 0)


def compare_errors(path: Route) -> tuple[Rows, Rows]:
    """Errors, shares and times of all methods with light from the map.

    Args:
        path: The path.
    Returns:
        One row per method, and the stages of `temporal`.
    """
    truth = _Runner(path, "raytrace", BAKED)
    runners = {label: _Runner(path, name, BAKED | knobs) for label, (name, knobs) in METHODS.items()}
    errors, motion, share = {label: _Errors() for label in (NOISE, *runners)}, [], []
    for number, seen in enumerate(_looked(path)):
        traced = truth.step(seen.frame)
        if number % 8 == 0:
            again = dataclasses.replace(seen.frame, key=jax.random.fold_in(seen.frame.key, 1))
            errors[NOISE].add(seen, truth.step(again), traced)
        motion.append(seen.motion)
        share.append(float(reflective(seen.frame.gbuffer).mean()))
        for label, runner in runners.items():
            errors[label].add(seen, runner.step(seen.frame), traced)
    base, name = statistics.fmean(truth.seconds), path.stage.scene.names.scene
    facts = {"scene": name, "px motion per frame": statistics.fmean(motion), "reflective": statistics.fmean(share)}
    rows = [facts | {"method": "raytrace", "MAE of 255": 0.0, "MAE of 255, mirrors": 0.0, "ms per frame": 1e3 * base,
            "recomputed, between key frames": None, "recomputed, all": 1.0, "frames per key frame": 1.0,
            "speed-up": 1.0}]  # fmt: skip
    rows.append({key: None for key in rows[0]} | facts | {"method": NOISE} | errors[NOISE].columns())
    for label, runner in runners.items():
        row = facts | {"method": label} | errors[label].columns() | runner.row(label)
        rows.append(row | {"speed-up": base / statistics.fmean(runner.seconds)})
    return rows, [{"scene": name, "light": "map", "method": "temporal"} | runners["temporal"].stages()]


def compare_times(
    path: Route, light: str, variants: Mapping[str, Mapping[str, Any]], *, every: int
) -> tuple[Rows, Rows]:
    """Times of `temporal` and of ray tracing with other light.

    Args:
        path: The path.
        light: `direct` (one sample) or `path` (`SAMPLES` paths).
        variants: Further knobs of `temporal`, by label.
        every: Frames from one that is also traced whole to the next.
    Returns:
        A row per variant with both times and their ratio, and the stages of `temporal`.
    """
    knobs = {"light": light, "samples": SAMPLES if light == "path" else 1}
    truth = _Runner(path, "raytrace", knobs)
    mine = {label: _Runner(path, "temporal", knobs | dict(more)) for label, more in variants.items()}
    for number, seen in enumerate(_looked(path)):
        if number % every == 0:
            truth.step(seen.frame)
        for runner in mine.values():
            runner.step(seen.frame)
    traced = 1e3 * statistics.fmean(truth.seconds)
    name = path.stage.scene.names.scene
    label = f"path, {SAMPLES} samples" if light == "path" else "direct, 1 sample"
    facts, rows, stages = {"scene": name, "light": label}, [], []
    for variant, runner in mine.items():
        row = runner.row(variant)
        rows.append(facts | {"frames": len(path.frames), "raytrace ms": traced} | row)
        rows[-1]["speed-up"] = traced / row["ms per frame"]
        stages.append(facts | {"method": variant} | runner.stages())
    return rows, stages


def sweep(path: Route) -> Rows:
    """What each knob trades, one at a time.

    Args:
        path: The path.
    Returns:
        One row per knob and value.
    """
    published = {"method": "as_published"}
    tried = [("defaults", "", {})] + [
        (knob, value, {knob: value} | (published if knob in PUBLISHED else {}))
        for knob, values in SWEEP.items()
        for value in values
    ]
    truth = _Runner(path, "raytrace", BAKED)
    runners = [(knob, value, _Runner(path, "temporal", BAKED | knobs), _Errors()) for knob, value, knobs in tried]
    for seen in _looked(path):
        traced = truth.step(seen.frame)
        for *_, runner, errors in runners:
            errors.add(seen, runner.step(seen.frame), traced)
    name = path.stage.scene.names.scene
    return [
        {"scene": name, "knob": knob, "value": str(value), **errors.columns(), **runner.row("temporal")}
        for knob, value, runner, errors in runners
    ]


def reuse_growth(sides: tuple[int, ...], triangles: tuple[int, ...], *, scene: str = "mirror_room") -> Rows:
    """Time of everything but tracing, by pixels and by triangles.

    Args:
        sides: Image sides in pixels.
        triangles: Tessellations of the scene.
        scene: A built-in scene with a parameter `triangles`.
    Returns:
        One row per case: third frame of a path of 240, light of one direct sample.
    """
    rows = []
    for count in triangles:
        for side in sides:
            source = SceneSource(scene, parameters={"triangles": count})
            job = Job(source, techniques=("raytrace",), frames=240, size=(side, side))
            path = Route(Stage(resolve(job)), (0, 1, 2, 3, 4))
            runner = _Runner(path, "temporal", {"threshold": 1.0})
            for frame in _frames(path):
                runner.step(frame)
            stages = [runner.infos[i].seconds for i in (2, 3, 4)]
            reuse = {name: 1e3 * statistics.median(s[name] for s in stages) for name in stages[0] if name != "trace"}
            faces = int(path.stage.scene.mesh.faces.shape[0])
            rows.append({"triangles": faces, "side": side, **reuse, "all but tracing": sum(reuse.values())})
    return rows


def stage_costs(side: int, *, scene: str = "mirror_room") -> Rows:
    """Each stage beside what its gathers, scatters and rays cost when nothing else is done.

    Args:
        side: Image side in pixels.
        scene: A built-in scene.
    Returns:
        One row per stage of the second frame after a key frame. `alone` is the number of single floats that are
        gathered from neighbouring places or scattered, times their measured cost, and the shadow rays as cast.
    """
    path = Route(Stage(resolve(Job(SceneSource(scene), techniques=("raytrace",), frames=240, size=(side, side)))),
                 (0, 1, 2, 3))  # fmt: skip
    runner = _Runner(path, "temporal", {"threshold": 1.0, "recent": False})
    frames = list(_frames(path))
    for frame in frames:
        runner.step(frame)
    options, info, gbuffer = runner.options, runner.infos[-1], frames[-1].gbuffer
    gather, scatter, ray = _unit_costs(path, gbuffer)
    mirrors = int(_mirrors(gbuffer).sum())
    grid = mirrors / options.stride**2
    edges = int(np.isin(np.asarray(info.reason), (Reason.EDGE, Reason.HIDDEN, Reason.RESIDUAL)).sum())
    counts = {
        # Three mirrors of 6 floats and an object each, per step; 3 results.
        "search": (grid * options.steps * 21, grid * 3, 0),
        # Two triangles a point: 9 floats, 4 pixels in two passes; 6 floats per pixel drawn.
        "shift": (grid * 2 * (9 + 4 * 3) + mirrors * 6, grid * 2 * 8, 0),
        # Four corners of 4 floats per step and for the residual; 4 results.
        "refine": (mirrors * (options.refine_steps + 1) * 16, mirrors * 4, 0),
        # Four corners of 12 floats, 3 more; 15 results; a ray each, and those of edges.
        "check": (mirrors * 51, mirrors * 15, mirrors + edges),
    }
    return [
        {
            "stage": stage,
            "gathers, M": gathers / 1e6,
            "scatters, M": scatters / 1e6,
            "rays, M": rays / 1e6,
            "alone ms": (alone := 1e3 * (gathers * gather + scatters * scatter + rays * ray)),
            "measured ms": 1e3 * info.seconds[stage],
            "ratio": 1e3 * info.seconds[stage] / alone,
        }
        for stage, (gathers, scatters, rays) in counts.items()
    ]


def _unit_costs(path: Route, gbuffer: GBuffer) -> tuple[float, float, float]:
    """Seconds per float gathered, per float scattered, and per shadow ray."""
    count = gbuffer.t.size
    source, index = gbuffer.t.reshape(-1), jnp.arange(count, dtype=jnp.int32)
    gather = jax.jit(lambda x, i: x[i] + x[jnp.minimum(i + 1, count - 1)])
    scatter = jax.jit(lambda x, i: jnp.zeros_like(x).at[i].set(x, mode="drop"))
    rays = Rays(gbuffer.p + 1e-3 * gbuffer.n, gbuffer.n)
    far = jnp.where(gbuffer.valid, jnp.float32(1), 0)
    casts = max(int(gbuffer.valid.sum()), 1)

    def median(call: Callable[[], Any]) -> float:
        return statistics.median(timed(call).seconds for _ in range(5))

    seconds = [median(lambda: gather(source, index)), median(lambda: scatter(source, index))]
    return seconds[0] / (2 * count), seconds[1] / count, median(lambda: path.stage.tracer.occluded(rays, far)) / casts


def plot_sweep(rows: Rows, out: Path) -> None:
    """Error against recomputed share of the sweep, as a picture.

    Args:
        rows: From `sweep`.
        out: PNG file to write.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for knob in dict.fromkeys(row["knob"] for row in rows):
        chosen = [r for r in rows if r["knob"] == knob and r["recomputed, between key frames"] is not None]
        x = [100 * r["recomputed, between key frames"] for r in chosen]
        axes.plot(x, [r["MAE of 255, mirrors"] for r in chosen], "o-", label=knob, linewidth=1, markersize=4)
        for row, at in zip(chosen, x, strict=True):
            axes.annotate(row["value"], (at, row["MAE of 255, mirrors"]), fontsize=6)
    axes.set(xlabel="recomputed between key frames, % of the reflective pixels", ylabel="MAE of 255, mirrors")
    axes.set_yscale("log")
    axes.legend(fontsize=7)
    figure.savefig(out, dpi=120)
    plt.close(figure)
