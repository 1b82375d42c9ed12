"""Mitsuba scene files: geometry, cameras, textures, materials and lights, compared with what Mitsuba makes of them."""

import math
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from mitsuba_scenes import camera, mitsuba, rays_of, seen_by_mitsuba, write_png, write_scene
from PIL import Image as PillowImage

from jaxrefl.core import resize
from jaxrefl.rays import EmbreeTracer, camera_rays
from jaxrefl.scene import (
    Description,
    Material,
    SceneError,
    assemble,
    describe_file,
    environment_radiance,
    load,
    texture_rgba,
)
from jaxrefl.scene.mitsuba import describe_mitsuba
from jaxrefl.scene.mitsuba_shapes import SEGMENTS
from jaxrefl.scene.mitsuba_textures import CHECKERBOARD
from jaxrefl.scene.plastic import albedo_beneath, albedo_outside, internal_reflectance
from jaxrefl.surface import look

mi = mitsuba()
pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")

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


# --- geometry ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flip", ["false", "true"])
@pytest.mark.parametrize("scale", ['<scale x="1.2" y="0.8" z="1"/>', '<scale x="-1" y="1" z="1"/>'])
@pytest.mark.parametrize("kind", ["rectangle", "cube", "sphere", "disk", "cylinder", "obj", "obj flat", "ply"])
def test_shapes_are_where_mitsuba_has_them(tmp_path: Path, kind: str, scale: str, flip: str):
    """Positions, sides and texture coordinates at the pixels of a picture."""
    if kind == "sphere" and "1.2" in scale:
        scale = '<scale value="1.2"/>'  # Mitsuba refuses ellipsoids
    if kind == "cylinder" and "1.2" in scale:
        scale = '<scale x="0.8" y="0.8" z="1.5"/>'
    plugin, more = kind.split()[0], ""
    if plugin in ("obj", "ply"):
        (tmp_path / "m.obj").write_text(
            "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0.3\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
        )
        mi.load_dict({"type": "obj", "filename": str(tmp_path / "m.obj")}).write_ply(str(tmp_path / "m.ply"))
        more = f'<string name="filename" value="m.{plugin}"/><boolean name="face_normals" value="{"flat" in kind}"/>'
        more = more.replace("True", "true").replace("False", "false")
    picture(tmp_path)
    texture = '<texture type="bitmap" name="reflectance"><string name="filename" value="picture.png"/></texture>'
    path = write_scene(
        tmp_path,
        camera(origin="0.3, 0.5, 4"),
        f'<shape type="{plugin}">{more}{TURN.format(scale)}<boolean name="flip_normals" value="{flip}"/>'
        f'<bsdf type="twosided"><bsdf type="diffuse">{texture}</bsdf></bsdf></shape>',
    )
    expected = seen_by_mitsuba(mi, path, SIZE)
    scene = load(path)
    gbuffer = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0])
    both = np.asarray(gbuffer.valid) & expected["valid"]
    # the silhouettes of tessellated shapes lie a little further inside: at most 1 of the 384 pixels was seen to differ
    assert (np.asarray(gbuffer.valid) != expected["valid"]).sum() <= 2
    assert both.sum() > 40
    found = np.asarray(gbuffer.p)[both]
    # measured worst case 0.0058 where a chord is seen at a grazing angle, 1.6e-5 (Mitsuba's float32) on flat shapes
    np.testing.assert_allclose(found, expected["p"][both], atol=1e-2 if plugin in ("sphere", "cylinder") else 5e-5)
    assert np.mean(np.asarray(gbuffer.outside)[both] == expected["front"][both]) > 0.99
    side = np.where(expected["front"], 1, -1)[..., None]
    cosine = (np.asarray(gbuffer.ns) * expected["ns"] * side).sum(-1)[both]
    assert np.quantile(cosine, 0.02) > 0.999
    difference = np.abs(np.asarray(gbuffer.base_colour) - expected["albedo"])[both]
    assert np.quantile(difference, 0.97) < 0.02, np.quantile(difference, [0.5, 0.9, 0.97])


def test_instances_and_groups(tmp_path: Path):
    path = write_scene(
        tmp_path,
        camera(),
        '<shape type="shapegroup" id="group"><shape type="cube" id="box"><transform name="to_world">'
        '<scale value="0.4"/><rotate y="1" angle="30"/></transform></shape><shape type="rectangle"/></shape>',
        '<shape type="instance"><ref id="group"/><transform name="to_world"><scale x="-1" y="1" z="1"/>'
        '<translate x="0.9"/></transform></shape>',
        '<shape type="instance"><ref id="group"/><transform name="to_world"><translate x="-0.9"/></transform></shape>',
    )
    scene = load(path)
    assert scene.names.objects == ("box", "rectangle", "box (2)", "rectangle (2)")
    expected = seen_by_mitsuba(mi, path, SIZE)
    gbuffer = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0])
    np.testing.assert_array_equal(gbuffer.valid, expected["valid"])
    np.testing.assert_allclose(gbuffer.p, expected["p"], atol=1e-5)


def test_flat_meshes_stay_flat_and_smooth_ones_smooth(tmp_path: Path):
    import trimesh

    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.obj", include_normals=False)
    shape = (
        '<shape type="obj"><string name="filename" value="ball.obj"/><boolean name="face_normals" value="{}"/></shape>'
    )
    (flat,) = described(tmp_path, shape.format("true")).parts
    (smooth,) = described(tmp_path, shape.format("false")).parts
    assert flat.normals is not None and smooth.normals is not None
    assert flat.vertices.shape == (960, 3) and smooth.vertices.shape == (162, 3)
    corners = flat.vertices[flat.faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    np.testing.assert_allclose(flat.normals[flat.faces], np.repeat(facing[:, None], 3, 1), atol=1e-6)


def test_vertex_colours(tmp_path: Path):
    colours = np.array([[0.1, 0.2, 0.3], [1, 0, 0], [0, 1, 0]])
    rows = "\n".join(
        f"{x} {y} 0 {r} {g} {b}" for (x, y), (r, g, b) in zip([(0, 0), (1, 0), (0, 1)], colours, strict=True)
    )
    header = "".join(f"property float {name}\n" for name in "x y z r g b".split())
    (tmp_path / "t.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 3\n{header}element face 1\nproperty list uchar int vertex_indices\n"
        f"end_header\n{rows}\n3 0 1 2\n"
    )
    bsdf = (
        '<bsdf type="diffuse"><texture type="mesh_attribute" name="reflectance">'
        '<string name="name" value="vertex_color"/></texture></bsdf>'
    )
    (part,) = described(tmp_path, f'<shape type="ply"><string name="filename" value="t.ply"/>{bsdf}</shape>').parts
    assert part.colours is not None
    np.testing.assert_allclose(part.colours[np.argsort(part.vertices @ [1, 2, 0])], colours, atol=1e-6)


# --- cameras -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "film"),
    [
        ("", ""),
        ('<string name="fov_axis" value="y"/>', ""),
        ('<string name="fov_axis" value="diagonal"/>', ""),
        ('<string name="fov_axis" value="smaller"/>', ""),
        ('<string name="fov_axis" value="larger"/>', ""),
        (
            '<float name="principal_point_offset_x" value="0.1"/><float name="principal_point_offset_y" value="-0.2"/>',
            "",
        ),
        (
            "",
            '<integer name="crop_offset_x" value="3"/><integer name="crop_offset_y" value="5"/>'
            '<integer name="crop_width" value="12"/><integer name="crop_height" value="8"/>',
        ),
    ],
)
def test_camera_rays_are_mitsubas(tmp_path: Path, more: str, film: str):
    path = write_scene(
        tmp_path, camera(origin="1, 2, 3", target="0.3, -0.2, -1", more=more, film=film), SPHERE.format("")
    )
    (name,), (ours,) = describe_file(path).cameras.keys(), describe_file(path).cameras.values()
    assert name == "eye" and (ours.width, ours.height) == ((12, 8) if film else SIZE)
    origins, directions = rays_of(mi, mi.load_file(str(path)).sensors()[0], (ours.width, ours.height))
    rays = camera_rays(ours)
    np.testing.assert_allclose(rays.direction, directions, atol=2e-6)  # measured worst case 2e-7
    assert np.abs(np.cross(origins - np.asarray(rays.origin), directions)).max() < 1e-5


def test_focal_lengths_and_other_sensors(tmp_path: Path):
    film = '<film type="hdrfilm"><integer name="width" value="30"/><integer name="height" value="20"/></film>'
    path = write_scene(
        tmp_path,
        f'<sensor type="perspective"><string name="focal_length" value="35mm"/>{film}</sensor>',
        f'<sensor type="thinlens" id="lens"><float name="fov" value="40"/>'
        f'<float name="aperture_radius" value="0.1"/>{film}</sensor>',
        f'<sensor type="orthographic" id="flat">{film}</sensor>',
        SPHERE.format(""),
    )
    description = describe_file(path)
    assert list(description.cameras) == ["camera 0", "lens"]
    _, directions = rays_of(mi, mi.load_file(str(path)).sensors()[0], (30, 20))
    np.testing.assert_allclose(camera_rays(description.cameras["camera 0"]).direction, directions, atol=2e-6)
    said = " | ".join(description.notes)
    assert "no depth of field" in said and "orthographic are ignored: flat" in said


# --- textures ------------------------------------------------------------------------------------------------------


def test_two_texels_lie_as_in_mitsuba(tmp_path: Path):
    write_png(tmp_path / "two.png", [[[255, 0, 0]], [[0, 0, 255]]])
    settings = {"type": "bitmap", "filename": str(tmp_path / "two.png"), "filter_type": "nearest"}
    texture, si = mi.load_dict(settings), mi.SurfaceInteraction3f()
    scene = load(
        write_scene(
            tmp_path,
            '<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
            '<string name="filename" value="two.png"/></texture></bsdf></shape>',
        )
    )
    assert scene.textures is not None
    for v in (0.25, 0.75):
        si.uv = [0.5, v]
        ours = texture_rgba(scene.textures, jnp.zeros(1, jnp.int32), jnp.asarray([[0.5, v]], jnp.float32))
        np.testing.assert_allclose(ours[0, :3], np.asarray(texture.eval(si)), atol=1e-6)


@pytest.mark.parametrize("raw", ["true", "false"])
@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_coding_wrapping_and_the_transform_of_textures(tmp_path: Path, raw: str, wrap: str):
    picture(tmp_path)
    texture = (
        '<texture type="bitmap" name="reflectance"><string name="filename" value="picture.png"/>'
        f'<boolean name="raw" value="{raw}"/><string name="wrap_mode" value="{wrap}"/>'
        '<transform name="to_uv"><scale x="1.5" y="-2"/><rotate z="1" angle="20"/><translate x="0.2" y="0.1"/>'
        "</transform></texture>"
    )
    path = write_scene(tmp_path, camera(), f'<shape type="rectangle"><bsdf type="diffuse">{texture}</bsdf></shape>')
    scene = load(path)
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0]), seen_by_mitsuba(mi, path, SIZE)
    # measured worst cases: 0.004 for raw pictures, which are coded with 8 bits anew, and 3e-6 for the others
    tolerance = 8e-3 if raw == "true" else 1e-4
    np.testing.assert_allclose(gbuffer.base_colour, expected["albedo"], atol=tolerance)


def test_checkerboards(tmp_path: Path):
    texture = (
        '<texture type="checkerboard" name="reflectance"><rgb name="color0" value="0.9, 0.5, 0.1"/>'
        '<rgb name="color1" value="0.1, 0.2, 0.3"/><transform name="to_uv"><scale x="3" y="2"/></transform></texture>'
    )
    path = write_scene(tmp_path, camera(), f'<shape type="rectangle"><bsdf type="diffuse">{texture}</bsdf></shape>')
    scene = load(path)
    gbuffer, expected = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0]), seen_by_mitsuba(mi, path, SIZE)
    np.testing.assert_allclose(
        gbuffer.base_colour, expected["albedo"], atol=4e-3
    )  # measured worst case 0.0037, half a step of 8-bit sRGB
    assert str(CHECKERBOARD) in " ".join(scene.names.notes)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_opacity_is_what_mitsuba_takes_of_a_bitmap(tmp_path: Path, channels: int):
    path = picture(tmp_path, channels=channels)
    material = only_material(
        tmp_path,
        '<bsdf type="mask" id="leaf"><texture type="bitmap" name="opacity"><string name="filename" '
        'value="picture.png"/></texture><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>',
    )
    mask = mi.load_dict(
        {"type": "mask", "opacity": {"type": "bitmap", "filename": str(path)}, "nested": {"type": "diffuse"}}
    )
    assert material.name == "leaf" and material.opacity == 1 and material.opacity_texture is not None
    alpha = material.opacity_texture.rgba[..., 3]
    si = mi.SurfaceInteraction3f()
    si.wi = [0, 0, 1]
    for row, column in np.ndindex(8, 8):
        si.uv = [(column + 0.5) / 8, (row + 0.5) / 8]
        passed = float(np.asarray(mask.eval_null_transmission(si))[0])
        assert alpha[row, column] / 255 == pytest.approx(1 - passed, abs=3e-3)  # half a step is 0.002


# --- materials -----------------------------------------------------------------------------------------------------

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


# --- lights --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flip", ["false", "true"])
@pytest.mark.parametrize("scale", ["1, 1, 1", "-1, 1, 1"])
@pytest.mark.parametrize("kind", ["rectangle", "disk", "sphere", "cube"])
def test_area_lights_shine_from_the_side_that_mitsuba_lets_shine(tmp_path: Path, kind: str, scale: str, flip: str):
    path = write_scene(
        tmp_path,
        camera(origin="0.4, 0.7, 3"),
        f'<shape type="{kind}"><boolean name="flip_normals" value="{flip}"/><transform name="to_world">'
        f'<scale value="{scale}"/></transform><emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter>'
        "</shape>",
    )
    expected = seen_by_mitsuba(mi, path, SIZE)
    scene = load(path)
    assert scene.materials.emits_back is not None and not scene.materials.emits_back.any()
    np.testing.assert_allclose(scene.materials.emission[0], [1, 2, 3])
    gbuffer = look(scene, EmbreeTracer(scene.mesh), scene.cameras[0])
    both = np.asarray(gbuffer.valid) & expected["valid"]
    assert both.sum() > 40
    np.testing.assert_array_equal(np.asarray(gbuffer.outside)[both], expected["emission"][both].max(-1) > 0)
    np.testing.assert_array_equal(np.asarray(gbuffer.base_colour)[both], expected["albedo"][both])  # black


def write_smooth_map(folder: Path) -> Path:
    """A map whose colour is an affine function of the direction, with another gradient in each channel."""
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(128) + 0.5) / 128, indexing="ij")
    polar, azimuth = np.pi * v, 2 * np.pi * u
    d = np.stack([np.sin(polar) * np.cos(azimuth), np.cos(polar), np.sin(polar) * np.sin(azimuth)], -1)
    path = folder / "sky.exr"
    mi.Bitmap((1 + 0.9 * d).astype(np.float32)).write(str(path))
    return path


@pytest.mark.parametrize(
    "transform",
    [
        "",
        '<rotate y="1" angle="70"/>',
        '<rotate x="1" angle="130"/><rotate z="1" angle="50"/>',
        '<scale x="-1" y="1" z="1"/><rotate x="1" angle="40"/>',
    ],
)
def test_environment_maps_are_turned_as_in_mitsuba(tmp_path: Path, transform: str, rng: np.random.Generator):
    write_smooth_map(tmp_path)
    path = write_scene(
        tmp_path,
        SPHERE.format(""),
        '<emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale" value="2.5"/>'
        f'<transform name="to_world">{transform}</transform></emitter>',
    )
    scene, emitter = load(path), mi.load_file(str(path)).environment()
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    expected = []
    for d in directions.tolist():
        si = mi.SurfaceInteraction3f()
        si.wi = [-c for c in d]
        expected.append(np.asarray(emitter.eval(si)))
    assert scene.lights.environment is not None
    ours = environment_radiance(scene.lights.environment, jnp.asarray(directions, jnp.float32))
    # Mitsuba puts the first and last row at the poles and not half a row beside them: up to half a row is between the
    # two, 2.5 * 0.9 * pi / 128 = 0.055; measured worst case 0.052. A wrong turn is off by up to 4.5.
    np.testing.assert_allclose(ours, np.array(expected), atol=0.056)


def test_punctual_lights_and_constant_skies(tmp_path: Path):
    description = described(
        tmp_path,
        SPHERE.format(""),
        '<emitter type="point" id="lamp"><point name="position" x="1" y="2" z="3"/>'
        '<rgb name="intensity" value="1,2,3"/></emitter>',
        '<emitter type="directional"><vector name="direction" x="0" y="-2" z="0"/>'
        '<spectrum name="irradiance" value="3"/></emitter>',
        '<emitter type="spot"><transform name="to_world"><lookat origin="0, 3, 0" target="0, 0, 0" up="1, 0, 0"/>'
        '</transform><float name="cutoff_angle" value="40"/><float name="beam_width" value="30"/>'
        '<rgb name="intensity" value="5"/></emitter>',
        '<emitter type="constant"><rgb name="radiance" value="0.1, 0.2, 0.3"/></emitter>',
        '<emitter type="projector"/>',
    )
    point, sun, spot = description.lights
    assert (point.name, point.position, point.intensity) == ("lamp", (1, 2, 3), (1, 2, 3))
    assert sun.directional and sun.direction == (0, -1, 0)
    grey_of_spectrum = mi.load_dict({"type": "directional", "irradiance": {"type": "spectrum", "value": 3.0}})
    assert np.asarray(sun.intensity) == pytest.approx(
        np.broadcast_to(np.asarray(mi.traverse(grey_of_spectrum)["irradiance.value"]), 3), rel=1e-5
    )
    np.testing.assert_allclose(spot.direction, [0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(spot.position, [0, 3, 0], atol=1e-6)
    np.testing.assert_allclose([spot.cos_inner, spot.cos_outer], np.cos(np.radians([30, 40])))
    assert description.sky is not None
    np.testing.assert_allclose(description.sky.radiance, np.reshape([0.1, 0.2, 0.3], (1, 1, 3)), rtol=1e-6)
    assert "projector are ignored" in " ".join(description.notes)


# --- files ---------------------------------------------------------------------------------------------------------


def test_old_versions_defaults_includes_and_unused_properties(tmp_path: Path):
    (tmp_path / "parts").mkdir()
    picture(tmp_path / "parts")
    (tmp_path / "parts" / "more.xml").write_text(
        '<scene version="0.6.0"><bsdf type="diffuse" id="paint"><texture type="bitmap" name="reflectance">'
        '<string name="filename" value="picture.png"/><boolean name="highQualityEdges" value="true"/></texture></bsdf>'
        '<shape type="sphere"><float name="radius" value="$size"/><ref id="paint"/></shape></scene>'
    )
    path = write_scene(
        tmp_path,
        '<default name="size" value="2"/>',
        '<integrator type="path"><integer name="maxDepth" value="4"/></integrator>',
        '<include filename="parts/more.xml"/>',
        '<shape type="disk" id="lid"><transform name="toWorld"><scale value="0.5"/></transform></shape>',
        '<shape type="hair"/>',
        version="0.5.0",
    )
    description = describe_file(path)
    ball, lid = description.parts
    assert ball.material.name == "paint" and ball.material.base_colour_texture is not None
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 2, rtol=1e-6)
    assert lid.name == "lid" and np.abs(lid.vertices).max() == pytest.approx(0.5)
    assert "shapes of the type hair are left out" in " ".join(description.notes)
    with pytest.raises(RuntimeError):
        mi.load_file(str(path))  # Mitsuba itself refuses it


def test_overrides_by_the_ids_of_materials(tmp_path: Path):
    path = write_scene(tmp_path, SPHERE.format('<bsdf type="twosided" id="paint"><bsdf type="diffuse"/></bsdf>'))
    (part,) = describe_file(path, overrides={"materials": {"paint": {"kind": "mirror"}}}).parts
    assert part.material.metallic == 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("<shape", "Error parsing"),
        ('<shape type="sphere"><ref id="nothing"/></shape>', 'unresolved reference to "nothing"'),
        ('<float name="x" value="$unknown"/>', "undefined parameter"),
        ('<include filename="missing.xml"/>', "missing.xml"),
        ('<shape type="obj"><string name="filename" value="missing.obj"/></shape>', "missing.obj does not exist"),
        ('<shape type="sphere"/><emitter type="envmap"><string name="filename" value="no.exr"/></emitter>', "no.exr"),
        ('<shape type="sphere"><bsdf type="conductor"><string name="material" value="xy"/></bsdf></shape>', "xy"),
        ('<shape type="sphere"><float name="radius" value="nan"/></shape>', "radius: expected a finite number"),
        ('<shape type="hair"/>', "at least one triangle"),
    ],
)
def test_broken_files_are_refused_with_their_name(tmp_path: Path, content: str, words: str):
    path = write_scene(tmp_path, content)
    with pytest.raises(SceneError, match="room.xml") as caught:
        describe_file(path)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_a_broken_mesh_file_is_refused(tmp_path: Path):
    (tmp_path / "m.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    path = write_scene(tmp_path, '<shape type="ply"><string name="filename" value="m.ply"/></shape>')
    with pytest.raises(SceneError, match="room.xml"):
        describe_file(path)


@pytest.mark.parametrize("name", ["missing.png", "broken.png"])
def test_missing_textures_are_grey_and_noted(tmp_path: Path, name: str):
    (tmp_path / "broken.png").write_bytes(b"not a picture")
    path = write_scene(
        tmp_path,
        SPHERE.format(
            f'<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="{name}"/>'
            "</texture></bsdf>"
        ),
    )
    description = describe_file(path)
    assert description.parts[0].material.base_colour == (0.5, 0.5, 0.5)
    assert f"texture '{name}' left out" in " ".join(description.notes)


def test_mitsubas_settings_are_as_they_were(tmp_path: Path):
    path = write_scene(tmp_path, '<path value="."/>', SPHERE.format(""))
    mi.set_variant("scalar_spectral")
    try:
        before = (mi.variant(), str(mi.file_resolver()), mi.log_level())
        describe_file(path)
        assert (mi.variant(), str(mi.file_resolver()), mi.log_level()) == before
        write_scene(tmp_path, "<shape")
        with pytest.raises(SceneError):
            describe_file(path)
        assert (mi.variant(), str(mi.file_resolver()), mi.log_level()) == before
    finally:
        mi.set_variant("scalar_rgb")


def test_without_mitsuba_the_message_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(SceneError, match=r"pip install 'jaxrefl\[mitsuba\]'"):
        describe_file(write_scene(tmp_path, SPHERE.format("")))


def test_mitsuba_is_imported_only_when_it_is_needed():
    code = "import sys, jaxrefl; assert not {'mitsuba', 'jaxrefl.scene.mitsuba'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_render_material_tables_hold_what_was_read(tmp_path: Path):
    scene = assemble(
        described(
            tmp_path,
            SPHERE.format('<bsdf type="conductor"><string name="material" value="Au"/></bsdf>'),
            SPHERE.format('<bsdf type="plastic"/>'),
        )
    )
    assert scene.features.conductive and scene.features.coupled and not scene.features.emissive


# --- real scenes ---------------------------------------------------------------------------------------------------

REAL = {
    # folder: triangles of its mesh files and named materials, as its README.md says; triangles of rectangles and disks
    "living-room": (143163, 19, 0),
    "staircase2": (30911, 8, 5 * SEGMENTS + 8 * 2),
    "veach-bidir": (11540, 4, 2 * 2),
    "coffee": (235265, 5, 3 * 2),
    "teapot": (126048, 2, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_scenes(name: str):
    path = Path(os.environ.get("JAXREFL_SCENES", "nowhere")) / name / "scene.xml"
    if not path.is_file():
        pytest.skip(f"{name} is not there: set JAXREFL_SCENES to the folder of real scene files")
    triangles, materials, more = REAL[name]
    assert sum(len(part.faces) for part in describe_mitsuba(path).parts) == triangles + more
    start = time.perf_counter()
    scene = load(path)
    assert time.perf_counter() - start < 15  # measured 1.8 s for living-room; the rest is for a busy machine
    ids = set(re.findall(r'<bsdf [^>]*id="([^"]+)"', path.read_text()))
    assert len(ids) == materials and ids <= set(scene.names.materials)
    (camera,) = scene.cameras
    size = (camera.width // 40, camera.height // 40)
    seen, expected = look(scene, EmbreeTracer(scene.mesh), resize(camera, size)), seen_by_mitsuba(mi, path, size)
    both = np.asarray(seen.valid) & expected["valid"]
    near = np.linalg.norm(np.asarray(seen.p) - expected["p"], axis=-1) < 1e-4 * float(np.abs(scene.upper).max())
    assert both.mean() > 0.5 and near[both].mean() > 0.99
    albedo = np.abs(np.asarray(seen.base_colour) - expected["albedo"]).max(-1)[both & (seen.metallic == 0)]
    # measured 0.0019 on the teapot's checkerboard (8-bit colours), 3e-5 elsewhere; the rest is glass
    assert np.quantile(albedo, 0.9) < 3e-3
