"""What is kept of a frame of the reference so that it can go on: sums of samples and what they cost <-> bytes."""

import dataclasses
import io
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrefl.radiance.path_types import PathLight
from jaxrefl.radiance.progressive import ProgressiveState
from pipelines.folder import FolderError, frame_path
from pipelines.outputs import write_atomic
from pipelines.stage import REFERENCE

SUFFIX = ".state.npz"
"""End of the name of a frame's state; it holds 180 bytes per pixel."""


@dataclasses.dataclass(frozen=True)
class Cost:
    """What a frame has cost over all its runs."""

    seconds: float = 0.0
    """Wall-clock seconds without compilation."""
    compile_seconds: float = 0.0
    """Seconds of compilation."""
    rays: int = 0
    """Rays cast."""

    @property
    def total(self) -> float:
        """All seconds."""
        return self.seconds + self.compile_seconds


def state_path(folder: Path, frame: int) -> Path:
    """Where the state of a frame lies.

    Args:
        folder: Results folder.
        frame: Number of the frame.
    Returns:
        The path.
    """
    return frame_path(folder, REFERENCE, frame, SUFFIX)


def save_state(folder: Path, frame: int, state: ProgressiveState, cost: Cost) -> None:
    """Write a state, whole or not at all.

    Args:
        folder: Results folder, locked.
        frame: Number of the frame.
        state: Sums so far.
        cost: What they cost.
    Raises:
        OSError: If the disk is full or the folder cannot be written; names the file.
    """
    stream = io.BytesIO()
    layers = {f"layer_{field.name}": getattr(state.layers, field.name) for field in dataclasses.fields(PathLight)}
    sums = {"radiance": state.radiance, "counts": state.counts, "seed": state.seed, **layers}
    arrays: dict[str, Any] = {k: np.asarray(v) for k, v in {**sums, **dataclasses.asdict(cost)}.items()}
    np.savez(stream, **arrays)
    write_atomic(state_path(folder, frame), stream.getvalue())


def load_state(folder: Path, frame: int) -> tuple[ProgressiveState, Cost] | None:
    """The state of a frame.

    Args:
        folder: Results folder, claimed by the state's job.
        frame: Number of the frame.
    Returns:
        Sums and cost, or None if there is no such file.
    Raises:
        FolderError: If the file is broken; names it.
    """
    path = state_path(folder, frame)
    try:
        with np.load(path) as file:
            names = [field.name for field in dataclasses.fields(PathLight)]
            layers = PathLight(*(jnp.asarray(file[f"layer_{name}"]) for name in names))
            radiance, counts, seed = (jnp.asarray(file[name]) for name in ("radiance", "counts", "seed"))
            state = ProgressiveState(radiance, counts, layers, seed)
            cost = Cost(float(file["seconds"]), float(file["compile_seconds"]), int(file["rays"]))
    except FileNotFoundError:
        return None
    except Exception as error:  # a broken archive fails in many ways
        raise FolderError(f"{path}: cannot be read; remove it to start this frame again: {error}") from error
    return state, cost
