"""Scenes written for Mitsuba: materials; what Mitsuba sees in them, and what comes back when they are read again."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from mitsuba_scenes import mitsuba, rays_of, seen_by_mitsuba
from mitsuba_writing import CAMERA, SIZE, back, exported, notes_of, picture, scene_of, square

from jaxrefl.core import fresnel_conductor, fresnel_schlick, look_at
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import Image, PunctualLight, describe_file, emitter, export_mitsuba, glass, glossy, matte, mirror
from jaxrefl.scene.conductor_fit import fitted_conductor
from jaxrefl.scene.plastic import albedo_beneath, albedo_outside, internal_reflectance
from jaxrefl.surface import look

mi = mitsuba()
pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


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
