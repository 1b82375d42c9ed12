"""The path tracer beside Mitsuba 3: do they agree, and which is faster? One scene file, both renderers, one run.

Built-in scenes are exported first; scene files are read by both as they are. Differences that are meant are named in
`docs/pages/mitsuba.md`.
"""

import math
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import scenes
from jaxrefl._types import Camera, Scene
from jaxrefl.composite import tone_map
from jaxrefl.core import resize
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import SceneWarning, assemble, export_mitsuba, load
from pipelines.against_mitsuba import Agreement, agreement, render_ours, render_theirs
from pipelines.outputs import png_bytes, write_atomic

BOUNCES = 15
"""Most scattering events of a path: Mitsuba's `max_depth` of 16, which the scene files have."""
BLOCK = 8
"""Side of the blocks whose means are compared, in pixels."""


def bench_mitsuba(
    names: list[str], size: tuple[int, int], samples: int, pictures: Path | None, *, variants: tuple[str, ...]
) -> Iterator[dict]:
    """Agreement and speed, scene by scene.

    Args:
        names: Built-in scenes and scene files.
        size: Largest width and height; the scene's own proportions are kept.
        samples: Samples per pixel of each of the replicates.
        pictures: Folder for the pictures (ours, theirs, scores); None: none.
        variants: Variants of Mitsuba to time; the first one is compared with.
    Yields:
        One row per scene.
    """
    for name in names:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore", SceneWarning)
            file, scene, camera = _scene(name, Path(folder), size)
            ours = render_ours(scene, EmbreeTracer(scene.mesh), camera, samples=samples, bounces=BOUNCES)
            shape = camera.width, camera.height
            theirs = [render_theirs(file, shape, samples=samples, bounces=BOUNCES, variant=v) for v in variants]
        found = agreement(ours.images, theirs[0].images, block=BLOCK)
        label = Path(name).parent.name if Path(name).name == "scene.xml" else Path(name).stem
        if pictures is not None:
            write_atomic(pictures / f"mitsuba_{label}.png", png_bytes(picture(found), {"scene": label}))
        speeds = {f"{v} M paths/s": r.paths_per_second / 1e6 for v, r in zip(variants, theirs, strict=True)}
        yield {
            "scene": label,
            "size": f"{camera.width}x{camera.height}",
            "difference, %": _listed(100 * found.difference),
            "its standard error, %": _listed(100 * found.means_error),
            "scores beyond 3, %": 100 * found.beyond,
            "expected, %": 100 * found.expected,
            "root mean square score": float(np.sqrt(np.nanmean(found.scores**2))),
            "jaxrefl M paths/s": ours.paths_per_second / 1e6,
            **speeds,
        }


def _scene(name: str, folder: Path, size: tuple[int, int]) -> tuple[Path, Scene, Camera]:
    """A scene file for both, the scene in it and its first camera at the size wanted."""
    if name in scenes.BUILT_IN:
        made = assemble(scenes.build(name))
        camera = scenes.BUILT_IN[name].path(1, size=size)[0]
        file = export_mitsuba(made, folder / name, camera=camera)
    elif Path(name).suffix == ".xml":
        file = Path(name)
    else:
        made = load(name)
        camera = resize(made.cameras[0], size) if made.cameras else _framed(made, size)
        file = export_mitsuba(made, folder / Path(name).stem, camera=camera)
    scene = load(file)
    own = scene.cameras[0]
    # Exactly the scene's proportions: where they change, Mitsuba keeps the horizontal field of view, we the vertical.
    unit = math.gcd(own.width, own.height)
    ratio = own.width // unit, own.height // unit
    times = max(1, min(size[0] // ratio[0], size[1] // ratio[1]))
    return file, scene, resize(own, (ratio[0] * times, ratio[1] * times))


def _framed(scene: Scene, size: tuple[int, int]) -> Camera:
    from pipelines.framing import framing_camera

    return framing_camera(scene, EmbreeTracer(scene.mesh), size)


def _listed(values: np.ndarray) -> str:
    return " ".join(f"{value:+.2f}" if value < 0 or values.min() < 0 else f"{value:.2f}" for value in values)


def picture(found: Agreement) -> np.ndarray:
    """Ours, theirs and the scores side by side.

    Args:
        found: A comparison.
    Returns:
        [h 3w 3] sRGB-coded values: scores from -6 (blue) over 0 (black) to 6 (red), the mean of the channels.
    """
    ours, theirs = (np.asarray(tone_map(np.asarray(image, np.float32))) for image in found.images)
    score = np.nan_to_num(found.scores).mean(-1).clip(-6, 6) / 6
    side = ours.shape[0] // score.shape[0]
    enlarged = np.kron(score, np.ones((side, side)))
    canvas = np.zeros_like(ours)
    h, w = (min(a, b) for a, b in zip(canvas.shape, enlarged.shape, strict=False))
    canvas[:h, :w, 0] = np.maximum(enlarged[:h, :w], 0)
    canvas[:h, :w, 2] = np.maximum(-enlarged[:h, :w], 0)
    return np.concatenate([ours, theirs, canvas], 1)
