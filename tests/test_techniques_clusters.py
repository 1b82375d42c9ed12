"""Pictures of clusters of mirror rays against ray tracing."""

import dataclasses
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from cluster_rooms import EYE, KINDS, SIZE, checks, clusters_of, frame_of, room, run
from shapes import QUAD, ball, floor

from jaxrefl._types import Frame
from jaxrefl.core import look_at
from jaxrefl.core.safe import norm
from jaxrefl.rays import in_view, view_of
from jaxrefl.scene.description import Image, Part, glossy, matte, mirror
from jaxrefl.techniques import clusters, raytrace
from jaxrefl.techniques.clusters import Found, Params
from jaxrefl.techniques.clusters.cameras import cluster_cameras
from jaxrefl.techniques.clusters.traverse import follow
from pipelines.bench_raster import NoRays


@pytest.fixture(scope="module")
def ball_room() -> Frame:
    return room()


def test_a_planar_mirror_differs_from_tracing_by_resampling_alone():
    """The share of pixels that show another thing falls with the texels: edges are cut at texels."""
    frame = frame_of([floor("m", mirror("m")), *checks("back")], size=(96, 72))
    truth, _ = run(raytrace, frame)
    wrong = []
    for resolution in (1.0, 2.0, 4.0):
        image, info = run(clusters, frame, params=Params(resolution=resolution), texels=10000, repair="none")
        assert info.counts["disoccluded"] == 0 and info.counts["clusters"] == 1
        difference = np.abs(np.asarray(image.radiance - truth.radiance)).max(-1)
        wrong.append((difference > 1e-3).mean())
        same = np.asarray(image.source == truth.source) & np.asarray(image.valid) & (difference < 1e-3)
        np.testing.assert_allclose(np.asarray(image.p)[same], np.asarray(truth.p)[same], atol=1e-3)
    assert wrong[2] < 0.6 * wrong[1] and wrong[1] < 0.6 * wrong[0] and wrong[0] < 0.02


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("maker", ["rays", "raster"])
def test_a_mirror_ball_is_that_of_ray_tracing(kind: str, maker: str, ball_room: Frame):
    truth, _ = run(raytrace, ball_room)
    image, info = run(clusters, ball_room, clusters=kind, maker=maker)
    shown = np.asarray(truth.valid)
    assert (np.asarray(image.valid) == shown).all() and info.counts["traced_pixels"] < 0.5 * shown.sum()
    difference = np.abs(np.asarray(image.radiance - truth.radiance)).mean(-1)[shown]
    assert difference.mean() < 0.04 and (difference > 0.05).mean() < 0.09  # edges of posts, 0.029 and 0.061


def test_rays_and_rasterisation_make_the_same_image(ball_room: Frame):
    a, _ = run(clusters, ball_room, maker="rays", repair="none")
    b, _ = run(clusters, ball_room, maker="raster", repair="none")
    assert (np.abs(np.asarray(a.radiance - b.radiance)).max(-1) > 1e-3).mean() < 0.002


def test_repairs(ball_room: Frame):
    """Nothing, a map, a ray: each leaves no less known than the one before, and tracing leaves no doubt."""
    truth, _ = run(raytrace, ball_room)
    shown, error, known = np.asarray(truth.valid), {}, {}
    for repair in ("none", "environment", "trace"):
        image, info = run(clusters, ball_room, repair=repair, capacity=4)
        difference = np.abs(np.asarray(image.radiance - truth.radiance)).mean(-1)
        error[repair], known[repair] = difference[shown].mean(), np.asarray(image.valid)[shown].mean()
    assert info.counts["disoccluded"] > 0.05
    assert error["trace"] < error["environment"] < error["none"]
    assert known["none"] < known["environment"] == known["trace"] == 1
    assert (np.asarray(image.confidence)[shown] == 1).all()


def test_what_is_disoccluded_is_found(ball_room: Frame):
    """Pixels whose reflected point is wrong are nearly all marked; without marks only edges are cut differently."""
    truth, _ = run(raytrace, ball_room)
    image, info = run(clusters, ball_room, repair="none", capacity=3)
    shown = np.asarray(truth.valid)
    wrong = shown & (np.asarray(norm(image.p - truth.p)) > 0.05 * np.asarray(truth.t + ball_room.gbuffer.t))
    wrong = wrong | (shown & ~np.asarray(image.valid))
    marked = np.asarray(info.found) >= Found.PASSED
    assert (wrong & ~marked).sum() < 0.05 * shown.sum() and (wrong & marked).sum() > 0.05 * shown.sum()


@pytest.mark.parametrize("maker", ["rays", "raster"])
def test_images_begin_where_rays_start(maker: str):
    """A plate inside the ball, of the same object: between a camera's eye and where the rays of its cluster start."""
    shape = ball("ball", mirror("m"), centre=(0, 0.6, 0), radius=0.6)
    plate = np.array([[-0.4, 0.3, 0.38], [-0.4, 0.9, 0.38], [0.4, 0.9, 0.38], [0.4, 0.3, 0.38]])
    faces = np.concatenate([shape.faces, QUAD + len(shape.vertices), QUAD[:, ::-1] + len(shape.vertices)])
    normals = np.concatenate([shape.normals, np.tile([0.0, 0.0, -1.0], (4, 1))])
    vertices = np.concatenate([shape.vertices, plate])
    frame = room(dataclasses.replace(shape, vertices=vertices, faces=faces, normals=normals), size=(128, 96))
    truth, _ = run(raytrace, frame)
    hidden, off = [], []
    for near in ("behind", "pixels"):
        image, info = run(clusters, frame, near=near, capacity=2, maker=maker, repair="none")
        found = np.asarray(info.found)
        hidden.append((found == Found.HIDDEN).sum() / info.counts["reflective_pixels"])
        clean = (found == Found.SURFACE) & np.asarray(truth.t > 0)
        off.append((np.asarray(norm(image.p - truth.p))[clean] > 0.1).mean())
    assert hidden[0] > 0.1 and hidden[1] < 0.5 * hidden[0] and off[1] < 0.15, (hidden, off)


def test_normal_maps_bend_the_rays():
    """A mirror floor whose texture tilts it this way and that: its clusters see what tracing sees."""
    tilt = np.full((1, 16, 4), 255, np.uint8)
    tilt[0, :, 0], tilt[0, :, 1], tilt[0, :, 2] = np.rint(127.5 + 30 * np.sin(np.arange(16) / 16 * 2 * np.pi)), 128, 252
    material = dataclasses.replace(mirror("m"), normal_texture=Image("tilt", tilt))
    uv = np.array([[0, 0], [0, 1], [4, 1], [4, 0]], np.float64)
    mapped = dataclasses.replace(floor("m", material), uv=uv)
    frame, plain = (frame_of([p, *checks("back")]) for p in (mapped, floor("m", mirror("m"))))
    truth, flat = (run(raytrace, f)[0] for f in (frame, plain))
    shown = np.asarray(truth.valid)
    changed = np.abs(np.asarray(truth.radiance - flat.radiance)).mean(-1)[shown].mean()
    image, info = run(clusters, frame)
    error = np.abs(np.asarray(image.radiance - truth.radiance)).mean(-1)[shown].mean()
    assert info.counts["clusters"] > 3 and error < 0.25 * changed, (info.counts, error, changed)


def test_cutting_clusters_makes_no_seams(ball_room: Frame):
    one, info_one = run(clusters, ball_room, params=Params(disparity=0.2))
    many, info_many = run(clusters, ball_room, params=Params(disparity=0.02))
    assert info_many.counts["clusters"] > 1.5 * info_one.counts["clusters"]
    difference = np.abs(np.asarray(one.radiance - many.radiance)).max(-1)
    assert (difference > 0.05).mean() < 0.02  # edges of posts, cut at other texels


@pytest.mark.parametrize("move", [(0.0, 0.0, 0.0), (100.0, -40.0, 70.0)])
def test_moving_the_scene_changes_nothing(move, ball_room: Frame):
    shape = ball("ball", mirror("m"), centre=(0, 0.6, 0), radius=0.6)
    parts = [floor("floor", matte("f", (0.5, 0.5, 0.5)), size=6), shape, *checks("back"), *checks("front", z=5)]
    moved = [dataclasses.replace(p, vertices=np.asarray(p.vertices) + np.asarray(move)) for p in parts]
    eye, target = np.array(EYE) + move, np.array([0, 0.5, 0]) + move
    frame = frame_of(moved, eye=eye, target=target)
    here, _ = run(clusters, ball_room)
    there, _ = run(clusters, frame)
    assert (np.abs(np.asarray(here.radiance - there.radiance)).max(-1) > 0.02).mean() < 0.02


@pytest.mark.parametrize("lobes", ["ggx", "cone"])
@pytest.mark.parametrize("way", ["rays", "neighbourhood"])
def test_rough_floors_blur_with_distance(lobes: str, way: str):
    """Against 256 traced rays: nearer than a mirror would be; the GGX lobe's own rays nearest of all."""
    frame = frame_of([floor("m", glossy("m", (1, 1, 1), alpha=0.08, metallic=1.0)), *checks("back")])
    truth, _ = run(raytrace, frame, samples=256)
    smooth = dataclasses.replace(frame.gbuffer, alpha=jnp.zeros_like(frame.gbuffer.alpha))
    sharp, _ = run(raytrace, dataclasses.replace(frame, gbuffer=smooth))
    image, info = run(clusters, frame, samples=64, lobes=lobes, glossy=way, repair="none", texels=2000)
    shown = np.asarray(truth.valid & image.valid)
    error, worst = (np.sqrt(np.mean(np.asarray(x.radiance - truth.radiance)[shown] ** 2)) for x in (image, sharp))
    limit = {("ggx", "rays"): 0.35, ("ggx", "neighbourhood"): 0.7}.get((lobes, way), 0.95)
    assert shown.mean() > 0.2 and error < limit * worst
    assert int(info.counts["steps"]) >= 1


def test_as_published_rough_reflections_fade_into_the_diffuse_colour():
    """The far plane comes nearer with roughness; beyond it nothing is reflected but the surface's own colour."""
    grey = glossy("m", (0.3, 0.3, 0.3), alpha=0.3)
    frame = frame_of([floor("m", grey), *checks("back", z=-3.9)])
    faded, _ = run(clusters, frame, far="glossiness", params=Params(fade=0.03), samples=16, repair="none")
    plain, _ = run(clusters, frame, samples=16, repair="none")
    shown = np.asarray(faded.valid & plain.valid)
    colour = np.asarray(faded.radiance)[shown].mean(0)
    assert np.ptp(colour) < 0.25 * np.ptp(np.asarray(plain.radiance)[shown].mean(0)) or np.ptp(colour) < 0.02


def bowl() -> Part:
    """A mirror bowl, open towards the viewer."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 65), np.linspace(0.02, 1.4, 24))
    p = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), -np.cos(v)], -1).reshape(-1, 3)
    index = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (i.reshape(-1) for i in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return Part(
        "bowl", p * 0.8 + [0, 0.9, 0], faces, glossy("bowl", (0.9, 0.6, 0.2), alpha=0.0, metallic=0.5), normals=-p
    )


@pytest.mark.parametrize("concave", ["reflector", "ignore", "cluster"])
def test_concave_reflectors_meet_themselves(concave: str):
    """Rays that meet the bowl again: seen as any other thing, or as its own pixels, unless they are ignored."""
    frame = room(bowl())
    truth, _ = run(raytrace, frame)
    image, _ = run(clusters, frame, concave=concave, pitch="ends", texels=3000, repair="none")
    mirrors, found, *_ = clusters_of(frame)
    inner = np.asarray(found.concave)[np.maximum(np.asarray(found.label), 0)] & np.asarray(mirrors.valid)
    assert inner.mean() > 0.05
    shown = np.asarray(truth.valid & image.valid)
    again = shown & (np.linalg.norm(np.asarray(truth.p) - [0, 0.9, 0], axis=-1) < 0.85)
    assert again.sum() > 50
    off = np.asarray(norm(image.p - truth.p))[again] > 0.1
    assert off.mean() > 0.7 if concave == "ignore" else off.mean() < 0.5


def test_deforming_meshes_need_no_tracer():
    """With rasterised depth images and light that casts no shadows nothing asks for rays."""

    frame = room()
    cast, _ = run(clusters, frame, maker="raster", repair="none")
    drawn, info = run(clusters, dataclasses.replace(frame, tracer=NoRays()), maker="raster", repair="none")
    assert info.rays == 0 and bool((cast.radiance == drawn.radiance).all())


def test_the_example_of_a_deforming_mesh_runs_as_it_is_printed(capsys):
    page = (Path(__file__).parent.parent / "docs" / "pages" / "clusters.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.S)
    exec(code, {})
    assert capsys.readouterr().out.strip() in page


def test_values_of_knobs_do_not_recompile(ball_room: Frame):
    run(clusters, ball_room, params=Params(disparity=0.1))
    before = cluster_cameras._cache_size(), follow._cache_size()
    run(clusters, ball_room, params=Params(disparity=0.12, resolution=1.5, lobe=1.0, smallest=2))
    assert (cluster_cameras._cache_size(), follow._cache_size()) == before


def test_in_view_is_the_inverse_of_the_axes():
    views = view_of(look_at((1, 2, 3), (0, 0, 0), size=SIZE))
    p = jnp.array([[0.3, -0.2, 0.9]])
    lateral, z = in_view(views, jnp.zeros(1, jnp.int32), p)
    back = views.eye[0] + lateral[0, 0] * views.axes[0, 0] + lateral[0, 1] * views.axes[0, 1] + z[0] * views.axes[0, 2]
    np.testing.assert_allclose(back, p[0], atol=1e-6)
