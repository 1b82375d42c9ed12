"""Glossy layers in scenes: errors of mirror rays with the gloss filter and of gathering, beside ray tracing's.

Errors are those of the layer before Fresnel, over pixels with alpha > 0, against GGX rays with the same light.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from jaxrefl._types import Frame
from jaxrefl.techniques import mirror_gloss as mirrors
from jaxrefl.techniques._tracing import trace_mirrors
from pipelines.bench_gloss_frames import LIGHT, frame_of, glossy_pixels, rays_of, run, with_alpha
from pipelines.bench_gloss_shown import shown_rays
from pipelines.bench_gloss_truth import Truth, errors_of, noise_of

Rows = list[dict[str, Any]]
_PUBLISHED = {
    "lobe": "one",
    "foreshortening": "published",
    "curvature": False,
    "method": "four_pass",
    "radius": 6,
    "spread": False,
    "within": "material",
}
MAIN: dict[str, tuple[str, dict[str, Any]]] = {"mirror_gloss": ("mirror_gloss", {}), "gather": ("gather", {})}
"""What is compared for every alpha."""
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "one Gaussian": ("mirror_gloss", {"lobe": "one"}),
    "own distance only": ("mirror_gloss", {"spread": False}),
    "slant as published": ("mirror_gloss", {"foreshortening": "published"}),
    "one material": ("mirror_gloss", {"within": "material"}),
    "as published": ("mirror_gloss", _PUBLISHED),
    "gather, nearest": ("gather", {"search": 32}),
}
"""What each part of the technique is worth."""
SWEEP: dict[str, tuple[str, dict[str, Any]]] = {
    **{f"window {r}": ("mirror_gloss", {"radius": r}) for r in (2, 4, 6, 8, 12)},
    "two passes 6": ("mirror_gloss", {"method": "separable", "radius": 6}),
    **{f"four passes {r}": ("mirror_gloss", {"method": "four_pass", "radius": r}) for r in (4, 6, 12)},
    **{f"gather {r}": ("gather", {"radius": r}) for r in (2, 6, 12)},
}
"""Radii and numbers of passes."""


def truth_of(frame: Frame, samples: int) -> Truth:
    """Two halves of a truth.

    Args:
        frame: The frame.
        samples: GGX rays per pixel of both together.
    Returns:
        The halves.
    """
    rays_of(frame, 1, 1)  # compiles, so that the halves run once
    return Truth(*(rays_of(frame, samples // 2, key).image for key in (1, 2)))


def equal_error(frame: Frame, truth: Truth, mask: np.ndarray, counts: tuple[int, ...]) -> Callable[[float], float]:
    """How many GGX rays per pixel ray tracing needs for an RMSE.

    Args:
        frame: The frame.
        truth: Its truth.
        mask: Pixels to average over.
        counts: Rays per pixel that are tried.
    Returns:
        RMSE -> rays per pixel, on straight lines through what was tried, logarithmically; below 1: less than one.
    """
    found = [max(errors_of(rays_of(frame, n, 3).image, truth, mask)["RMSE"], 1e-6) for n in counts]
    x, y = np.log(counts), np.log(np.maximum.accumulate(found[::-1])[::-1])

    def rays(rmse: float) -> float:
        goal = np.log(max(rmse, 1e-6))
        last = len(x) - 2
        i = next((i for i in range(len(x) - 1) if y[i + 1] <= goal), last)
        slope = min((y[i + 1] - y[i]) / (x[i + 1] - x[i]), -0.1)
        return float(np.exp(x[i] + (goal - y[i]) / slope))

    return rays


def by_alpha(
    name: str, alphas: tuple[float | None, ...], *, size: tuple[int, int], samples: int, counts: tuple[int, ...]
) -> Iterator[Rows]:
    """Errors and times of the glossy layer, and what ray tracing needs for the same error.

    Args:
        name: Scene.
        alphas: Widths that replace those of all reflectors; None: the scene's own.
        size: (width, height).
        samples: GGX rays per pixel of the truth.
        counts: Rays per pixel with which ray tracing is tried.
    Yields:
        Per alpha one row per method.
    """
    original = frame_of(name, size, None)
    for alpha in alphas:
        frame = with_alpha(original, alpha)
        mask, truth, rows = glossy_pixels(frame), truth_of(frame, samples), []
        rays = equal_error(frame, truth, mask, counts)
        per_ray = rays_of(frame, 4, 4).ms / 4
        smooth = dataclasses.replace(frame, gbuffer=with_alpha(frame, 0.0).gbuffer)
        images = {label: run(frame, technique, {**LIGHT, **knobs}) for label, (technique, knobs) in MAIN.items()}
        images["mirror"] = run(smooth, "raytrace", LIGHT)
        for label, done in images.items():
            found = errors_of(done.image, truth, mask)
            needed = rays(found["RMSE"])
            rows.append(
                {"scene": frame.scene.names.scene, "alpha": "own" if alpha is None else alpha, "method": label,
                 **found, "ms": done.ms, "GGX rays": needed, "ms of GGX rays": needed * per_ray,
                 "error of the truth": noise_of(truth, mask)}
            )  # fmt: skip
        yield rows


def compared(
    name: str, alpha: float | None, methods: dict[str, tuple[str, dict[str, Any]]], *, size: tuple[int, int],
    samples: int,
) -> Rows:  # fmt: skip
    """Errors and times of some methods.

    Args:
        name: Scene.
        alpha: Width of all lobes; None: the scene's own.
        methods: Technique and knobs by label.
        size: (width, height).
        samples: GGX rays per pixel of the truth.
    Returns:
        One row per method.
    """
    frame = frame_of(name, size, alpha)
    mask, truth, rows = glossy_pixels(frame), truth_of(frame, samples), []
    for label, (technique, knobs) in methods.items():
        done = run(frame, technique, {**LIGHT, **knobs})
        rows.append(
            {"scene": frame.scene.names.scene, "pixels": f"{size[0]} x {size[1]}",
             "alpha": "own" if alpha is None else alpha, "method": label, **errors_of(done.image, truth, mask),
             "ms of the filter": done.filter_ms, "ms": done.ms}
        )  # fmt: skip
    return rows


def split(name: str, alpha: float | None, *, size: tuple[int, int], samples: int, radius: int) -> Rows:
    """What of the error is the filter's, and what one mirror ray per pixel cannot know.

    Args:
        name: Scene.
        alpha: Width of all lobes; None: the scene's own.
        size: (width, height); small, for the whole window.
        samples: GGX rays per pixel of the truth, and of those that are looked up in the mirror image.
        radius: Of the whole window.
    Returns:
        Rows: the technique; the same with the plain sum over a whole window; the mean over the rays that are shown.
    """
    frame = frame_of(name, size, alpha)
    mask, truth = glossy_pixels(frame), truth_of(frame, samples)
    sharp = trace_mirrors(frame, options=mirrors.Options(**LIGHT))
    halves = [shown_rays(frame, sharp, jax.random.fold_in(frame.key, 5 + i), samples=samples // 2) for i in range(2)]
    shares = {
        "share of the lobe shown": float((halves[0].share + halves[1].share)[mask].mean() / 2),
        "beyond the picture": float((halves[0].outside + halves[1].outside)[mask].mean() / 2),
    }
    found = {
        "mirror_gloss": errors_of(run(frame, "mirror_gloss", LIGHT).image, truth, mask),
        f"window {radius}, no pyramid": errors_of(
            run(frame, "mirror_gloss", {**LIGHT, "radius": radius, "layers": 1}).image, truth, mask
        ),
        "rays that are shown": errors_of(halves[0].image, truth, mask, again=halves[1].image),
    }
    base = {"scene": frame.scene.names.scene, "alpha": "own" if alpha is None else alpha}
    return [{**base, "method": label, **row, **shares} for label, row in found.items()]
