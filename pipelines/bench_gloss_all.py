"""`jaxrefl bench --gloss`: all tables and pictures of the gloss filter, kept as they grow."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipelines.bench_gloss import edge_profiles, evaluations, peers
from pipelines.bench_gloss_pictures import plot_alphas, plot_errors, plot_sweep
from pipelines.bench_gloss_scenes import MAIN, SWEEP, VARIANTS, by_alpha, compared, split
from pipelines.bench_tables import write
from pipelines.stamp import hardware

Sections = dict[str, list[dict[str, Any]]]
Add = Callable[[str, list[dict[str, Any]]], None]
ALPHAS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5)


def run_gloss(names: list[str], out: Path, argv: list[str], part: str, *, quick: bool) -> None:
    """Measure the gloss filter.

    Args:
        names: Scenes; built-in ones at 960 x 540, files at half of that, for their truth takes long, and at full size
            with fewer rays and alphas.
        out: Folder to write to: one page, one file with all numbers and some pictures per part.
        argv: Arguments of the benchmark, for the stamp.
        part: `flat` pictures, `knobs` in the first scene, `errors` in built-in ones, `interiors`: those of files; or
            `all`.
        quick: Small cases.
    """
    command = "jaxrefl bench --gloss " + " ".join(_short(name) for name in names)
    command += f" --part {part}" * (part != "all")
    for name, measure in (("flat", _flat), ("knobs", _knobs), ("errors", _errors), ("interiors", _interiors)):
        if part not in (name, "all"):
            continue
        sections: Sections = {}

        def add(title: str, rows: list[dict[str, Any]], name: str = name, sections: Sections = sections) -> None:
            sections[title] = sections.get(title, []) + rows
            write(out, f"gloss_{name}", [_short(word) for word in argv], sections, [command])

        measure(names, sections, add, out, quick)


LAYERS = "Glossy layer, by alpha of all reflectors; the truth's noise is taken off"
KNOBS = "Radius, passes and resolution, alpha 0.1"
PARTS = "What each part is worth, alpha 0.1"
LARGE = "Interiors at 960 x 540 pixels, truth of 32 rays per pixel"
HALVES = "Interiors at 480 x 270 pixels by alpha of all reflectors, truth of 48 rays per pixel"
LIMIT = "What the filter adds and what the mirror image does not show, 240 x 135 pixels"


SMALL, HALF, WHOLE = (48, 27), (480, 270), (960, 540)


def _flat(names: list[str], sections: Sections, add: Add, out: Path, quick: bool) -> None:
    side, alphas = (64, (0.1,)) if quick else (512, ALPHAS)
    add("A blurred edge against the GGX lobe (width from 20 % to 80 %, relative error)",
        edge_profiles(alphas, (0.2, 0.5, 0.9), side=side))  # fmt: skip
    add(f"Evaluations against the whole window, {side // 2} x {side // 2} pixels, 3 surfaces, turning footprints",
        evaluations(side // 2, 8 if quick else 32))  # fmt: skip
    cores = int(hardware()["cores"])
    add(f"Milliseconds per Mpixel, {side} x {side} pixels, median of 5 runs, {cores} core{'s' * (cores > 1)}",
        peers(side, (8,) if quick else (4, 8, 16, 32), threads=cores))  # fmt: skip


def _errors(names: list[str], sections: Sections, add: Add, out: Path, quick: bool) -> None:
    samples, counts = (8, (1, 4)) if quick else (96, (1, 4, 16))
    for name in (n for n in names if "/" not in n):
        for rows in by_alpha(
            name, (0.1,) if quick else (None, *ALPHAS), size=SMALL if quick else WHOLE, samples=samples, counts=counts
        ):
            add(LAYERS, rows)
        plot_alphas(sections[LAYERS], out / "gloss.png")
        _causes(name, add, out, samples, quick)


def _interiors(names: list[str], sections: Sections, add: Add, out: Path, quick: bool) -> None:
    samples, counts = (8, (1, 4)) if quick else (48, (1, 4))
    half, whole = (SMALL, SMALL) if quick else (HALF, WHOLE)
    for name in (n for n in names if "/" in n):
        for rows in by_alpha(name, (None, 0.1), size=whole, samples=samples * 2 // 3, counts=counts):
            add(LARGE, rows)
        for rows in by_alpha(name, (0.1,) if quick else (None, *ALPHAS), size=half, samples=samples, counts=counts):
            add(HALVES, rows)
        plot_alphas(sections[HALVES], out / "gloss_interiors.png")
        _causes(name, add, out, samples, quick)


def _causes(name: str, add: Add, out: Path, samples: int, quick: bool) -> None:
    small, half = (SMALL, SMALL) if quick else ((240, 135), HALF)
    picture = out / f"gloss_errors_{Path(_short(name)).parts[0]}.png"
    plot_errors(name, picture, alpha=None, size=half, samples=samples)
    for alpha in (None,) if quick else (0.05, 0.2, None):
        add(LIMIT, split(name, alpha, size=small, samples=samples, radius=8 if quick else 64))


def _knobs(names: list[str], sections: Sections, add: Add, out: Path, quick: bool) -> None:
    half, samples = (SMALL, 8) if quick else (HALF, 96)
    add(PARTS, compared(names[0], 0.1, {**MAIN, **VARIANTS}, size=half, samples=samples))
    add(KNOBS, compared(names[0], 0.1, SWEEP, size=half, samples=samples))
    few = {label: SWEEP[label] for label in ("window 6", "four passes 6", "gather 6")}
    for size in () if quick else ((240, 135), WHOLE):
        add(KNOBS, compared(names[0], 0.1, few, size=size, samples=samples))
    plot_sweep(sections[KNOBS], out / "gloss_sweep.png")


def _short(word: str) -> str:
    """Scenes by folder and name: where they lie is of no interest."""
    return "/".join(Path(word).parts[-2:])
