"""Descriptions become arrays: numbering, what is left None, features, and what is refused."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scene_files import checker
from shapes import floor

from jaxrefl.scene import (
    Description,
    Image,
    Material,
    Part,
    PunctualLight,
    SceneError,
    assemble,
    constant_sky,
    emitter,
    feature_reasons,
    glass,
    glossy,
    matte,
    mirror,
)

WHITE = matte("white", (0.8, 0.8, 0.8))


def quad(name: str = "quad", material: Material = WHITE, z: float = 0.0, **arrays) -> Part:
    vertices = np.array([[0, 0, z], [1, 0, z], [1, 1, z], [0, 1, z]])
    return Part(name, vertices, np.array([[0, 1, 2], [0, 2, 3]]), material, **arrays)


def ball(material: Material, *, name: str = "ball", smooth: bool = True) -> Part:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    return Part(name, mesh.vertices, mesh.faces, material, normals=mesh.vertices if smooth else None)


def scene_of(*parts: Part, **kwargs):
    return assemble(Description("test", list(parts), **kwargs))


def test_a_plain_scene_carries_nothing_it_does_not_need():
    scene = scene_of(quad())
    mesh = scene.mesh
    assert (mesh.normals, mesh.uv, mesh.tangents, mesh.colours, scene.textures) == (None,) * 5
    assert scene.lights.area is scene.lights.punctual is scene.lights.environment is None
    assert not any(dataclasses.astuple(scene.features))
    assert mesh.faces.dtype == mesh.material.dtype == mesh.object.dtype == jnp.int32
    np.testing.assert_array_equal(scene.lower, [0, 0, 0])
    np.testing.assert_array_equal(scene.upper, [1, 1, 0])


def test_texture_coordinates_without_a_texture_are_dropped():
    assert scene_of(quad(uv=np.zeros((4, 2)))).mesh.uv is None


def test_parts_of_one_name_are_one_object_and_equal_materials_one_row():
    other = matte("white", [0.8, 0.8, 0.8])
    scene = scene_of(quad("a"), quad("b", mirror("silver"), 1.0), quad("a", other, 2.0))
    assert scene.names.objects == ("a", "b") and scene.names.materials == ("white", "silver")
    np.testing.assert_array_equal(scene.mesh.object, [0, 0, 1, 1, 0, 0])
    np.testing.assert_array_equal(scene.mesh.material, [0, 0, 1, 1, 0, 0])


def test_different_materials_of_one_name_are_told_apart():
    scene = scene_of(quad(), quad("b", matte("white", (0.1, 0.1, 0.1)), 1.0))
    assert scene.names.materials == ("white", "white (2)")


def test_flat_parts_next_to_smooth_ones_keep_their_face_normals():
    scene = scene_of(quad(), ball(WHITE))
    mesh = scene.mesh
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.normals[mesh.faces[:2]], np.broadcast_to([0.0, 0, 1], (2, 3, 3)))
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, rtol=1e-6)


def test_authored_normals_are_normalised():
    scene = scene_of(quad(normals=np.tile([0, 0, 7.0], (4, 1))))
    assert scene.mesh.normals is not None
    np.testing.assert_array_equal(scene.mesh.normals, np.tile([0, 0, 1.0], (4, 1)))
    assert not scene.names.notes


def test_tangents_only_where_a_normal_map_needs_them():
    image = Image("bumps", checker())
    mapped = glossy("mapped", (1, 1, 1), alpha=0.1).replace(normal_texture=image)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0.0]])
    scene = scene_of(quad(material=mapped, uv=uv), ball(WHITE))
    assert scene.features.normal_mapped and scene.mesh.tangents is not None and scene.mesh.normals is not None
    t, n = np.asarray(scene.mesh.tangents), np.asarray(scene.mesh.normals)
    np.testing.assert_allclose(t[np.asarray(scene.mesh.faces)[0]], np.tile([1, 0, 0, 1.0], (3, 1)), atol=1e-6)
    np.testing.assert_allclose((t[:, :3] * n).sum(1), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(t[:, :3], axis=1), 1, rtol=1e-6)


def test_a_flat_box_with_a_normal_map_gets_a_tangent_per_face():
    box = trimesh.creation.box()
    mapped = glossy("mapped", (1, 1, 1), alpha=0.1).replace(normal_texture=Image("bumps", checker()))
    uv = np.random.default_rng(0).random((len(box.vertices), 2))
    mesh = scene_of(Part("box", box.vertices, box.faces, mapped, uv=uv)).mesh
    assert mesh.normals is None and mesh.tangents is not None
    corners = np.asarray(mesh.tangents)[np.asarray(mesh.faces)]
    np.testing.assert_allclose((corners[..., :3] * box.face_normals[:, None]).sum(-1), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(corners[..., :3], axis=-1), 1, rtol=1e-6)


def test_one_image_used_as_colour_and_as_data_is_stored_once_per_coding():
    image = Image("shared", checker())
    material = Material("m", base_colour_texture=image, emission_texture=image, metallic_roughness_texture=image)
    scene = scene_of(quad(material=material.replace(emission=(1.0, 1.0, 1.0)), uv=np.zeros((4, 2))))
    assert scene.textures is not None and scene.textures.srgb.tolist() == [True, False]
    assert scene.materials.base_colour_texture.tolist() == scene.materials.emission_texture.tolist() == [0]
    assert scene.materials.metallic_roughness_texture.tolist() == [1]


def test_a_textured_part_without_coordinates_is_noted():
    scene = scene_of(quad(material=WHITE.replace(base_colour_texture=Image("wood", checker()))))
    assert any("no texture coordinates" in note and "'quad'" in note for note in scene.names.notes)


def test_colours_default_to_white():
    scene = scene_of(quad("a", colours=np.full((4, 3), 0.5)), quad("b"))
    assert scene.features.vertex_coloured and scene.mesh.colours is not None
    np.testing.assert_array_equal(scene.mesh.colours, [[0.5] * 3] * 4 + [[1.0] * 3] * 4)


def test_degenerate_triangles_and_unused_vertices_are_left_out_and_counted():
    part = quad()
    faces = np.concatenate([part.faces, [[0, 1, 1], [0, 0, 0]]])
    vertices = np.concatenate([part.vertices, [[99, 99, 99]]])
    scene = scene_of(dataclasses.replace(part, vertices=vertices, faces=faces))
    assert scene.mesh.faces.shape == (2, 3) and scene.mesh.vertices.shape == (4, 3)
    assert scene.names.notes == ("left out 2 triangles that have no area, in 1 object (quad)",)
    assert float(scene.upper.max()) == 1


@pytest.mark.parametrize(
    ("part", "feature"),
    [
        (quad(material=mirror("m")), "planar"),
        (ball(mirror("m")), "curved"),
        (ball(mirror("m"), smooth=False), "curved"),
        (quad(material=glossy("m", (1, 1, 1), alpha=0.2)), "glossy"),
        (quad(material=glass("m")), "refractive"),
        (quad(material=emitter("m", (5, 5, 5))), "emissive"),
    ],
)
def test_features_name_their_reason(part: Part, feature: str):
    scene = scene_of(quad("other", z=3.0), part)
    assert getattr(scene.features, feature)
    reason = feature_reasons(scene)[feature]
    assert ("m" if feature in ("glossy", "refractive", "emissive") else part.name) in reason
    assert set(feature_reasons(scene)) == {name for name, on in vars(scene.features).items() if on}


def test_a_mirror_box_is_planar_and_a_matte_one_is_nothing():
    box = trimesh.creation.box()
    for material, planar in ((mirror("m"), True), (WHITE, False)):
        features = scene_of(Part("box", box.vertices, box.faces, material)).features
        assert (features.planar, features.curved) == (planar, False)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_features_do_not_depend_on_size_or_place(scale: float):
    box, sphere = trimesh.creation.box(), trimesh.creation.icosphere(subdivisions=3)
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.7, 0.4]))[:3, :3]
    for mesh, planar in ((box, True), (sphere, False)):
        vertices = scale * (mesh.vertices @ turn.T + [5, -3, 2])
        features = scene_of(Part("thing", vertices, mesh.faces, mirror("m"))).features
        assert (features.planar, features.curved) == (planar, not planar)


def test_bent_normals_make_a_flat_mirror_curved():
    normals = np.array([[0.1, 0, 1], [-0.1, 0, 1], [0, 0.1, 1], [0, 0, 1]])
    features = scene_of(quad(material=mirror("m"), normals=normals)).features
    assert (features.planar, features.curved) == (False, True)


def test_lights_reach_the_scene():
    light = PunctualLight("lamp", (1.0, 1.0, 1.0), position=(0.0, 1.0, 0.0))
    scene = scene_of(quad(), lights=[light], sky=constant_sky((1, 1, 1)), ambient=(0.1, 0.1, 0.1))
    assert scene.features.punctual and scene.features.environment_lit
    np.testing.assert_allclose(scene.lights.ambient, 0.1)


def with_array(name: str, value) -> Part:
    return dataclasses.replace(quad(), **{name: value})


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ([], "at least one triangle"),
        ([with_array("faces", np.zeros((0, 3), int))], "at least one triangle"),
        ([with_array("faces", np.array([[0, 0, 0]]))], "at least one triangle"),
        ([with_array("faces", np.array([[0, 1, 4]]))], "'quad': faces: expected indices from 0 to 3"),
        ([with_array("faces", np.array([[0, 1, -1]]))], "'quad': faces: expected indices"),
        ([with_array("faces", np.array([[0.0, 1, 2]]))], "expected integers"),
        ([with_array("vertices", np.full((4, 3), np.nan))], "'quad': vertices: expected finite"),
        ([with_array("vertices", np.zeros((4, 2)))], "expected shape"),
        ([with_array("uv", np.zeros((3, 2)))], "uv: expected shape"),
        ([quad(material=WHITE.replace(alpha=1.5))], "'white': alpha: expected a number from 0 to 1, got 1.5"),
        ([quad(material=WHITE.replace(eta=0.5))], "eta"),
        ([quad(material=WHITE.replace(base_colour=(2.0, 0.0, 0.0)))], "base_colour"),
        ([quad(material=WHITE.replace(emission=(-1.0, 0.0, 0.0)))], "emission"),
        ([quad(material=WHITE.replace(metallic=float("nan")))], "metallic"),
    ],
)
def test_bad_descriptions_are_refused_by_name(parts: list[Part], says: str):
    with pytest.raises(SceneError, match=says):
        assemble(Description("broken", parts))


def test_a_cut_out_is_noted_since_images_see_it_as_opaque():
    leaf = matte("leaf", (0.1, 0.5, 0.1)).replace(opacity=0.5)
    scene = assemble(Description("leaf", [floor("leaf", leaf)]))
    assert scene.features.cut_out
    assert any("opaque: leaf" in note for note in scene.names.notes)
