"""The lobe table on disk: the usual one is shipped, others are built once per machine. Host code."""

import functools
import os
import tempfile
import zipfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxrefl.filters.lobe_table import LobeGaussians, LobeTable, TableOptions, build_table

_FIELDS = ("weight", "mean", "along", "across")
_VERSION = 1
"""Raised whenever tables come out differently."""
_SHIPPED = Path(__file__).parent
"""The table that techniques use comes with the package."""


def cache_folder() -> Path:
    """Where tables are kept.

    Returns:
        `$JAXREFL_CACHE`, or `jaxrefl` in `$XDG_CACHE_HOME` or `~/.cache`.
    """
    if own := os.environ.get("JAXREFL_CACHE"):
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxrefl"


@functools.cache
def load_table(*, options: TableOptions = TableOptions()) -> LobeTable:  # noqa: B008  frozen
    """The lobe table, from this process, from disk, or built (20 seconds) and written to disk.

    Args:
        options: What is tabulated.
    Returns:
        The table.
    Edge cases: where the cache folder cannot be written, the table is built again in every process; a damaged file is
    replaced.
    """
    name = f"lobe-{options.surface}-{options.method}-{options.size}-v{_VERSION}.npz"
    for folder in (_SHIPPED, cache_folder()):
        try:
            with np.load(folder / name, allow_pickle=False) as stored:
                return LobeTable(LobeGaussians(*(jnp.asarray(stored[field]) for field in _FIELDS)))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            continue
    table = jax.block_until_ready(build_table(options=options))
    save_table(table, cache_folder() / name)
    return table


def save_table(table: LobeTable, path: Path) -> None:
    """Write a table, under another name first, so that no other process ever reads half a file.

    Args:
        table: Any table.
        path: File to write.
    Returns:
        Nothing; a folder that cannot be written is left alone.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npz", delete=False) as stream:
            g = table.gaussians
            weight, mean, along, across = (np.asarray(x) for x in (g.weight, g.mean, g.along, g.across))
            np.savez(stream, weight=weight, mean=mean, along=along, across=across)
        os.chmod(stream.name, 0o644)
        os.replace(stream.name, path)
    except OSError:
        return
