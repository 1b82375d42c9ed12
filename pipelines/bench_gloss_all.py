"""`jaxrefl bench --gloss`: all tables and pictures of the gloss filter, kept as they grow."""

from pathlib import Path
from typing import Any

from pipelines.bench_gloss import edge_profiles, evaluations, peers
from pipelines.bench_gloss_pictures import plot_alphas, plot_errors, plot_sweep
from pipelines.bench_gloss_scenes import SWEEP, VARIANTS, by_alpha, compared, split
from pipelines.bench_tables import write

ALPHAS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5)


def run_gloss(names: list[str], out: Path, argv: list[str], *, quick: bool) -> None:
    """Measure everything: flat pictures first, then the sweep in the first scene, then all scenes.

    Args:
        names: Scenes; built-in ones at 960 x 540, files at half of that, for their truth takes long.
        out: Folder to write to.
        argv: Arguments of the benchmark, for the stamp.
        quick: Small cases.
    """
    side, alphas = (64, (0.1,)) if quick else (512, ALPHAS)
    command = "jaxrefl bench --gloss " + " ".join(_short(name) for name in names)
    sections: dict[str, list[dict[str, Any]]] = {}

    def add(title: str, rows: list[dict[str, Any]]) -> None:
        sections[title] = sections.get(title, []) + rows
        write(out, "gloss", [_short(word) for word in argv], sections, [command])

    add("A blurred edge against the GGX lobe (width from 20 % to 80 %, relative error)",
        edge_profiles(alphas, (0.2, 0.5, 0.9), side=side))  # fmt: skip
    add(f"Evaluations against the whole window, {side // 2} x {side // 2} pixels, 3 surfaces, turning footprints",
        evaluations(side // 2, 8 if quick else 32))  # fmt: skip
    add(f"Milliseconds per Mpixel, {side} x {side} pixels, one thread each",
        peers(side, (8,) if quick else (4, 8, 16, 32)))  # fmt: skip
    _scenes(names, add, quick=quick)
    plot_alphas(sections[LAYERS], out / "gloss.png")
    plot_sweep(sections[KNOBS], out / "gloss_sweep.png")
    for name in names:
        plot_errors(name, out / f"gloss_errors_{Path(_short(name)).parts[0]}.png", alpha=None,
                    size=(48, 27) if quick else (480, 270), samples=8 if quick else 64)  # fmt: skip


LAYERS = "Glossy layer, by alpha of all reflectors; the truth's noise is taken off"
KNOBS = "Radius, passes and resolution, alpha 0.1"
PARTS = "What each part is worth"
LIMIT = "What the filter adds and what the mirror image does not show, 240 x 135 pixels"


def _scenes(names: list[str], add: Any, *, quick: bool) -> None:
    small, samples = ((48, 27), 8) if quick else ((240, 135), 128)
    first, sizes = names[0], ((48, 27),) if quick else ((240, 135), (480, 270), (960, 540))
    for size in sizes:
        add(KNOBS, compared(first, 0.1, SWEEP, size=size, samples=samples))
    for name in names:
        for alpha in (None,) if quick else (0.05, 0.1, 0.2, 0.5, None):
            add(LIMIT, split(name, alpha, size=small, samples=samples, radius=8 if quick else 64))
        add(PARTS, compared(name, None, VARIANTS, size=small, samples=samples))
    for name in names:
        large = sizes[-1] if "/" not in name or quick else (480, 270)
        for rows in by_alpha(name, (None,) if quick else (None, *ALPHAS), size=large,
                             samples=samples if quick else 96, counts=(1, 4) if quick else (1, 4, 16)):  # fmt: skip
            add(LAYERS, rows)


def _short(word: str) -> str:
    """Scenes by folder and name: where they lie is of no interest."""
    return "/".join(Path(word).parts[-2:])
