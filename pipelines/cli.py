"""The command `jaxrefl`: words -> a command, errors -> one message and an exit code.

Exit codes: 0 done; 1 failed on the way (a full disk, a defect); 2 something in the words, the job or an input file does
not fit; 130 interrupted. A user's error shows a traceback only if the environment variable JAXREFL_TRACEBACK is set.
"""

import os
import sys
import warnings
from collections.abc import Sequence

COMMANDS = {
    "info": "tell what is in a scene",
    "render": "render a scene along a camera path",
    "reference": "path trace images that errors can be measured against",
    "compare": "render with several techniques and measure their errors",
    "bake": "bake the diffuse light of a scene into a light map",
    "report": "write the HTML report of a results folder",
    "export": "write a scene for another renderer",
    "scenes": "list the built-in scenes",
    "bench": "measure the speed of this machine",
}
"""Commands and what they do."""

HELP = """jaxrefl renders the reflections of 3-D scenes, and measures how wrong they are.

usage: jaxrefl COMMAND ...

commands:
{commands}

A first picture, and a first comparison:
  jaxrefl render cornell --size 480 270 --out results/first
  jaxrefl compare cornell --techniques raytrace envmap --frames 4 --size 480 270 --out results/compare

`jaxrefl COMMAND --help` explains a command and its flags.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the command `jaxrefl`.

    Args:
        argv: Words after the program's name; None: those of this process.
    Returns:
        Exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help", "help"):
        print(help_text())
        return 0 if words else 2
    if words[0] in ("-V", "--version"):
        import importlib.metadata

        print(f"jaxrefl {importlib.metadata.version('jaxrefl')}")
        return 0
    try:
        return _dispatch(words[0], words[1:])
    except KeyboardInterrupt:
        return _fail("interrupted; the same command continues where it stopped", 130)
    except (ValueError, ImportError) as error:
        if _is_defect(error) or os.environ.get("JAXREFL_TRACEBACK"):
            raise
        return _fail(str(error), 2 if isinstance(error, ValueError) else 1)
    except (OSError, ArithmeticError) as error:
        return _fail(_os_message(error) if isinstance(error, OSError) else str(error), 1)


def help_text() -> str:
    """The help text of the command.

    Returns:
        Text that lists the commands.
    """
    return HELP.format(commands="\n".join(f"  {name:10}{what}" for name, what in COMMANDS.items()))


def _dispatch(command: str, words: list[str]) -> int:
    if command not in COMMANDS:
        from pipelines.toml_tables import JobError, suggestion

        raise JobError(f"unknown command {command!r}; {suggestion(command, COMMANDS)}")
    if command in ("render", "compare", "reference"):
        _use_cache(words)
    from pipelines import commands

    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: print(f"note: {message}", file=sys.stderr)
        return getattr(commands, command)(words)


def _use_cache(words: list[str]) -> None:
    """Turn on JAX's compilation cache, before the first array exists; workers inherit it."""
    for i, word in enumerate(words):
        folder = words[i + 1] if word == "--cache" and i + 1 < len(words) else word.partition("--cache=")[2]
        if folder:
            os.environ["JAX_COMPILATION_CACHE_DIR"] = os.path.abspath(folder)
            os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
            import jax

            # The environment counts only until JAX is imported, which somebody may have done before.
            jax.config.update("jax_compilation_cache_dir", os.path.abspath(folder))
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _is_defect(error: Exception) -> bool:
    """True if an error was not raised by this project's own checks, so that its traceback is worth showing."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    origin = "" if trace is None else trace.tb_frame.f_globals.get("__name__", "")
    return origin.partition(".")[0] not in ("jaxrefl", "pipelines", "scenes")


def _os_message(error: OSError) -> str:
    if error.strerror is None:
        return str(error)
    return f"{error.filename}: {error.strerror}" if error.filename else error.strerror


def _fail(message: str, code: int) -> int:
    print(f"jaxrefl: {message}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
