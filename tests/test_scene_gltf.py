"""glTF files: geometry against trimesh, and every material, light and camera field that is read."""

import math
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scene_files import QUAD, QUAD_FACES, GltfWriter, checker, quad_gltf

from jaxrefl.core import project
from jaxrefl.scene import SceneWarning, describe_file, load
from jaxrefl.scene.gltf_materials import UvTransform

QUIET = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")
pytestmark = QUIET


def describe(gltf: GltfWriter, folder: Path, suffix: str = ".glb", **options):
    return describe_file(gltf.write(folder / f"scene{suffix}"), **options)


def material_of(folder: Path, **fields):
    return describe(quad_gltf(fields), folder).parts[0].material


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_geometry_comes_out_in_world_space(tmp_path: Path, suffix: str):
    node = {"translation": [1, 2, 3], "rotation": [0, 0, math.sqrt(0.5), math.sqrt(0.5)], "scale": [2, 1, 1]}
    description = describe(quad_gltf(node=node), tmp_path, suffix)
    (part,) = description.parts
    assert part.name == "panel"
    # scale, then a quarter turn around z, then the translation
    expected = np.stack([-QUAD[:, 1], 2 * QUAD[:, 0], QUAD[:, 2]], 1) + [1, 2, 3]
    np.testing.assert_allclose(part.vertices, expected, atol=1e-6)
    np.testing.assert_array_equal(part.faces, QUAD_FACES)
    assert part.normals is not None
    np.testing.assert_allclose(part.normals / np.linalg.norm(part.normals, axis=1, keepdims=True), [[0, 0, 1]] * 4)


def test_nested_nodes_and_instances_agree_with_trimesh(tmp_path: Path):
    scene = trimesh.Scene()
    rng = np.random.default_rng(3)
    ball = trimesh.creation.icosphere(subdivisions=1)
    for i in range(4):
        matrix = trimesh.transformations.random_rotation_matrix(rng.random(3))
        matrix[:3, :3] *= rng.uniform(0.5, 2)
        matrix[:3, 3] = rng.normal(size=3)
        scene.add_geometry(ball, geom_name="ball", node_name=f"n{i}", parent_node_name=f"n{i - 1}" if i else None,
                           transform=matrix)  # fmt: skip
    path = tmp_path / "nested.glb"
    scene.export(str(path))
    parts = describe_file(path).parts
    expected = trimesh.load_scene(str(path)).to_mesh()
    assert len(parts) == 4 and sum(len(p.faces) for p in parts) == len(expected.faces)
    ours = np.concatenate([p.vertices[p.faces].reshape(-1, 9) for p in parts])
    theirs = expected.triangles.reshape(-1, 9)
    order = [np.lexsort(np.round(a, 3).T) for a in (ours, theirs)]
    # measured worst case 4e-7: matrices are stored in float32 by neither, but positions are
    np.testing.assert_allclose(ours[order[0]], theirs[order[1]], atol=2e-6)


def test_a_mirroring_node_turns_triangles_and_normals_around(tmp_path: Path):
    (part,) = describe(quad_gltf(node={"scale": [-1, 1, 1]}), tmp_path).parts
    a, b, c = part.vertices[part.faces[0]]
    assert np.cross(b - a, c - a)[2] > 0
    assert part.normals is not None and (part.normals[:, 2] > 0).all()


def test_a_matrix_node_is_read_by_columns(tmp_path: Path):
    matrix = np.eye(4)
    matrix[:3, 3] = [5, 6, 7]
    (part,) = describe(quad_gltf(node={"matrix": matrix.T.reshape(-1).tolist()}), tmp_path).parts
    np.testing.assert_allclose(part.vertices, QUAD + [5, 6, 7], atol=1e-6)


def test_nodes_of_one_name_stay_two_objects(tmp_path: Path):
    gltf = quad_gltf()
    gltf.content["nodes"].append({"name": "panel", "mesh": 0, "translation": [0, 0, 1]})
    gltf.content["scenes"][0]["nodes"] = [0, 1]
    description = describe(gltf, tmp_path)
    assert [part.name for part in description.parts] == ["panel", "panel (2)"]
    assert any("share a name" in note for note in description.notes)


@pytest.mark.parametrize(("mode", "indices"), [(5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])])
def test_strips_and_fans_face_the_same_way(tmp_path: Path, mode: int, indices: list[int]):
    gltf = quad_gltf()
    primitive = gltf.content["meshes"][0]["primitives"][0]
    primitive |= {"mode": mode, "indices": gltf.accessor(np.array(indices, np.uint8))}
    (part,) = describe(gltf, tmp_path).parts
    corners = part.vertices[part.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(normals, [[0, 0, 1]] * 2)


def test_sparse_normalised_and_strided_accessors(tmp_path: Path):
    gltf = quad_gltf()
    attributes = gltf.content["meshes"][0]["primitives"][0]["attributes"]
    rows, values = gltf.view(np.array([2], np.uint16).tobytes()), gltf.view(np.array([[1, 1, 9]], np.float32).tobytes())
    gltf.content["accessors"][attributes["POSITION"]]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": rows, "componentType": 5123},
        "values": {"bufferView": values},
    }
    attributes["COLOR_0"] = gltf.accessor(np.full((4, 4), [255, 128, 0, 255], np.uint8), normalized=True)
    interleaved = np.concatenate([np.zeros((4, 3), np.float32), np.arange(8, dtype=np.float32).reshape(4, 2)], 1)
    view = gltf.view(interleaved.tobytes(), byteStride=20)
    gltf.content["accessors"].append(
        {"bufferView": view, "byteOffset": 12, "componentType": 5126, "type": "VEC2", "count": 4}
    )
    attributes["TEXCOORD_0"] = len(gltf.content["accessors"]) - 1
    (part,) = describe(gltf, tmp_path).parts
    assert part.uv is not None and part.colours is not None
    np.testing.assert_allclose(part.vertices[2], [1, 1, 9])
    np.testing.assert_allclose(part.colours, [[1, 128 / 255, 0]] * 4, atol=1e-6)
    np.testing.assert_allclose(part.uv, np.arange(8).reshape(4, 2))


def test_material_defaults_are_those_of_the_specification(tmp_path: Path):
    m = material_of(tmp_path)
    assert (m.name, m.base_colour, m.metallic, m.alpha, m.eta) == ("paint", (1, 1, 1), 1, 1, 1.5)
    assert (m.transmission, m.thin, m.emission) == (0, False, (0, 0, 0))


def test_metallic_roughness_and_emission(tmp_path: Path):
    m = material_of(
        tmp_path,
        pbrMetallicRoughness={"baseColorFactor": [0.1, 0.2, 0.3, 1], "metallicFactor": 0.25, "roughnessFactor": 0.5},
        emissiveFactor=[1, 0.5, 0],
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 8}},
    )
    assert (m.base_colour, m.metallic, m.alpha, m.emission) == ((0.1, 0.2, 0.3), 0.25, 0.25, (8, 4, 0))


def test_glass_with_volume_absorbs_as_the_specification_says(tmp_path: Path):
    volume = {"thicknessFactor": 0.1, "attenuationDistance": 2.0, "attenuationColor": [0.5, 1, 0.25]}
    extensions = {
        "KHR_materials_transmission": {"transmissionFactor": 0.9},
        "KHR_materials_ior": {"ior": 1.33},
        "KHR_materials_volume": volume,
    }
    m = material_of(tmp_path, extensions=extensions)
    assert (m.transmission, m.eta, m.thin) == (0.9, 1.33, False)
    np.testing.assert_allclose(np.exp(-2.0 * np.array(m.attenuation)), volume["attenuationColor"], rtol=1e-12)


def test_transmission_without_volume_is_a_thin_pane(tmp_path: Path):
    m = material_of(tmp_path, extensions={"KHR_materials_transmission": {"transmissionFactor": 1}})
    assert m.thin and m.transmission == 1 and m.attenuation == (0, 0, 0)


def test_unlit_surfaces_emit_their_colour(tmp_path: Path):
    factor = {"baseColorFactor": [0.1, 0.2, 0.3, 1]}
    m = material_of(tmp_path, pbrMetallicRoughness=factor, extensions={"KHR_materials_unlit": {}})
    assert m.emission == (0.1, 0.2, 0.3) and m.base_colour == (0, 0, 0) and not m.reflective


def textured(transforms: list[dict], **sampler) -> GltfWriter:
    gltf = quad_gltf({})
    gltf.content |= {
        "images": [gltf.image(checker())],
        "samplers": [sampler],
        "textures": [{"source": 0, "sampler": 0}],
    }
    infos = [
        {"index": 0, **({"extensions": {"KHR_texture_transform": transform}} if transform else {})}
        for transform in transforms
    ]
    gltf.content["materials"][0] |= {
        "pbrMetallicRoughness": {"baseColorTexture": infos[0], "metallicRoughnessTexture": infos[1]},
        "normalTexture": {**infos[2], "scale": 0.5},
    }
    return gltf


def test_textures_samplers_and_normal_scale(tmp_path: Path):
    m = describe(textured([{}, {}, {}], wrapS=33071, wrapT=10497), tmp_path).parts[0].material
    assert m.base_colour_texture is m.metallic_roughness_texture is m.normal_texture
    assert m.base_colour_texture is not None and m.base_colour_texture.repeat == (False, True)
    np.testing.assert_array_equal(m.base_colour_texture.rgba, checker())
    assert m.normal_scale == 0.5


def test_a_texture_transform_that_all_slots_share_is_baked(tmp_path: Path):
    transform = {"offset": [0.25, 0.5], "scale": [2, 3], "rotation": math.pi / 2}
    description = describe(textured([transform] * 3), tmp_path)
    uv = description.parts[0].uv
    assert uv is not None and not any("texture coordinates of its own" in note for note in description.notes)
    u, v = np.array([[0, 1], [1, 1], [1, 0], [0, 0]]).T
    np.testing.assert_allclose(uv, np.stack([0.25 + 3 * v, 0.5 - 2 * u], 1), atol=1e-12)


def test_texture_transforms_that_differ_are_noted(tmp_path: Path):
    description = describe(textured([{"scale": [2, 2]}, {}, {"scale": [2, 2]}]), tmp_path)
    noted = [note for note in description.notes if "texture coordinates of its own" in note]
    assert len(noted) == 1 and "metallic_roughness_texture" in noted[0]


def test_the_texture_transform_is_scale_then_rotation_then_offset():
    moved = UvTransform(offset=(10, 20), rotation=math.pi / 2, scale=(2, 1)).apply(np.array([[1.0, 0], [0, 1.0]]))
    # counter-clockwise on the image, whose v axis points down: +u goes to -v and +v to +u
    np.testing.assert_allclose(moved, [[10, 18], [11, 20]], atol=1e-12)


def test_lights_and_cameras_stand_where_their_nodes_do(tmp_path: Path):
    lights = [
        {"type": "spot", "intensity": 2, "color": [1, 0.5, 0], "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}},
        {"type": "directional", "intensity": 3},
        {"type": "point"},
    ]
    gltf = quad_gltf(extensions={"KHR_lights_punctual": {"lights": lights}})
    quarter = [math.sqrt(0.5), 0, 0, math.sqrt(0.5)]  # a quarter turn around x: -Z becomes +Y
    gltf.content["nodes"] += [
        {"name": f"light {i}", "translation": [i, 0, 0], "rotation": quarter,
         "extensions": {"KHR_lights_punctual": {"light": i}}}
        for i in range(3)
    ] + [{"name": "eye", "camera": 0, "translation": [0.5, 0.5, 2]}]  # fmt: skip
    gltf.content["scenes"][0]["nodes"] = [0, 1, 2, 3, 4]
    gltf.content["cameras"] = [{"type": "perspective", "perspective": {"yfov": math.pi / 2, "aspectRatio": 2}}]
    description = describe(gltf, tmp_path)
    spot, sun, point = description.lights
    np.testing.assert_allclose(spot.direction, [0, 1, 0], atol=1e-12)
    assert spot.intensity == (2, 1, 0) and spot.cos_inner == math.cos(0.1) and spot.cos_outer == math.cos(0.2)
    assert sun.directional and sun.intensity == (3, 3, 3)
    assert point.position == (2, 0, 0) and point.cos_outer < -1 and not point.directional
    camera = description.cameras["eye"]
    assert (camera.width, camera.height) == (1080, 540)
    xy, depth = project(camera, jnp.asarray([[0.5, 2.5, 0.0]], jnp.float32))  # 45 degrees above the axis
    np.testing.assert_allclose(xy, [[540, 0]], atol=1e-3)
    np.testing.assert_allclose(depth, [2], rtol=1e-6)


IGNORED = {
    "clearcoat": ({"extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 1}}}, "KHR_materials_clearcoat"),
    "sheen": ({"extensions": {"KHR_materials_sheen": {}}}, "KHR_materials_sheen"),
    "specular": ({"extensions": {"KHR_materials_specular": {}}}, "KHR_materials_specular"),
    "occlusion": ({"occlusionTexture": {"index": 0}}, "occlusionTexture"),
    "blend": ({"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.5]}}, "alphaMode BLEND"),
    "thickness": ({"extensions": {"KHR_materials_volume": {"thicknessTexture": {"index": 0}}}}, "thicknessTexture"),
    "range": ({"pbrMetallicRoughness": {"roughnessFactor": 2}}, "roughnessFactor: expected 0 to 1, got 2"),
    "index": ({"extensions": {"KHR_materials_ior": {"ior": 0}}}, "expected an index >= 1, got 0"),
}


@pytest.mark.parametrize("case", IGNORED)
@pytest.mark.filterwarnings("default::jaxrefl.scene.errors.SceneWarning")
def test_every_field_that_is_ignored_is_named_in_one_warning(tmp_path: Path, case: str):
    fields, says = IGNORED[case]
    path = quad_gltf(fields).write(tmp_path / "scene.glb")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = load(path)
    found = [str(w.message) for w in caught if issubclass(w.category, SceneWarning)]
    assert sum(says in message and "paint" in message for message in found) == 1, found
    assert len(found) == len(scene.names.notes) == len(caught)


def test_animations_skins_points_and_unknown_extensions_are_noted(tmp_path: Path):
    gltf = quad_gltf(animations=[{}], skins=[{}], extensionsUsed=["EXT_made_up"])
    primitives = gltf.content["meshes"][0]["primitives"]
    primitives.append({**primitives[0], "mode": 0})
    notes = " | ".join(describe(gltf, tmp_path).notes)
    for word in ("animations are ignored", "skins are ignored", "points and lines", "EXT_made_up"):
        assert word in notes


def test_a_missing_image_is_left_out_with_a_note(tmp_path: Path):
    gltf = textured([{}, {}, {}])
    gltf.content["images"] = [{"uri": "nowhere.png"}]
    description = describe(gltf, tmp_path)
    assert description.parts[0].material.base_colour_texture is None
    assert any("nowhere.png" in note and "left out" in note for note in description.notes)
