"""Shared vocabulary: what flows between the stages.

Everything here is an `equinox.Module` (a PyTree of arrays) with jaxtyping shapes. Conventions that hold for every
type: linear Rec.709 radiance, float32, `[h w c]` with row 0 on top and pixel centres at +0.5; a right-handed world in
any unit; cameras look along -Z with +Y up; `wo` (to the viewer) and `wi` (to the reflected scene) are unit vectors that
both point away from the surface. Validity is a boolean mask beside the data; what an invalid element holds is
written down as its fill value and is always finite.

`*b` is any batch shape: `h w` for images, `n` for a list of rays. `v f` are mesh vertices and faces, `m` materials.
"""

import dataclasses
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int, UInt8


class Camera(eqx.Module):
    """Pinhole camera, camera-to-world, looking along -Z with +Y up (OpenGL, Blender, NeRF)."""

    world_from_camera: Float[Array, "4 4"]
    """Rigid camera-to-world transform."""
    focal: Float[Array, "2"]
    """Focal lengths (x, y) in pixels, > 0."""
    centre: Float[Array, "2"]
    """Principal point (x, y) in pixels, from the top left corner of the image."""
    width: int = eqx.field(static=True)
    """Image width in pixels."""
    height: int = eqx.field(static=True)
    """Image height in pixels."""


class Rays(eqx.Module):
    """Half lines in world space."""

    origin: Float[Array, "*b 3"]
    """Start point, world space."""
    direction: Float[Array, "*b 3"]
    """Unit direction, world space."""


class Hits(eqx.Module):
    """Closest intersections of a batch of rays with the scene's triangles."""

    valid: Bool[Array, "*b"]
    """True where the ray hit a triangle; every other field is 0 elsewhere."""
    t: Float[Array, "*b"]
    """Distance along the unit ray, world units; fill 0."""
    triangle: Int[Array, "*b"]
    """Row in `Mesh.faces`; fill 0."""
    barycentric: Float[Array, "*b 2"]
    """Weights (u, v) of the triangle's second and third vertex; fill 0."""


class Mesh(eqx.Module):
    """All triangles of a scene in world space; what a scene does not have is None and costs nothing."""

    vertices: Float[Array, "v 3"]
    """Positions, world space."""
    faces: Int[Array, "f 3"]
    """Vertex indices, counter-clockwise seen from the outside."""
    material: Int[Array, "f"]
    """Row in `Materials`."""
    object: Int[Array, "f"]
    """Row in `Scene.names.objects`."""
    normals: Float[Array, "v 3"] | None = None
    """Unit shading normals; None: every triangle is flat."""
    uv: Float[Array, "v 2"] | None = None
    """Texture coordinates, (0, 0) at the top left of the image as in glTF; None: no texture in the scene."""
    tangents: Float[Array, "v 4"] | None = None
    """Unit tangents and handedness as in glTF; None: no normal map in the scene."""
    colours: Float[Array, "v 3"] | None = None
    """Linear vertex colours that multiply the base colour; None: there are none."""


class Conductors(eqx.Module):
    """Complex indices of refraction of metals, per material or point; `base_colour` then multiplies the reflectance."""

    known: Bool[Array, "*b"]
    """True: this material's Fresnel term is that of eta + i k; False: Schlick's with F0 = `base_colour`."""
    eta: Float[Array, "*b 3"]
    """Real part of the index per channel, >= 0; 0 with k = 1 reflects everything; fill 0."""
    k: Float[Array, "*b 3"]
    """Imaginary part (absorption) per channel, >= 0; fill 1."""


class Materials(eqx.Module):
    """Table of metallic-roughness materials; one row per material. Textures multiply the row's value."""

    base_colour: Float[Array, "m 3"]
    """Diffuse albedo of a dielectric, specular colour (F0) of a metal; linear, in [0, 1]."""
    metallic: Float[Array, "m"]
    """0 dielectric to 1 metal."""
    alpha: Float[Array, "m"]
    """GGX width in [0, 1] (perceptual roughness squared); 0 is a perfect mirror."""
    eta: Float[Array, "m"]
    """Index of refraction, >= 1; exactly 1 with `metallic` 0 is a matte surface without any reflection."""
    transmission: Float[Array, "m"]
    """Share of the non-reflected light that is refracted instead of scattered diffusely, in [0, 1]."""
    attenuation: Float[Array, "m 3"]
    """Absorption coefficient inside the volume, per world unit, >= 0."""
    thin: Bool[Array, "m"]
    """True: transmission passes straight through (a pane without volume)."""
    emission: Float[Array, "m 3"]
    """Emitted radiance, linear, >= 0; both sides."""
    base_colour_texture: Int[Array, "m"]
    """Row in `Textures` (sRGB), -1 for none."""
    metallic_roughness_texture: Int[Array, "m"]
    """Row in `Textures` (G perceptual roughness, B metallic), -1 for none."""
    normal_texture: Int[Array, "m"]
    """Row in `Textures` (tangent space normals), -1 for none."""
    normal_scale: Float[Array, "m"]
    """Factor on the x and y of the normal map."""
    emission_texture: Int[Array, "m"]
    """Row in `Textures` (sRGB), -1 for none."""
    textured: tuple[str, ...] = eqx.field(static=True)
    """Names of the texture columns that any material uses; the others are not looked up."""
    emits_back: Bool[Array, "m"] | None = None
    """True: both sides emit, False: only the side the triangle faces; None: all emit from both sides."""
    conductor: Conductors | None = None
    """Complex indices of refraction; None: every metal's Fresnel term is Schlick's."""
    coupled: Bool[Array, "m"] | None = None
    """True: diffuse light passes the interface twice and bounces beneath it, as in plastic; None: for no material."""
    opacity: Float[Array, "m"] | None = None
    """Share of the light that meets the surface, in [0, 1], before `opacity_texture`; None: everything is opaque."""
    opacity_texture: Int[Array, "m"] | None = None
    """Row in `Textures` whose alpha channel is the opacity, -1 for none; None with `opacity`."""


class Textures(eqx.Module):
    """All images of a scene, 8 bits per channel, one after another in a flat list of texels."""

    texels: UInt8[Array, "n 4"]
    """RGBA, row by row, row 0 on top."""
    offset: Int[Array, "k"]
    """First texel of each image."""
    width: Int[Array, "k"]
    """Width of each image in texels."""
    height: Int[Array, "k"]
    """Height of each image in texels."""
    srgb: Bool[Array, "k"]
    """True: the RGB channels are sRGB-coded and are decoded before filtering."""
    repeat: Bool[Array, "k 2"]
    """Wrap mode for (u, v): True repeats, False clamps to the edge."""


class Environment(eqx.Module):
    """Light from infinitely far away on a latitude-longitude map, with tables for importance sampling."""

    radiance: Float[Array, "eh ew 3"]
    """Linear radiance; row 0 looks up (+Y of the map), the middle column looks along -Z of the map."""
    world_from_map: Float[Array, "3 3"]
    """Rotation that takes map directions to world directions."""
    row_cdf: Float[Array, "eh"]
    """Cumulative probability of the rows, last element 1."""
    column_cdf: Float[Array, "eh ew"]
    """Cumulative probability of the columns in each row, last element 1."""
    probability: Float[Array, "eh ew"]
    """Probability of each texel; sums to 1."""


class AreaLights(eqx.Module):
    """Emissive triangles with a distribution proportional to their power."""

    triangle: Int[Array, "e"]
    """Rows in `Mesh.faces`."""
    cdf: Float[Array, "e"]
    """Cumulative probability, last element 1."""
    probability: Float[Array, "e"]
    """Probability of each triangle; sums to 1."""
    area: Float[Array, "e"]
    """Triangle areas, world units squared."""
    textured: bool = eqx.field(static=True, default=False)
    """True: some of them have an emission texture; static, so that others are not looked up."""


class PunctualLights(eqx.Module):
    """Lights without a shape: points, spots, and directional lights with an angular radius (the sun)."""

    position: Float[Array, "p 3"]
    """World position; 0 for directional lights."""
    direction: Float[Array, "p 3"]
    """Unit direction in which the light shines (spots and directional lights), world space."""
    intensity: Float[Array, "p 3"]
    """Radiant intensity (points, spots) or irradiance on a surface facing the light (directional)."""
    directional: Bool[Array, "p"]
    """True: parallel light from `-direction`; False: falls off with the squared distance from `position`."""
    cos_inner: Float[Array, "p"]
    """Cosine of the angle inside which a spot has its full intensity; -1 for points."""
    cos_outer: Float[Array, "p"]
    """Cosine of the angle outside which a spot is dark; below -1 for points."""
    angular_radius: Float[Array, "p"]
    """Half angle under which a directional light is seen, radians; 0 gives hard shadows."""


class Lights(eqx.Module):
    """Everything that emits; what a scene does not have is None and costs nothing."""

    ambient: Float[Array, "3"]
    """Constant radiance from all directions, without shadows, on top of the other lights."""
    area: AreaLights | None = None
    """Emissive triangles; None: nothing emits."""
    punctual: PunctualLights | None = None
    """Point, spot and directional lights; None: there are none."""
    environment: Environment | None = None
    """Light from infinitely far away; None: there is none."""


@dataclasses.dataclass(frozen=True)
class Features:
    """What is in a scene. Static: code for what is absent is not traced, not precomputed, not stored."""

    planar: bool = False
    """A reflector made of coplanar triangles with a flat shading normal."""
    curved: bool = False
    """A reflector that is not planar."""
    glossy: bool = False
    """A reflector with alpha > 0."""
    refractive: bool = False
    """A material with transmission > 0."""
    textured: bool = False
    """A material with a base colour, metallic-roughness or emission texture."""
    normal_mapped: bool = False
    """A material with a normal map."""
    vertex_coloured: bool = False
    """A mesh with vertex colours."""
    emissive: bool = False
    """Triangles that emit light."""
    punctual: bool = False
    """Point, spot or directional lights."""
    environment_lit: bool = False
    """An environment map or a constant sky."""
    conductive: bool = False
    """A metal with a complex index of refraction."""
    coupled: bool = False
    """A material whose diffuse light passes its interface twice (plastic)."""
    cut_out: bool = False
    """A material with an opacity below 1, such as leaves on a card."""
    moving: bool = False
    """Objects that move between frames."""


@dataclasses.dataclass(frozen=True)
class Names:
    """What the indices mean. Static and compared by value."""

    scene: str
    """Name of the scene, from its file or its generator."""
    objects: tuple[str, ...]
    """One name per object index."""
    materials: tuple[str, ...]
    """One name per material index."""
    cameras: tuple[str, ...] = ()
    """One name per camera in `Scene.cameras`."""
    notes: tuple[str, ...] = ()
    """What was assumed, changed or ignored on import, one sentence each."""


class LightMap(eqx.Module):
    """Diffuse light at every surface of a scene, baked into a texture; see `radiance.lightmap`."""

    light: Float[Array, "s lh lw 3"]
    """Light before the albedo (irradiance / pi), of the side the triangles face and, if there are two layers, of the
    other side; 0 where nothing was baked."""
    uv: Float[Array, "f 3 2"]
    """Corners of each triangle in the texture, in texels, centres at +0.5; all 0: the triangle has no place."""
    fingerprint: str = eqx.field(static=True)
    """Digest of the geometry, materials and lights that the map was baked for."""
    options: str = eqx.field(static=True)
    """The options it was baked with, as JSON."""


class Scene(eqx.Module):
    """A scene as arrays: geometry, materials, textures, lights, and what it takes to render them."""

    mesh: Mesh
    """All triangles."""
    materials: Materials
    """One row per material."""
    lights: Lights
    """Everything that emits."""
    textures: Textures | None
    """None: nothing is textured."""
    lower: Float[Array, "3"]
    """Smallest coordinates of the bounding box, world space."""
    upper: Float[Array, "3"]
    """Largest coordinates of the bounding box, world space."""
    cameras: tuple[Camera, ...]
    """Cameras that came with the scene, named by `names.cameras`; may be empty."""
    features: Features = eqx.field(static=True)
    """What is in the scene; absent features cost nothing."""
    names: Names = eqx.field(static=True)
    """What the indices mean, and what was noted on import."""
    lightmap: LightMap | None = None
    """Baked diffuse light; None: there is none."""


@runtime_checkable
class Tracer(Protocol):
    """Answers ray queries; see `jaxrefl.rays.EmbreeTracer` and `jaxrefl.rays.BruteTracer`."""

    rays: int
    """How many rays have been cast so far."""

    def closest(self, rays: Rays, *, active: Bool[Array, "*b"] | None = None) -> Hits:
        """Closest hit of each ray; rays that are not `active` are not cast and come back as misses."""
        ...

    def closest_rows(self, rays: Rays, first: int, count: int) -> Hits:
        """Closest hits of `count` rows of an image of rays, from row `first` on."""
        ...

    def occluded(self, rays: Rays, t_max: Float[Array, "*b"]) -> Bool[Array, "*b"]:
        """True where something lies on the ray closer than `t_max`; rays with `t_max <= 0` are not cast."""
        ...


class GBuffer(eqx.Module):
    """What is seen at each pixel or at the end of each ray; a field is None where the scene has no such feature."""

    valid: Bool[Array, "*b"]
    """True where the ray hit a surface."""
    p: Float[Array, "*b 3"]
    """Position, world space; fill 0."""
    p_error: Float[Array, "*b"]
    """Bound on the rounding error of `p`, world units, for `rays.offset_origin`; fill 0."""
    n: Float[Array, "*b 3"]
    """Geometric unit normal on the viewer's side; fill (0, 0, 1)."""
    ns: Float[Array, "*b 3"]
    """Shading unit normal on the viewer's side; fill (0, 0, 1)."""
    wo: Float[Array, "*b 3"]
    """Unit direction to the viewer; also set where the ray missed."""
    t: Float[Array, "*b"]
    """Distance from the ray's origin, world units; fill 0."""
    z_camera: Float[Array, "*b"] | None
    """Depth along the camera's axis, world units; fill 0; None for rays that are not a camera's."""
    base_colour: Float[Array, "*b 3"]
    """Base colour; fill 0."""
    metallic: Float[Array, "*b"]
    """Metalness; fill 0."""
    alpha: Float[Array, "*b"]
    """GGX width; fill 0."""
    eta: Float[Array, "*b"]
    """Index of refraction of the surface's inside; fill 1."""
    outside: Bool[Array, "*b"]
    """True where the viewer is on the side the triangle faces (its inside is the denser medium); fill True."""
    object: Int[Array, "*b"]
    """Object index; fill -1."""
    material: Int[Array, "*b"]
    """Material index; fill -1."""
    triangle: Int[Array, "*b"]
    """Triangle index; fill -1."""
    emission: Float[Array, "*b 3"] | None = None
    """Emitted radiance towards the viewer; fill 0; None: nothing emits."""
    transmission: Float[Array, "*b"] | None = None
    """Transmission; fill 0; None: nothing is refractive."""
    motion: Float[Array, "*b 2"] | None = None
    """Where the surface point was in the previous frame minus where it is now, (x, y) in pixels; fill 0."""
    conductor: Conductors | None = None
    """Complex index at each point; fill `known` False; None: no metal has one."""
    coupled: Bool[Array, "*b"] | None = None
    """True where diffuse light passes the interface twice; fill False; None: nowhere."""
    opacity: Float[Array, "*b"] | None = None
    """Share of the light that meets the surface; fill 1; None: everything is opaque."""


class Reflection(eqx.Module):
    """What every technique returns, usually [h w]: light that arrives at a surface from the reflected scene."""

    radiance: Float[Array, "*b 3"]
    """Incoming radiance, averaged over the specular lobe, *before* Fresnel and specular colour; fill 0."""
    valid: Bool[Array, "*b"]
    """True where the pixel shows a reflective surface and the technique knows its reflection."""
    source: Int[Array, "*b"]
    """Where the radiance comes from, a `jaxrefl.Source` code."""
    confidence: Float[Array, "*b"]
    """How far the technique trusts the pixel, 0 to 1; fill 0."""
    p: Float[Array, "*b 3"]
    """Reflected point, world space; fill 0 where `source` is NONE or ENVIRONMENT."""
    t: Float[Array, "*b"]
    """Distance from the reflector to the reflected point, world units; fill 0 as for `p`."""
    transmitted: Float[Array, "*b 3"] | None = None
    """Radiance that arrives through the surface along the refracted ray, *before* the transmission weight; fill 0;
    None: the scene has no refractive material."""


class Frame(eqx.Module):
    """What a technique's `step` is given for one image."""

    scene: Scene
    """The scene."""
    camera: Camera
    """Camera of this frame."""
    gbuffer: GBuffer
    """What the camera sees [h w]."""
    key: Array
    """Random key of this frame."""
    tracer: Tracer = eqx.field(static=True)
    """Ray queries against `scene.mesh`, on the host."""
    ahead: Camera | None = None
    """Camera of the next key frame, for techniques that look ahead (`Technique.ahead`); None: it is not known."""


Size = Sequence[int]
"""Image size (width, height) in pixels."""
