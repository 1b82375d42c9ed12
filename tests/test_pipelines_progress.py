"""What a run says on the way."""

import io
import json
import subprocess
import sys

from pipelines.progress import Silent, shown


def test_a_log_gets_one_line_per_frame():
    stream = io.StringIO()
    with shown(2, stream=stream) as progress:
        progress.note("no camera")
        progress.advance("plain 0000", 0.25)
        progress.advance("plain 0001", 0.5)
    lines = stream.getvalue().splitlines()
    assert lines[0] == "note: no camera"
    assert lines[1].startswith("1/2 plain 0000: 0.250 s; ") and lines[1].endswith(" left")
    assert lines[2].startswith("2/2 plain 0001: 0.500 s; ") and lines[2].endswith("0:00 left")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_gets_a_bar():
    stream = Terminal()
    with shown(2, stream=stream) as progress:
        progress.note("no camera [red]")
        progress.advance("plain 0000", 0.25)
        progress.advance("plain 0001", 0.5)
    text = stream.getvalue()
    assert "note: no camera [red]" in text and "2/2" in text


def test_silence_keeps_the_notes():
    progress = Silent()
    progress.note("a")
    progress.advance("plain 0000", 0.1)
    assert progress.notes == ["a"]


def test_the_command_starts_fast_without_loading_what_it_does_not_need():
    code = "import json, sys; from pipelines import cli; cli.main(['--help']); print(json.dumps(list(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"jax", "tyro", "rich", "distributed", "matplotlib"} & set(json.loads(done.stdout.splitlines()[-1]))
