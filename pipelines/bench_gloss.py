"""The gloss filter: edge profiles against the lobe, evaluations against each other and OpenCV, errors in scenes.

Times are of steady running (a call in which JAX compiled is run again) and of one run, so ratios hold. Errors in scenes
are those of the glossy layer before Fresnel, over pixels with alpha > 0, against many GGX rays with the same light.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Frame, Reflection
from jaxrefl.filters import (
    Footprint,
    GlossOptions,
    GlossParams,
    Guides,
    TableOptions,
    gloss,
    load_table,
    lobe_gaussians,
)
from jaxrefl.filters.lobe import lobe_directions, offsets, profile_of, shares_below
from jaxrefl.metrics import compare
from jaxrefl.surface import look, reflective
from jaxrefl.techniques import TECHNIQUES
from pipelines.job import Job, SceneSource
from pipelines.measure import timed
from pipelines.resolve import resolve
from pipelines.stage import Stage

Rows = list[dict[str, Any]]
PUBLISHED = {
    "lobe": "one",
    "foreshortening": "published",
    "curvature": False,
    "method": "four_pass",
    "radius": 6,
    "spread": False,
    "within": "material",
}
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "mirror_gloss": ("mirror_gloss", {}),
    "radius 2": ("mirror_gloss", {"radius": 2}),
    "radius 6": ("mirror_gloss", {"radius": 6}),
    "two passes": ("mirror_gloss", {"method": "separable", "radius": 6}),
    "four passes": ("mirror_gloss", {"method": "four_pass", "radius": 6}),
    "one Gaussian": ("mirror_gloss", {"lobe": "one"}),
    "own distance only": ("mirror_gloss", {"spread": False}),
    "slant as published": ("mirror_gloss", {"foreshortening": "published"}),
    "one material": ("mirror_gloss", {"within": "material"}),
    "as published": ("mirror_gloss", PUBLISHED),
    "gather": ("gather", {}),
    "gather, nearest": ("gather", {"search": 32}),
}
"""What is compared in scenes, and its knobs."""
RAYS = (1, 4, 16)
"""Samples from which the noise of ray tracing is extrapolated."""


def flat_guides(shape: tuple[int, int], ids: np.ndarray | None = None) -> Guides:
    """Guides of one plane that faces the viewer.

    Args:
        shape: Rows and columns.
        ids: Surfaces; None: one.
    Returns:
        The guides.
    """
    normal = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0], jnp.float32), (*shape, 3))
    found = np.zeros(shape) if ids is None else ids
    return Guides(jnp.asarray(found, jnp.int32), normal, jnp.ones(shape, jnp.float32), jnp.zeros((*shape, 2)))


def _filter(image: np.ndarray, guides: Guides, footprint: Footprint, options: GlossOptions) -> jax.Array:
    ones = jnp.ones(image.shape[:2], jnp.float32)
    return gloss(jnp.asarray(image, jnp.float32), ones, ones, guides, footprint, GlossParams(), options=options)[0]


def _constant(shape: tuple[int, int], weight: Any, mean: Any, covariance: Any) -> Footprint:
    parts = (jnp.asarray(x, jnp.float32) for x in (weight, mean, covariance))
    return Footprint(*(jnp.broadcast_to(x, (*shape, *x.shape)) for x in parts))


def edge_profiles(alphas: tuple[float, ...], taus: tuple[float, ...], *, side: int) -> Rows:
    """A filtered step edge against the frontal lobe's profile.

    Args:
        alphas: Widths of the lobe.
        taus: Relative distances.
        side: Columns of the picture; the blur, 2 alpha tau, is a sixteenth of it wide, and its middle half is compared.
    Returns:
        One row per table, alpha and tau.
    """
    rows, shape = [], (side // 4, side)
    place = np.arange(side) + 0.5 - (side / 2 + side // 100)  # not where pixels of coarse layers meet
    image = np.broadcast_to((place > 0)[None, :, None], (*shape, 3))
    for method in ("two", "one", "moments"):
        table = load_table(options=TableOptions(method))
        for alpha in alphas:
            for tau in taus:
                focal = side / 16 / (2 * alpha * tau)
                scalars = (jnp.float32(1), jnp.float32(alpha), jnp.float32(1))
                directions, weights = lobe_directions(scalars[0], scalars[1], rows=512, columns=256)
                along, _, weights = offsets(directions, weights, scalars[2], surface="plane")
                true = np.asarray(
                    shares_below(profile_of(along, weights), jnp.asarray(place / (focal * tau), jnp.float32))
                )
                lobe = lobe_gaussians(table, scalars[0], scalars[1], jnp.float32(tau))
                a, b = np.asarray(lobe.along) * focal, np.asarray(lobe.across) * focal
                size = _constant(
                    shape, lobe.weight, np.zeros((len(a), 2)), np.stack([a * a, 0 * a, b * b], -1)
                )  # fmt: skip
                found = np.asarray(_filter(image, flat_guides(shape), size, GlossOptions()))[side // 8, :, 0]
                widths = [np.diff(np.interp([0.2, 0.8], p, place))[0] for p in (found, true)]
                rmse = float(np.sqrt(np.mean((found - true)[side // 4 : -side // 4] ** 2)))
                rows.append(
                    {"Gaussians": method, "alpha": alpha, "tau": tau, "RMSE": rmse,
                     "width": float(widths[0] / widths[1] - 1)}
                )  # fmt: skip
    return rows


def evaluations(side: int, radius: int) -> Rows:
    """All evaluations against the plain sum over a whole window, with edges and varying footprints.

    Args:
        side: Of the picture.
        radius: Of the window; the footprint's larger deviation is a third of it.
    Returns:
        One row per evaluation.
    """
    shape = (side, side)
    y, x = np.mgrid[:side, :side] / side
    angle, major = 3 * x + 2 * y, (0.7 + 0.3 * np.sin(5 * x)) * radius / 3
    minor = 0.5 * major
    c, s = np.cos(angle), np.sin(angle)
    covariance = np.stack(
        [(major * c) ** 2 + (minor * s) ** 2, (major**2 - minor**2) * c * s, (major * s) ** 2 + (minor * c) ** 2], -1
    )
    ones = np.ones((*shape, 1))
    size = Footprint(*(jnp.asarray(v, jnp.float32) for v in (ones, np.zeros((*shape, 1, 2)), covariance[..., None, :])))
    guides = flat_guides(shape, (np.hypot(x - 0.5, y - 0.4) < 0.25) + 2 * (x + 0.6 * y > 1.1))
    smooth = (0.5 + 0.5 * np.sin(18 * x) * np.cos(14 * y))[..., None] * np.ones(3)
    images = {"smooth": smooth, "noise": np.random.default_rng(0).random((*shape, 3))}
    exact, rows = GlossOptions("window", radius, 1), []
    truth = {name: timed(lambda image=image: _filter(image, guides, size, exact)) for name, image in images.items()}
    tried = {
        "window, whole": exact,
        "window 4, pyramid": GlossOptions("window", 4),
        "window 6, pyramid": GlossOptions("window", 6),
        "two passes, whole": GlossOptions("separable", radius, 1),
        "four passes, whole": GlossOptions("four_pass", radius, 1),
        "four passes, whole, linear": GlossOptions("four_pass", radius, 1, "linear"),
        "two passes 8, pyramid": GlossOptions("separable", 8),
        "four passes 8, pyramid": GlossOptions("four_pass", 8),
    }
    for name, options in tried.items():
        row: dict[str, Any] = {"evaluation": name, "radius": radius}
        for kind, image in images.items():
            done = timed(lambda image=image, options=options: _filter(image, guides, size, options))
            error = np.asarray(done.value) - np.asarray(truth[kind].value)
            row[f"RMSE, {kind}"] = float(np.sqrt(np.mean(error**2)))
            row["ms per Mpixel"] = 1e3 * done.seconds / side**2 * 1e6
        row["of the whole window's time"] = row["ms per Mpixel"] / (truth["noise"].seconds / side**2 * 1e9)
        rows.append(row)
    return rows


def peers(side: int, radii: tuple[int, ...], *, threads: int = 1) -> Rows:
    """Time per Mpixel against bilateral filters of OpenCV (contrib) and scikit-image at the same footprint.

    Args:
        side: Of the picture.
        radii: Radii; the deviation is radius / 2.5.
        threads: Of OpenCV.
    Returns:
        One row per radius, milliseconds; None: not installed. scikit-image runs on a sixteenth of the pixels.
    """
    shape, rows = (side, side), []
    image = np.random.default_rng(0).random((*shape, 3)).astype(np.float32)
    guides = flat_guides(shape)
    for radius in radii:
        variance = (radius / 2.5) ** 2
        size = _constant(shape, [1.0], [[0.0, 0.0]], [[variance, 0.0, variance]])
        row: dict[str, Any] = {"radius": radius}
        options = {"window 4": GlossOptions(), "four passes": GlossOptions("four_pass", 6)}
        for name, option in options.items():
            row[name] = 1e9 * timed(lambda o=option, s=size: _filter(image, guides, s, o)).seconds / side**2
        row["OpenCV joint bilateral"] = _seconds_of(_opencv(image, radius, threads), side**2)
        row["scikit-image bilateral"] = _seconds_of(_skimage(image[: side // 4, : side // 4], radius), side**2 / 16)
        rows.append(row)
    return rows


def _seconds_of(call: Callable[[], Any] | None, pixels: float) -> float | None:
    if call is None:
        return None
    began = time.perf_counter()
    call()
    return 1e9 * (time.perf_counter() - began) / pixels


def _opencv(image: np.ndarray, radius: int, threads: int) -> Callable[[], Any] | None:
    try:
        import cv2  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    cv2.setNumThreads(threads)
    # Not constant: OpenCV then skips the range weight and blurs. Its range weight here is 1 almost everywhere.
    guide = np.broadcast_to(np.linspace(0, 1, image.shape[1], dtype=np.float32)[None, :, None], image.shape).copy()
    return lambda: cv2.ximgproc.jointBilateralFilter(guide, image, 2 * radius + 1, 10.0, radius / 2.5)


def _skimage(image: np.ndarray, radius: int) -> Callable[[], Any]:
    from skimage.restoration import denoise_bilateral

    window = 2 * radius + 1
    return lambda: denoise_bilateral(image, window, sigma_color=10.0, sigma_spatial=radius / 2.5, channel_axis=-1)


def _frame_of(name: str, size: tuple[int, int], alpha: float | None) -> Frame:
    job = Job(SceneSource(name), techniques=("raytrace",), frames=240, size=size)
    stage = Stage(resolve(job))
    camera = stage.camera(0)
    gbuffer = look(stage.scene, stage.tracer, camera)
    if alpha is not None:
        gbuffer = dataclasses.replace(gbuffer, alpha=jnp.where(reflective(gbuffer), alpha, 0))
    scene = dataclasses.replace(stage.scene, features=dataclasses.replace(stage.scene.features, glossy=True))
    return Frame(scene, camera, gbuffer, stage.key(0, 1), stage.tracer)


def _run(frame: Frame, name: str, knobs: Mapping[str, Any]) -> tuple[Reflection, float, dict[str, float]]:
    technique = TECHNIQUES[name]
    options = technique.Options(**knobs)
    state = technique.init(frame.scene, frame.tracer, options=options)
    done = timed(lambda: technique.step(state, frame, technique.Params(), options=options))
    _, reflection, info = done.value
    return reflection, done.seconds, info.seconds


def in_scenes(
    names: list[str], alphas: tuple[float | None, ...], *, size: tuple[int, int], samples: int
) -> Iterator[Rows]:
    """Errors and times of the glossy layer.

    Args:
        names: Scenes.
        alphas: Widths that replace those of all reflectors; None: the scene's own.
        size: (width, height).
        samples: GGX rays per pixel of the truth.
    Yields:
        Per scene and alpha one row per method; `GGX rays`, `ms of GGX rays`: what ray tracing needs for this RMSE.
    """
    for name in names:
        for alpha in alphas:
            rows = []
            frame = _frame_of(name, size, alpha)
            mask = np.asarray(reflective(frame.gbuffer) & (frame.gbuffer.alpha > 0))
            truth = np.asarray(_run(frame, "raytrace", {"samples": samples, "light": "direct"})[0].radiance)
            shuffled = dataclasses.replace(frame, key=jax.random.fold_in(frame.key, 1))
            noise = []
            for count in RAYS:
                image, seconds, _ = _run(shuffled, "raytrace", {"samples": count})
                error = (np.asarray(image.radiance) - truth)[mask]
                noise.append((count, float(np.mean(error**2)) / (1 / count + 1 / samples), seconds))
            variance, per_ray = noise[-1][1], noise[-1][2] / noise[-1][0]
            floor = variance / samples
            for label, (technique, knobs) in METHODS.items():
                image, seconds, stages = _run(frame, technique, {"area_samples": 8, "environment_samples": 8, **knobs})
                found = compare(np.asarray(image.radiance), truth, mask)
                squared = float(np.mean((np.asarray(image.radiance) - truth)[mask] ** 2))
                error = max(squared - floor, 1e-12)
                rows.append(
                    {"scene": frame.scene.names.scene, "alpha": "own" if alpha is None else alpha, "method": label,
                     "RMSE": error**0.5, "DSSIM": found["dssim"], "ms": 1e3 * seconds,
                     "ms of the filter": 1e3 * (stages.get("gloss", 0) + stages.get("gather", 0)),
                     "GGX rays": variance / error, "ms of GGX rays": 1e3 * per_ray * variance / error}
                )  # fmt: skip
            yield rows


def plot_scenes(rows: Rows, out: Path) -> None:
    """Error against time of all methods, one panel per scene.

    Args:
        rows: From `in_scenes`.
        out: PNG file to write.
    """
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(row["scene"] for row in rows))
    figure, axes = plt.subplots(1, len(names), figsize=(4.6 * len(names), 4), layout="constrained", squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        for label in METHODS:
            chosen = [r for r in rows if r["scene"] == name and r["method"] == label]
            x, y = [r["ms of the filter"] for r in chosen], [r["RMSE"] for r in chosen]
            axis.loglog(x, y, "x" if label.startswith("gather") else "o", label=label, markersize=5)
        axis.set(title=name, xlabel="time of the filter, ms", ylabel="RMSE of the glossy layer")
    axes[0][-1].legend(fontsize=6)
    figure.savefig(out, dpi=110)
    plt.close(figure)


def plot_errors(name: str, out: Path, *, size: tuple[int, int], samples: int) -> None:
    """Truth, filtered and gathered layer, and where they differ, of one scene.

    Args:
        name: Scene.
        out: PNG file to write.
        size: (width, height).
        samples: GGX rays per pixel of the truth.
    """
    import matplotlib.pyplot as plt

    frame = _frame_of(name, size, None)
    images = {"GGX rays": np.asarray(_run(frame, "raytrace", {"samples": samples})[0].radiance)}
    for technique in ("mirror_gloss", "gather"):
        images[technique] = np.asarray(_run(frame, technique, {"area_samples": 8})[0].radiance)
    figure, axes = plt.subplots(2, 3, figsize=(12, 4.8), layout="constrained")
    for axis, (title, image) in zip(axes[0], images.items(), strict=True):
        axis.imshow(np.clip(image, 0, 1) ** (1 / 2.2))
        axis.set_title(title)
    for axis, title in zip(axes[1][1:], ("mirror_gloss", "gather"), strict=True):
        shown = axis.imshow(np.abs(images[title] - images["GGX rays"]).mean(-1), vmax=0.2, cmap="magma")
        axis.set_title(f"{title}: mean absolute difference")
        figure.colorbar(shown, ax=axis)
    for axis in axes.ravel():
        axis.axis("off")
    figure.savefig(out, dpi=80)
    plt.close(figure)
