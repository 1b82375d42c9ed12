"""Pictures of the gloss filter's benchmark: error against time, and where in a scene the errors are."""

from pathlib import Path
from typing import Any

import numpy as np

from pipelines.bench_gloss_frames import LIGHT, frame_of, glossy_pixels, run
from pipelines.bench_gloss_scenes import truth_of
from pipelines.bench_gloss_truth import displayed

Rows = list[dict[str, Any]]


def plot_alphas(rows: Rows, out: Path) -> None:
    """Error against roughness, and against the time of a whole step, one column per scene.

    Args:
        rows: From `bench_gloss_scenes.by_alpha`, with numbers as alphas only.
        out: PNG file to write.
    """
    import matplotlib.pyplot as plt

    rows = [row for row in rows if row["alpha"] != "own"]
    names, methods = (list(dict.fromkeys(row[key] for row in rows)) for key in ("scene", "method"))
    figure, axes = plt.subplots(2, len(names), figsize=(4.2 * len(names), 6.4), layout="constrained", squeeze=False)
    for column, name in zip(axes.T, names, strict=True):
        for label in methods:
            chosen = [r for r in rows if r["scene"] == name and r["method"] == label]
            column[0].loglog([r["alpha"] for r in chosen], [r["RMSE"] for r in chosen], "o-", label=label)
            if label != "mirror":
                column[1].loglog([r["ms"] for r in chosen], [r["RMSE"] for r in chosen], "o", label=label)
        rays = [r for r in rows if r["scene"] == name and r["method"] == "mirror_gloss"]
        same = [r["ms of GGX rays"] for r in rays]
        column[1].loglog(same, [r["RMSE"] for r in rays], "x", label="GGX rays, same RMSE", color="k")
        column[0].set(title=name, xlabel="alpha", ylabel="RMSE of the glossy layer")
        column[1].set(xlabel="time of a step, ms", ylabel="RMSE of the glossy layer")
        _plain_ticks(*(axis.xaxis for axis in column))
    for axis in axes[:, 0]:
        axis.legend(fontsize=7)
    figure.savefig(out, dpi=80)
    plt.close(figure)


def _plain_ticks(*axes: Any) -> None:
    """Label logarithmic axes by plain numbers at 1, 2 and 5: the usual labels run into each other."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in axes:
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def plot_sweep(rows: Rows, out: Path) -> None:
    """Error against time of the filter alone, one panel per resolution; numbers are radii.

    Args:
        rows: From `bench_gloss_scenes.compared`, labels that end in a radius.
        out: PNG file to write.
    """
    import matplotlib.pyplot as plt

    sizes = list(dict.fromkeys(row["pixels"] for row in rows))
    kinds = list(dict.fromkeys(row["method"].rsplit(" ", 1)[0] for row in rows))
    figure, axes = plt.subplots(1, len(sizes), figsize=(4.2 * len(sizes), 3.6), layout="constrained", squeeze=False)
    for axis, size in zip(axes[0], sizes, strict=True):
        for kind in kinds:
            chosen = [r for r in rows if r["pixels"] == size and r["method"].rsplit(" ", 1)[0] == kind]
            x, y = [r["ms of the filter"] for r in chosen], [r["RMSE"] for r in chosen]
            axis.loglog(x, y, "o-", label=kind)
            for row, a, b in zip(chosen, x, y, strict=True):
                axis.annotate(row["method"].rsplit(" ", 1)[1], (a, b), fontsize=7)
        axis.set(title=f"{size} pixels", xlabel="time of the filter, ms", ylabel="RMSE of the glossy layer")
        _plain_ticks(axis.xaxis)
    axes[0][0].legend(fontsize=7)
    figure.savefig(out, dpi=80)
    plt.close(figure)


def plot_errors(name: str, out: Path, *, alpha: float | None, size: tuple[int, int], samples: int) -> None:
    """Truth, filtered and gathered layer, and where they differ, of one scene.

    Args:
        name: Scene.
        out: PNG file to write.
        alpha: Width of all lobes; None: the scene's own.
        size: (width, height).
        samples: GGX rays per pixel of the truth.
    """
    import matplotlib.pyplot as plt

    frame = frame_of(name, size, alpha)
    mask = glossy_pixels(frame)[..., None]
    images = {"GGX rays": truth_of(frame, samples).mean}
    for technique in ("mirror_gloss", "gather"):
        images[technique] = run(frame, technique, LIGHT).image
    shown = {title: displayed(image) * mask for title, image in images.items()}
    figure, axes = plt.subplots(2, 3, figsize=(12, 5), layout="constrained")
    for axis, (title, image) in zip(axes[0], shown.items(), strict=True):
        axis.imshow(image)
        axis.set_title(title, fontsize=9)
    for axis, title in zip(axes[1][1:], ("mirror_gloss", "gather"), strict=True):
        picture = axis.imshow(np.abs(shown[title] - shown["GGX rays"]).mean(-1), vmax=0.2, cmap="magma")
        axis.set_title(f"{title}: mean absolute difference as shown", fontsize=9)
        figure.colorbar(picture, ax=axis)
    for axis in axes.ravel():
        axis.axis("off")
    figure.savefig(out, dpi=70)
    plt.close(figure)
