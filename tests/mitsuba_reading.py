"""Mitsuba scene files and what is read from them: what several tests of reading use."""

from pathlib import Path

import numpy as np
from mitsuba_scenes import write_png, write_scene

from jaxrefl.scene import Description, Material, describe_file

SIZE = (24, 16)
SPHERE = '<shape type="sphere">{}</shape>'
TURN = (
    '<transform name="to_world">{}<rotate x="1" angle="35"/><rotate y="1" angle="20"/>'
    '<translate x="0.2" y="-0.1"/></transform>'
)


def described(folder: Path, *content: str, version: str = "3.0.0") -> Description:
    return describe_file(write_scene(folder, *content, version=version))


def only_material(folder: Path, bsdf: str, *, version: str = "3.0.0") -> Material:
    (part,) = described(folder, SPHERE.format(bsdf), version=version).parts
    return part.material


def notes_of(folder: Path, *content: str) -> str:
    return " | ".join(described(folder, *content).notes)


def picture(folder: Path, *, size=(8, 8), channels: int = 3, seed: int = 0) -> Path:
    shape = (*size, channels) if channels > 1 else size
    return write_png(folder / "picture.png", np.random.default_rng(seed).integers(0, 256, shape))
