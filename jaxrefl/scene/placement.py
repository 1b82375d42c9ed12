"""Where a description stands in the world: units and up axis.

Input and output: `Description`s (NumPy).
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Camera
from jaxrefl._validate import checked_number
from jaxrefl.scene.description import Description, Part, PunctualLight

WORLD_FROM_FILE = {
    "x": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "-x": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    "y": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-y": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "z": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-z": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
}
"""Rotations that turn each axis of a file to +Y."""


def placed(description: Description, *, units: float = 1.0, up: str = "y") -> Description:
    """The same scene in other units and with another axis pointing up.

    Args:
        description: Any description.
        units: World units per unit of the file, > 0: 0.001 turns millimetres into metres.
        up: Axis of the file that becomes +Y: "x", "y", "z", "-x", "-y" or "-z".
    Returns:
        The description. The picture does not change: cameras move along, absorption is per world unit, and point and
        spot lights are made stronger by units squared. The sky stays where it is.
    Raises:
        ValueError: If `units` is not positive or `up` is not an axis.
    """
    units = checked_number("units", units, above=0.0)
    if not isinstance(up, str) or up not in WORLD_FROM_FILE:
        raise ValueError(f"up: expected one of {', '.join(WORLD_FROM_FILE)}, got {up!r}")
    if units == 1 and up == "y":
        return description
    rotation = np.array(WORLD_FROM_FILE[up], np.float64)
    return dataclasses.replace(
        description,
        parts=[_placed_part(part, rotation, units) for part in description.parts],
        lights=[_placed_light(light, rotation, units) for light in description.lights],
        cameras={name: _placed_camera(camera, rotation, units) for name, camera in description.cameras.items()},
    )


def _placed_part(part: Part, rotation: np.ndarray, units: float) -> Part:
    tangents = part.tangents
    if tangents is not None:
        tangents = np.concatenate([tangents[:, :3] @ rotation.T, tangents[:, 3:]], 1)
    r, g, b = (a / units for a in part.material.attenuation)
    return dataclasses.replace(
        part,
        vertices=units * (part.vertices @ rotation.T),
        material=part.material.replace(attenuation=(r, g, b)),
        normals=None if part.normals is None else part.normals @ rotation.T,
        tangents=tangents,
    )


def _placed_light(light: PunctualLight, rotation: np.ndarray, units: float) -> PunctualLight:
    strength = 1.0 if light.directional else units * units
    return dataclasses.replace(
        light,
        position=_triple(units * (rotation @ light.position)),
        direction=_triple(rotation @ light.direction),
        intensity=_triple(strength * np.asarray(light.intensity)),
    )


def _placed_camera(camera: Camera, rotation: np.ndarray, units: float) -> Camera:
    matrix = np.asarray(camera.world_from_camera, np.float64).copy()
    matrix[:3] = rotation @ matrix[:3]
    matrix[:3, 3] *= units
    return dataclasses.replace(camera, world_from_camera=jnp.asarray(matrix, jnp.float32))


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
