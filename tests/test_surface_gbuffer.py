"""The G-buffer against an independent NumPy version, and its properties."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import assert_close

from jaxrefl.core import look_at, project
from jaxrefl.rays import EmbreeTracer, camera_rays
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, Image, Part, emitter, glossy, matte, mirror
from jaxrefl.surface import build_gbuffer, look

SIZE = (24, 18)


def checker(name: str, values: tuple[int, int]) -> Image:
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[..., :3] = np.array([[values[0], values[1]], [values[1], values[0]]])[..., None]
    return Image(name, pixels)


@pytest.fixture(scope="module")
def scene():
    """A textured floor, a vertex-coloured wall and a smooth mirror tetrahedron."""
    floor = glossy("floor", (0.8, 0.6, 0.4), alpha=0.25).replace(
        base_colour_texture=checker("c", (255, 128)), metallic_roughness_texture=checker("m", (255, 64))
    )
    square = np.array([[-2, 0, -2], [-2, 0, 2], [2, 0, 2], [2, 0, -2]], np.float64)
    uv = np.array([[0, 0], [0, 3], [3, 3], [3, 0]], np.float64)
    corners = np.array([[0, 1.2, 0], [0.8, 0.2, 0.5], [-0.8, 0.2, 0.5], [0, 0.2, -0.9]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    wall = square[:, [0, 2, 1]] + np.array([0, 2, -2])
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], np.float64)
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    return assemble(
        Description(
            "test",
            [
                Part("floor", square, quad, floor, uv=uv),
                Part("wall", wall, quad, matte("wall", (0.5, 0.5, 0.5)), colours=colours),
                Part("gem", corners, faces, mirror("gem"), normals=corners - corners.mean(0)),
                Part("lamp", square * 0.1 + np.array([1.5, 2, 0]), quad, emitter("lamp", (3, 2, 1))),
            ],
        )
    )


@pytest.fixture(scope="module")
def seen(scene):
    camera = look_at((1.5, 2.0, 4.0), (0, 0.5, 0), size=SIZE)
    previous = look_at((1.4, 2.0, 4.0), (0, 0.5, 0), size=SIZE)
    tracer = EmbreeTracer(scene.mesh)
    return scene, camera, previous, tracer, look(scene, tracer, camera, previous_camera=previous)


def test_every_kind_of_surface_is_in_the_picture(seen):
    scene, *_, gbuffer = seen
    assert {int(i) for i in np.unique(gbuffer.object)} >= {-1, 0, 1, 2}


def test_positions_and_normals_agree_with_the_rays(seen):
    """p = o + t d, and the geometric normal is that of the plane through the triangle, in float64."""
    scene, camera, _, _, gbuffer = seen
    rays, valid = camera_rays(camera), np.asarray(gbuffer.valid)
    along = (
        np.asarray(rays.origin, np.float64) + np.asarray(rays.direction, np.float64) * np.asarray(gbuffer.t)[..., None]
    )
    assert np.abs(along - np.asarray(gbuffer.p))[valid].max() < 2e-6 * 5  # 5 world units away, measured 1.2e-6
    corners = np.asarray(scene.mesh.vertices, np.float64)[np.asarray(scene.mesh.faces)[np.asarray(gbuffer.triangle)]]
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal *= np.sign((normal * np.asarray(gbuffer.wo)).sum(-1, keepdims=True))
    assert_close(np.asarray(gbuffer.n)[valid], normal[valid].astype(np.float32), scale=5)


def test_normals_face_the_viewer(seen):
    *_, gbuffer = seen
    valid = gbuffer.valid
    assert bool(((gbuffer.n * gbuffer.wo).sum(-1)[valid] >= 0).all())
    assert bool(((gbuffer.n * gbuffer.ns).sum(-1)[valid] >= 0).all())
    np.testing.assert_allclose(jnp.linalg.norm(gbuffer.ns, axis=-1), 1, atol=1e-5)


def test_fill_values_are_what_the_types_say(seen):
    *_, gbuffer = seen
    empty = ~np.asarray(gbuffer.valid)
    assert empty.any()
    zero = ("p", "p_error", "t", "z_camera", "base_colour", "metallic", "alpha", "emission", "motion")
    for name in zero:
        assert (np.asarray(getattr(gbuffer, name))[empty] == 0).all(), name
    for name in ("object", "material", "triangle"):
        assert (np.asarray(getattr(gbuffer, name))[empty] == -1).all(), name
    assert (np.asarray(gbuffer.eta)[empty] == 1).all() and np.asarray(gbuffer.outside)[empty].all()
    assert (np.asarray(gbuffer.ns)[empty] == [0, 0, 1]).all()
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gbuffer))


def test_depth_and_motion_come_from_projection(seen):
    _, camera, previous, _, gbuffer = seen
    valid = np.asarray(gbuffer.valid)
    xy, depth = project(camera, gbuffer.p)
    np.testing.assert_allclose(np.asarray(gbuffer.z_camera)[valid], np.asarray(depth)[valid], rtol=1e-6)
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    centres = np.stack([columns, rows], -1) + 0.5
    np.testing.assert_allclose(np.asarray(xy)[valid], centres[valid], atol=2e-4)
    before, _ = project(previous, gbuffer.p)
    np.testing.assert_allclose(np.asarray(gbuffer.motion)[valid], np.asarray(before - xy)[valid], atol=1e-5)
    assert np.abs(np.asarray(gbuffer.motion)[valid]).max() > 0.1


def test_a_still_camera_has_no_motion(seen):
    scene, camera, _, tracer, _ = seen
    assert float(jnp.abs(look(scene, tracer, camera, previous_camera=camera).motion).max()) == 0


def test_textures_multiply_what_the_table_says(seen):
    """Base colour, metallic and alpha of the floor, looked up bilinearly by hand in float64."""
    scene, *_, gbuffer = seen
    floor = np.asarray(gbuffer.object) == 0
    p = np.asarray(gbuffer.p, np.float64)[floor]
    uv = (p[:, [0, 2]] + 2) / 4 * 3
    x, y = uv[:, 0] * 2 - 0.5, uv[:, 1] * 2 - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - x0, y - y0

    def bilinear(even: float, odd: float) -> np.ndarray:
        def texel(dx: int, dy: int) -> np.ndarray:
            return np.where((x0 + dx + y0 + dy) % 2 == 0, even, odd)

        top = texel(0, 0) * (1 - fx) + texel(1, 0) * fx
        return top * (1 - fy) + (texel(0, 1) * (1 - fx) + texel(1, 1) * fx) * fy

    colour = bilinear(1.0, ((128 / 255 + 0.055) / 1.055) ** 2.4)
    packed = bilinear(1.0, 64 / 255)
    tolerance = {"rtol": 1e-4, "atol": 2e-5}  # texture coordinates carry the rounding of the position: measured 3e-6
    np.testing.assert_allclose(np.asarray(gbuffer.base_colour)[floor], colour[:, None] * [0.8, 0.6, 0.4], **tolerance)
    np.testing.assert_allclose(np.asarray(gbuffer.alpha)[floor], 0.25 * packed**2, **tolerance)
    assert (np.asarray(gbuffer.metallic)[floor] == 0).all()


def test_vertex_colours_are_interpolated(seen):
    scene, *_, gbuffer = seen
    wall = np.asarray(gbuffer.object) == 1
    assert wall.any() and np.ptp(np.asarray(gbuffer.base_colour)[wall], axis=0).min() > 0.05
    other = np.asarray(gbuffer.object) == 2
    np.testing.assert_allclose(np.asarray(gbuffer.base_colour)[other], 0.95, rtol=1e-6)


def test_one_row_at_a_time_gives_the_same_picture(seen):
    """`look` builds in blocks of rows; the whole at once must not differ by more than rounding (motion: in pixels)."""
    scene, camera, previous, tracer, gbuffer = seen
    rays = camera_rays(camera)
    whole = build_gbuffer(scene, rays, tracer.closest(rays), camera=camera, previous_camera=previous)
    same = jax.tree.map(lambda x, y: np.allclose(x, y, rtol=1e-6, atol=1e-5), whole, gbuffer)
    assert jax.tree.all(same), same


def test_absent_features_are_not_stored():
    plain = assemble(Description("plain", [Part("t", np.eye(3), np.array([[0, 1, 2]]), matte("m", (1, 1, 1)))]))
    camera = look_at((2, 2, 2), (0.3, 0.3, 0.3), size=(8, 8))
    gbuffer = look(plain, EmbreeTracer(plain.mesh), camera)
    assert gbuffer.emission is None and gbuffer.transmission is None and gbuffer.motion is None
    assert bool(gbuffer.valid.any())
