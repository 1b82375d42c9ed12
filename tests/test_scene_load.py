"""From file to scene: units and axes, default light, overrides, and the inventory."""

import json
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scene_files import CUBE_OBJ, checker, quad_gltf, write_obj

from jaxrefl.core import look_at, project
from jaxrefl.scene import (
    Description,
    Image,
    Material,
    Part,
    PunctualLight,
    SceneWarning,
    assemble,
    describe_file,
    format_inventory,
    glass,
    inventory,
    load,
    matte,
    placed,
)

MTL = "newmtl wood\nKd 0.5 0.4 0.3\nnewmtl steel\nKd 0.1 0.1 0.1\nKs 0.9 0.9 0.9\nNs 198\n"
TWO_OBJECTS = (
    CUBE_OBJ.replace("o cube", "o table top\nusemtl wood") + "o leg 1\nusemtl steel\nf 1 2 3\no leg 2\nf 1 2 4\n"
)
quiet = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


def describe_with(folder: Path, toml: str) -> Description:
    path = write_obj(folder, TWO_OBJECTS, mtl=MTL)
    (folder / "scene.jaxrefl.toml").write_text(toml)
    return describe_file(path)


def materials(description: Description) -> dict[str, object]:
    return {part.name: part.material for part in description.parts}


@quiet
@pytest.mark.parametrize("suffix", ["ply", "stl", "stl_ascii", "obj", "glb"])
def test_the_same_ball_from_every_format(tmp_path: Path, suffix: str):
    ball = trimesh.creation.icosphere(subdivisions=2)
    path = tmp_path / f"ball.{suffix.removesuffix('_ascii')}"
    ball.export(str(path), file_type=suffix)
    scene = load(path)
    assert scene.mesh.faces.shape == (320, 3) and scene.mesh.normals is not None
    assert scene.mesh.vertices.shape == (162, 3)
    np.testing.assert_allclose(scene.upper, ball.bounds[1], atol=1e-6)
    # measured worst case 1.0e-4: the icosphere's triangles are not all alike
    np.testing.assert_allclose((scene.mesh.normals * scene.mesh.vertices).sum(1), 1, atol=2e-4)


@quiet
def test_vertex_colours_of_ply(tmp_path: Path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.visual.vertex_colors = np.tile(np.array([188, 0, 255, 255], np.uint8), (len(ball.vertices), 1))
    ball.export(str(tmp_path / "ball.ply"))
    scene = load(tmp_path / "ball.ply")
    assert scene.features.vertex_coloured and scene.mesh.colours is not None
    np.testing.assert_allclose(scene.mesh.colours[0], [0.5029, 0, 1], atol=1e-4)


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
def test_the_named_axis_points_up_and_the_world_stays_right_handed(up: str):
    corner = np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    triangle = np.stack([corner, np.roll(corner, 1), np.roll(corner, 2)])
    part = Part("t", triangle, np.array([[0, 1, 2]]), matte("m", (1, 1, 1)))
    moved = placed(Description("d", [part]), up=up).parts[0].vertices
    np.testing.assert_allclose(moved[0], [0, 1, 0])
    assert np.linalg.det(moved) == pytest.approx(np.linalg.det(triangle))


def test_units_change_numbers_but_not_the_picture():
    camera = look_at((1, 2, 5), (0, 0, 0), size=(64, 48))
    light = PunctualLight("lamp", (8.0, 8.0, 8.0), position=(0.0, 4.0, 0.0))
    part = Part("t", np.eye(3), np.array([[0, 1, 2]]), glass("g", attenuation=(1.0, 2.0, 3.0)))
    before = Description("d", [part], [light], cameras={"c": camera})
    after = placed(before, units=0.01, up="z")
    p, q = (jnp.asarray(d.parts[0].vertices, jnp.float32) for d in (before, after))
    np.testing.assert_allclose(project(after.cameras["c"], q)[0], project(camera, p)[0], atol=1e-3)
    lamp = after.lights[0]
    assert lamp.position == pytest.approx((0, 0, -0.04))
    # irradiance: intensity over squared distance
    assert lamp.intensity[0] / 0.04**2 == pytest.approx(light.intensity[0] / 4**2)
    assert np.array(after.parts[0].material.attenuation) * 0.01 == pytest.approx((1, 2, 3))


@pytest.mark.parametrize(
    ("fields", "lit"),
    [({}, True), ({"emissiveFactor": [1, 1, 1]}, False), ({"emissiveFactor": [1, 1, 1], "textured": True}, True)],
)
@quiet
def test_a_scene_without_light_gets_a_sky_and_says_so(tmp_path: Path, fields: dict, lit: bool):
    gltf = quad_gltf({})
    if fields.pop("textured", False):
        gltf.content |= {"images": [gltf.image(checker())], "textures": [{"source": 0}]}
        fields = {**fields, "emissiveTexture": {"index": 0}}
    gltf.content["materials"][0] |= fields
    scene = load(gltf.write(tmp_path / "a.glb"))
    assert (scene.lights.environment is not None) == lit
    assert any("constant sky of radiance 1 is added" in note for note in scene.names.notes) == lit
    if scene.lights.environment is not None:
        np.testing.assert_array_equal(scene.lights.environment.radiance, np.ones((1, 1, 3)))


def test_each_note_is_one_warning(tmp_path: Path):
    path = write_obj(tmp_path)
    with pytest.warns(SceneWarning) as caught:
        scene = load(path)
    assert [str(w.message) for w in caught] == [f"scene.obj: {note}" for note in scene.names.notes]


@quiet
def test_an_environment_map_lights_the_scene(tmp_path: Path):
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n"
    (tmp_path / "sky.hdr").write_bytes(header + bytes([128, 128, 128, 130]) * 8)
    scene = load(write_obj(tmp_path), environment=tmp_path / "sky.hdr")
    assert scene.lights.environment is not None and scene.lights.environment.radiance.shape == (2, 4, 3)
    assert not any("no light" in note for note in scene.names.notes)
    turned = load(write_obj(tmp_path), overrides={"environment": str(tmp_path / "sky.hdr"), "environment_rotation": 90})
    assert turned.lights.environment is not None
    # a quarter turn counter-clockwise seen from above takes the middle of the map from -Z to -X
    rotation = np.asarray(turned.lights.environment.world_from_map)
    np.testing.assert_allclose(rotation @ [0, 0, -1], [-1, 0, 0], atol=1e-6)


@quiet
def test_overrides_beside_the_file_are_found_and_can_be_left_out(tmp_path: Path):
    description = describe_with(tmp_path, '[materials.wood]\nkind = "mirror"\n')
    assert materials(description)["table top"].metallic == 1
    path = tmp_path / "scene.obj"
    assert materials(describe_file(path, overrides={}))["table top"].metallic == 0
    (tmp_path / "other.toml").write_text('[materials.wood]\nkind = "glass"\n')
    assert materials(describe_file(path, overrides=tmp_path / "other.toml"))["table top"].transmission == 1


@quiet
def test_every_kind(tmp_path: Path):
    toml = """
[materials.wood]
kind = "glossy"
alpha = 0.3
[objects."leg 1"]
kind = "emitter"
radiance = 5
[objects."leg 2"]
kind = "matte"
colour = [0.1, 0.2, 0.3]
"""
    found = materials(describe_with(tmp_path, toml))
    wood, one, two = (found[name] for name in ("table top", "leg 1", "leg 2"))
    assert (wood.alpha, wood.eta, wood.base_colour) == (0.3, 1.5, (0.5, 0.4, 0.3))
    assert one.emission == (5, 5, 5) and not one.reflective
    assert two.base_colour == (0.1, 0.2, 0.3) and not two.reflective


@quiet
def test_patterns_ignore_and_single_parameters(tmp_path: Path):
    description = describe_with(
        tmp_path, '[objects."leg*"]\nkind = "ignore"\n[materials."w*"]\neta = 1.4\nalpha = 0.5\n'
    )
    assert set(materials(description)) == {"table top"}
    wood = materials(description)["table top"]
    assert (wood.eta, wood.alpha, wood.base_colour) == (1.4, 0.5, (0.5, 0.4, 0.3))


@quiet
def test_objects_win_over_materials_and_later_over_earlier(tmp_path: Path):
    toml = '[objects."leg 1"]\nalpha = 0.1\n[materials."*"]\nalpha = 0.2\n[materials.steel]\nalpha = 0.3\n'
    found = materials(describe_with(tmp_path, toml))
    assert [found[name].alpha for name in ("table top", "leg 1", "leg 2")] == [0.2, 0.1, 0.3]


@quiet
def test_rare_parameters_from_overrides(tmp_path: Path):
    toml = """
[materials.steel]
conductor = { eta = [0.2, 0.9, 1.1], k = 3 }
[materials.wood]
coupled = true
opacity = 0.5
[objects."leg 2"]
kind = "emitter"
radiance = 2
emits_back = false
"""
    found = {part.name: part.material for part in describe_with(tmp_path, toml).parts}
    assert found["leg 1"].conductor == ((0.2, 0.9, 1.1), (3, 3, 3))
    assert found["table top"].coupled and found["table top"].opacity == 0.5
    assert found["leg 2"].emission == (2, 2, 2) and not found["leg 2"].emits_back
    (tmp_path / "scene.jaxrefl.toml").write_text("[materials.steel]\nconductor = false\n")
    assert all(part.material.conductor is None for part in describe_file(tmp_path / "scene.obj").parts)


def test_lights_cameras_units_and_axes_from_overrides(tmp_path: Path):
    toml = """
units = 10
up = "z"
ambient = 0.25
sky = [0.1, 0.2, 0.3]
[[lights]]
type = "sun"
direction = [0, -2, 0]
irradiance = 3
angular_radius = 0.5
[[lights]]
type = "spot"
position = [0, 5, 0]
intensity = [1, 2, 3]
inner_angle = 10
outer_angle = 20
[[cameras]]
name = "front"
eye = [0, 0, 50]
target = [0, 0, 0]
size = [320, 240]
"""
    scene = assemble(describe_with(tmp_path, toml))
    np.testing.assert_allclose(scene.upper, [10, 10, 10])
    np.testing.assert_allclose(scene.lights.ambient, 0.25)
    punctual = scene.lights.punctual
    assert punctual is not None and scene.lights.environment is not None
    np.testing.assert_allclose(punctual.direction, [[0, -1, 0], [0, -1, 0]])
    np.testing.assert_allclose(punctual.intensity, [[3, 3, 3], [1, 2, 3]])
    np.testing.assert_allclose(punctual.angular_radius, [math.radians(0.5), 0], rtol=1e-6)
    np.testing.assert_allclose(punctual.cos_outer[1], math.cos(math.radians(20)), rtol=1e-6)
    assert scene.names.cameras == ("front",) and scene.cameras[0].width == 320


@quiet
def test_arguments_win_over_the_override_file(tmp_path: Path):
    path = write_obj(tmp_path)
    (tmp_path / "scene.jaxrefl.toml").write_text("units = 10\n")
    assert float(load(path).upper.max()) == 10
    assert float(load(path, units=2.0).upper.max()) == 2


@quiet
def test_the_crease_angle_decides_between_sharp_and_smooth(tmp_path: Path):
    path = write_obj(tmp_path)
    assert load(path).mesh.normals is None  # flat everywhere: no normals are stored
    smooth = load(path, crease_angle=100)
    assert smooth.mesh.normals is not None and smooth.mesh.vertices.shape == (8, 3)


@quiet
def test_the_inventory_tells_everything_and_can_be_stored(tmp_path: Path):
    scene = assemble(describe_with(tmp_path, "[[cameras]]\neye = [0, 0, 5]\ntarget = [0, 0, 0]\n"))
    data = inventory(scene)
    assert json.loads(json.dumps(data)) == data
    assert data["triangles"] == 14 == sum(o["triangles"] for o in data["objects"])
    assert data["bounds"]["diagonal"] == pytest.approx(math.sqrt(12), rel=1e-6)
    assert [o["name"] for o in data["objects"]] == ["table top", "leg 1", "leg 2"]
    assert set(data["features"]) | set(data["absent"]) == set(vars(scene.features))
    mesh = scene.mesh
    arrays = (mesh.vertices, mesh.faces, mesh.material, mesh.object)
    assert data["memory"]["mesh"] == sum(array.size * 4 for array in arrays)
    assert data["memory"]["total"] == sum(size for name, size in data["memory"].items() if name != "total")
    text = format_inventory(data)
    for word in ("14 triangles", "table top", "alpha 0.1", "matte", "constant sky of radiance (1, 1, 1)", "camera 0"):
        assert word in text, text
    for word in ("planar: objects leg 1, leg 2", "switched off: curved"):
        assert word in text, text
    assert max(map(len, text.splitlines())) < 400


def test_the_inventory_shows_rare_parameters_only_where_they_are(rng: np.random.Generator):
    triangle = np.eye(3)
    image = Image("leaf", rng.integers(0, 256, (2, 2, 4), np.uint8))
    plain = Part("wall", triangle, np.array([[0, 1, 2]]), matte("paint", (1, 1, 1)))
    assert (
        not {"conductor", "coupled", "opacity", "emits_back"}
        & inventory(assemble(Description("d", [plain])))["materials"][0].keys()
    )
    rare = Material(
        "odd",
        metallic=0.5,
        conductor=((0.2, 0.9, 1.1), (3.9, 2.4, 2.2)),
        coupled=True,
        opacity=0.25,
        opacity_texture=image,
        emission=(1.0, 2.0, 3.0),
        emits_back=False,
    )
    odd = Part("leaf", triangle + 1, np.array([[0, 1, 2]]), rare, uv=np.zeros((3, 2)))
    data = inventory(assemble(Description("d", [plain, odd])))
    assert json.loads(json.dumps(data)) == data
    first, second = data["materials"]
    assert "conductor" not in first and first["opacity"] == 1 and first["opacity_texture"] == -1
    assert second["conductor"]["eta"] == pytest.approx([0.2, 0.9, 1.1], abs=1e-6)
    assert (second["opacity"], second["coupled"], second["emits_back"]) == (0.25, True, False)
    text = format_inventory(data)
    for word in (
        "complex index (0.2, 0.9, 1.1) + i (3.9, 2.4, 2.2)",
        "coupled",
        "opacity 0.25",
        "opacity 0",
        "(front)",
    ):
        assert word in text, text
