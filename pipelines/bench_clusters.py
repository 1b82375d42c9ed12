"""Clusters of mirror rays against ray tracing: errors, disocclusions and times along paths of few frames.

As in the paper, images have twice the pixels per side that are shown: 512 squared with 4 rays per pixel is 1024 squared
with one, averaged down. Light comes from a light map and every pixel's mirror ray is the same in all methods, so the
differences are the methods' own. All reflectors of a scene are taken as mirrors, but in the tables of rough ones.
"""

import argparse
import dataclasses
import statistics
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Frame, GBuffer, Reflection, Scene
from jaxrefl.composite import blend
from jaxrefl.core import resize
from jaxrefl.metrics import mae255
from jaxrefl.radiance import LightOptions, diffuse_light
from jaxrefl.surface import look, reflective
from jaxrefl.techniques import TECHNIQUES
from jaxrefl.techniques.clusters import Options
from pipelines.bench_clusters_pictures import draw_strip
from pipelines.bench_raster import deforming, rasteriser
from pipelines.bench_tables import write
from pipelines.bench_temporal import Route, open_path
from pipelines.measure import timed

Rows = list[dict[str, Any]]
PUBLISHED = {"clusters": "spherical", "least": 0.0, "eye": "equation", "axis": "normal", "near": "centre",
             "repair": "environment"}  # fmt: skip
"""Knobs of the method as its paper has it."""
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "clusters, unrepaired": ("clusters", {"repair": "none"}),
    "clusters, environment": ("clusters", {"repair": "environment"}),
    "clusters, traced": ("clusters", {"repair": "trace"}),
    "clusters, rasterised": ("clusters", {"repair": "trace", "maker": "raster"}),
    "octahedral bins": ("clusters", {"clusters": "octahedral", "repair": "none"}),
    "spherical bins": ("clusters", {"clusters": "spherical", "repair": "none"}),
    "Eq. 1": ("clusters", {"eye": "equation", "repair": "none"}),
    "fit of Eq. 1": ("clusters", {"eye": "fit", "repair": "none"}),
    "as published": ("clusters", PUBLISHED),
    "envmap": ("envmap", {}),
}
QUICK = ("clusters, traced", "envmap")
"""What a quick run compares."""
SWEEPS: dict[str, tuple[Any, ...]] = {
    "capacity": (8, 16, 32, 64, 128, 256),
    "resolution": (0.5, 1.0, 2.0),
    "disparity": (0.05, 0.1, 0.2, 0.4),
    "smallest": (1.0, 4.0, 16.0, 64.0),
    "near": ("pixels", "behind", "centre"),
    "pitch": ("near", "ends"),
    "concave": ("reflector", "ignore", "cluster"),
    "maker": ("rays", "raster"),
}
"""Knobs and the values they are tried with, one at a time: the paper's Tables 3 and 5 among them."""
_COUNTS = ("disoccluded", "without_camera", "clusters", "texels", "steps", "traced_pixels", "reflective_pixels")
BYTES = 8 * 4
"""Per texel: its plane, radiance, triangle and where its image begins."""
RAYS = (8, 49)
"""Rays per rough pixel, as in the paper."""
TRUTH_RAYS = 256
"""Rays per rough pixel of the truth."""


class Shot(NamedTuple):
    """One frame as all methods get it, and its truth."""

    frame: Frame
    """The frame, twice as wide and high as it is shown."""
    diffuse: np.ndarray
    """[h w 3] diffuse light, for the picture."""
    traced: Reflection
    """By ray tracing."""
    seconds: float
    """How long that took."""


def mirrors_only(scene: Scene) -> Scene:
    """A scene whose reflectors are all smooth.

    Args:
        scene: The scene.
    Returns:
        The scene with alpha 0 and without textures of roughness.
    """
    zero = jnp.zeros_like(scene.materials.alpha)
    none = jnp.full_like(scene.materials.metallic_roughness_texture, -1)
    materials = dataclasses.replace(scene.materials, alpha=zero, metallic_roughness_texture=none)
    return dataclasses.replace(scene, materials=materials, features=dataclasses.replace(scene.features, glossy=False))


def shots(route: Route, *, smooth: bool, side: int, samples: int = 1) -> list[Shot]:
    """Frames of a path with their ray traced reflections.

    Args:
        route: The path.
        smooth: Whether to take all reflectors as mirrors.
        side: Width and height, pixels.
        samples: Rays per rough pixel.
    Returns:
        One shot per frame.
    """
    stage = route.stage
    scene = mirrors_only(stage.scene) if smooth else stage.scene
    found = []
    for number in route.frames:
        camera = resize(stage.camera(number), (side, side))
        gbuffer, key = look(scene, stage.tracer, camera), stage.key(number, 1)
        light = diffuse_light(scene, stage.tracer, gbuffer, key, options=LightOptions(model="baked"))
        frame = Frame(scene, camera, gbuffer, key, stage.tracer)
        done = _run("raytrace", {"samples": samples}, frame)
        found.append(Shot(frame, np.asarray(light), done.value[1], done.seconds))
    return found


def _run(name: str, knobs: dict[str, Any], frame: Frame, state: Any = None) -> Any:
    technique = TECHNIQUES[name]
    known = {field.name for field in dataclasses.fields(technique.Options)}
    options = technique.Options(**{k: v for k, v in knobs.items() if k in known}, light="baked", block=65536) \
        if "block" in known else technique.Options(light="baked")  # fmt: skip
    params = technique.Params(**{k: v for k, v in knobs.items() if k not in known})
    state = technique.init(frame.scene, frame.tracer, options=options) if state is None else state
    return timed(lambda: technique.step(state, frame, params, options=options))


def row_of(label: str, name: str, knobs: dict[str, Any], taken: list[Shot]) -> dict[str, Any]:
    """One method's figures over some frames.

    Args:
        label: Its name in the table.
        name: The technique.
        knobs: Its knobs.
        taken: The frames.
    Returns:
        Errors on the 0-255 scale of the frame as shown and over its reflective pixels, shares of pixels, counts, times.
    """
    frame_errors, errors, counts, seconds, wrong = [], [], [], [], []
    for shot in taken:
        done = _run(name, knobs, shot.frame)
        image, info = done.value[1], done.value[2]
        seconds.append(done.seconds)
        counts.append(info.counts)
        frame_error, error = _errors(shot, image)
        frame_errors.append(frame_error)
        errors.append(error)
        wrong.append(_missed(shot, image))
    known = {k: statistics.fmean(float(c[k]) for c in counts) for k in _COUNTS if k in counts[0]}
    mean = known.get
    marked, alone = mean("disoccluded"), known.get("without_camera", 0) / max(known.get("reflective_pixels", 1), 1)
    traced = statistics.fmean(s.seconds for s in taken)
    return {
        "method": label,
        "MAE 255, reflective": statistics.fmean(errors),
        "MAE 255, frame": statistics.fmean(frame_errors),
        "disoccluded %": None if marked is None else 100 * max(marked - alone, 0),
        "no camera %": None if marked is None else 100 * alone,
        "wrong %": 100 * statistics.fmean(wrong),
        "clusters": mean("clusters"),
        "texels per pixel": known["texels"] / max(known["reflective_pixels"], 1) if "texels" in known else None,
        "steps per pixel": mean("steps"),
        "traced pixels": mean("traced_pixels"),
        "ms": 1e3 * statistics.fmean(seconds),
        "tracing / this": traced / statistics.fmean(seconds),
    }


def _errors(shot: Shot, image: Reflection) -> tuple[float, float]:
    """Mean absolute difference of the frame as shown, all of it and where it reflects."""
    gbuffer = shot.frame.gbuffer
    shown = [_halved(np.asarray(blend(gbuffer, jnp.asarray(shot.diffuse), r))) for r in (image, shot.traced)]
    mask = _halved(np.asarray(reflective(gbuffer), np.float32)[..., None])[..., 0] == 1
    everywhere = mae255(shown[0], shown[1], np.ones_like(mask))
    return everywhere, mae255(shown[0], shown[1], mask) if mask.any() else 0.0


def _halved(image: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 pixels."""
    h, w = (n // 2 * 2 for n in image.shape[:2])
    return image[:h, :w].reshape(h // 2, 2, w // 2, 2, -1).mean((1, 3))


def _missed(shot: Shot, image: Reflection) -> float:
    """Share of the reflective pixels that show no point which tracing shows within a pixel of them: not edges that are
    cut half a pixel away, but what the depth image did not see."""
    gbuffer: GBuffer = shot.frame.gbuffer
    mine, truth = np.asarray(image.p), np.asarray(shot.traced.p)
    hit, truly = (np.asarray(r.t) > 0 for r in (image, shot.traced))
    limit = 0.02 * (np.asarray(gbuffer.t) + np.asarray(shot.traced.t))
    near = np.zeros(hit.shape, bool)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            other, there = np.roll(truth, (dy, dx), (0, 1)), np.roll(truly, (dy, dx), (0, 1))
            far = np.linalg.norm(mine - other, axis=-1)
            near |= (hit & there & (far <= np.maximum(limit, np.roll(limit, (dy, dx), (0, 1))))) | (~hit & ~there)
    shiny = np.asarray(reflective(gbuffer))
    known = np.asarray(image.valid) & near
    return float((shiny & ~known).sum() / max(shiny.sum(), 1))


def against_tracing(taken: list[Shot], methods: tuple[str, ...]) -> Rows:
    """All methods on one scene.

    Args:
        taken: Its frames.
        methods: Names of some of `METHODS`.
    Returns:
        One row per method.
    """
    return [row_of(label, *METHODS[label], taken) for label in methods]


def picture(shot: Shot, out: Path) -> None:
    """Draw how clusters see a frame, unrepaired.

    Args:
        shot: The frame.
        out: PNG file to write.
    """
    _, image, info = _run("clusters", {"repair": "none"}, shot.frame).value
    draw_strip(shot.traced, image, info, out)


def sweeps(taken: list[Shot]) -> Rows:
    """The knobs, one at a time, unrepaired.

    Args:
        taken: Frames of a scene.
    Returns:
        One row per knob and value.
    """
    rows = []
    for knob, values in SWEEPS.items():
        for value in values:
            row = row_of(f"{knob} {value}", "clusters", {"repair": "none", knob: value}, taken)
            rows.append({"knob": knob, "value": value, **{k: v for k, v in row.items() if k != "method"}})
    return rows


def stages(taken: list[Shot]) -> Rows:
    """Milliseconds of each stage, the largest and the mean: the paper's Table 2.

    Args:
        taken: Frames of a scene.
    Returns:
        One row per stage.
    """
    infos = [_run("clusters", {}, shot.frame).value[2] for shot in taken]
    names = list(infos[0].seconds)
    times = {name: [1e3 * info.seconds[name] for info in infos] for name in names}
    return [{"stage": n, "max ms": max(times[n]), "mean ms": statistics.fmean(times[n])} for n in names]


def resolutions(route: Route, sides: tuple[int, ...]) -> Rows:
    """Time against the size of the image: the paper's Table 4.

    Args:
        route: A path.
        sides: Widths and heights, pixels.
    Returns:
        One row per size, for the path's first frame.
    """
    rows = []
    for side in sides:
        taken = shots(Route(route.stage, route.frames[:1]), smooth=True, side=side)
        row = row_of("clusters", "clusters", {"repair": "none"}, taken)
        shown = {k: row[k] for k in ("clusters", "MAE 255, reflective", "ms", "tracing / this")}
        pixels = int(np.asarray(reflective(taken[0].frame.gbuffer)).sum())
        used = {"MB held": Options().room(side * side), "MB rendered": row["texels per pixel"] * pixels}
        rows.append({"side": side, **shown, **{k: 1e-6 * BYTES * texels for k, texels in used.items()}})
    return rows


def rough(route: Route, side: int) -> Rows:
    """Rough reflections with 8 and 49 rays per pixel, against as many traced rays and the truth of many.

    Args:
        route: A path through a scene with rough reflectors.
        side: Width and height, pixels.
    Returns:
        One row per method and number of rays.
    """
    taken = shots(route, smooth=False, side=side, samples=TRUTH_RAYS)
    ways = {"clusters": {}, "clusters, cone": {"lobes": "cone"}, "clusters, neighbourhood": {"glossy": "neighbourhood"},
            "clusters, as published": PUBLISHED | {"lobes": "cone", "far": "glossiness"}}  # fmt: skip
    rows = []
    for count in RAYS:
        times: dict[str, float] = {}
        for label, knobs in {"raytrace": None, **ways}.items():
            name, wanted = ("raytrace", {}) if knobs is None else ("clusters", {"repair": "trace", **knobs})
            row = row_of(label, name, wanted | {"samples": count}, taken)
            times[label] = row["ms"]
            rows.append({
                "rays": count, "method": label, "MAE 255, reflective": row["MAE 255, reflective"],
                "disoccluded %": row["disoccluded %"], "ms": row["ms"], "tracing / this": times["raytrace"] / row["ms"],
            })  # fmt: skip
    return rows


def spread(route: Route, frames: int) -> Route:
    """A few frames, evenly spread over a whole path.

    Args:
        route: A path of many frames.
        frames: How many to keep.
    Returns:
        The path with these.
    """
    step = max(len(route.frames) // frames, 1)
    return Route(route.stage, route.frames[::step][:frames])


def plot(rows: Rows, out: Path) -> None:
    """Error and time against clusters and against the depth images' resolution, per scene.

    Args:
        rows: Rows of `sweeps` with a column `scene`.
        out: PNG file to write.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(8.4, 6.0), layout="constrained")
    for column, (knob, x) in enumerate((("capacity", "clusters"), ("resolution", "value"))):
        for scene in dict.fromkeys(row["scene"] for row in rows):
            chosen = [row for row in rows if row["scene"] == scene and row["knob"] == knob]
            for line, y in enumerate(("MAE 255, reflective", "ms")):
                axes[line, column].plot([r[x] for r in chosen], [r[y] for r in chosen], "o-", label=scene, markersize=4)
                axes[line, column].set(xlabel=x if knob == "capacity" else "texels per pixel and side", ylabel=y)
                axes[line, column].set_xscale("log")
    axes[0, 0].legend(fontsize=7)
    figure.savefig(out, dpi=110)
    plt.close(figure)


def bench_clusters(arguments: argparse.Namespace, argv: list[str]) -> None:
    """Make the tables, one file per part.

    Args:
        arguments: `clusters` (scenes), `side`, `frames`, `part`, `quick`, `out`.
        argv: Arguments of the benchmark, for the stamp.
    """
    side, frames = (48, 1) if arguments.quick else (arguments.side, min(arguments.frames, 8))
    command = f"jaxrefl bench --clusters SCENE ... --side {side} --frames {frames} --part "
    tables: dict[str, dict[str, Rows]] = {
        "errors": {"Against ray tracing": []},
        "knobs": {"Knobs": []},
        "times": {"Stages": [], "Output resolution": []},
        "rough": {"Rough reflections": []},
    }
    wanted = set(tables) | {"growth"} if arguments.part == "all" else {arguments.part}

    def add(part: str, title: str, scene: str, rows: Rows) -> None:
        tables[part][title] += [{"scene": scene, **row} for row in rows]
        write(arguments.out, f"clusters_{part}", argv, tables[part], [command + part])

    for name in arguments.clusters if wanted - {"growth"} else ():
        whole = open_path(name, (side, side), 240, 240, texels=2**12 if arguments.quick else 2**16)
        route = spread(whole, frames)
        taken = shots(route, smooth=True, side=side) if wanted - {"growth", "rough"} else []
        if "errors" in wanted:
            picture(taken[0], arguments.out / f"clusters_{Path(name).parent.name or name}.png")
            add(
                "errors",
                "Against ray tracing",
                name,
                against_tracing(taken, QUICK if arguments.quick else tuple(METHODS)),
            )
        if "knobs" in wanted:
            add("knobs", "Knobs", name, sweeps(taken[:1]))
            plot(tables["knobs"]["Knobs"], arguments.out / "clusters_knobs.png")
        if "times" in wanted:
            add("times", "Stages", name, stages(taken))
            add("times", "Output resolution", name, resolutions(route, (side // 4, side // 2, side)))
        if "rough" in wanted and route.stage.scene.features.glossy:
            add("rough", "Rough reflections", name, rough(spread(whole, 1), side // 2))
    if "growth" in wanted:
        counts = (2_000,) if arguments.quick else (40_000, 300_000, 1_000_000)
        growth = {"Deforming meshes": deforming(counts, side), "The rasteriser": rasteriser(counts, side)}
        write(arguments.out, "clusters_growth", argv, growth, [command + "growth"])
