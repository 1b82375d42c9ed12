"""The gloss filter on flat pictures: edge profiles against the lobe, evaluations against each other and OpenCV.

Times are of steady running (a call in which JAX compiled is run again) and of one run, so ratios hold; those beside
other programs are medians, with all of them run in turn.
"""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

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
from pipelines.measure import timed

Rows = list[dict[str, Any]]


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
        "window 2, pyramid": GlossOptions("window", 2),
        "window 4, pyramid": GlossOptions("window", 4),
        "window 6, pyramid": GlossOptions("window", 6),
        "two passes, whole": GlossOptions("separable", radius, 1),
        "four passes, whole": GlossOptions("four_pass", radius, 1),
        "four passes, whole, linear": GlossOptions("four_pass", radius, 1, "linear"),
        "two passes 6, pyramid": GlossOptions("separable", 6),
        "four passes 4, pyramid": GlossOptions("four_pass", 4),
        "four passes 6, pyramid": GlossOptions("four_pass", 6),
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


def wavy_guides(shape: tuple[int, int]) -> Guides:
    """Guides of a surface whose pixels all agree with their neighbours, but that is no plane.

    Args:
        shape: Rows and columns.
    Returns:
        Waves of 128 pixels with 7 % of the inverse depth.
    """
    phase = np.broadcast_to(2 * np.pi / 128 * np.arange(shape[1]), shape)
    inverse, rise = 1 + 0.07 * np.sin(phase), 0.07 * 2 * np.pi / 128 * np.cos(phase)
    depth, slope = (jnp.asarray(v, jnp.float32) for v in (1 / inverse, np.stack([rise, 0 * rise], -1)))
    return dataclasses.replace(flat_guides(shape), depth=depth, slope=slope)


def peers(side: int, radii: tuple[int, ...], *, threads: int, rounds: int = 5) -> Rows:
    """Time per Mpixel against bilateral filters of OpenCV (contrib) and scikit-image at the same footprint.

    Args:
        side: Of the picture.
        radii: Radii; the deviation is radius / 2.5.
        threads: Of OpenCV; as many as JAX has.
        rounds: How often all are run, one after the other.
    Returns:
        One row per radius, medians in milliseconds; None: not installed. scikit-image runs on a sixteenth of the
        pixels. "Waves": on a surface on which every pair of pixels has to be asked whether it agrees.
    """
    shape, rows = (side, side), []
    image = np.random.default_rng(0).random((*shape, 3)).astype(np.float32)
    flat, waves = flat_guides(shape), wavy_guides(shape)
    options = {
        "window 6": (flat, GlossOptions("window", 6)),
        "window 6, waves": (waves, GlossOptions("window", 6)),
        "window 4": (flat, GlossOptions("window", 4)),
        "four passes 6": (flat, GlossOptions("four_pass", 6)),
        "four passes 4": (flat, GlossOptions("four_pass", 4)),
    }
    for radius in radii:
        variance = (radius / 2.5) ** 2
        size = _constant(shape, [1.0], [[0.0, 0.0]], [[variance, 0.0, variance]])
        calls: dict[str, Callable[[], Any] | None] = {
            name: lambda g=guides, o=option, s=size: _filter(image, g, s, o)
            for name, (guides, option) in options.items()
        }
        calls["OpenCV joint bilateral"] = _opencv(image, radius, threads)
        calls["scikit-image bilateral"] = _skimage(image[: side // 4, : side // 4], radius)
        spent: dict[str, list[float]] = {name: [] for name in calls}
        for number in range(rounds + 1):  # the first compiles
            for name, call in calls.items():
                if call is None:
                    continue
                began = time.perf_counter()
                jax.block_until_ready(call())
                if number:
                    spent[name].append(time.perf_counter() - began)
        row: dict[str, Any] = {"radius": radius}
        for name, seconds in spent.items():
            pixels = side**2 / (16 if name.startswith("scikit") else 1)
            row[name] = 1e9 * float(np.median(seconds)) / pixels if seconds else None
        rows.append(row)
    return rows


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
