"""Mitsuba scene files: materials, compared with what Mitsuba makes of them."""

import math
from pathlib import Path

import numpy as np
import pytest
from mitsuba_reading import SIZE, SPHERE, described, notes_of, only_material, picture
from mitsuba_scenes import camera, mitsuba, write_png, write_scene
from PIL import Image as PillowImage

from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import load
from jaxrefl.scene.plastic import albedo_beneath, albedo_outside, internal_reflectance
from jaxrefl.surface import look

mi = mitsuba()
pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


GOLD = mi.traverse(mi.load_dict({"type": "conductor", "material": "Au"}))
BSDFS = {
    # xml: expected fields
    '<bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.2, 0.3"/></bsdf>': {
        "base_colour": (0.1, 0.2, 0.3), "eta": 1.0, "metallic": 0.0, "coupled": False,
    },
    '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>': {"base_colour": (0.5, 0.5, 0.5), "eta": 1.0},
    '<bsdf type="mask"><float name="opacity" value="0.3"/><bsdf type="diffuse"/></bsdf>': {"opacity": 0.3, "eta": 1.0},
    '<bsdf type="plastic"><float name="int_ior" value="1.8"/><float name="ext_ior" value="1.2"/><boolean '
    'name="nonlinear" value="true"/><rgb name="diffuse_reflectance" value="0.1, 0.2, 0.3"/></bsdf>': {
        "base_colour": (0.1, 0.2, 0.3), "eta": 1.5, "alpha": 0.0, "coupled": True, "metallic": 0.0,
    },
    '<bsdf type="roughplastic"><string name="distribution" value="ggx"/><float name="alpha" value="0.2"/></bsdf>': {
        "eta": 1.49 / 1.000277, "alpha": 0.2, "coupled": True,
    },
    '<bsdf type="conductor"><string name="material" value="none"/></bsdf>': {
        "metallic": 1.0, "alpha": 0.0, "conductor": ((0, 0, 0), (1, 1, 1)), "base_colour": (1, 1, 1),
    },
    '<bsdf type="roughconductor"><string name="material" value="Au"/><rgb name="specular_reflectance" '
    'value="0.5, 0.6, 0.7"/><string name="distribution" value="ggx"/><float name="alpha_u" value="0.1"/>'
    '<float name="alpha_v" value="0.4"/></bsdf>': {
        "metallic": 1.0, "alpha": 0.2, "base_colour": (0.5, 0.6, 0.7),
        "conductor": tuple(tuple(np.asarray(GOLD[f"{key}.value"]).tolist()) for key in ("eta", "k")),
    },
    '<bsdf type="conductor"><rgb name="eta" value="1, 2, 3"/><rgb name="k" value="4, 5, 6"/></bsdf>': {
        "conductor": ((1, 2, 3), (4, 5, 6)),
    },
    '<bsdf type="dielectric"><string name="int_ior" value="water"/><float name="ext_ior" value="1"/></bsdf>': {
        "eta": 1.333, "transmission": 1.0, "base_colour": (1, 1, 1), "alpha": 0.0, "thin": False,
    },
    '<bsdf type="roughdielectric"><float name="alpha" value="0.3"/><float name="int_ior" value="1.5"/>'
    '<float name="ext_ior" value="1"/></bsdf>': {"eta": 1.5, "transmission": 1.0, "alpha": 0.3},
    '<bsdf type="thindielectric"><float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf>': {
        "eta": 1.5, "transmission": 1.0, "thin": True,
    },
    '<bsdf type="principled"><rgb name="base_color" value="0.1, 0.2, 0.3"/><float name="metallic" value="0.7"/>'
    '<float name="roughness" value="0.4"/><float name="specular" value="0.5"/></bsdf>': {
        "base_colour": (0.1, 0.2, 0.3), "metallic": 0.7, "alpha": 0.16, "eta": 1.5, "transmission": 0.0,
    },
    '<bsdf type="principled"><rgb name="base_color" value="0.25, 0.64, 1"/><float name="spec_trans" value="1"/>'
    '<float name="eta" value="1.3"/></bsdf>': {"base_colour": (0.5, 0.8, 1), "eta": 1.3, "transmission": 1.0},
    '<bsdf type="bumpmap"><texture type="checkerboard"/><bsdf type="dielectric"/></bsdf>': {"transmission": 1.0},
    '<bsdf type="blendbsdf"><float name="weight" value="0.7"/><bsdf type="diffuse"/><bsdf type="conductor"/></bsdf>': {
        "metallic": 1.0,
    },
    '<bsdf type="hk"><rgb name="reflectance" value="0.1, 0.2, 0.3"/></bsdf>': {
        "base_colour": (0.1, 0.2, 0.3), "eta": 1.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("number", range(len(BSDFS)))
def test_each_material(tmp_path: Path, number: int):
    xml, expected = list(BSDFS.items())[number]
    material = only_material(tmp_path, xml)
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(material, name), value, rtol=1e-5, err_msg=name)


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        ('<bsdf type="roughconductor" id="tin"/>', "distribution beckmann"),
        ('<bsdf type="plastic" id="tin"/>', "nonlinear = false: tin"),
        (
            '<bsdf type="plastic" id="tin"><float name="specular_reflectance" value="0.5"/></bsdf>',
            "specular_reflectance",
        ),
        ('<bsdf type="roughconductor"><float name="alpha_u" value="0.2"/></bsdf>', "geometric mean"),
        ('<bsdf type="hk" id="tin"/>', "hk is not known here; a matte surface of its colour is shown: tin"),
        ('<bsdf type="bumpmap" id="tin"><bsdf type="diffuse"/></bsdf>', "bump maps are ignored: tin"),
        ('<bsdf type="blendbsdf" id="tin"><bsdf type="diffuse"/><bsdf type="plastic"/></bsdf>', "heavier"),
        ('<bsdf type="principled" id="tin"><float name="clearcoat" value="1"/></bsdf>', "clearcoat is ignored: tin"),
        ('<bsdf type="coating"><bsdf type="diffuse"/></bsdf>', "coating is ignored; the material beneath it"),
        ('<bsdf type="diffuse" id="tin"><rgb name="reflectance" value="2, 1, 1"/></bsdf>', "set to 1: diffuse 'tin'"),
        ('<bsdf type="diffuse" id="tin"/>', "black back in Mitsuba (no twosided around them)"),
    ],
)
def test_what_is_approximated_is_noted(tmp_path: Path, xml: str, words: str):
    assert words in notes_of(tmp_path, SPHERE.format(xml))


def test_one_note_for_all_that_is_one_sided(tmp_path: Path):
    shapes = [SPHERE.format(f'<bsdf type="diffuse" id="m{i}"/>') for i in range(9)]
    notes = described(tmp_path, *shapes).notes
    assert sum("black back" in note for note in notes) == 1
    assert "m0, m1, m2, m3, m4 and 4 more" in " ".join(notes)


def test_an_index_below_one_turns_the_triangles_around(tmp_path: Path):
    bsdf = '<bsdf type="dielectric"><float name="int_ior" value="1"/><float name="ext_ior" value="1.25"/></bsdf>'
    (part,) = described(tmp_path, SPHERE.format(bsdf)).parts
    corners = part.vertices[part.faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert part.material.eta == pytest.approx(1.25) and ((facing * corners.mean(1)).sum(1) < 0).all()


def test_plastic_without_nonlinear_looks_as_in_mitsuba(tmp_path: Path):
    """The same diffuse factor rho / (1 - r), with the albedo of a coupled material."""
    rho, eta = np.array([0.1, 0.5, 0.9]), 1.5
    material = only_material(
        tmp_path,
        '<bsdf type="plastic"><float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/>'
        f'<rgb name="diffuse_reflectance" value="{rho[0]}, {rho[1]}, {rho[2]}"/></bsdf>',
    )
    r = internal_reflectance(eta)
    found = np.array(material.base_colour)
    np.testing.assert_allclose(found / (1 - found * r), rho / (1 - r), rtol=1e-6)
    # Mitsuba's own fit of the same integral; its error is 0.0005
    assert r == pytest.approx(mi.fresnel_diffuse_reflectance(1 / eta), abs=1e-3)
    np.testing.assert_allclose(albedo_beneath(albedo_outside(rho, eta), eta), rho, rtol=1e-12)


def test_absorption_inside_glass(tmp_path: Path):
    glass = (
        '<bsdf type="dielectric"/><medium name="interior" type="homogeneous"><rgb name="sigma_t" value="1, 2, 3"/>'
        '<float name="albedo" value="0"/><float name="scale" value="0.5"/></medium>'
    )
    assert only_material(tmp_path, glass).attenuation == pytest.approx((0.5, 1, 1.5))
    assert "ignored" in notes_of(tmp_path, SPHERE.format(glass.replace("dielectric", "diffuse")))


def test_roughness_and_normal_textures(tmp_path: Path):
    picture(tmp_path, channels=1)
    bitmap = (
        '<texture type="bitmap" name="{}"><string name="filename" value="picture.png"/>'
        '<boolean name="raw" value="true"/></texture>'
    )
    rough = only_material(
        tmp_path,
        f'<bsdf type="roughconductor"><string name="distribution" value="ggx"/>{bitmap.format("alpha")}</bsdf>',
    )
    stored = np.asarray(PillowImage.open(tmp_path / "picture.png")) / 255
    assert rough.metallic_roughness_texture is not None
    packed = rough.metallic_roughness_texture.rgba / 255
    np.testing.assert_allclose(
        rough.alpha * packed[..., 1] ** 2, stored, atol=5e-3
    )  # measured worst case 0.0037, of 8-bit square roots
    assert (packed[..., 2] == 1).all() and rough.metallic == 1
    bumpy = only_material(tmp_path, f'<bsdf type="normalmap">{bitmap.format("normalmap")}<bsdf type="diffuse"/></bsdf>')
    assert bumpy.normal_texture is not None
    np.testing.assert_array_equal(bumpy.normal_texture.rgba[..., 0] / 255, stored)


def test_normal_maps_tilt_as_in_mitsuba(tmp_path: Path):
    """Also on a mirrored shape, whose texture runs the other way round."""
    write_png(tmp_path / "n.png", np.full((2, 2, 3), (200, 90, 220)))
    bsdf = (
        '<bsdf type="twosided"><bsdf type="normalmap"><texture name="normalmap" type="bitmap"><string name="filename" '
        'value="n.png"/><boolean name="raw" value="true"/></texture><bsdf type="diffuse"/></bsdf></bsdf>'
    )
    path = write_scene(
        tmp_path,
        camera(),
        f'<shape type="rectangle"><transform name="to_world"><rotate z="1" angle="25"/></transform>{bsdf}</shape>',
    )
    scene = load(path)
    gbuffer = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0])
    tilted = np.asarray(gbuffer.ns)[SIZE[1] // 2, SIZE[0] // 2]
    local = np.array([200, 90, 220]) / 127.5 - 1
    local /= np.linalg.norm(local)
    # Mitsuba's frame: s along growing u (the rectangle's X), t = cross(n, s)
    angle = math.radians(25)
    s, t = np.array([math.cos(angle), math.sin(angle), 0]), np.array([-math.sin(angle), math.cos(angle), 0])
    np.testing.assert_allclose(tilted, local[0] * s + local[1] * t + local[2] * np.array([0, 0, 1]), atol=1e-5)
