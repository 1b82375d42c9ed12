"""The main job on real scenes: three files, 24 frames at 960x540, two techniques against a reference.

The scene files are not part of the project; the environment variable `JAXREFL_SCENES` names the folder that holds
them. Runs that are complete are only read, so the tables can be made again without rendering.
"""

import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

JOBS: dict[str, tuple[str, ...]] = {
    "CornellBox-Mirror": ("cornell-obj/CornellBox-Mirror.obj", "--reference-samples", "64"),
    "MetalRoughSpheres": (
        "gltf-MetalRoughSpheresNoTextures/MetalRoughSpheresNoTextures.glb",
        *("--reference-samples", "16"),
    ),
    "ToyCar": (
        "gltf-ToyCar/ToyCar.gltf",
        *("--environment", "hdri/venice_sunset_1k.hdr", "--reference-samples", "16"),
    ),
}
"""Scene file below `JAXREFL_SCENES` and the flags of each run."""

COMMON = ("--techniques", "raytrace", "envmap", "--reference", "raytrace", "--frames", "24", "--size", "960", "540")
FIGURES = ("mae255", "rmse", "psnr", "dssim", "seconds")


def run_main_job(out: Path) -> tuple[list[dict], list[str]]:
    """Render what is missing and read the figures.

    Args:
        out: Folder of the results, one folder per scene in it.
    Returns:
        One row per scene, technique and mask, means over the frames; and the commands.
    Raises:
        ValueError: If `JAXREFL_SCENES` does not name a folder with the scenes.
    """
    folder = Path(os.environ.get("JAXREFL_SCENES", ""))
    rows, commands = [], []
    for name, (scene, *flags) in JOBS.items():
        if not (folder / scene).is_file():
            raise ValueError(f"JAXREFL_SCENES: expected a folder with {scene}, got {str(folder)!r}")
        commands.append(" ".join(["jaxrefl compare", f"$JAXREFL_SCENES/{scene}", *flags, *COMMON, "--out", name]))
        inside = [str(folder / flag) if flag.startswith("hdri/") else flag for flag in flags]
        command = [sys.executable, "-m", "pipelines.cli", "compare", str(folder / scene), *inside, *COMMON]
        subprocess.run([*command, "--out", str(out / name)], check=True)
        rows += _means(name, json.loads((out / name / "metrics.json").read_text()))
    return rows, commands


def _means(name: str, frames: list[dict]) -> list[dict]:
    """Means over the frames, per technique and mask."""
    groups: dict[tuple[str, str], list[dict]] = {}
    for row in frames:
        groups.setdefault((row["technique"], row["mask"]), []).append(row)
    found = []
    for (technique, mask), group in groups.items():
        row = {"scene": name, "technique": technique, "mask": mask, "frames": len(group)}
        for figure in FIGURES:
            values = [r[figure] for r in group if r[figure] is not None]
            row[figure] = statistics.fmean(values) if values else "-"
        row["rays"] = round(statistics.fmean(r["rays"] for r in group))
        row["peak_mib"] = float(max(r["peak_mib"] for r in group))
        found.append(row)
    return found
