"""Bad scene files: each is refused with a sentence that names the file and the fault, or repaired and counted."""

import re
import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scene_files import CUBE_OBJ, QUAD, GltfWriter, checker, quad_gltf, write_obj

from jaxrefl.scene import SceneError, SceneWarning, load

Maker = Callable[[Path], Path]


def raw(name: str, data: bytes | str) -> Maker:
    def make(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return path

    return make


def obj(old: str = "", new: str = "", *, mtl: str | None = None, toml: str | None = None) -> Maker:
    def make(folder: Path) -> Path:
        if toml is not None:
            (folder / "scene.jaxrefl.toml").write_text(toml)
        return write_obj(folder, CUBE_OBJ.replace(old, new, 1) if old else CUBE_OBJ, mtl=mtl)

    return make


def gltf(change: Callable[[GltfWriter], None] = lambda g: None, *, cut: int | None = None) -> Maker:
    def make(folder: Path) -> Path:
        writer = quad_gltf({})
        change(writer)
        path = writer.write(folder / "scene.glb")
        if cut is not None:
            path.write_bytes(path.read_bytes()[:cut])
        return path

    return make


def exported(name: str, *, cut: int, file_type: str | None = None) -> Maker:
    def make(folder: Path) -> Path:
        path = folder / name
        trimesh.creation.box().export(str(path), file_type=file_type)
        path.write_bytes(path.read_bytes()[:cut])
        return path

    return make


def primitive(writer: GltfWriter) -> dict:
    return writer.content["meshes"][0]["primitives"][0]


def set_indices(values: list) -> Callable[[GltfWriter], None]:
    return lambda g: primitive(g).update(indices=g.accessor(np.array(values, np.uint16)))


def set_positions(values: np.ndarray) -> Callable[[GltfWriter], None]:
    return lambda g: primitive(g)["attributes"].update(POSITION=g.accessor(values.astype(np.float32)))


def compressed(name: str) -> Callable[[GltfWriter], None]:
    return lambda g: g.content.update(extensionsRequired=[name], extensionsUsed=[name])


def draco_without_data(g: GltfWriter) -> None:
    primitive(g)["extensions"] = {"KHR_draco_mesh_compression": {}}
    del g.content["accessors"][primitive(g)["attributes"]["POSITION"]]["bufferView"]


def external_buffer(g: GltfWriter) -> None:
    g.content["buffers"] = [{"byteLength": len(g.buffer), "uri": "nowhere.bin"}]


def missing_bin(folder: Path) -> Path:
    writer = quad_gltf({})
    external_buffer(writer)
    return writer.write(folder / "scene.gltf")


def short_bin(folder: Path) -> Path:
    writer = quad_gltf({})
    external_buffer(writer)
    (folder / "nowhere.bin").write_bytes(writer.buffer[:-8])
    return writer.write(folder / "scene.gltf")


def two_parents(g: GltfWriter) -> None:
    g.content["nodes"] = [{"children": [1], "mesh": 0}, {"children": [0]}]


REFUSED: dict[str, tuple[Maker, str]] = {
    "missing file": (lambda folder: folder / "nowhere.obj", "nowhere.obj: cannot be read: No such file"),
    "unknown format": (raw("scene.fbx", "x"), r"expected a \.gltf, .*, got '\.fbx'"),
    "no suffix": (raw("scene", "x"), "got 'no suffix'"),
    "empty file": (raw("scene.obj", b""), "the file is empty"),
    "a folder": (lambda folder: (folder / "scene.obj").mkdir() or folder / "scene.obj", "got a folder"),
    "obj that is no obj": (raw("scene.obj", b"\x89PNG\r\n\x1a\n\0\0\0 binary"), "expected OBJ statements"),
    "obj without faces": (raw("scene.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "at least one triangle"),
    "obj index too large": (obj("f 1 5 8 4", "f 1 5 9 4"), "line 16: v index 9 is out of range: expected 1 to 8"),
    "obj index zero": (obj("f 1 5 8 4", "f 0 5 8 4"), "line 16: v index 0 is out of range"),
    "obj relative index too small": (obj("f 1 5 8 4", "f -9 5 8 4"), "v index -9 is out of range"),
    "obj texture index": (obj("f 1 5 8 4", "f 1/1 5/1 8/1 4/1"), "vt index 1 is out of range"),
    "obj word for a number": (obj("v 1 1 1", "v 1 one 1"), "line 9: could not convert"),
    "obj two coordinates": (obj("v 1 1 1", "v 1 1"), "line 9: expected 3 numbers"),
    "obj face of two": (obj("f 1 5 8 4", "f 1 5"), "line 16: expected a face of at least 3"),
    "obj broken face": (obj("f 1 5 8 4", "f a b c"), "broken face"),
    "obj all vertices NaN": (
        raw("scene.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        "at least one triangle",
    ),
    "coordinates too large": (obj(toml="units = 1e20"), "'cube': vertices: expected coordinates up to 1e.18"),
    "mtl word for a number": (obj("o cube", "usemtl m", mtl="newmtl m\nKd red\n"), "scene.mtl: material 'm': kd"),
    "mtl two numbers": (obj("o cube", "usemtl m", mtl="newmtl m\nKd 1 1\n"), "expected 1 or 3 numbers"),
    "glb truncated in its header": (gltf(cut=15), "truncated: a GLB header has 20 bytes"),
    "glb truncated in its data": (gltf(cut=-8), "truncated: expected"),
    "glb version 1": (raw("scene.glb", b"glTF" + struct.pack("<IIII", 1, 20, 0, 0)), "expected GLB version 2, got 1"),
    "gltf that is no json": (raw("scene.gltf", "{broken"), "the file is broken"),
    "gltf without asset": (raw("scene.gltf", "{}"), "expected glTF JSON with an `asset`"),
    "gltf version 1": (raw("scene.gltf", '{"asset": {"version": "1.0"}}'), "expected glTF version 2, got 1.0"),
    "gltf without meshes": (raw("scene.gltf", '{"asset": {"version": "2.0"}}'), "at least one triangle"),
    "gltf missing bin": (missing_bin, "needs nowhere.bin, which cannot be read"),
    "gltf short bin": (short_bin, "buffer 0: expected .* bytes, got .*truncated"),
    "gltf index too large": (gltf(set_indices([0, 1, 4])), "'square': expected indices from 0 to 3, got 4"),
    "gltf all vertices NaN": (gltf(set_positions(np.full((4, 3), np.nan))), "at least one triangle"),
    "gltf two components": (gltf(set_positions(QUAD[:, :2])), "expected 3 components, got 2"),
    "gltf no such accessor": (gltf(lambda g: primitive(g).update(indices=99)), "accessors: expected an index from 0"),
    "gltf no such material": (gltf(lambda g: primitive(g).update(material=7)), "materials: expected an index"),
    "gltf accessor too long": (
        gltf(lambda g: g.content["accessors"][0].update(count=1000)),
        "accessor 0: expected 1000 x 3 values",
    ),
    "gltf node loop": (gltf(two_parents), "one with two parents"),
    "gltf infinite transform": (gltf(lambda g: g.content["nodes"][0].update(scale=[1, 1, 1e999])), "finite transform"),
    "gltf broken colour": (
        gltf(lambda g: g.content["materials"][0].update(emissiveFactor=[1, 2])),
        "material 'paint': broken value",
    ),
    "gltf draco": (gltf(compressed("KHR_draco_mesh_compression")), "Draco-compressed geometry .* cannot be read; save"),
    "gltf draco without fallback": (gltf(draco_without_data), "Draco-compressed geometry"),
    "gltf meshopt": (gltf(compressed("EXT_meshopt_compression")), "meshopt-compressed geometry"),
    "ply truncated": (exported("scene.ply", cut=-20), "broken or truncated"),
    "ply text truncated": (exported("scene.ply", cut=-20, file_type="ply"), "truncated"),
    "ply header only": (raw("scene.ply", "ply\nformat ascii 1.0\n"), "broken or truncated"),
    "stl truncated": (exported("scene.stl", cut=-20), "broken or truncated"),
    "toml broken": (obj(toml="units = = 3"), "scene.jaxrefl.toml: not a TOML file"),
    "toml unknown key": (obj(toml="unit = 3"), "unknown key 'unit'; known are units"),
    "toml unknown parameter": (obj(toml="[materials.default]\nrough = 1"), "materials.default: unknown key 'rough'"),
    "toml parameter of another kind": (
        obj(toml='[materials.default]\nkind = "mirror"\nalpha = 0.2'),
        "unknown key 'alpha'; known are kind, colour",
    ),
    "toml opacity": (obj(toml="[materials.default]\nopacity = 2"), "opacity: expected a number from 0 to 1"),
    "toml coupled": (obj(toml="[materials.default]\ncoupled = 1"), "coupled: expected true or false, got 1"),
    "toml conductor": (obj(toml="[materials.default]\nconductor = 2"), "conductor: expected { eta = ..., k = ... }"),
    "toml unknown kind": (obj(toml='[materials.default]\nkind = "shiny"'), "expected one of mirror, glossy"),
    "toml no such material": (obj(toml='[materials.glass]\nkind = "glass"'), "matches nothing; there are default"),
    "toml no such object": (obj(toml='[objects."ball*"]\nkind = "ignore"'), "matches nothing; there are cube"),
    "toml alpha out of range": (obj(toml="[materials.default]\nalpha = 1.5"), "alpha: expected a number from 0 to 1"),
    "toml metallic out of range": (obj(toml="[materials.default]\nmetallic = -1"), "metallic: expected a number"),
    "toml alpha is text": (obj(toml='[materials.default]\nalpha = "low"'), "got 'low'"),
    "toml index below 1": (obj(toml="[materials.default]\neta = 0.9"), "eta: expected a number >= 1"),
    "toml everything ignored": (obj(toml='[objects."*"]\nkind = "ignore"'), "at least one triangle"),
    "toml units": (obj(toml="units = 0"), "units: expected a number > 0"),
    "toml up": (obj(toml='up = "north"'), "up: expected one of x"),
    "toml crease angle": (obj(toml="crease_angle = 200"), "crease_angle: expected a number from 0 to 180"),
    "toml missing environment": (obj(toml='environment = "nowhere.hdr"'), "nowhere.hdr: cannot read"),
    "toml two skies": (obj(toml='environment = "a.hdr"\nsky = 1'), "expected one of the two"),
    "toml light without position": (obj(toml='[[lights]]\ntype = "point"\nintensity = 1'), "lights.0.: needs position"),
    "toml unknown light": (obj(toml='[[lights]]\ntype = "laser"'), "expected one of point, spot, sun"),
    "toml camera in its target": (obj(toml="[[cameras]]\neye = [0,0,0]\ntarget = [0,0,0]"), "cameras.0.: look_at"),
    "toml camera without pixels": (
        obj(toml="[[cameras]]\neye = [0,0,1]\ntarget = [0,0,0]\nsize = [0, 9]"),
        "cameras.0.: size",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(tmp_path: Path, case: str):
    make, says = REFUSED[case]
    with pytest.raises(SceneError, match=says):
        load(make(tmp_path))


def half_nan(g: GltfWriter) -> None:
    positions = QUAD.copy()
    positions[3] = np.inf
    set_positions(positions)(g)


def zero_normal(g: GltfWriter) -> None:
    normals = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    normals[1] = 0
    primitive(g)["attributes"]["NORMAL"] = g.accessor(normals)


def broken_image(g: GltfWriter) -> None:
    g.content |= {"images": [{"bufferView": g.view(b"not an image")}], "textures": [{"source": 0}]}
    g.content["materials"][0]["pbrMetallicRoughness"] = {"baseColorTexture": {"index": 0}}


def metallic_two(g: GltfWriter) -> None:
    g.content["materials"][0]["pbrMetallicRoughness"] = {"metallicFactor": 2}


def textured_without_uv(g: GltfWriter) -> None:
    broken_image(g)
    g.content["images"] = [g.image(checker())]
    del primitive(g)["attributes"]["TEXCOORD_0"]


REPAIRED: dict[str, tuple[Maker, str, int]] = {
    "one NaN vertex in obj": (
        obj("v 1 1 1", "v nan 1 1"),
        "1 vertices are NaN, infinite or beyond 1e.18; left out 5 triangles that use them, in 1 object .cube.",
        7,
    ),
    "one huge vertex in obj": (obj("v 1 1 1", "v 1e30 1 1"), "left out 5 triangles that use them", 7),
    "one infinite vertex in gltf": (gltf(half_nan), "left out 1 triangles that use them", 1),
    "triangle without area": (obj("f 1 5 8 4", "f 1 5 8 4\nf 1 1 2"), "left out 1 triangles that have no area", 12),
    "zero normal": (gltf(zero_normal), "1 normals are zero or NaN; replaced", 2),
    "long normals": (obj("f 1 5 8 4", "vn 0 0 3\nf 1//1 5//1 8//1 4//1"), "4 normals are not of unit length", 12),
    "missing texture": (
        obj("o cube", "usemtl m", mtl="newmtl m\nmap_Kd nowhere.png\n"),
        "texture 'nowhere.png' left out: .*No such file",
        12,
    ),
    "broken texture": (gltf(broken_image), "texture 'image 0' left out", 2),
    "missing library": (obj("o cube", "mtllib nowhere.mtl"), "material library 'nowhere.mtl' is missing", 12),
    "undefined material": (obj("o cube", "usemtl ghost", mtl="newmtl m\n"), "'ghost' is not defined", 12),
    "material defined twice": (obj("o cube", "usemtl m", mtl="newmtl m\nnewmtl m\n"), "'m' is defined twice", 12),
    "colour above 1": (obj("o cube", "usemtl m", mtl="newmtl m\nKd 2 0 0\n"), "Kd: expected 0 to 1, got", 12),
    "metallic above 1": (gltf(metallic_two), "metallicFactor: expected 0 to 1, got 2; set to 1", 2),
    "texture without coordinates": (gltf(textured_without_uv), "it has no texture coordinates", 2),
    "unknown statement": (obj("o cube", "curv 0 1\no cube"), "1 lines starting with 'curv' are ignored", 12),
    "no light": (obj(), "the scene has no light; a constant sky of radiance 1 is added", 12),
}


@pytest.mark.parametrize("case", REPAIRED)
def test_repaired_with_a_warning_that_counts(tmp_path: Path, case: str):
    make, says, triangles = REPAIRED[case]
    path = make(tmp_path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = load(path)
    assert {w.category for w in caught} == {SceneWarning}
    messages = [str(w.message) for w in caught]
    assert sum(re.search(says, message) is not None for message in messages) == 1, messages
    assert all(message.startswith(path.name) for message in messages)
    assert scene.mesh.faces.shape[0] == triangles
    for array in (scene.mesh.vertices, scene.mesh.normals, scene.mesh.uv, scene.lower, scene.upper):
        assert array is None or np.isfinite(array).all()
