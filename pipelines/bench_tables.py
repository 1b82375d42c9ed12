"""Tables of benchmarks: rows -> Markdown for the documentation, JSON with what they were measured on."""

import json
from pathlib import Path

from pipelines.stamp import hardware, versions


def table(rows: list[dict]) -> str:
    """Rows as a Markdown table.

    Args:
        rows: Dictionaries with the same keys.
    Returns:
        The table.
    """
    keys = list(rows[0])
    shown = [[f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows]
    head = ["| " + " | ".join(keys) + " |", "|" + "---|" * len(keys)]
    return "\n".join(head + ["| " + " | ".join(line) + " |" for line in shown])


def write(out: Path, name: str, argv: list[str], sections: dict[str, list[dict]], commands: list[str]) -> None:
    """Print tables; keep them as Markdown for the documentation and as JSON with what they were measured on.

    Args:
        out: Folder to write to.
        name: Name of both files.
        argv: Arguments of the benchmark, for the stamp.
        sections: Rows by title; empty ones are left out of the page.
        commands: Commands to print below.
    """
    machine = hardware()
    where = f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gib']} GiB"
    parts = [f"**{title}**\n\n{table(rows)}" for title, rows in sections.items() if rows]
    parts.append("Commands: " + "; ".join(f"`{command}`" for command in commands) + f". Seed 0. Measured on {where}.")
    text = "\n\n".join(parts)
    print(text)
    out.mkdir(parents=True, exist_ok=True)
    stamp = {"command": " ".join(["jaxrefl", "bench", *argv]), "versions": versions(), "hardware": machine, "seed": 0}
    (out / f"{name}.json").write_text(json.dumps({"stamp": stamp, "commands": commands, **sections}, indent=1) + "\n")
    (out / f"{name}.md").write_text(text + "\n")
