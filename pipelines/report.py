"""One self-contained HTML page about a results folder: pictures side by side, error maps, tables, plots, what was run.

    folder --read_results--> Results --tables, plots, embed_pictures--> template --> DIR/report.html

The page needs nothing but a browser: no network, no file beside it; a content security policy in it forbids both.
"""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from pipelines import report_plots as plots
from pipelines import report_tables as tables
from pipelines.outputs import write_atomic
from pipelines.report_images import Pictures, embed_pictures
from pipelines.report_results import FIGURES, MASKS, REFERENCE, Results, read_results

TEMPLATES = Path(__file__).parent / "templates"


def write_report(folder: Path) -> Path:
    """Writes `report.html` into a results folder, in one piece or not at all.

    Args:
        folder: Folder that `jaxrefl render` or `jaxrefl compare` wrote; without a reference the page has no errors.
    Returns:
        Path of the page.
    Raises:
        ValueError: If the folder, its job, its rows or a picture is missing or malformed; names the file.
        OSError: If the page cannot be written.
    Edge cases: the reference is never rendered again, so a folder that was moved or copied reports the same.
    """
    results = read_results(Path(folder))
    page = render_page(results, embed_pictures(results))
    path = results.folder / "report.html"
    write_atomic(path, page.encode())
    return path


def render_page(results: Results, pictures: Pictures) -> str:
    """The page as text.

    Args:
        results: Checked results.
        pictures: Embedded pictures of the same results.
    Returns:
        HTML; all names from outside are escaped.
    """
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    bars, stages = plots.stage_bars(results)
    measured = [mask for mask in results.masks if _measured(results, mask)]
    return environment.get_template("report.html.j2").render(
        results=results,
        pictures=pictures,
        masks=[(mask, MASKS[mask]) for mask in measured],
        figures=[(name, tables.LABELS[name], name in tables.HIGHER_IS_BETTER) for name in FIGURES],
        figure_tables={mask: tables.figure_table(results, mask) for mask in measured},
        trades={mask: plots.trade_plot(results, mask) for mask in measured},
        # Without errors there are still times to plot.
        frame_plots={mask: plots.plots_over_frames(results, mask) for mask in measured or results.masks[:1]},
        against=tables.reference_note(results),
        costs=[tables.LABELS[name] for name in tables.COSTS],
        cost_table=tables.cost_table(results),
        bars=bars,
        stages=stages,
        counts=tables.count_table(results),
        stamp=tables.stamp_table(results),
        plot=plots,
        viewer=_viewer_data(results, pictures, measured),
        style=Markup((TEMPLATES / "report.css").read_text(encoding="utf-8")),
        script=Markup((TEMPLATES / "report.js").read_text(encoding="utf-8")),
    )


def _measured(results: Results, mask: str) -> bool:
    return any(row.mask == mask and row.numbers["mae255"] is not None for row in results.rows)


def _viewer_data(results: Results, pictures: Pictures, masks: list[str]) -> dict[str, Any]:
    """What the script needs: pictures per source and frame, and the figures to show under them."""
    shown = {"mae255": "MAE", "psnr": "PSNR", "dssim": "DSSIM"}

    def caption(technique: str, frame: int, mask: str) -> str:
        row = results.of(technique, mask).get(frame)
        values = [] if row is None else [(label, row.numbers[name]) for name, label in shown.items()]
        return ", ".join(f"{label} {tables.text(v, tables.decimals([v]))}" for label, v in values if v is not None)

    return {
        "frames": pictures.frames,
        "sources": [
            {
                "name": source.name,
                "pictures": source.pictures,
                "errors": source.errors,
                "captions": {m: [caption(source.name, frame, m) for frame in pictures.frames] for m in masks},
            }
            for source in pictures.sources
        ],
        "reference": REFERENCE if results.reference else None,
    }
