"""Reads a results folder and checks it: the first stage of the report, folder -> `Results`.

What the runner wrote is read as any other file from outside: everything that is missing or malformed is an error that
names the file and the row. Figures that are null (no reference, no reflective pixel) stay None.
"""

import json
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxrefl.metrics import FIGURES

REFERENCE = "reference"
"""Name of the subfolder with the reference's frames."""

MASKS = {"reflective": "Reflective pixels", "frame": "Whole frame"}
"""Masks of the rows and what the report calls them, the one that matters first."""

NUMBERS = (*FIGURES, "seconds", "init_seconds", "compile_seconds", "rays", "peak_mib", "reflective_share")
"""Columns of a row that hold a number or null."""


REFERENCE_FIGURES = ("spp", "relative_error", "standard_error")
"""What a row of `jaxrefl reference` says about how noisy its image is."""


@dataclass(frozen=True)
class Row:
    """Figures and costs of one frame of one technique over one mask."""

    technique: str
    frame: int
    mask: str
    numbers: dict[str, float | None]
    """One value per name in `NUMBERS`; None where it is not defined or was not measured."""
    stages: dict[str, float]
    """Seconds per stage of the technique."""
    shared: dict[str, float]
    """Seconds per stage that all techniques share, such as the surface and diffuse light."""
    info: dict[str, Any]
    """The technique's own counts."""
    stamp: dict[str, Any]
    """Versions, seed, command, hardware."""


@dataclass(frozen=True)
class Results:
    """A results folder, checked."""

    folder: Path
    scene: str
    job: dict[str, Any]
    """The resolved job."""
    job_text: str
    """The job file as it stands."""
    rows: tuple[Row, ...]
    techniques: tuple[str, ...]
    """In the order in which they first appear, the reference left out."""
    frames: tuple[int, ...]
    """Frame numbers, ascending."""
    masks: tuple[str, ...]
    """Masks that the rows use, in the order of `MASKS`."""
    reference: bool
    """True if the folder holds frames of a reference."""

    def of(self, technique: str, mask: str) -> dict[int, Row]:
        """Rows of one technique over one mask, by frame."""
        return {row.frame: row for row in self.rows if row.technique == technique and row.mask == mask}

    def reference_rows(self) -> list[dict[str, Any]]:
        """Rows of a reference that `jaxrefl reference` made, by frame; empty for one that a technique rendered."""
        rows = []
        for path in sorted((self.folder / REFERENCE).glob("frame_????.json")):
            try:
                entry = json.loads(_text(path))[0]
                if "folder" in entry:
                    rows.append({"folder": str(entry["folder"]), **{n: entry[n] for n in REFERENCE_FIGURES}})
            except (ValueError, TypeError, LookupError) as error:
                raise ValueError(f"{path}: expected the row of a reference: {error}") from error
        return rows

    def picture(self, source: str, frame: int) -> Path:
        """PNG of a frame of a technique or of the reference."""
        return self.folder / source / f"frame_{frame:04d}.png"

    def radiance(self, source: str, frame: int) -> Path:
        """Plain EXR of a frame of a technique or of the reference."""
        return self.folder / source / f"frame_{frame:04d}.exr"


def read_results(folder: Path) -> Results:
    """The job, the rows and the list of frames of a results folder.

    Args:
        folder: Folder that `jaxrefl render` or `jaxrefl compare` wrote.
    Returns:
        The checked results; pictures are looked for but not opened yet.
    Raises:
        ValueError: If the folder, its job, its rows or a picture of a row is missing or malformed.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder}: expected a results folder, found {'a file' if folder.exists() else 'nothing'}")
    job_text = _text(folder / "job.toml")
    try:
        job = tomllib.loads(job_text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{folder / 'job.toml'}: not valid TOML: {error}") from error
    rows, scenes = _rows(folder / "metrics.json")
    techniques = tuple(dict.fromkeys(row.technique for row in rows if row.technique != REFERENCE))
    if not techniques:
        raise ValueError(
            f"{folder / 'metrics.json'}: expected rows of at least one technique, got those of the reference"
        )
    results = Results(
        folder=folder,
        scene=", ".join(scenes),
        job=job,
        job_text=job_text,
        rows=rows,
        techniques=techniques,
        frames=tuple(sorted({row.frame for row in rows if row.technique != REFERENCE})),
        masks=tuple(mask for mask in MASKS if any(row.mask == mask for row in rows)),
        reference=any(any((folder / REFERENCE).glob(f"frame_????.{kind}")) for kind in ("png", "exr")),
    )
    for technique in techniques:
        for frame in results.of(technique, results.masks[0]):
            png, exr = results.picture(technique, frame), results.radiance(technique, frame)
            if not (png.is_file() or exr.is_file()):
                raise ValueError(f"{png}: missing like its EXR, but metrics.json has a row for the frame")
    return results


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise ValueError(f"{path}: missing; expected a folder written by `jaxrefl render` or `compare`") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read: {error}") from error


def _rows(path: Path) -> tuple[tuple[Row, ...], list[str]]:
    """The rows of metrics.json and the names of their scenes."""

    def refuse(constant: str) -> None:
        raise ValueError(f"{path}: {constant} is not valid JSON; figures that are not defined are null")

    try:
        raw = json.loads(_text(path), parse_constant=refuse)
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: not valid JSON: {error}") from error
    if not isinstance(raw, list) or not raw:
        raise ValueError(f"{path}: expected a list of at least one row, got {type(raw).__name__} {str(raw)[:40]!r}")
    rows = tuple(_row(entry, f"{path}: row {index}") for index, entry in enumerate(raw))
    seen: dict[tuple[str, int, str], int] = {}
    for index, row in enumerate(rows):
        first = seen.setdefault((row.technique, row.frame, row.mask), index)
        if first != index:
            raise ValueError(
                f"{path}: rows {first} and {index} are both {row.technique}, frame {row.frame}, {row.mask}"
            )
    return rows, list(dict.fromkeys(str(entry.get("scene", "unnamed scene")) for entry in raw))


def _row(entry: Any, where: str) -> Row:
    if not isinstance(entry, dict):
        raise ValueError(f"{where}: expected an object, got {entry!r}")
    expected = {"technique": str, "frame": int, "mask": str}
    for name, kind in expected.items():
        if not isinstance(entry.get(name), kind) or isinstance(entry.get(name), bool):
            raise ValueError(f"{where}: {name}: expected {kind.__name__}, got {entry.get(name)!r}")
    if entry["mask"] not in MASKS:
        raise ValueError(f"{where}: mask: expected one of {', '.join(MASKS)}, got {entry['mask']!r}")
    # A technique's name is also its folder: it must not lead out of the results.
    if entry["frame"] < 0 or Path(entry["technique"]).name != entry["technique"]:
        raise ValueError(f"{where}: expected a frame from 0 and a plain technique name, got {entry['technique']!r}")
    numbers = {name: _number(entry.get(name), f"{where}: {name}") for name in NUMBERS}
    tables = {name: entry.get(name) or {} for name in ("stages", "shared", "info", "stamp")}
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise ValueError(f"{where}: {name}: expected an object, got {table!r}")
    stages, shared = (
        {name: _number(value, f"{where}: {table}.{name}") or 0.0 for name, value in tables[table].items()}
        for table in ("stages", "shared")
    )
    identity = entry["technique"], entry["frame"], entry["mask"]
    return Row(*identity, numbers, stages, shared, tables["info"], tables["stamp"])


def _number(value: Any, where: str) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{where}: expected a finite number or null, got {value!r}")
    return float(value)
