"""Host-side description of a scene, between the file readers and `assemble`.

Readers (`gltf.py`, `obj.py`, ...), material overrides and the built-in scenes all speak this vocabulary: plain NumPy,
one `Part` per object and material, everything already in world space. `assemble` turns it into a `Scene` of arrays.
"""

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from jaxrefl._types import Camera


@dataclass(frozen=True)
class Image:
    """An 8-bit texture image."""

    name: str
    """File or image name, for messages."""
    rgba: np.ndarray
    """[h w 4] uint8, row 0 on top."""
    repeat: tuple[bool, bool] = (True, True)
    """Wrap mode for (u, v): True repeats, False clamps."""


@dataclass(frozen=True)
class Material:
    """A metallic-roughness material; see `jaxrefl.Materials` for the meaning of each field."""

    name: str
    base_colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    metallic: float = 0.0
    alpha: float = 1.0
    eta: float = 1.5
    transmission: float = 0.0
    attenuation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    thin: bool = False
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_colour_texture: Image | None = None
    metallic_roughness_texture: Image | None = None
    normal_texture: Image | None = None
    normal_scale: float = 1.0
    emission_texture: Image | None = None

    @property
    def reflective(self) -> bool:
        """True if the surface has a specular lobe."""
        return self.metallic > 0 or self.eta != 1 or self.metallic_roughness_texture is not None

    def replace(self, **changes) -> "Material":
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)


def matte(name: str, colour) -> Material:
    """A purely diffuse material: index 1, so no reflection at all."""
    return Material(name, base_colour=tuple(colour), alpha=1.0, eta=1.0)


def mirror(name: str, colour=(0.95, 0.95, 0.95)) -> Material:
    """A perfect metal mirror with the given specular colour."""
    return Material(name, base_colour=tuple(colour), metallic=1.0, alpha=0.0)


def glossy(name: str, colour, *, alpha: float, metallic: float = 0.0, eta: float = 1.5) -> Material:
    """A glossy dielectric (or, with `metallic` 1, metal)."""
    return Material(name, base_colour=tuple(colour), metallic=metallic, alpha=alpha, eta=eta)


def glass(name: str, colour=(1.0, 1.0, 1.0), *, eta: float = 1.5, alpha: float = 0.0, attenuation=(0.0, 0.0, 0.0)):
    """A refractive dielectric."""
    return Material(
        name, base_colour=tuple(colour), alpha=alpha, eta=eta, transmission=1.0, attenuation=tuple(attenuation)
    )


def emitter(name: str, radiance) -> Material:
    """A light source: emits `radiance` from both sides and reflects nothing."""
    return Material(name, base_colour=(0.0, 0.0, 0.0), eta=1.0, emission=tuple(radiance))


@dataclass(frozen=True)
class Part:
    """Triangles of one object with one material, in world space."""

    name: str
    """Object name; parts with the same name are one object."""
    vertices: np.ndarray
    """[v 3] float64 or float32 positions."""
    faces: np.ndarray
    """[f 3] integer vertex indices, counter-clockwise from the outside."""
    material: Material
    normals: np.ndarray | None = None
    """[v 3] shading normals, any length; None: flat."""
    uv: np.ndarray | None = None
    """[v 2] texture coordinates, (0, 0) at the top left of the image."""
    tangents: np.ndarray | None = None
    """[v 4] tangents and handedness; None: derived from `uv` where a normal map needs them."""
    colours: np.ndarray | None = None
    """[v 3] linear vertex colours."""


@dataclass(frozen=True)
class PunctualLight:
    """A point, spot or directional light; see `jaxrefl.PunctualLights`."""

    name: str
    intensity: tuple[float, float, float]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, -1.0, 0.0)
    directional: bool = False
    cos_inner: float = -1.0
    cos_outer: float = -2.0
    angular_radius: float = 0.0


@dataclass(frozen=True)
class Sky:
    """Light from infinitely far away: a latitude-longitude image (a constant sky is a 1-pixel image)."""

    radiance: np.ndarray
    """[eh ew 3] linear radiance, row 0 up, middle column along -Z."""
    world_from_map: np.ndarray = field(default_factory=lambda: np.eye(3))
    """[3 3] rotation from map to world directions."""
    name: str = "sky"


def constant_sky(colour) -> Sky:
    """The same radiance from every direction."""
    return Sky(np.asarray(colour, np.float32).reshape(1, 1, 3), name="constant sky")


@dataclass(frozen=True)
class Description:
    """A whole scene before it becomes arrays."""

    name: str
    parts: list[Part]
    lights: list[PunctualLight] = field(default_factory=list)
    sky: Sky | None = None
    ambient: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cameras: dict[str, Camera] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    """What was assumed, changed or ignored so far, one sentence each."""
