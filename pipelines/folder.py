"""The results folder: who may write into it, what is done already, and the tables made from it.

DIR/job.toml                     the resolved job; another job is refused
DIR/.lock                        held while a run is writing
DIR/<technique>/frame_0000.png   and .exr, .layers.exr; .json, written last, says that the frame is done
DIR/reference/                   the same, for what errors are measured against
DIR/metrics.json, metrics.csv    all rows of all techniques
"""

import csv
import fcntl
import io
import json
import os
import socket
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.frames import FrameFiles, suffixes
from pipelines.job import Job, job_text
from pipelines.outputs import TEMPORARY, json_text, read_exr, write_atomic
from pipelines.stage import REFERENCE


class FolderError(ValueError):
    """A results folder that cannot be used: it is in use, or holds the results of another job."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a results folder, alone.

    The lock is the operating system's, so that of a killed run is gone with it.

    Args:
        folder: Results folder; made if needed.
    Yields:
        Nothing; the lock is held until the block ends.
    Raises:
        FolderError: If another run holds it; says which process.
        OSError: If the folder cannot be made or written.
    """
    if folder.exists() and not folder.is_dir():
        raise FolderError(f"{folder}: expected a folder, got a file")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / ".lock"
    descriptor = _acquire(path)
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)


def _acquire(path: Path) -> int:
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.read(descriptor, 200).decode(errors="replace").strip() or "another process"
            os.close(descriptor)
            if isinstance(error, BlockingIOError):
                raise FolderError(
                    f"{path.parent}: is in use by {holder}; wait for it or name another folder"
                ) from error
            raise
        # The previous holder may have removed the file between our open and our lock: then we hold nothing.
        try:
            same = os.fstat(descriptor).st_ino == path.stat().st_ino
        except FileNotFoundError:
            same = False
        if same:
            return descriptor
        os.close(descriptor)


def claim(folder: Path, job: Job) -> None:
    """Make a locked folder the folder of a job, and clear away what a killed run left half-written.

    A job that left no frame (because its scene was broken, say) does not stand in the way of the next.

    Args:
        folder: Results folder.
        job: Resolved job.
    Raises:
        FolderError: If it holds the results of another job; names what differs.
    """
    path, text = folder / "job.toml", job_text(job)
    there = path.read_text(encoding="utf-8") if path.exists() else None
    if there != text and any(folder.glob("*/frame_*")):
        if there is not None:
            raise FolderError(
                f"{folder}: holds the results of another job ({_difference(there, text)}); name another folder"
            )
        raise FolderError(
            f"{folder}: holds frames but no job.toml, so nobody knows what they show; name another folder"
        )
    for leftover in [*folder.glob(f".*{TEMPORARY}"), *folder.glob(f"*/.*{TEMPORARY}")]:
        leftover.unlink(missing_ok=True)
    if there != text:
        write_atomic(path, text.encode())


def _difference(there: str, text: str) -> str:
    try:
        old, new = (_flat(tomllib.loads(t)) for t in (there, text))
    except tomllib.TOMLDecodeError:
        return "its job.toml is broken"
    keys = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    shown = [f"{key}: {old.get(key, 'absent')!r} there, {new.get(key, 'absent')!r} now" for key in keys[:3]]
    return "; ".join(shown) + (f"; {len(keys) - 3} more" if len(keys) > 3 else "")


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat = {}
    for key, value in table.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return flat


def frame_path(folder: Path, technique: str, frame: int, suffix: str) -> Path:
    """Where a file of a frame lies.

    Args:
        folder: Results folder.
        technique: Name of a technique of the job, or `reference`.
        frame: Number of the frame.
        suffix: One of `frames.suffixes`.
    Returns:
        The path.
    """
    return folder / technique / f"frame_{frame:04d}{suffix}"


def is_done(folder: Path, job: Job, technique: str, frame: int) -> bool:
    """Whether a frame has all its files.

    Args:
        folder: Results folder.
        job: Resolved job.
        technique: Name of a technique of the job, or `reference`.
        frame: Number of the frame.
    Returns:
        True if nothing needs to be done.
    """
    return all(frame_path(folder, technique, frame, suffix).is_file() for suffix in suffixes(job, technique))


def store(folder: Path, finished: FrameFiles) -> None:
    """Write the files of a frame, each whole or not at all, the rows last.

    Args:
        folder: Results folder, locked.
        finished: The frame.
    Raises:
        OSError: If the disk is full or the folder cannot be written; names the file.
    """
    for suffix, data in finished.files.items():
        write_atomic(frame_path(folder, finished.technique, finished.frame, suffix), data)


def read_reference(folder: Path, frame: int) -> np.ndarray:
    """The reference image of a frame, from its file, so that figures do not depend on when it was rendered.

    Args:
        folder: Results folder.
        frame: Number of the frame.
    Returns:
        [h w 3] linear radiance.
    Raises:
        OSError: If it is missing or broken.
    """
    planes = read_exr(frame_path(folder, REFERENCE, frame, ".exr"))
    return np.stack([planes[axis] for axis in "RGB"], -1)


def collect(folder: Path, job: Job) -> list[dict[str, Any]]:
    """Write metrics.json and metrics.csv from the frames that are done.

    Args:
        folder: Results folder, locked.
        job: Resolved job.
    Returns:
        All rows, by frame, then technique in the job's order, then mask; without any nothing is written.
    Raises:
        FolderError: If a frame's rows are broken; names the file.
    """
    table = []
    for frame in range(job.frames or 0):
        for technique in job.techniques:
            path = frame_path(folder, technique, frame, ".json")
            if path.is_file():
                table += _read_rows(path)
    if not table:
        return table
    lines = ",\n".join(json_text(row) for row in table)
    write_atomic(folder / "metrics.json", f"[\n{lines}\n]\n".encode())
    write_atomic(folder / "metrics.csv", csv_text(table).encode())
    return table


def _read_rows(path: Path) -> list[dict[str, Any]]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise FolderError(f"{path}: is not valid JSON; remove it and start again: {error}") from error


def csv_text(table: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV.

    Args:
        table: Rows, as in metrics.json.
    Returns:
        Text with one column per key; nested tables become columns such as `stages.trace`, null is empty. The stamp
        stays in metrics.json.
    """
    flat = [_flat({key: value for key, value in row.items() if key != "stamp"}) for row in table]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(dict.fromkeys(key for row in flat for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return stream.getvalue()
