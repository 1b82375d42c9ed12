"""What the commands do, once their words are understood."""

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from pipelines.flags import BakeFlags, CompareBase, RenderBase, SceneFlags
from pipelines.flags_to_job import job_of, parse, scene_of
from pipelines.toml_tables import JobError

if TYPE_CHECKING:
    from pipelines.run import Result

RENDER_HELP = """Render a scene along a camera path.

Every frame leaves a PNG, a linear EXR, a multi-layer EXR and its figures. A run that is interrupted continues where it
was when the same command is given again.

Examples:
  jaxrefl render cornell --out results/cornell
  jaxrefl render scene.glb --environment sky.hdr --frames 24 --size 960 540 --out results/scene
  jaxrefl render teapot_room --parameters triangles=100000 --raytrace.samples 16 --out results/teapot
  jaxrefl render scene.obj --camera.file transforms.json --out results/path
  jaxrefl render --job job.toml
"""

COMPARE_HELP = """Render a scene with several techniques and measure their errors against a reference.

All techniques share the camera, the G-buffer and the diffuse light of a frame, so that differences are due to
reflections. The report lies in DIR/report.html.

Examples:
  jaxrefl compare cornell --techniques raytrace envmap --out results/cornell
  jaxrefl compare scene.glb --techniques envmap --reference-samples 256 --frames 24 --out results/scene
  jaxrefl compare --job job.toml --scheduler local:4 --out results/job
"""

REFERENCE_HELP = """Path trace every frame of a camera path until it is good enough, with an error estimate per pixel.

A frame stops as soon as one of --spp, --error and --time is reached; without any at 1024 samples per pixel or a
relative error of 1 %. A run that is interrupted continues where it was; asking for more later continues too. Pixels are
sampled at their centres, as techniques sample them, so that `jaxrefl compare --reference DIR` can measure errors pixel
by pixel; --pixel box gives a picture with smooth edges instead.

Examples:
  jaxrefl reference cornell --spp 256 --size 480 270 --out results/reference
  jaxrefl compare cornell --techniques raytrace --size 480 270 --reference results/reference --out results/errors
  jaxrefl reference scene.glb --error 0.005 --time 3600 --out results/scene
"""

BAKE_HELP = """Bake the diffuse light of a static scene, all bounces included, into a light map.

Later runs read it with --light.lightmap FILE as long as the scene and the knobs are the same.

Examples:
  jaxrefl bake cornell --out cornell.npz
  jaxrefl render cornell --light.model baked --light.lightmap cornell.npz
"""

INFO_HELP = """Tell what is in a scene: triangles, materials, lights, cameras, features and what they switch on.

Examples:
  jaxrefl info scene.glb
  jaxrefl info cornell --parameters triangles=100000
"""


def render(argv: Sequence[str]) -> int:
    """`jaxrefl render`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    """
    return _run(RenderBase, argv, "render", RENDER_HELP)


def compare(argv: Sequence[str]) -> int:
    """`jaxrefl compare`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    """
    return _run(CompareBase, argv, "compare", COMPARE_HELP)


def reference(argv: Sequence[str]) -> int:
    """`jaxrefl reference`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    """
    from pipelines.reference import run_reference
    from pipelines.reference_flags import parse_reference

    flags, job, goal = parse_reference(argv, description=REFERENCE_HELP)
    command = shlex.join(["jaxrefl", "reference", *argv])
    out = flags.out or Path("results") / f"{Path(flags.job or job.scene.source).stem}-reference"
    result = run_reference(job, out, goal=goal, keep_state=flags.keep_state, command=command)
    _reference_summary(result)
    return 0


def _reference_summary(result: "Result") -> None:
    from rich.console import Console
    from rich.table import Table

    names = ("relative_error", "standard_error", "seconds", "paths_per_second")
    table = Table("frame", "spp", "relative error", "RMS standard error", "s", "paths/s", box=None, pad_edge=False)
    for row in result.rows:
        table.add_row(str(row["frame"]), str(row["spp"]), *(_mean([row[name]]) for name in names))
    console = Console()
    console.print(table)
    where = f"frames worked on: {result.rendered}; images: {result.folder}/reference"
    console.print(where, markup=False, highlight=False, soft_wrap=True)


def _run(base: type, argv: Sequence[str], name: str, help: str) -> int:
    from pipelines.run import run_job

    flags, job = parse(base, argv, prog=f"jaxrefl {name}", description=help)
    command = shlex.join(["jaxrefl", name, *argv])
    made = job_of(flags, job)
    out = flags.out or Path("results") / Path(flags.job or made.scene.source).stem
    result = run_job(made, out, scheduler=flags.scheduler, command=command)
    _summary(result)
    return 0


def _summary(result: "Result") -> None:
    from rich.console import Console
    from rich.table import Table

    from pipelines.report import write_report

    page = write_report(result.folder)
    table = Table("technique", "mask", "MAE/255", "RMSE", "PSNR dB", "DSSIM", "s per frame", box=None, pad_edge=False)
    for technique, mask in dict.fromkeys((row["technique"], row["mask"]) for row in result.rows):
        rows = [row for row in result.rows if (row["technique"], row["mask"]) == (technique, mask)]
        names = ("mae255", "rmse", "psnr", "dssim", "seconds")
        table.add_row(technique, mask, *(_mean([row[name] for row in rows]) for name in names))
    console = Console()
    console.print(table)
    console.print(f"frames rendered: {result.rendered}; report: {page}", markup=False, highlight=False, soft_wrap=True)


def _mean(values: list[float | None]) -> str:
    known = [v for v in values if v is not None]
    return f"{sum(known) / len(known):.4g}" if known else "-"


def info(argv: Sequence[str]) -> int:
    """`jaxrefl info`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    """
    from jaxrefl.scene import format_inventory, inventory
    from pipelines.job import Job
    from pipelines.resolve import resolve
    from pipelines.stage import load_scene
    from pipelines.switches import format_switches

    flags: Any = tyro.cli(SceneFlags, args=list(argv), prog="jaxrefl info", description=INFO_HELP)
    scene, _ = load_scene(resolve(Job(scene_of(flags, None))).scene)
    print(format_inventory(inventory(scene)))
    print()
    print(format_switches(scene))
    return 0


def export(argv: Sequence[str]) -> int:
    """`jaxrefl export`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    """
    from pipelines.export import main

    return main(list(argv))


def bake(argv: Sequence[str]) -> int:
    """`jaxrefl bake`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    """
    from jaxrefl.radiance import LightMapOptions
    from jaxrefl.rays import EmbreeTracer
    from pipelines.job import Job
    from pipelines.lightmaps import baked, write
    from pipelines.resolve import resolve
    from pipelines.stage import load_scene

    flags: Any = tyro.cli(BakeFlags, args=list(argv), prog="jaxrefl bake", description=BAKE_HELP)
    out = flags.out or Path("results") / f"{Path(flags.scene or 'scene').stem}.lightmap.npz"
    scene, _ = load_scene(resolve(Job(scene_of(flags, None))).scene)
    try:
        options = LightMapOptions(flags.texels, flags.samples, flags.bounces)
    except ValueError as error:
        raise JobError(f"--{error}") from error
    write(baked(scene, EmbreeTracer(scene.mesh), options, lambda text: print(text, file=sys.stderr)), out)
    print(out)
    return 0


def report(argv: Sequence[str]) -> int:
    """`jaxrefl report`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    """
    from pipelines.report import write_report

    help = "Write DIR/report.html from the results in DIR; it opens from disk and needs no network."
    folder: Path = tyro.cli(_Folder, args=list(argv), prog="jaxrefl report", description=help)
    if not folder.is_dir():
        raise JobError(f"{folder}: expected a results folder of `jaxrefl render` or `jaxrefl compare`")
    print(write_report(folder))
    return 0


def _Folder(folder: tyro.conf.Positional[Path]) -> Path:
    """A results folder."""
    return folder


def scenes(argv: Sequence[str]) -> int:
    """`jaxrefl scenes`.

    Args:
        argv: Words after the command.
    Returns:
        Exit code.
    """
    import inspect

    from scenes import BUILT_IN

    tyro.cli(_nothing, args=list(argv), prog="jaxrefl scenes", description="List the built-in scenes.")
    for name, module in BUILT_IN.items():
        parameters = inspect.signature(module.build).parameters.values()
        print(f"{name}: {module.STRESSES}")
        print(f"    --parameters {' '.join(f'{p.name}={p.default}' for p in parameters)}")
    return 0


def _nothing() -> None:
    """No words."""


def bench(argv: Sequence[str]) -> int:
    """`jaxrefl bench`.

    Args:
        argv: Words after the command; the benchmarks read them.
    Returns:
        Exit code.
    """
    from pipelines.bench import main

    return main(list(argv)) or 0
