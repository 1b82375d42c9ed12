"""OBJ and MTL files: relative indices, polygons, groups, and each rule of the material mapping."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image as PillowImage
from scene_files import CUBE_OBJ, checker, write_obj

from jaxrefl.scene import Material, describe_file
from jaxrefl.scene.mtl import alpha_from_exponent

pytestmark = pytest.mark.filterwarnings("ignore::jaxrefl.scene.errors.SceneWarning")


def material_of(folder: Path, mtl: str) -> tuple[Material, list[str]]:
    text = CUBE_OBJ.replace("o cube", "o cube\nusemtl m")
    description = describe_file(write_obj(folder, text, mtl=f"newmtl m\n{mtl}"))
    return description.parts[0].material, description.notes


def triangles(path: Path) -> np.ndarray:
    """All triangles, sorted, whatever their order in the file."""
    parts = describe_file(path).parts
    flat = np.concatenate([p.vertices[p.faces].reshape(-1, 9) for p in parts])
    return flat[np.lexsort(np.round(flat, 6).T)]


def test_relative_indices_mean_the_same_as_absolute_ones(tmp_path: Path):
    absolute = write_obj(tmp_path)
    text = re.sub(r"^f .*$", lambda m: re.sub(r"\d+", lambda n: str(int(n[0]) - 9), m[0]), CUBE_OBJ, flags=re.M)
    assert "f -5 -6 -7 -8" in text
    relative = write_obj(tmp_path, text, name="relative.obj")
    np.testing.assert_array_equal(triangles(relative), triangles(absolute))


def test_relative_indices_count_from_the_face_that_uses_them(tmp_path: Path):
    text = """
o first
v 0 0 0
v 1 0 0
v 0 1 0
vt 0 0
vt 1 0
vt 0 1
f -3/-3 -2/-2 -1/-1
o second
v 0 0 5
v 1 0 5
v 0 1 5
f -3/1 -2/2 -1/3
"""
    first, second = describe_file(write_obj(tmp_path, text)).parts
    assert (first.name, second.name) == ("first", "second")
    np.testing.assert_array_equal(first.vertices[first.faces[0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(second.vertices[second.faces[0]], [[0, 0, 5], [1, 0, 5], [0, 1, 5]])
    assert second.uv is not None
    np.testing.assert_array_equal(second.uv[second.faces[0]], [[0, 1], [1, 1], [0, 0]])  # v counted from the top


def test_geometry_agrees_with_trimesh(tmp_path: Path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.export(str(tmp_path / "ball.obj"), include_normals=True)
    ours = triangles(tmp_path / "ball.obj")
    theirs = trimesh.load_mesh(str(tmp_path / "ball.obj")).triangles.reshape(-1, 9)
    np.testing.assert_allclose(ours, theirs[np.lexsort(np.round(theirs, 6).T)])


def test_polygons_of_any_size_become_fans(tmp_path: Path):
    text = "\n".join(f"v {np.cos(a)} {np.sin(a)} 0" for a in np.arange(7) * 2 * np.pi / 7)
    (part,) = describe_file(write_obj(tmp_path, text + "\nf 1 2 3 4 5 6 7\nf 1// 2 3/\n")).parts
    assert len(part.faces) == 6
    corners = part.vertices[part.faces[:5]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    np.testing.assert_allclose(area, 3.5 * np.sin(2 * np.pi / 7))


@pytest.mark.parametrize(
    "faces",
    [
        "f 1/1/1 2/2/1 3/3/1\nf 1 3 4",
        "f 1 3 4\nf 1/1/1 2/2/1 3/3/1",
        "f 1 2/2 3/3/1\nf 1 3 4",
        "f 1//1 2//1 3//1\nf 1/1 3/3 4/4",
        "f 1//1 2//1 3//1\nf 1//1 3//1 4//1",
        "f 1/1 2/2 3/3\nf 1/1 3/3 4/4",
    ],
)
def test_every_mixture_of_references_is_told_apart(tmp_path: Path, faces: str):
    """Counting slashes over the whole file is not enough: some mixtures have as many as a uniform file."""
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n" + faces
    (part,) = describe_file(write_obj(tmp_path, text)).parts
    corners = part.vertices[part.faces]
    expected = {((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1))}
    assert {tuple(tuple(int(c) for c in p[:2]) for p in triangle) for triangle in corners} == expected
    if "1/1" in faces:
        assert part.uv is not None
        at = part.uv[(part.vertices == [1, 1, 0]).all(1)]
        assert (at == [1, 0]).all(1).any()  # the third texture coordinate, counted from the top


def test_objects_materials_tabs_comments_and_continued_lines(tmp_path: Path):
    text = (
        CUBE_OBJ.replace("f 5", "usemtl b # blue\nf 5").replace("v -1 -1 -1\n", "v\t-1  -1 \\\n -1 # corner\n")
        + "g later\nusemtl a\nf 1 2 3\n"
    )
    description = describe_file(write_obj(tmp_path, text, mtl="newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n"))
    found = {(p.name, p.material.name): len(p.faces) for p in description.parts}
    assert found == {("cube", "default"): 2, ("cube", "b"): 10, ("cube", "a"): 1}


def test_groups_are_objects_where_there_is_no_o(tmp_path: Path):
    text = CUBE_OBJ.replace("o cube", "g base").replace("f 1 5", "g top\nf 1 5")
    assert [p.name for p in describe_file(write_obj(tmp_path, text)).parts] == ["base", "top"]


def test_normals_of_the_file_are_kept_and_missing_ones_repaired(tmp_path: Path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 1 1\nf 1//1 2//1 3//1\nf 1 3 4\n"
    (part,) = describe_file(write_obj(tmp_path, text)).parts
    assert part.normals is not None
    np.testing.assert_array_equal(part.normals[part.faces[0]], [[0, 1, 1]] * 3)
    assert np.isnan(part.normals[part.faces[1]]).all()


def test_vertex_colours_are_decoded_from_srgb(tmp_path: Path):
    text = "".join(f"v {x} {y} 0 0.5 0 1\n" for x, y in ((0, 0), (1, 0), (0, 1))) + "f 1 2 3\n"
    (part,) = describe_file(write_obj(tmp_path, text)).parts
    assert part.colours is not None
    np.testing.assert_allclose(part.colours, [[0.21404, 0, 1]] * 3, atol=1e-5)


def test_smooth_normals_do_not_stop_where_the_material_changes(tmp_path: Path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    lines = [f"v {x} {y} {z}" for x, y, z in ball.vertices]
    for i, face in enumerate(ball.faces + 1):
        lines += [f"usemtl {'ab'[i % 2]}", "f " + " ".join(map(str, face))]
    parts = describe_file(write_obj(tmp_path, "\n".join(lines), mtl="newmtl a\nnewmtl b\n")).parts
    assert len(parts) == 2
    for part in parts:
        assert part.normals is not None
        # measured worst case 1.0e-4: the icosphere's triangles are not all alike
        np.testing.assert_allclose((part.normals * part.vertices).sum(1), 1, atol=2e-4)


def test_the_width_of_an_exponent():
    assert [alpha_from_exponent(n) for n in (0, 6, 198)] == pytest.approx([1, 0.5, 0.1])


@pytest.mark.parametrize("exponent", [10, 200, 1000])
def test_the_lobe_of_an_exponent_falls_off_like_beckmann_at_its_peak(exponent: float):
    angle = 0.01 / np.sqrt(exponent)
    phong = 1 - np.cos(angle) ** (exponent + 2)
    beckmann = 1 - np.exp(-((np.tan(angle) / alpha_from_exponent(exponent)) ** 2))
    assert beckmann == pytest.approx(phong, rel=1e-3)


RULES = {
    "no Ks is matte": ("Kd 0.2 0.3 0.4\nNi 1.5\nNs 10", {"base_colour": (0.2, 0.3, 0.4), "eta": 1, "metallic": 0}),
    "black Ks is matte": ("Kd 0.2 0.3 0.4\nKs 0 0 0\nNs 100", {"eta": 1}),
    "illum 1 is matte": ("Kd 0.2 0.3 0.4\nKs 1 1 1\nillum 1", {"eta": 1}),
    "nothing at all is matte": ("", {"base_colour": (0.8, 0.8, 0.8), "eta": 1}),
    "mirror": ("Ks 0.9 0.8 0.7\nNs 1000\nillum 5", {"metallic": 1, "alpha": 0, "base_colour": (0.9, 0.8, 0.7)}),
    "illum 3 is a mirror": ("Ks 0.9 0.9 0.9\nillum 3", {"metallic": 1, "alpha": 0}),
    "glass": ("Ni 2.5\nTf 0.25 1 1\nillum 7", {"transmission": 1, "eta": 2.5, "base_colour": (0.5, 1, 1), "alpha": 0}),
    "glass without Ni": ("illum 4", {"transmission": 1, "eta": 1.5}),
    "plastic": ("Kd 0.5 0.1 0.1\nKs 0.5 0.5 0.5\nNs 198\nillum 2", {"alpha": 0.1, "eta": 1.5, "metallic": 0}),
    "plastic with Ni": ("Kd 0.5 0.1 0.1\nKs 0.5 0.5 0.5\nNi 1.8", {"eta": 1.8, "metallic": 0}),
    "gold": ("Kd 0 0 0\nKs 1 0.7 0.3\nNs 198", {"metallic": 1, "base_colour": (1, 0.7, 0.3), "alpha": 0.1}),
    "black metal": ("Kd 0.01 0.01 0.01\nKs 0.6 0.6 0.6", {"base_colour": (0.61, 0.61, 0.61)}),
    "pane": ("Kd 0.5 0.5 0.5\nKs 0.1 0.1 0.1\nd 0.25", {"transmission": 0.75, "thin": True}),
    "pane by Tr": ("Kd 0.5 0.5 0.5\nKs 0.1 0.1 0.1\nTr 0.75", {"transmission": 0.75, "thin": True}),
    "emission": ("Ke 17 12 4", {"emission": (17, 12, 4)}),
    "extended": ("Pr 0.5\nPm 0.25", {"alpha": 0.25, "metallic": 0.25, "eta": 1.5}),
    "one number": ("Kd 0.25", {"base_colour": (0.25, 0.25, 0.25)}),
}


@pytest.mark.parametrize("rule", RULES)
def test_materials(tmp_path: Path, rule: str):
    mtl, expected = RULES[rule]
    material, _ = material_of(tmp_path, mtl)
    for field, value in expected.items():
        assert getattr(material, field) == pytest.approx(value), field


def test_a_coloured_highlight_over_a_coloured_body_keeps_both(tmp_path: Path):
    """The brass of the OpenGL tables: what scatters is Kd, what reflects is Ks."""
    kd, ks = np.array([0.33, 0.22, 0.03]), np.array([0.78, 0.57, 0.11])
    m, _ = material_of(tmp_path, f"Kd {kd[0]} {kd[1]} {kd[2]}\nKs {ks[0]} {ks[1]} {ks[2]}")
    base = np.array(m.base_colour)
    # min(Kd + Ks, 1) clips the red of this one, and the two hues differ a little: measured worst case 0.045
    np.testing.assert_allclose(base * (1 - m.metallic), kd, atol=0.05)
    np.testing.assert_allclose(base * m.metallic, ks, atol=0.08)


def test_textures_and_their_options(tmp_path: Path):
    PillowImage.fromarray(checker()).save(tmp_path / "wood grain.png")
    flat = np.broadcast_to(np.array([128, 128, 255], np.uint8), (2, 2, 3))
    PillowImage.fromarray(np.ascontiguousarray(flat)).save(tmp_path / "flat.png")
    mtl = "Kd 0 0 0\nmap_Kd -clamp on -s 2 2 1 wood grain.png\nmap_Bump -bm 0.3 flat.png\nmap_Ke wood grain.png"
    m, notes = material_of(tmp_path, mtl)
    assert m.base_colour_texture is not None and m.base_colour_texture.repeat == (False, False)
    np.testing.assert_array_equal(m.base_colour_texture.rgba, checker())
    assert m.base_colour == (1, 1, 1) and m.emission == (1, 1, 1) and m.normal_texture is not None
    joined = " | ".join(notes)
    for word in ("Kd is black although", "option -s of map_kd is ignored", "option -bm of map_bump is ignored"):
        assert word in joined


def test_a_height_map_is_not_taken_for_a_normal_map(tmp_path: Path):
    PillowImage.fromarray(checker()).save(tmp_path / "bumps.png")
    m, notes = material_of(tmp_path, "bump bumps.png")
    assert m.normal_texture is None and any("holds heights" in note for note in notes)


def test_ignored_statements_are_counted_once_per_kind(tmp_path: Path):
    _, notes = material_of(tmp_path, "Ka 1 1 1\nmap_d a.png\nnewmtl other\nKa 1 1 1\n")
    assert "scene.mtl: Ka is ignored (2 materials)" in notes
    assert "scene.mtl: map_d is ignored (1 material)" in notes


def test_a_missing_library_and_an_undefined_material_are_noted(tmp_path: Path):
    text = "mtllib nowhere.mtl\n" + CUBE_OBJ.replace("o cube", "o cube\nusemtl ghost")
    description = describe_file(write_obj(tmp_path, text))
    assert "material library 'nowhere.mtl' is missing" in description.notes
    assert any("'ghost' is not defined" in note for note in description.notes)
    assert description.parts[0].material.name == "ghost"


def test_several_libraries_on_one_line(tmp_path: Path):
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "b.mtl").write_text("newmtl b\nKd 0 1 0\n")
    text = "mtllib a.mtl b.mtl\n" + CUBE_OBJ.replace("o cube", "o cube\nusemtl b")
    assert describe_file(write_obj(tmp_path, text)).parts[0].material.base_colour == (0, 1, 0)
