"""What two runs of one job must agree on."""

import json
from pathlib import Path

MEASURED = ("seconds", "compile_seconds", "init_seconds", "stages", "peak_mib", "shared", "stamp")


def images(folder: Path) -> dict[str, bytes]:
    """Content of every image."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("frame_*") if p.suffix in (".png", ".exr")}


def figures(folder: Path) -> list[dict]:
    """All rows, without what is a measurement of time or memory or a stamp."""
    rows = json.loads((folder / "metrics.json").read_text())
    return [{key: value for key, value in row.items() if key not in MEASURED} for row in rows]
