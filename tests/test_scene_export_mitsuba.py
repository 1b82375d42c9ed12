"""Scenes written for Mitsuba: what Mitsuba sees in them, and what comes back when they are read again."""

import os
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from mitsuba_scenes import mitsuba, rays_of, seen_by_mitsuba

from jaxrefl import Camera, Scene
from jaxrefl.core import fresnel_conductor, fresnel_schlick, look_at
from jaxrefl.rays import EmbreeTracer, camera_rays
from jaxrefl.scene import (
    Description,
    Image,
    Material,
    Part,
    PunctualLight,
    SceneError,
    SceneWarning,
    Sky,
    assemble,
    constant_sky,
    describe_file,
    emitter,
    environment_radiance,
    export_mitsuba,
    glass,
    glossy,
    load,
    matte,
    mirror,
)
from jaxrefl.scene.conductor_fit import fitted_conductor
from jaxrefl.scene.plastic import albedo_beneath, albedo_outside, internal_reflectance
from jaxrefl.surface import look
from pipelines import cli

mi = mitsuba()
quiet = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")
pytestmark = quiet

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


# --- geometry and cameras ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("smooth", [True, False])
def test_mitsuba_sees_what_we_see(tmp_path: Path, smooth: bool):
    """Positions, sides, textured albedo and emission, at the same pixels."""
    coloured = matte("a.b", (0.9, 0.6, 0.3)).replace(base_colour_texture=picture())
    normals = {"normals": np.array([[0, 0.2, 1], [0.2, 0, 1], [0, 0, 1], [0.1, 0.1, 1.0]])} if smooth else {}
    scene, path = exported(
        tmp_path,
        square(coloured, **normals),
        square(matte("blue", (0.1, 0.2, 0.9)), at=(1.2, 0.3, -1)),
        Part("lamp", SQUARE * 0.3 + (-1, 1, 0.5), QUAD, emitter("lamp", (3, 2, 1)).replace(emits_back=False)),
    )
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), CAMERA), seen_by_mitsuba(mi, path, SIZE)
    np.testing.assert_array_equal(gbuffer.valid, expected["valid"])
    np.testing.assert_allclose(gbuffer.p, expected["p"], atol=1e-5)
    np.testing.assert_array_equal(np.asarray(gbuffer.outside)[gbuffer.valid], expected["front"][gbuffer.valid])
    cosine = (np.asarray(gbuffer.ns) * expected["ns"]).sum(-1)[np.asarray(gbuffer.valid) & expected["front"]]
    assert cosine.min() > 0.9999
    # measured worst case 0.0024: the factor is baked into 8-bit sRGB
    np.testing.assert_allclose(gbuffer.base_colour, expected["albedo"], atol=5e-3)
    np.testing.assert_allclose(gbuffer.emission, expected["emission"], rtol=1e-6)


def test_cameras_come_back_and_are_mitsubas(tmp_path: Path):
    one = look_at((1, 2, 3), (0, 0.3, 0), fov_y=37, size=SIZE)
    shifted = Camera(one.world_from_camera, one.focal, one.centre + jnp.asarray([1.5, -2.0]), *SIZE)
    scene = scene_of(square(matte("m", (1, 1, 1))))
    path = export_mitsuba(scene, tmp_path / "out", camera=[one, shifted])
    found = describe_file(path).cameras
    assert list(found) == ["frame_0000", "frame_0001"]
    sensors = mi.load_file(str(path)).sensors()
    for camera, again, sensor in zip((one, shifted), found.values(), sensors, strict=True):
        assert (again.width, again.height) == SIZE
        for name in ("world_from_camera", "focal", "centre"):
            np.testing.assert_allclose(getattr(again, name), getattr(camera, name), rtol=2e-6, atol=2e-6)
        _, directions = rays_of(mi, sensor, SIZE)
        np.testing.assert_allclose(camera_rays(camera).direction, directions, atol=2e-6)  # measured 2e-7


def test_geometry_comes_back(tmp_path: Path, rng: np.random.Generator):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    ball, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces)
    scene, path = exported(
        tmp_path,
        Part("ball", ball, faces, matte("red", (1, 0, 0)), normals=ball, uv=rng.random((len(ball), 2))),
        square(matte("map", (1, 1, 1)).replace(base_colour_texture=picture())),
        square(mirror("ball"), name="ball", at=(0, 0, 2)),
    )
    again = load(path)
    assert set(again.names.materials) == {"red", "map", "ball"} and "square" in again.names.objects

    def corners(scene: Scene, name: str) -> np.ndarray:
        mesh = scene.mesh
        rows = np.flatnonzero(np.asarray(mesh.material) == scene.names.materials.index(name))
        columns = [np.asarray(a)[np.asarray(mesh.faces)[rows]] for a in (mesh.vertices, mesh.normals, mesh.uv)]
        return np.concatenate(columns, -1)

    for name in scene.names.materials:
        np.testing.assert_allclose(corners(again, name), corners(scene, name), atol=1e-6)


def test_vertex_colours(tmp_path: Path, rng: np.random.Generator):
    colours = rng.random((4, 3))
    part = square(matte("m", (0.5, 0.6, 0.7)), colours=colours)
    scene, path = exported(tmp_path, part)
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), CAMERA), seen_by_mitsuba(mi, path, SIZE)
    np.testing.assert_allclose(gbuffer.base_colour, expected["albedo"], atol=1e-5)
    (again,) = describe_file(path).parts
    assert again.colours is not None
    expected_colours = (colours * (0.5, 0.6, 0.7))[QUAD]  # flat triangles come back with vertices of their own
    np.testing.assert_allclose(again.colours[again.faces], expected_colours, atol=1e-6)


def test_ids_are_shared_by_all_that_has_one(tmp_path: Path):
    parts = [square(matte(name, (1, 1, 1)), name="sky") for name in ("sky", "camera", "sky (2)", "a.b")]
    scene, path = exported(tmp_path, *parts, sky=constant_sky((1, 1, 1)))
    assert set(describe_file(path).cameras) == {"camera (2)"}
    assert set(load(path).names.materials) == {"sky", "camera", "sky (2)", "a_b"}
    mi.load_file(str(path))  # which refuses ids that are not unique


# --- materials -----------------------------------------------------------------------------------------------------

EXACT = {
    "matte": matte("m", (0.1, 0.2, 0.3)),
    "coupled plastic": glossy("m", (0.1, 0.2, 0.3), alpha=0.0, eta=1.6).replace(coupled=True),
    "rough coupled plastic": glossy("m", (0.1, 0.2, 0.3), alpha=0.2, eta=1.6).replace(coupled=True),
    "known metal": mirror("m", colour=(0.9, 0.8, 0.7)).replace(conductor=((0.2, 0.9, 1.1), (3.9, 2.4, 2.2)), alpha=0.3),
    "glass": glass("m", eta=1.4, colour=(0.9, 0.8, 0.7), attenuation=(0.5, 1, 2)),
    "rough glass": glass("m", eta=1.4, alpha=0.2),
    "thin glass": glass("m", eta=1.4).replace(thin=True),
    "cut out": matte("m", (0.1, 0.2, 0.3)).replace(opacity=0.4),
    "one-sided lamp": emitter("m", (3, 2, 1)).replace(emits_back=False),
    "lamp": emitter("m", (3, 2, 1)),
}


@pytest.mark.parametrize("name", EXACT)
def test_materials_that_mitsuba_knows_come_back(tmp_path: Path, name: str):
    material = EXACT[name]
    again = back(tmp_path, material)
    for field, value in vars(material).items():
        if field == "alpha" and not material.reflective:
            continue
        if value is None or isinstance(value, str | bool):
            assert getattr(again, field) == value, field
        else:
            np.testing.assert_allclose(getattr(again, field), value, rtol=1e-6, err_msg=field)


@pytest.mark.parametrize("slot", ["base_colour_texture", "normal_texture", "opacity_texture", "emission_texture"])
def test_textures_come_back(tmp_path: Path, slot: str):
    image = picture()
    material = matte("m", (1, 1, 1)).replace(**{slot: image}, emission=(2, 2, 2) if "emission" in slot else (0, 0, 0))
    again = getattr(back(tmp_path, material.replace(emits_back=False)), slot)
    assert again is not None and again.repeat == (True, True)
    channels = [3] if "opacity" in slot else [0, 1, 2]
    stored, came = image.rgba[..., channels].astype(int), again.rgba[..., channels].astype(int)
    if "emission" in slot:  # an EXR, whose largest value is now the factor
        assert np.abs(stored * 1.0 / stored.max() - came / came.max()).max() < 6e-3
    else:
        np.testing.assert_array_equal(came, stored)


def test_an_index_that_is_not_known_is_fitted_to_schlick():
    cos = jnp.linspace(0.01, 1, 100)
    for f0, most in ((0.02, 0.03), (0.1, 0.03), (0.3, 0.03), (0.6, 0.03), (0.9, 0.03), (0.99, 0.005), (1.0, 1e-6)):
        eta, k, error = fitted_conductor(f0)
        found = fresnel_conductor(cos, jnp.full(100, eta), jnp.full(100, k))
        difference = np.abs(np.asarray(found - fresnel_schlick(cos, jnp.full(100, f0)))).max()
        assert difference <= error + 1e-5 and error <= most
        assert float(found[-1]) == pytest.approx(f0, abs=1e-5)


@pytest.mark.parametrize("f0", [0.0, 1e-6, 0.02, 0.5, 0.95, 0.999999, 1.0])
def test_fitted_indices_are_finite(f0: float):
    eta, k, error = fitted_conductor(f0)
    assert np.isfinite([eta, k, error]).all() and eta >= 0 and k >= 0


def test_metals_are_fitted_and_say_how_well(tmp_path: Path):
    material = mirror("chrome", colour=(0.95, 0.6, 0.2)).replace(alpha=0.3)
    again = back(tmp_path, material)
    assert again.metallic == 1 and again.alpha == pytest.approx(0.3) and again.conductor is not None
    eta, k = np.array(again.conductor)
    np.testing.assert_allclose(((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2), material.base_colour, rtol=1e-5)
    said = notes_of(tmp_path, square(material))
    assert f"difference over the angle is {max(fitted_conductor(f)[2] for f in material.base_colour):.3f}" in said


def test_plastic_that_is_not_coupled_returns_its_albedo_in_mitsuba(tmp_path: Path):
    """Mean diffuse albedo of the light that enters, by quadrature over both directions."""
    base, eta = np.array([0.1, 0.5, 0.9]), 1.5
    _, path = exported(tmp_path, square(glossy("m", base, alpha=0.0, eta=eta)))
    bsdf = mi.load_file(str(path)).shapes()[0].bsdf()
    context, si, total, steps = mi.BSDFContext(), mi.SurfaceInteraction3f(), np.zeros(3), 24
    sines = np.sqrt((np.arange(steps) + 0.5) / steps)  # uniform in the projected solid angle
    for i in sines:
        si.wi = [i, 0, np.sqrt(1 - i * i)]
        for o in sines:
            value = np.asarray(bsdf.eval(context, si, [0, o, np.sqrt(1 - o * o)]))
            total += value / np.sqrt(1 - o * o) * np.pi / steps**2
    entered = (1 - internal_reflectance(eta)) * eta**2
    # measured worst case 0.5 %, of Mitsuba's own fit of the internal reflectance and of the quadrature
    np.testing.assert_allclose(total / entered, base, rtol=1e-2)
    again = describe_file(path).parts[0].material
    np.testing.assert_allclose(albedo_outside(np.array(again.base_colour), eta), base, rtol=1e-5)


def test_textures_of_plastic_are_changed_texel_by_texel(tmp_path: Path):
    image = picture()
    material = glossy("m", (1, 1, 1), alpha=0.1).replace(base_colour_texture=image)
    scene, path = exported(tmp_path, square(material))
    gbuffer = look(scene, EmbreeTracer(scene.mesh), CAMERA)
    flat = np.full((2, 2, 4), image.rgba[3, 4])
    again = back(tmp_path, material.replace(base_colour_texture=Image("flat", flat)))
    assert again.base_colour_texture is not None
    levels = np.where(flat / 255 <= 0.04045, flat / 255 / 12.92, ((flat / 255 + 0.055) / 1.055) ** 2.4)[0, 0, :3]
    coded = again.base_colour_texture.rgba[0, 0, :3] / 255
    found = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(found, albedo_beneath(levels, 1.5), atol=4e-3)  # half a step of 8-bit sRGB
    assert gbuffer.coupled is None and mi.load_file(str(path)) is not None


def test_opacity_in_mitsuba(tmp_path: Path):
    scene, path = exported(tmp_path, square(matte("m", (1, 1, 1)).replace(opacity=0.8, opacity_texture=picture())))
    gbuffer = look(scene, EmbreeTracer(scene.mesh), CAMERA)
    assert gbuffer.opacity is not None
    loaded = mi.load_file(str(path))
    origins, directions = rays_of(mi, loaded.sensors()[0], SIZE)
    for index in zip(*np.nonzero(np.asarray(gbuffer.valid)), strict=True):
        ray = mi.Ray3f(origins[index].tolist(), directions[index].tolist())
        si = loaded.ray_intersect(ray)
        passed = float(np.asarray(si.bsdf(mi.RayDifferential3f(ray)).eval_null_transmission(si))[0])
        assert 1 - passed == pytest.approx(float(gbuffer.opacity[index]), abs=4e-3)  # 8 bits: 0.002


@pytest.mark.parametrize("z", [3.0, -3.0])
@pytest.mark.parametrize("both", [True, False])
def test_both_sides_shine_without_speckles(tmp_path: Path, z: float, both: bool):
    lamp = emitter("lamp", (3, 2, 1)).replace(emits_back=both)
    scene = scene_of(square(lamp), square(matte("wall", (1, 1, 1)), at=(0, 0, -8)))
    camera = look_at((0.3, 0.2, z), (0, 0, 0), size=SIZE)
    path = export_mitsuba(scene, tmp_path / "out", camera=camera)
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), camera), seen_by_mitsuba(mi, path, SIZE)
    np.testing.assert_allclose(gbuffer.emission, expected["emission"], rtol=1e-6)
    assert expected["emission"].any() == (both or z > 0)


def test_varying_roughness_and_metalness(tmp_path: Path):
    image = picture()
    metal_only = image.rgba.copy()
    metal_only[..., 2] = 255
    rough = mirror("m").replace(alpha=0.8, metallic_roughness_texture=Image("r", metal_only))
    again = back(tmp_path, rough)
    assert again.metallic == 1 and again.metallic_roughness_texture is not None
    expected = 0.8 * (metal_only[..., 1] / 255) ** 2
    packed = again.metallic_roughness_texture.rgba / 255
    np.testing.assert_allclose(again.alpha * packed[..., 1] ** 2, expected, atol=6e-3)  # twice 8 bits: 0.006
    mixed = glossy("m", (0.5, 0.5, 0.5), alpha=0.81, metallic=0.9).replace(metallic_roughness_texture=image)
    again = back(tmp_path, mixed)
    assert again.metallic_roughness_texture is not None and again.eta == pytest.approx(1.5)
    packed = again.metallic_roughness_texture.rgba / 255
    np.testing.assert_allclose(packed[..., 1], 0.9 * image.rgba[..., 1] / 255, atol=3e-3)
    np.testing.assert_allclose(packed[..., 2], 0.9 * image.rgba[..., 2] / 255, atol=3e-3)
    assert "become principled" in notes_of(tmp_path, square(mixed))


ODD = {
    "partly metallic": (glossy("m", (0.5, 0.4, 0.3), alpha=0.2, metallic=0.4), ""),
    "partly transmissive": (glass("m").replace(transmission=0.3, alpha=0.1), ""),
    "all at once": (glass("m").replace(transmission=0.3, metallic=0.2), ""),
    "rough thin": (glass("m", alpha=0.2).replace(thin=True), "rough thin panes"),
    "textured metal": (mirror("m").replace(base_colour_texture=picture()), "do not become white"),
    "normal map": (glossy("m", (1, 1, 1), alpha=0.1).replace(normal_texture=picture(), normal_scale=0.5), "tilt in"),
    "cut out glass": (glass("m").replace(opacity=0.5, opacity_texture=picture()), ""),
    "textured lamp": (emitter("m", (5, 4, 3)).replace(emission_texture=picture()), "black mesh"),
    "mixed wrap": (
        matte("m", (1, 1, 1)).replace(base_colour_texture=Image("i", picture().rgba, (True, False))),
        "repeat in one direction",
    ),
    "black metal": (mirror("m", colour=(0, 0, 0)), "fitted"),
    "rough glass of index 1": (glass("m", eta=1.0, alpha=0.3), ""),
    "glass of index 1": (glass("m", eta=1.0), ""),
    "varying glass": (glass("m").replace(metallic_roughness_texture=picture()), "become principled"),
    "index 1 metal": (mirror("m").replace(eta=1.0), ""),
}


@pytest.mark.parametrize("name", ODD)
def test_everything_loads_in_mitsuba_and_is_noted(tmp_path: Path, name: str):
    material, words = ODD[name]
    assert words in notes_of(tmp_path, square(material), lights=[PunctualLight("l", (9, 9, 9), position=(0, 0, 2))])
    image = np.asarray(mi.render(mi.load_file(str(tmp_path / "out" / "scene.xml"), spp=4)))
    assert image.shape == (SIZE[1], SIZE[0], 3) and np.isfinite(image).all()


def test_blends_have_the_shares_of_the_material(tmp_path: Path):
    material = glossy("m", (0.5, 0.5, 0.5), alpha=0.3, metallic=0.25).replace(transmission=0.4)
    _, path = exported(tmp_path, square(material))
    text = path.read_text()
    weights = [float(line.split('value="')[1].split('"')[0]) for line in text.splitlines() if 'name="weight"' in line]
    # (1 - w) is the metal's share; of the rest (1 - w) is glass
    np.testing.assert_allclose(weights, [0.75, 0.6], rtol=1e-6)


# --- lights --------------------------------------------------------------------------------------------------------


def test_lights_come_back(tmp_path: Path):
    lights = [
        PunctualLight("p", (1, 2, 3), position=(1, 2, 3)),
        PunctualLight("s", (3, 2, 1), direction=(0.6, -0.8, 0), directional=True, angular_radius=0.01),
        PunctualLight("c", (5, 5, 5), position=(0, 3, 0), direction=(0, -0.6, 0.8), cos_inner=0.9, cos_outer=0.7),
    ]
    said = notes_of(tmp_path, square(matte("m", (1, 1, 1))), lights=lights, ambient=(0.1, 0.1, 0.1))
    for words in ("hard shadows: light 1", "fades linearly with the angle", "ambient term"):
        assert words in said
    found = describe_file(tmp_path / "out" / "scene.xml").lights
    for light, again in zip(lights, found, strict=True):
        assert again.directional == light.directional
        for field in ("intensity", "direction", "cos_inner", "cos_outer") + (("position",) * (not light.directional)):
            if light.cos_outer >= -1 or light.directional or field in ("intensity", "position"):
                np.testing.assert_allclose(getattr(again, field), getattr(light, field), rtol=1e-5, atol=1e-6)


def test_skies_come_back_and_look_as_in_mitsuba(tmp_path: Path, rng: np.random.Generator):
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(128) + 0.5) / 128, indexing="ij")
    d = np.stack([np.sin(np.pi * v) * np.cos(2 * np.pi * u), np.cos(np.pi * v), np.sin(np.pi * v)], -1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    sky = Sky((1.5 + d).astype(np.float32), turn * np.sign(np.linalg.det(turn)))
    scene, path = exported(tmp_path, square(matte("m", (1, 1, 1))), sky=sky)
    again = describe_file(path).sky
    assert again is not None and scene.lights.environment is not None
    np.testing.assert_allclose(again.world_from_map, sky.world_from_map, atol=1e-6)
    np.testing.assert_array_equal(again.radiance, sky.radiance)
    directions = rng.normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    emitter_of_mitsuba, expected = mi.load_file(str(path)).environment(), []
    for direction in directions.tolist():
        si = mi.SurfaceInteraction3f()
        si.wi = [-c for c in direction]
        expected.append(np.asarray(emitter_of_mitsuba.eval(si)))
    ours = environment_radiance(scene.lights.environment, jnp.asarray(directions, jnp.float32))
    # half a row, see the reader's test: pi / 128 = 0.025; measured worst case 0.024
    np.testing.assert_allclose(ours, np.array(expected), atol=0.026)


def test_constant_skies(tmp_path: Path):
    _, path = exported(tmp_path, square(matte("m", (1, 1, 1))), sky=constant_sky((0.1, 0.2, 0.3)))
    again = describe_file(path).sky
    assert again is not None
    np.testing.assert_allclose(again.radiance[0, 0], [0.1, 0.2, 0.3], rtol=1e-6)


# --- files and the command -----------------------------------------------------------------------------------------


def test_a_folder_of_others_is_refused_and_an_own_one_written_again(tmp_path: Path):
    scene = scene_of(square(matte("m", (1, 1, 1))))
    path = export_mitsuba(scene, tmp_path / "a" / "b", camera=CAMERA)
    first = path.read_text()
    assert export_mitsuba(scene, tmp_path / "a" / "b", camera=CAMERA) == path and path.read_text() == first
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "scene.xml").write_text("<scene version='3.0.0'/>")
    for folder, words in ((tmp_path / "c", "is not empty"), (tmp_path / "c" / "scene.xml", "got a file")):
        with pytest.raises(SceneError, match=words):
            export_mitsuba(scene, folder, camera=CAMERA)
    assert (tmp_path / "c" / "scene.xml").read_text() == "<scene version='3.0.0'/>"


@pytest.mark.parametrize("name", ["samples", "max_depth"])
@pytest.mark.parametrize("value", [0, -1, True])
def test_numbers_are_checked(tmp_path: Path, name: str, value):
    with pytest.raises(SceneError, match=f"{name}: expected a whole number"):
        export_mitsuba(scene_of(square(matte("m", (1, 1, 1)))), tmp_path, camera=CAMERA, **{name: value})


def test_a_camera_is_needed(tmp_path: Path):
    with pytest.raises(SceneError, match="expected a camera"):
        export_mitsuba(scene_of(square(matte("m", (1, 1, 1)))), tmp_path)


def test_no_mitsuba_is_needed_to_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "mitsuba", None)
    assert exported(tmp_path, square(matte("m", (1, 1, 1))))[1].is_file()


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    words = f"export cornell --to mitsuba --frames 2 --size 32 24 --samples 4 --max-depth 5 --out {out}"
    with warnings.catch_warnings():
        warnings.simplefilter("always", SceneWarning)
        assert cli.main(words.split()) == 0
    said = capsys.readouterr()
    assert said.out.strip() == str(out / "scene.xml") and "ambient term" in said.err
    scene = mi.load_file(str(out / "scene.xml"), spp=1)
    assert len(scene.sensors()) == 2 and list(scene.sensors()[1].film().size()) == [32, 24]
    assert (out / "scene.xml").read_text().count('name="spp" value="4"') == 1
    again = load(out / "scene.xml")
    assert again.names.cameras == ("frame_0000", "frame_0001") and again.features.emissive
    assert cli.main(f"export cornell --out {tmp_path}".split()) == 2
    assert "is not empty" in capsys.readouterr().err
    assert cli.main(["export", "cornell"]) == 2 and "--out DIR" in capsys.readouterr().err


def test_the_command_keeps_the_size_of_the_scenes_camera(tmp_path: Path):
    path = export_mitsuba(scene_of(square(matte("m", (1, 1, 1)))), tmp_path / "a", camera=CAMERA)
    assert cli.main(f"export {path} --out {tmp_path / 'b'}".split()) == 0
    (camera,) = describe_file(tmp_path / "b" / "scene.xml").cameras.values()
    assert (camera.width, camera.height) == SIZE


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["gltf-ToyCar/ToyCar.gltf", "gltf-GlassVaseFlowers/GlassVaseFlowers.glb", "living-room/scene.xml"]
)
def test_real_scenes_are_written_and_read(tmp_path: Path, name: str):
    path = Path(os.environ.get("JAXREFL_SCENES", "nowhere")) / name
    if not path.is_file():
        pytest.skip(f"{name} is not there: set JAXREFL_SCENES to the folder of real scene files")
    scene = load(path)
    written = export_mitsuba(scene, tmp_path / "out", camera=scene.cameras[0] if scene.cameras else CAMERA)
    again = load(written)
    assert again.mesh.faces.shape == scene.mesh.faces.shape
    assert set(again.names.materials) == set(scene.names.materials)
    np.testing.assert_allclose(again.lower, scene.lower, atol=1e-5 * float(jnp.abs(scene.upper).max()))
    mi.load_file(str(written))
