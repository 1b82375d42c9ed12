"""Mitsuba scene files: shapes and cameras, compared with what Mitsuba makes of them."""

from pathlib import Path

import numpy as np
import pytest
from mitsuba_reading import SIZE, SPHERE, TURN, described, picture
from mitsuba_scenes import camera, mitsuba, rays_of, seen_by_mitsuba, write_scene

from jaxrefl.rays import EmbreeTracer, camera_rays
from jaxrefl.scene import describe_file, load
from jaxrefl.surface import look

mi = mitsuba()
pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


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
