"""How far a run is: a bar with rate and time left on a terminal, one plain line per frame anywhere else."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, TextIO


class Progress(Protocol):
    """What a run tells while it runs."""

    def note(self, text: str) -> None:
        """Say something worth knowing.

        Args:
            text: One sentence.
        """
        ...

    def advance(self, what: str, seconds: float) -> None:
        """Tell that a frame is finished.

        Args:
            what: Name of the frame and technique.
            seconds: What its step took.
        """
        ...


class _Bar:
    def __init__(self, bar, task):
        self._bar, self._task = bar, task

    def note(self, text: str) -> None:
        self._bar.console.print(f"note: {text}", markup=False, highlight=False)

    def advance(self, what: str, seconds: float) -> None:
        self._bar.update(self._task, advance=1, description=what)


class _Lines:
    def __init__(self, total: int, stream: TextIO):
        self._total, self._stream = total, stream
        self._done, self._began = 0, time.monotonic()

    def note(self, text: str) -> None:
        print(f"note: {text}", file=self._stream, flush=True)

    def advance(self, what: str, seconds: float) -> None:
        self._done += 1
        each = (time.monotonic() - self._began) / self._done
        left = _clock(each * (self._total - self._done))
        line = f"{self._done}/{self._total} {what}: {seconds:.3f} s; {each:.2f} s per frame, {left} left"
        print(line, file=self._stream, flush=True)


class Silent:
    """Progress that nobody sees; `notes` keeps what was said."""

    def __init__(self):
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        """Keep a sentence.

        Args:
            text: One sentence.
        """
        self.notes.append(text)

    def advance(self, what: str, seconds: float) -> None:
        """Ignore a finished frame.

        Args:
            what: Name of the frame and technique.
            seconds: What its step took.
        """


def _clock(seconds: float) -> str:
    whole = round(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"


@contextmanager
def shown(total: int, *, stream: TextIO | None = None) -> Iterator[Progress]:
    """Progress on a terminal or in a log.

    Args:
        total: How many frames there are to do.
        stream: Where to write, None: standard error; a bar if it is a terminal, lines if not.
    Yields:
        The progress to report to.
    """
    where = sys.stderr if stream is None else stream
    if not where.isatty():
        yield _Lines(total, where)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if not speed else f"{1 / speed:.2f} s per frame")

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), Rate())
    with Bar(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=Console(file=where)) as bar:
        yield _Bar(bar, bar.add_task("starting", total=total))
