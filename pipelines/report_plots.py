"""Plots of the report as geometry: `Results` -> lines over frames, error against time, bars of stage times.

The template draws them as inline SVG, so that they follow the page's colours in light and dark and the frame that is
shown. All coordinates are in the units of the SVG's view box, `WIDTH` by `HEIGHT`.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from pipelines.report_results import FIGURES, Results
from pipelines.report_tables import HIGHER_IS_BETTER, LABELS, decimals, mean, summarise, text

WIDTH, HEIGHT = 420.0, 230.0
LEFT, RIGHT, TOP, BOTTOM = 58.0, 408.0, 12.0, 198.0
"""The plot's area inside the view box."""

LOG_RATIO = 30.0
"""A positive axis whose largest value is more than this many times the smallest is logarithmic."""


@dataclass(frozen=True)
class Axis:
    """A numeric axis from `low` to `high` with labelled ticks."""

    low: float
    high: float
    log: bool
    ticks: list[tuple[float, str]]
    """(share of the axis in [0, 1], label)."""

    def share(self, value: float) -> float:
        """Where a value lies on the axis: 0 at `low`, 1 at `high`."""
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Mark:
    """A data point."""

    x: float
    y: float
    title: str
    """What a pointer over it reads."""


@dataclass(frozen=True)
class Series:
    """The points of one technique."""

    name: str
    colour: int
    """Index of the technique, which decides colour and dashes everywhere on the page."""
    lines: list[str]
    """SVG point lists, one per unbroken run of frames."""
    marks: list[Mark]


@dataclass(frozen=True)
class Plot:
    """One small diagram."""

    title: str
    note: str
    """"log scale", or empty."""
    x_label: str
    x_ticks: list[tuple[float, str]]
    """(x, label)."""
    y_ticks: list[tuple[float, str]]
    """(y, label)."""
    series: list[Series]
    first: int | None = None
    """Frame at the left end; None: the axis is not frames."""
    last: int | None = None
    """Frame at the right end."""


@dataclass(frozen=True)
class Bar:
    """Mean time of a technique, split into stages."""

    technique: str
    total: str
    """Seconds per frame."""
    width: float
    """Percent of the slowest technique's."""
    parts: list[tuple[str, float, int, str]]
    """(stage, percent of this bar, colour index, seconds)."""


def plots_over_frames(results: Results, mask: str) -> list[Plot]:
    """One plot per figure that has values, and one of the times.

    Args:
        results: Checked results.
        mask: Name of the mask.
    Returns:
        The plots; none for a single frame.
    """
    if len(results.frames) < 2:
        return []
    plots = [_plot_over_frames(results, mask, name) for name in (*FIGURES, "seconds")]
    return [plot for plot in plots if plot is not None]


def trade_plot(results: Results, mask: str) -> Plot | None:
    """Mean error against mean time, one point per technique.

    Args:
        results: Checked results.
        mask: Name of the mask.
    Returns:
        The plot, or None with fewer than two techniques that have both.
    """
    points = []
    for index, technique in enumerate(results.techniques):
        seconds, error = (summarise(results, technique, mask, name).mean for name in ("seconds", "mae255"))
        if seconds > 0 and not math.isnan(error):
            points.append((index, technique, seconds, error))
    if len(points) < 2:
        return None
    x_axis, y_axis = axis([p[2] for p in points], force_log=True), axis([p[3] for p in points])
    series = [
        Series(
            name,
            index,
            [],
            [Mark(_x(x_axis.share(t)), _y(y_axis.share(e)), f"{name}: {text(t, 3)} s, MAE {text(e, 2)}")],
        )
        for index, name, t, e in points
    ]
    return Plot(
        title="Error against time",
        note="log scale" if y_axis.log else "",
        x_label="Seconds per frame, log scale",
        x_ticks=[(_x(share), label) for share, label in x_axis.ticks],
        y_ticks=[(_y(share), label) for share, label in y_axis.ticks],
        series=series,
    )


def stage_bars(results: Results) -> tuple[list[Bar], list[str]]:
    """Where the time of a frame goes, as means over the frames.

    Args:
        results: Checked results.
    Returns:
        One bar per technique that reports stages, one for the stages that all techniques share, and the names of all
        stages in the order of their colours.
    """
    means: dict[str, dict[str, float]] = {}
    for technique in dict.fromkeys(row.technique for row in results.rows):
        rows = list(results.of(technique, results.masks[0]).values())
        stages = _mean_stages([row.stages for row in rows])
        seconds = [s for row in rows if (s := row.numbers["seconds"]) is not None]
        rest = (mean(seconds) if seconds else 0.0) - sum(stages.values())
        # What is left of the frame's time gets a segment of its own once it can be seen.
        if stages and rest > 0.01 * sum(stages.values()):
            stages["not in a stage"] = rest
        if sum(stages.values()) > 0:
            means[technique] = stages
    shared = _mean_stages([row.shared for row in results.rows if row.mask == results.masks[0]])
    if sum(shared.values()) > 0:
        means["shared by all"] = shared
    names = list(dict.fromkeys(name for stages in means.values() for name in stages))
    longest = max((sum(stages.values()) for stages in means.values()), default=1.0)
    bars = []
    for technique, stages in means.items():
        total = sum(stages.values())
        parts = [
            (name, 100 * s / total, names.index(name), f"{text(s, decimals([total]))} s") for name, s in stages.items()
        ]
        bars.append(Bar(technique, f"{text(total, decimals([total]))} s", 100 * total / longest, parts))
    return bars, names


def _mean_stages(tables: list[dict[str, float]]) -> dict[str, float]:
    names = dict.fromkeys(name for table in tables for name in table)
    return {name: mean([table.get(name, 0.0) for table in tables]) for name in names}


def axis(values: Iterable[float], *, force_log: bool = False, from_zero: bool = True) -> Axis:
    """An axis with round ends and at most seven ticks that holds all values.

    Args:
        values: At least one finite number.
        force_log: Logarithmic whenever all values are positive.
        from_zero: A linear axis starts at 0, so that lengths compare, unless a value is negative.
    Returns:
        A linear axis, or a logarithmic one for a wide range.
    """
    values = list(values)
    low, high = min(values), max(values)
    if low > 0 and (force_log or high / low > LOG_RATIO):
        return _log_axis(low, high)
    if from_zero and low > 0:
        low = 0.0
    if low == high:
        low, high = low - 0.5 * abs(low or 1), high + 0.5 * abs(high or 1)
    if high == low:
        high = low + 1
    step = _round_step((high - low) / 4)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    ticks = [((i - first) / (last - first), text(i * step, digits)) for i in range(first, last + 1)]
    return Axis(first * step, last * step, False, ticks)


def _log_axis(low: float, high: float) -> Axis:
    rounds = [
        m * 10.0**e for e in range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 2) for m in (1, 2, 5)
    ]
    bottom = max(r for r in rounds if r <= low * 1.0001)
    top = min(r for r in rounds if r >= high * 0.9999 and r > bottom)
    inside = [r for r in rounds if bottom <= r <= top]
    if len(inside) > 7:
        inside = [r for r in inside if math.isclose(r, 10.0 ** round(math.log10(r)))] or [bottom, top]
    span = math.log(top / bottom)
    ticks = [(math.log(r / bottom) / span, text(r, max(0, -math.floor(math.log10(r) + 1e-9)))) for r in inside]
    return Axis(bottom, top, True, ticks)


def _round_step(step: float) -> float:
    power = 10.0 ** math.floor(math.log10(step))
    return next((m * power for m in (1, 2, 5) if m * power >= step * 0.9999), 10 * power)


def _x(share: float) -> float:
    return round(LEFT + share * (RIGHT - LEFT), 1)


def _y(share: float) -> float:
    return round(BOTTOM - share * (BOTTOM - TOP), 1)


def _plot_over_frames(results: Results, mask: str, name: str) -> Plot | None:
    values = {
        technique: {f: v for f, row in results.of(technique, mask).items() if (v := row.numbers[name]) is not None}
        for technique in results.techniques
    }
    everything = [v for by_frame in values.values() for v in by_frame.values()]
    if not everything:
        return None
    first, last = results.frames[0], results.frames[-1]
    y_axis = axis(everything, from_zero=name not in HIGHER_IS_BETTER)
    digits = decimals([min((abs(v) for v in everything if v), default=1.0)])
    series = []
    for index, technique in enumerate(results.techniques):
        marks, runs, run = [], [], []
        for frame in results.frames:
            if frame not in values[technique]:
                runs, run = [*runs, run], []
                continue
            value = values[technique][frame]
            x, y = _x((frame - first) / (last - first)), _y(y_axis.share(value))
            marks.append(Mark(x, y, f"{technique}, frame {frame}: {text(value, digits)}"))
            run.append(f"{x},{y}")
        lines = [" ".join(points) for points in [*runs, run] if len(points) > 1]
        series.append(Series(technique, index, lines, marks))
    step = max(1, math.ceil(_round_step((last - first) / 6)))
    labelled = [f for f in range(first, last + 1) if (f - first) % step == 0]
    return Plot(
        title=LABELS[name],
        note="log scale" if y_axis.log else "",
        x_label="Frame",
        x_ticks=[(_x((f - first) / (last - first)), str(f)) for f in labelled],
        y_ticks=[(_y(share), label) for share, label in y_axis.ticks],
        series=series,
        first=first,
        last=last,
    )
