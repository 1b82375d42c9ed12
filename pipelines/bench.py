"""Benchmarks: what the library costs on top of the bare ray cast, how it grows, what memory and start-up it takes.

`jaxrefl bench` prints the tables and writes them, with the commands and the hardware beside them, to
`docs/pages/figures/`. Times are medians of interleaved runs after compilation; ratios are of one run.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

import scenes
from jaxrefl.core import resize
from jaxrefl.rays import EmbreeTracer, camera_rays
from jaxrefl.scene import assemble
from jaxrefl.surface import look
from pipelines.bench_clusters import bench_clusters
from pipelines.bench_energy import bench_energy
from pipelines.bench_gloss_all import run_gloss
from pipelines.bench_lightmap import bench_lightmap
from pipelines.bench_main_job import run_main_job
from pipelines.bench_mitsuba import BOUNCES, bench_mitsuba
from pipelines.bench_path import bench_path
from pipelines.bench_stability import bench_stability
from pipelines.bench_tables import write
from pipelines.bench_temporal import (
    INNER,
    PLAIN,
    Route,
    compare_errors,
    compare_times,
    open_path,
    plot_sweep,
    reuse_growth,
    stage_costs,
    sweep,
)

FIGURES = Path(__file__).parent.parent / "docs" / "pages" / "figures"
SCENE = "mirror_room"
SIDES = (256, 512, 1024)
TRIANGLES = (10_000, 100_000, 1_000_000)
SPP = (4, 8, 16, 32, 64, 128, 256)
"""Samples per pixel of `jaxrefl bench --path`."""
FIRST_FRAME = ["render", "cornell", "--technique", "raytrace", "--frames", "1", "--size", "960", "540"]


def interleaved(runs: int, *functions: Callable[[], object]) -> list[float]:
    """Median seconds of each function, run in turn so that all see the same machine.

    Args:
        runs: Counted runs of each, after one that is not counted.
        functions: What to time; results are waited for.
    Returns:
        One median per function.
    """
    times: list[list[float]] = [[] for _ in functions]
    for run in range(runs + 1):
        for seconds, function in zip(times, functions, strict=True):
            began = time.perf_counter()
            jax.block_until_ready(function())
            if run > 0:
                seconds.append(time.perf_counter() - began)
    return [statistics.median(seconds) for seconds in times]


def bench_rays(sides: tuple[int, ...], triangles: tuple[int, ...], runs: int) -> list[dict]:
    """embreex alone against rays + surface: camera to finished G-buffer.

    Args:
        sides: Image sides in pixels.
        triangles: Tessellations of the scene.
        runs: Counted runs.
    Returns:
        One row per scene size and image size.
    """
    rows = []
    for target in triangles:
        scene = assemble(scenes.build(SCENE, triangles=target))
        began = time.perf_counter()
        tracer = EmbreeTracer(scene.mesh)
        build_seconds = time.perf_counter() - began
        for side in sides:
            camera = resize(scenes.BUILT_IN[SCENE].path(1, size=(side, side))[0], (side, side))
            rays = camera_rays(camera)
            origin = np.ascontiguousarray(rays.origin).reshape(-1, 3)
            direction = np.ascontiguousarray(rays.direction).reshape(-1, 3)

            def bare(origin=origin, direction=direction, tracer=tracer):
                return tracer.cast(origin, direction)

            def whole(scene=scene, tracer=tracer, camera=camera):
                return look(scene, tracer, camera)

            began = time.perf_counter()
            jax.block_until_ready(whole())
            first = time.perf_counter() - began
            bare_seconds, whole_seconds = interleaved(runs, bare, whole)
            rows.append(
                {
                    "triangles": int(scene.mesh.faces.shape[0]),
                    "side": side,
                    "bare_ms": 1e3 * bare_seconds,
                    "whole_ms": 1e3 * whole_seconds,
                    "ratio": whole_seconds / bare_seconds,
                    "bare_mrays": side * side / bare_seconds / 1e6,
                    "whole_mrays": side * side / whole_seconds / 1e6,
                    "first_s": first,
                    "build_s": build_seconds,
                }
            )
    return rows


def growth(rows: list[dict], axis: str) -> list[dict]:
    """Exponent of time against pixels or triangles: 1 is linear, 0 constant.

    Args:
        rows: From `bench_rays`.
        axis: "side" (pixels) or "triangles".
    Returns:
        One row per value of the other axis, with the exponent between its smallest and largest case, and how much
            longer the largest takes.
    """
    other = "triangles" if axis == "side" else "side"
    found = []
    for value in sorted({row[other] for row in rows}):
        chosen = sorted((row for row in rows if row[other] == value), key=lambda row: row[axis])
        sizes = [row[axis] ** (2 if axis == "side" else 1) for row in chosen]
        if len(chosen) < 2:
            continue
        span = np.log(sizes[-1] / sizes[0])
        found.append(
            {
                other: value,
                "from": sizes[0],
                "to": sizes[-1],
                "bare_exponent": float(np.log(chosen[-1]["bare_ms"] / chosen[0]["bare_ms"]) / span),
                "whole_exponent": float(np.log(chosen[-1]["whole_ms"] / chosen[0]["whole_ms"]) / span),
                "whole_times": chosen[-1]["whole_ms"] / chosen[0]["whole_ms"],
            }
        )
    return found


def bench_memory(triangles: int, size: tuple[int, int]) -> dict:
    """Peak memory of a process of its own that renders one frame.

    Args:
        triangles: Tessellation of the scene.
        size: (width, height).
    Returns:
        The figure and the command.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = ["render", SCENE, "--parameters", f"triangles={triangles}", "--technique", "raytrace"]
        command += ["--frames", "1", "--size", str(size[0]), str(size[1]), "--out", f"{folder}/out"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        _run(command)
        peak = max(before, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / 1024
    return {"triangles": triangles, "size": f"{size[0]}x{size[1]}", "peak_mib": peak}


def bench_first_frame(runs: int) -> dict:
    """Seconds from starting a process to its finished frame on disk, without and with the compilation cache.

    Args:
        runs: Runs of each; the median is taken.
    Returns:
        Cold and warm seconds.
    """
    with tempfile.TemporaryDirectory() as folder:

        def once(number: int, extra: list[str]) -> float:
            began = time.time()
            _run([*FIRST_FRAME, "--out", f"{folder}/{number}", *extra])
            return Path(f"{folder}/{number}/raytrace/frame_0000.json").stat().st_mtime - began

        cache = ["--cache", f"{folder}/cache"]
        cold = [once(i, []) for i in range(runs)]
        once(100, cache)
        warm = [once(200 + i, cache) for i in range(runs)]
    return {
        "command": " ".join(["jaxrefl", *FIRST_FRAME]),
        "cold_s": statistics.median(cold),
        "warm_s": statistics.median(warm),
    }


def _run(arguments: list[str]) -> None:
    subprocess.run([sys.executable, "-m", "pipelines.cli", *arguments], check=True, stdout=subprocess.DEVNULL)


def main(argv: list[str]) -> int:
    """Run the benchmarks.

    Args:
        argv: Arguments after `jaxrefl bench`.
    Returns:
        Exit code 0.
    """
    parser = argparse.ArgumentParser(prog="jaxrefl bench", description=__doc__)
    parser.add_argument("--runs", type=int, default=9, help="counted runs of each case")
    parser.add_argument("--quick", action="store_true", help="small cases, to see that it works")
    parser.add_argument("--out", type=Path, default=FIGURES, help="folder for bench.json and bench.md")
    parser.add_argument("--main-job", type=Path, help="instead: run the main job on real scenes into this folder")
    parser.add_argument("--path", action="store_true", help="instead: how the path tracer's error falls with samples")
    parser.add_argument("--stability", action="store_true", help="instead: a scene scaled and moved, path traced")
    parser.add_argument("--mitsuba", nargs="+", metavar="SCENE", help="instead: agreement with Mitsuba 3, and speed")
    parser.add_argument("--lightmap", nargs="+", metavar="SCENE", help="instead: errors of light maps in these scenes")
    parser.add_argument("--temporal", nargs="+", metavar="SCENE", help="instead: reprojection along camera paths")
    parser.add_argument("--gloss", nargs="+", metavar="SCENE", help="instead: the gloss filter, and errors in scenes")
    parser.add_argument("--clusters", nargs="+", metavar="SCENE", help="instead: clusters of mirror rays")
    parts = ("errors", "times", "knobs", "growth", "flat", "rough", "interiors", "all")
    help_part = (
        "which tables (--temporal: the first four; --clusters: and rough; --gloss: flat, errors, knobs, interiors)"
    )
    parser.add_argument("--part", default="all", choices=parts, help=help_part)
    parser.add_argument("--side", type=int, default=1024, help="width and height of images (--temporal, --clusters)")
    parser.add_argument("--frames", type=int, default=240, help="frames of each path (--temporal, --clusters)")
    parser.add_argument("--loop", type=int, default=240, help="frames of a whole loop: motion per frame (--temporal)")
    arguments = parser.parse_args(argv)
    for name, run in _OTHERS.items():
        if getattr(arguments, name):
            run(arguments, argv)
            return 0
    _speed(arguments, argv)
    return 0


def _speed(arguments: argparse.Namespace, argv: list[str]) -> None:
    sides, triangles = ((64, 128), (1_000, 10_000)) if arguments.quick else (SIDES, TRIANGLES)

    # Memory first: the peak of a child counts from the largest child there has been.
    size = (192, 108) if arguments.quick else (1920, 1080)
    memory = bench_memory(10_000 if arguments.quick else 300_000, size)
    start = bench_first_frame(1 if arguments.quick else 3)
    rays = bench_rays(sides, triangles, arguments.runs)
    sections = {
        f"embreex alone (`bare`) and rays + surface (`whole`), `{SCENE}`": rays,
        "Growth with pixels (exponent 1 is linear)": growth(rays, "side"),
        "Growth with triangles (exponent 0 is constant)": growth(rays, "triangles"),
        "Peak memory of a process that renders one frame": [memory],
        "Time from starting the process to the first frame on disk": [start],
    }
    write(arguments.out, "bench", argv, sections, ["jaxrefl bench"])
    energy = bench_energy((96, 54), 4) if arguments.quick else bench_energy((960, 540), 32)
    write(arguments.out, "energy", argv, {"The furnace: every mean should be 1": energy}, ["jaxrefl bench"])


def _main_job(arguments: argparse.Namespace, argv: list[str]) -> None:
    rows, commands = run_main_job(arguments.main_job)
    write(arguments.out, "main_job", argv, {"Means over 24 frames": rows}, commands)


def _path(arguments: argparse.Namespace, argv: list[str]) -> None:
    size, spp, long, names = ((16, 9), (4, 8), 64, ("cornell",)) if arguments.quick else ((32, 18), SPP, 4096, None)
    rows = bench_path(size, spp, long, names=names)
    title = f"Slope of log RMSE against log samples, {size[0]} x {size[1]} pixels, reference of {long} samples"
    write(arguments.out, "path_convergence", argv, {title: rows}, ["jaxrefl bench --path"])


def _stability(arguments: argparse.Namespace, argv: list[str]) -> None:
    size, samples = ((16, 16), 2) if arguments.quick else ((128, 128), 64)
    rows = bench_stability("cornell", size, samples)
    title = f"`cornell`, {size[0]} x {size[1]} pixels, {samples} samples: difference from the scene as it is"
    write(arguments.out, "path_stability", argv, {title: rows}, ["jaxrefl bench --stability"])


def _lightmap(arguments: argparse.Namespace, argv: list[str]) -> None:
    size, samples = ((32, 18), 16) if arguments.quick else ((160, 90), 512)
    tries = ((1024, 8),) if arguments.quick else ((2**14, 32), (2**16, 32), (2**18, 16))
    title, rows = f"Baked against {samples} paths per pixel at {size[0]} x {size[1]}", []
    for row in bench_lightmap(arguments.lightmap, size, samples, tries):  # kept as it grows: it takes long
        rows.append(row)
        write(arguments.out, "lightmap", argv, {title: rows}, ["jaxrefl bench --lightmap SCENE ..."])


def _mitsuba(arguments: argparse.Namespace, argv: list[str]) -> None:
    size, samples = ((32, 24), 2) if arguments.quick else ((256, 256), 16)
    pictures = None if arguments.quick else arguments.out
    variants = ("scalar_rgb",) if arguments.quick else ("scalar_rgb", "llvm_ad_rgb")
    title = f"Up to {size[0]} x {size[1]} pixels, 8 replicates of {samples} samples, up to {BOUNCES} bounces"
    rows = []
    for row in bench_mitsuba(arguments.mitsuba, size, samples, pictures, variants=variants):
        rows.append(row)  # kept as they grow: it takes long
        write(arguments.out, "mitsuba", argv, {title: rows}, ["jaxrefl bench --mitsuba SCENE ..."])


def _temporal(arguments: argparse.Namespace, argv: list[str]) -> None:
    side, frames, loop = (64, 4, arguments.loop) if arguments.quick else (
        arguments.side, arguments.frames, arguments.loop)  # fmt: skip
    texels = 4096 if arguments.quick else 2**15 * (side // 512 + 1)
    command = f"jaxrefl bench --temporal SCENE ... --side {side} --frames {frames} --loop {loop} --part "
    stages_title = "Milliseconds per stage, frames that are no key frames"

    def keep(part: str, sections: dict[str, list[dict]]) -> None:
        write(arguments.out, f"temporal_{part}", argv, sections, [command + part])

    def route(name: str) -> Route:
        return open_path(name, (side, side), frames, loop, texels=texels)

    def errors() -> None:
        title = f"{frames} frames of a loop of {loop}, {side} x {side} pixels, light from a map"
        sections: dict[str, list[dict]] = {title: [], stages_title: []}
        for name in arguments.temporal:
            rows, stages = compare_errors(route(name))
            sections[title] += rows
            sections[stages_title] += stages
            keep("errors", sections)  # kept as it grows: it takes long

    def times() -> None:
        title = f"Time against ray tracing, {side} x {side} pixels"
        sections: dict[str, list[dict]] = {title: [], stages_title: []}
        for name in arguments.temporal:
            for light, variants in (("direct", PLAIN), ("path", INNER)):
                rows, stages = compare_times(route(name), light, variants, every=max(frames // 3, 1))
                sections[title] += rows
                sections[stages_title] += stages
                keep("times", sections)

    def knobs() -> None:
        rows = sweep(route(arguments.temporal[0]))
        plot_sweep(rows, arguments.out / "temporal_knobs.png")
        keep("knobs", {f"Knobs, one at a time; {frames} frames, {side} x {side} pixels": rows})

    def growth() -> None:
        sides, triangles = ((64,), (1000,)) if arguments.quick else ((side // 4, side // 2, side), TRIANGLES)
        keep("growth", {
            "Milliseconds of all stages but tracing, by triangles and pixels": reuse_growth(sides, triangles),
            f"Stages beside their gathers, scatters and rays alone, {side} x {side} pixels": stage_costs(side),
        })  # fmt: skip

    for part in (errors, times, knobs, growth):
        if arguments.part in (part.__name__, "all"):
            part()


def _gloss(arguments: argparse.Namespace, argv: list[str]) -> None:
    run_gloss(arguments.gloss, arguments.out, argv, arguments.part, quick=arguments.quick)


_OTHERS = {
    "clusters": bench_clusters,
    "gloss": _gloss,
    "main_job": _main_job,
    "path": _path,
    "stability": _stability,
    "lightmap": _lightmap,
    "mitsuba": _mitsuba,
    "temporal": _temporal,
}
"""Benchmarks that a flag asks for, in place of those of speed."""
