"""Tables of the report: `Results` -> mean and worst figures per technique, costs, counts, and what was run.

Everything here is text by the time it leaves, so that the template only lays out.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pipelines.report_results import FIGURES, Results

LABELS = {
    "mae255": "MAE, 0–255",
    "rmse": "RMSE",
    "relmse": "relMSE",
    "psnr": "PSNR, dB",
    "dssim": "DSSIM",
    "seconds": "Seconds per frame",
    "init_seconds": "Precomputation, s",
    "compile_seconds": "Compilation, s",
    "rays": "Rays per frame",
    "peak_mib": "Peak memory, MiB",
    "reflective_share": "Reflective pixels",
}
"""Column names; more is better for `HIGHER_IS_BETTER`, less for the other figures."""

HIGHER_IS_BETTER = frozenset({"psnr"})


@dataclass(frozen=True)
class Cell:
    """One figure of one technique, summarised over the frames."""

    mean: str
    """Mean over the frames where the figure is defined, or a dash."""
    worst: str
    """Worst frame's value."""
    worst_frame: int | None
    """Frame number of the worst value; None if no frame has one."""
    best: bool
    """True if no other technique of the table has a better mean."""
    missing: int
    """Frames without a value."""


@dataclass(frozen=True)
class Summary:
    """Mean and worst of a column over the frames."""

    mean: float
    worst: float
    worst_frame: int | None
    missing: int


def reference_note(results: Results) -> str | None:
    """What errors are measured against, and how noisy that is itself.

    Args:
        results: Checked results.
    Returns:
        Sentences, or None if the reference was rendered with a technique, or there is none.
    """
    rows = results.reference_rows()
    if not rows:
        return None

    def span(name: str, factor: float = 1.0) -> str:
        values = [factor * float(row[name]) for row in rows if row[name] is not None]
        if len(values) < len(rows):
            return "unknown"
        low, high = (f"{value:.3g}" for value in (min(values), max(values)))
        return low if low == high else f"{low} to {high}"

    return (
        f"Errors are measured against the path traced images in {rows[0]['folder']}, {span('spp')} samples per pixel. "
        f"Their own relative error is {span('relative_error', 100)} %, an RMSE of {span('standard_error')} over the "
        "frame: what is smaller than that says nothing."
    )


def figure_table(results: Results, mask: str) -> list[tuple[str, list[Cell]]]:
    """Error figures over one mask.

    Args:
        results: Checked results.
        mask: A name in `report_results.MASKS`.
    Returns:
        (technique, one cell per name in `FIGURES`) in the order of the techniques.
    """
    columns = []
    for name in FIGURES:
        sign = -1 if name in HIGHER_IS_BETTER else 1
        summaries = [summarise(results, technique, mask, name) for technique in results.techniques]
        means = [sign * s.mean for s in summaries if not math.isnan(s.mean)]
        best = min(means) if len(means) > 1 else None
        digits = decimals([s.mean for s in summaries])
        columns.append(
            [
                Cell(
                    mean=text(s.mean, digits),
                    worst=text(s.worst, digits),
                    worst_frame=s.worst_frame,
                    best=best is not None and sign * s.mean == best,
                    missing=s.missing,
                )
                for s in summaries
            ]
        )
    return [(technique, [column[i] for column in columns]) for i, technique in enumerate(results.techniques)]


def summarise(results: Results, technique: str, mask: str, name: str) -> Summary:
    """Mean and worst value of a column over the frames that have one.

    An undefined PSNR of a frame whose pictures are equal counts as infinite (JSON has no infinity).

    Args:
        results: Checked results.
        technique: Name of the technique.
        mask: Name of the mask.
        name: Name of the column.
    Returns:
        The summary; NaN and no frame where no frame has a value.
    """
    rows = results.of(technique, mask)
    values = {}
    for frame, row in rows.items():
        value = row.numbers[name]
        if value is None and name == "psnr" and row.numbers["mae255"] == 0:
            value = math.inf
        if value is not None:
            values[frame] = value
    if not values:
        return Summary(math.nan, math.nan, None, len(rows))
    choose = min if name in HIGHER_IS_BETTER else max
    worst = choose(values, key=lambda frame: values[frame])
    return Summary(sum(values.values()) / len(values), values[worst], worst, len(rows) - len(values))


COSTS = ("seconds", "init_seconds", "compile_seconds", "rays", "peak_mib", "reflective_share")


def cost_table(results: Results) -> list[tuple[str, list[str]]]:
    """Costs per technique, means over the frames; compilation summed, precomputation and memory at their largest.

    Args:
        results: Checked results.
    Returns:
        (technique or "reference", one text per name in `COSTS`).
    """
    combine = {"init_seconds": max, "compile_seconds": sum, "peak_mib": max}
    table: dict[str, dict[str, float]] = {}
    for technique in dict.fromkeys(row.technique for row in results.rows):
        rows = list(results.of(technique, results.masks[0]).values())
        table[technique] = {}
        for name in COSTS:
            values = [v for row in rows if (v := row.numbers[name]) is not None]
            table[technique][name] = combine.get(name, mean)(values) if values else math.nan
    digits = {"init_seconds": 2, "compile_seconds": 2, "rays": 0, "peak_mib": 0}
    digits["seconds"] = decimals([costs["seconds"] for costs in table.values()])

    def shown(name: str, value: float) -> str:
        if name == "reflective_share":
            return "–" if math.isnan(value) else f"{100 * value:.1f} %"
        return text(value, digits[name])

    return [(technique, [shown(name, value) for name, value in costs.items()]) for technique, costs in table.items()]


def count_table(results: Results) -> list[tuple[str, list[tuple[str, str]]]]:
    """The techniques' own counts, means over the frames.

    Args:
        results: Checked results.
    Returns:
        (technique, [(name, text)]) for techniques that report counts; values that are not numbers are left out.
    """
    table = []
    for technique in results.techniques:
        sums: dict[str, list[float]] = {}
        for row in results.of(technique, results.masks[0]).values():
            for name, value in flatten(row.info):
                if isinstance(value, int | float) and not isinstance(value, bool):
                    sums.setdefault(name, []).append(float(value))
        if sums:
            table.append((technique, [(name, text(mean(v), decimals([mean(v)]))) for name, v in sums.items()]))
    return table


def stamp_table(results: Results) -> list[tuple[str, list[tuple[str, str]]]]:
    """What was run: every entry of the rows' stamps, with all values where rows differ.

    Args:
        results: Checked results.
    Returns:
        (group, [(name, text)]): one group per table of the stamp, and first, without a name, what stands alone.
    """
    groups: dict[str, dict[str, dict[str, None]]] = {"": {}}
    for row in results.rows:
        for name, value in flatten(row.stamp):
            group, _, rest = name.rpartition(".")
            groups.setdefault(group, {}).setdefault(rest, {})[str(value)] = None
    return [(group, [(n, "; ".join(v)) for n, v in entries.items()]) for group, entries in groups.items() if entries]


def flatten(table: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Leaves of nested mappings with dotted names.

    Args:
        table: Nested mapping; lists become text.
        prefix: Put before each name.
    Returns:
        (name, leaf) in order; None leaves are left out.
    """
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{prefix}{name}.")
        elif isinstance(value, list):
            yield f"{prefix}{name}", " ".join(str(v) for v in value)
        elif value is not None:
            yield f"{prefix}{name}", value


def mean(values: list[float]) -> float:
    """Arithmetic mean of a list that is not empty."""
    return sum(values) / len(values)


def decimals(values: Iterable[float]) -> int:
    """Decimals that show the smallest value to three significant digits, at most 6.

    Args:
        values: Numbers of one column; zeros, NaN and infinities do not count.
    Returns:
        A number of decimals from 0 to 6.
    """
    sizes = [abs(v) for v in values if v and math.isfinite(v)]
    if not sizes:
        return 0
    return min(6, max(0, 2 - math.floor(math.log10(min(sizes)))))


def text(value: float, digits: int) -> str:
    """A number with a thin space between thousands; a dash for NaN, the sign for infinity.

    Args:
        value: Any float.
        digits: Decimals.
    Returns:
        The text.
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞"
    return f"{value:,.{digits}f}".replace(",", "\u202f")
