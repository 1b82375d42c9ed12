"""Scenes written for Mitsuba and read again: what several tests of writing use."""

import warnings
from pathlib import Path

import numpy as np

from jaxrefl import Scene
from jaxrefl.core import look_at
from jaxrefl.scene import Description, Image, Material, Part, SceneWarning, assemble, describe_file, export_mitsuba

SIZE = (24, 16)
CAMERA = look_at((0.3, 0.4, 4), (0.1, 0, 0), size=SIZE)
SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
QUAD = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.array([[0.1, 0.9], [1.3, 0.8], [1.1, -0.2], [0, 0]])


def square(material: Material, *, name: str = "square", at=(0.0, 0.0, 0.0), **more) -> Part:
    return Part(name, SQUARE + np.asarray(at), QUAD, material, **{"uv": UV, **more})


def picture(*, seed: int = 0, size=(8, 8)) -> Image:
    return Image("picture", np.random.default_rng(seed).integers(0, 256, (*size, 4), dtype=np.uint8))


def scene_of(*parts: Part, **more) -> Scene:
    return assemble(Description("test", list(parts), **more))


def exported(folder: Path, *parts: Part, **more) -> tuple[Scene, Path]:
    """A scene, and the file it was written to."""
    scene = scene_of(*parts, **more)
    return scene, export_mitsuba(scene, folder / "out", camera=CAMERA)


def notes_of(folder: Path, *parts: Part, **more) -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SceneWarning)
        _, path = exported(folder, *parts, **more)
    said = " | ".join(str(w.message) for w in caught)
    for warning in caught:  # every note stands in the file too
        assert str(warning.message).removeprefix("scene.xml: ") in path.read_text()
    return said


def back(folder: Path, material: Material, **more) -> Material:
    """A material after it was written and read."""
    _, path = exported(folder, square(material, **more))
    (part,) = describe_file(path).parts
    return part.material
