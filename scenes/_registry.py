"""Built-in scenes by name."""

import inspect
from types import ModuleType

from jaxrefl.scene.description import Description
from scenes import cornell, furnace, mirror_room, roughness_steps, teapot_room

BUILT_IN: dict[str, ModuleType] = {
    "cornell": cornell,
    "teapot_room": teapot_room,
    "mirror_room": mirror_room,
    "roughness_steps": roughness_steps,
    "furnace": furnace,
}
"""The scene modules by name, in the order in which they are listed."""


def build(name: str, **parameters) -> Description:
    """A built-in scene by name.

    Args:
        name: One of `BUILT_IN`.
        **parameters: `triangles` and the scene's own parameters; see its `build`.
    Returns:
        The description, ready for `jaxrefl.scene.assemble`.
    Raises:
        ValueError: If there is no such scene, the scene has no such parameter, or a value is out of range.
    """
    if name not in BUILT_IN:
        raise ValueError(f"scene: expected one of {', '.join(BUILT_IN)}, got {name!r}")
    known = inspect.signature(BUILT_IN[name].build).parameters
    for parameter in parameters:
        if parameter not in known:
            raise ValueError(f"{parameter}: scene {name} has no such parameter, only {', '.join(known)}")
    return BUILT_IN[name].build(**parameters)
