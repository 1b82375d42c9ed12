"""Host-side description of a scene, between the file readers and `assemble`.

Readers (`gltf.py`, `obj.py`, ...), material overrides and the built-in scenes all speak this vocabulary: plain NumPy,
one `Part` per object and material, everything already in world space. `assemble` turns it into a `Scene` of arrays.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxrefl._types import Camera

Colour = Sequence[float | int] | np.ndarray
"""Three linear values: red, green, blue."""


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
    """A metallic-roughness material; one row of `jaxrefl.Materials`."""

    name: str
    """Name, for overrides and messages."""
    base_colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear, in [0, 1]: diffuse albedo of a dielectric, specular colour of a metal."""
    metallic: float = 0.0
    """0 dielectric to 1 metal."""
    alpha: float = 1.0
    """GGX width in [0, 1]."""
    eta: float = 1.5
    """Index of refraction, >= 1; exactly 1 with `metallic` 0 is matte."""
    transmission: float = 0.0
    """Share of the non-reflected light that is refracted, in [0, 1]."""
    attenuation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Absorption coefficient inside, per world unit, >= 0."""
    thin: bool = False
    """True: a pane without volume."""
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Emitted radiance, linear, >= 0."""
    base_colour_texture: Image | None = None
    """sRGB-coded factor on `base_colour`."""
    metallic_roughness_texture: Image | None = None
    """G: perceptual roughness, whose square is a factor on `alpha`; B: factor on `metallic`."""
    normal_texture: Image | None = None
    """Tangent space normals."""
    normal_scale: float = 1.0
    """Factor on the x and y of the normal map."""
    emission_texture: Image | None = None
    """sRGB-coded factor on `emission`."""
    emits_back: bool = True
    """True: both sides emit; False: only the side the triangles face."""
    conductor: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    """Index of refraction of a metal, real and imaginary part per channel; `base_colour` then multiplies its
    reflectance; None: Schlick's Fresnel term with F0 = `base_colour`."""
    coupled: bool = False
    """True: diffuse light passes the interface on its way in and out and bounces beneath it (plastic); `base_colour` is
    the albedo beneath the interface."""
    opacity: float = 1.0
    """Share of the light that meets the surface, in [0, 1]."""
    opacity_texture: Image | None = None
    """Image whose alpha channel multiplies `opacity`."""

    @property
    def reflective(self) -> bool:
        """True if the surface has a specular lobe."""
        return self.metallic > 0 or self.eta != 1 or self.metallic_roughness_texture is not None

    def replace(self, **changes) -> "Material":
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)


def matte(name: str, colour: Colour) -> Material:
    """A purely diffuse material: index 1, so no reflection at all.

    Args:
        name: Name of the material.
        colour: Albedo, linear, in [0, 1].
    Returns:
        The material.
    """
    return Material(name, base_colour=_triple(colour), alpha=1.0, eta=1.0)


def mirror(name: str, *, colour: Colour = (0.95, 0.95, 0.95)) -> Material:
    """A perfect metal mirror.

    Args:
        name: Name of the material.
        colour: Specular colour at normal incidence, in [0, 1].
    Returns:
        The material.
    """
    return Material(name, base_colour=_triple(colour), metallic=1.0, alpha=0.0)


def glossy(name: str, colour: Colour, *, alpha: float, metallic: float = 0.0, eta: float = 1.5) -> Material:
    """A glossy dielectric (or, with `metallic` 1, metal).

    Args:
        name: Name of the material.
        colour: Base colour, linear, in [0, 1].
        alpha: GGX width in [0, 1].
        metallic: 0 dielectric to 1 metal.
        eta: Index of refraction, >= 1.
    Returns:
        The material.
    """
    return Material(name, base_colour=_triple(colour), metallic=metallic, alpha=alpha, eta=eta)


def glass(
    name: str,
    *,
    colour: Colour = (1.0, 1.0, 1.0),
    eta: float = 1.5,
    alpha: float = 0.0,
    attenuation: Colour = (0.0, 0.0, 0.0),
) -> Material:
    """A refractive dielectric.

    Args:
        name: Name of the material.
        colour: What passes the surface, in [0, 1].
        eta: Index of refraction, >= 1.
        alpha: GGX width in [0, 1].
        attenuation: Absorption coefficient inside, per world unit, >= 0.
    Returns:
        The material.
    """
    return Material(
        name, base_colour=_triple(colour), alpha=alpha, eta=eta, transmission=1.0, attenuation=_triple(attenuation)
    )


def emitter(name: str, radiance: Colour) -> Material:
    """A light source: emits from both sides and reflects nothing.

    Args:
        name: Name of the material.
        radiance: Emitted radiance, linear, >= 0.
    Returns:
        The material.
    """
    return Material(name, base_colour=(0.0, 0.0, 0.0), eta=1.0, emission=_triple(radiance))


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
    """What the triangles are made of."""
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
    """A point, spot or directional light; one row of `jaxrefl.PunctualLights`."""

    name: str
    """Name, for messages."""
    intensity: tuple[float, float, float]
    """Radiant intensity (points, spots) or irradiance on a surface facing the light (directional)."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """World position; not used by directional lights."""
    direction: tuple[float, float, float] = (0.0, -1.0, 0.0)
    """Direction in which the light shines; not used by points."""
    directional: bool = False
    """True: parallel light."""
    cos_inner: float = -1.0
    """Cosine of the angle inside which a spot has its full intensity."""
    cos_outer: float = -2.0
    """Cosine of the angle outside which a spot is dark; below -1 for points."""
    angular_radius: float = 0.0
    """Half angle under which a directional light is seen, radians."""


@dataclass(frozen=True)
class Sky:
    """Light from infinitely far away: a latitude-longitude image (a constant sky is a 1-pixel image)."""

    radiance: np.ndarray
    """[eh ew 3] linear radiance, row 0 up, middle column along -Z."""
    world_from_map: np.ndarray = field(default_factory=lambda: np.eye(3))
    """[3 3] rotation from map to world directions."""
    name: str = "sky"
    """Name, for messages."""


def constant_sky(colour: Colour) -> Sky:
    """The same radiance from every direction.

    Args:
        colour: Linear radiance, >= 0.
    Returns:
        The sky.
    """
    return Sky(np.asarray(colour, np.float32).reshape(1, 1, 3), name="constant sky")


@dataclass(frozen=True)
class Description:
    """A whole scene before it becomes arrays."""

    name: str
    """Name of the scene."""
    parts: list[Part]
    """All triangles."""
    lights: list[PunctualLight] = field(default_factory=list)
    """Lights without a shape; those with one are parts whose material emits."""
    sky: Sky | None = None
    """Light from infinitely far away; None: black."""
    ambient: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Constant radiance from all directions, without shadows, on top of everything else."""
    cameras: dict[str, Camera] = field(default_factory=dict)
    """Cameras by name."""
    notes: list[str] = field(default_factory=list)
    """What was assumed, changed or ignored so far, one sentence each."""


def _triple(values: Colour) -> tuple[float, float, float]:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
