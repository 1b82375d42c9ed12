"""A parsed Mitsuba scene file: its nodes, their properties and children, the files they name, and what was noted.

Mitsuba's own parser does the work, so that versions, defaults, includes, references and transforms mean what they mean
there. `open_scene` is the only place that changes Mitsuba's global state (variant, log level, file search path), and
puts it back.
"""

import contextlib
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.notes import Notes

VARIANT = "scalar_rgb"
"""Variant in which files are read: it needs no compiler, and its colours are linear Rec.709 like ours."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Node:
    """One object of the file: a shape, a material, a texture, a light, a camera."""

    scene: "MitsubaFile"
    """The file it stands in."""
    index: int
    """Its number there."""

    @property
    def props(self) -> Any:
        """Mitsuba's properties of the object."""
        return self.scene.state.nodes[self.index].props

    @property
    def plugin(self) -> str:
        """Name of the plugin, such as "roughconductor"."""
        return self.props.plugin_name()

    @property
    def kind(self) -> str:
        """What the object is: "Shape", "BSDF", "Texture", "Emitter", "Sensor", "Film", "Medium", ..."""
        return self.scene.state.nodes[self.index].type.name

    @property
    def name(self) -> str:
        """The id in the file; empty if it has none."""
        return self.props.id()

    @property
    def place(self) -> str:
        """What to call the object in messages: its id, or its plugin and line."""
        if self.name:
            return f"{self.plugin} {self.name!r}"
        location = self.scene.mi.parser.file_location(self.scene.state, self.scene.state.nodes[self.index])
        return f"{self.plugin} in {Path(location).name}"

    def __contains__(self, key: str) -> bool:
        return key in self.props

    def keys(self) -> list[str]:
        """Names of all properties and children."""
        return list(self.props.keys())

    def get(self, key: str, default: Any) -> Any:
        """A plain property; children do not count."""
        if key not in self.props or self._is_child(key):
            return default
        return self.props[key]

    def number(self, key: str, default: float) -> float:
        """A finite number."""
        value = self.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise SceneError(f"{self.scene.path}: {self.place}: {key}: expected a finite number, got {value!r}")
        return float(value)

    def vector(self, key: str, default: Triple) -> np.ndarray:
        """Three numbers: a point or a vector."""
        return np.asarray(self.get(key, default), np.float64).reshape(3)

    def matrix(self, key: str = "to_world") -> np.ndarray:
        """A transform [4 4]; the identity where there is none."""
        value = self.get(key, None)
        return np.eye(4) if value is None else np.asarray(value.matrix, np.float64).reshape(4, 4)

    def child(self, key: str) -> "Node | None":
        """The child under a name, such as the texture of a colour."""
        return Node(self.scene, self.props[key].index()) if key in self.props and self._is_child(key) else None

    def children(self, kind: str | None = None) -> list["Node"]:
        """All children in file order, or those of one kind."""
        nodes = [Node(self.scene, self.props[key].index()) for key in self.keys() if self._is_child(key)]
        return [node for node in nodes if kind is None or node.kind == kind]

    def _is_child(self, key: str) -> bool:
        return self.props.type(key).name == "ResolvedReference"


@dataclass(frozen=True)
class MitsubaFile:
    """A scene file as Mitsuba's parser sees it."""

    mi: Any
    """The module `mitsuba`, in `VARIANT`."""
    path: Path
    """The file."""
    state: Any
    """`mitsuba.parser.ParserState` with references resolved."""
    notes: Notes
    """What was noted so far."""

    @property
    def root(self) -> Node:
        """The scene itself."""
        return Node(self, 0)

    def resolve(self, node: Node, filename: str) -> Path:
        """The file that a node names: beside the file it stands in, or on the file's search path.

        Args:
            node: Who names it.
            filename: As written.
        Returns:
            The path, which exists or is where the file was expected.
        """
        own = Path(str(self.state.files[self.state.nodes[node.index].file_index])).parent / filename
        if own.is_file():
            return own
        found = Path(str(self.mi.file_resolver().resolve(filename)))
        return found if found.is_file() else self.path.parent / filename

    def evaluated(self, texture: Any) -> Triple:
        """Colour of one of Mitsuba's textures that is the same everywhere."""
        red, green, blue = np.asarray(texture.eval(self.mi.SurfaceInteraction3f()), np.float64).reshape(-1)[:3].tolist()
        return red, green, blue


@contextlib.contextmanager
def open_scene(path: Path) -> Iterator[MitsubaFile]:
    """Parse a scene file; while the context lasts, Mitsuba may also be asked to load single objects.

    Args:
        path: An `.xml` file of any version that Mitsuba 3 upgrades.
    Yields:
        The parsed file.
    Raises:
        SceneError: If Mitsuba is not installed, the file is broken, or a reference, a default or an included file is
            missing.
    Edge cases: where no variant was set before, `VARIANT` stays set, as Mitsuba cannot be without one again.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            import mitsuba
    except ImportError as error:
        raise SceneError(
            f"{path}: reading Mitsuba scenes needs the package mitsuba: pip install 'jaxrefl[mitsuba]' ({error})"
        ) from error
    mi: Any = mitsuba
    before = mi.variant()
    mi.set_variant(VARIANT)
    level, resolver = mi.log_level(), mi.file_resolver()
    try:
        mi.set_log_level(mi.LogLevel.Error)
        own = mi.FileResolver(resolver)
        own.prepend(str(path.absolute().parent))
        mi.set_file_resolver(own)
        yield MitsubaFile(mi, path, _parsed(mi, path), Notes())
    finally:
        mi.set_file_resolver(resolver)
        mi.set_log_level(level)
        if before not in (None, VARIANT):
            mi.set_variant(before)


def _parsed(mi: Any, path: Path) -> Any:
    config = mi.parser.ParserConfig(VARIANT)
    try:
        state = mi.parser.parse_file(config, str(path))
        mi.parser.transform_upgrade(config, state)
        mi.parser.transform_resolve_references(config, state)
    except RuntimeError as error:
        raise SceneError(f"{path}: {_cleaned(error)}") from error
    if state.root.props.plugin_name() != "scene":
        raise SceneError(f"{path}: expected a <scene>, got a {state.root.props.plugin_name()!r}")
    return state


def _cleaned(error: Exception) -> str:
    """Mitsuba's message in one line, without the places in its source code."""
    parts = [line.partition("] ")[2] if line.startswith("[") else line for line in str(error).splitlines()]
    return " ".join(part.strip() for part in parts if part.strip())


def loaded(node: Node, settings: dict[str, Any]) -> Any:
    """One object made by Mitsuba from a few of a node's properties.

    Args:
        node: What the object stands for, for messages.
        settings: As for `mitsuba.load_dict`.
    Returns:
        Mitsuba's object.
    Raises:
        SceneError: If Mitsuba refuses; names the file and the object.
    """
    try:
        return node.scene.mi.load_dict(settings)
    except RuntimeError as error:
        raise SceneError(f"{node.scene.path}: {node.place}: {_cleaned(error)}") from error
