"""Clusters of mirror rays: bins, eyes and cameras, and the walk through depth images."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cluster_rooms import KINDS, checks, clusters_of, frame_of, room, run
from hypothesis import given
from hypothesis import strategies as st
from reference import clusters as slow
from shapes import QUAD, ball, floor

from jaxrefl._types import Frame, Rays
from jaxrefl.core import look_at
from jaxrefl.rays import seen_by
from jaxrefl.scene.description import Part, mirror
from jaxrefl.surface import look, reflective
from jaxrefl.techniques import clusters
from jaxrefl.techniques.clusters import Options, Params
from jaxrefl.techniques.clusters.bins import AZIMUTHS, POLARS, SIDE, octahedral_bin, spherical_bin
from jaxrefl.techniques.clusters.cameras import cluster_cameras
from jaxrefl.techniques.clusters.cluster import Mirrors, describe
from jaxrefl.techniques.clusters.eye import displacement, mirrored_eye, nearest_point
from jaxrefl.techniques.clusters.label import set_apart
from jaxrefl.techniques.clusters.traverse import project_rays


@pytest.fixture(scope="module")
def ball_room() -> Frame:
    return room()


# Bins


@given(x=st.floats(-1, 1, width=16), y=st.floats(-1, 1, width=16), z=st.floats(-1, 1, width=16))
def test_spherical_bins_are_those_of_the_paper(x: float, y: float, z: float):
    n = np.array([x, y, z]) + [0, 0, 1e-3]
    n = n / np.linalg.norm(n)
    found = int(spherical_bin(jnp.asarray(n, jnp.float32), jnp.float32(1)))
    column, row = slow.spherical_bin(n, AZIMUTHS, POLARS)
    if found != row * AZIMUTHS + column:  # within rounding of the edge of a bin
        around, down = np.degrees(np.arctan2(n[2], n[0])) % 360 * AZIMUTHS / 360, np.arccos(n[1]) * POLARS / np.pi
        assert min(abs(around - round(around)), abs(down - round(down))) < 1e-4


def test_octahedral_bins_have_one_size():
    rng = np.random.default_rng(0)
    n = rng.normal(size=(400_000, 3))
    n = n / np.linalg.norm(n, axis=-1, keepdims=True)
    count = np.bincount(octahedral_bin(jnp.asarray(n, jnp.float32), jnp.ones(len(n))), minlength=SIDE * SIDE)
    assert len(count) == SIDE * SIDE
    assert np.abs(count / 4000 - 1).max() < 0.08  # 4 standard deviations of a count of 4000 are 0.063
    spherical = np.bincount(spherical_bin(jnp.asarray(n, jnp.float32), jnp.ones(len(n))))
    assert spherical.max() > 4 * spherical[spherical > 0].min()  # what they are for


def test_one_sphere_over_the_whole_frame_has_the_papers_52_clusters():
    """13 x 8 bins, of which half are visible, if its pole lies on the outline; one row more or less at the outline."""
    sphere = frame_of([ball("b", mirror("m"))], eye=(0, 0, 40), target=(0, 0, 0), size=(96, 96))
    tight = dataclasses.replace(sphere.camera, focal=sphere.camera.focal * 16)
    tight = dataclasses.replace(sphere, camera=tight, gbuffer=look(sphere.scene, sphere.tracer, tight))
    share = float(reflective(tight.gbuffer).mean())
    assert share > 0.6
    _, found, *_ = clusters_of(tight, Params(exponent=0.0), clusters="spherical")
    assert 48 <= int((found.pixels > 0).sum()) <= 60


@pytest.mark.parametrize("kind", KINDS)
def test_every_mirror_pixel_has_a_cluster_of_its_own_reflector(kind: str, ball_room: Frame):
    mirrors, found, _, _ = clusters_of(ball_room, clusters=kind)
    valid, label = np.asarray(mirrors.valid), np.asarray(found.label)
    assert (label[valid] >= 0).all() and (label[~valid] == -1).all()
    assert (np.asarray(found.object)[label[valid]] == np.asarray(mirrors.object)[valid]).all()
    assert int(found.pixels.sum()) == valid.sum()


@pytest.mark.parametrize("kind", KINDS)
def test_too_many_clusters_are_merged_and_counted(kind: str, ball_room: Frame):
    mirrors, found, cameras, wanted = clusters_of(ball_room, clusters=kind, capacity=3)
    assert wanted > 3 and int(found.pixels.sum()) == int(mirrors.valid.sum())
    _, info = run(clusters, ball_room, clusters=kind, capacity=3)
    assert info.counts["merged"] > 0 and info.counts["clusters"] <= 3


def test_a_plane_is_one_cluster_and_parallel_planes_are_not(ball_room: Frame):
    def stair(steps: int) -> list[Part]:
        parts = [np.array([[-1, 0.2 * i, -i], [-1, 0.2 * i, -i + 1], [1, 0.2 * i, -i + 1], [1, 0.2 * i, -i]])
                 for i in range(steps)]  # fmt: skip
        faces = np.concatenate([QUAD + 4 * i for i in range(steps)])
        return [Part("stair", np.concatenate(parts), faces, mirror("m")), *checks("back", z=-6)]

    for kind in KINDS:
        for steps in (1, 3):
            frame = frame_of(stair(steps), eye=(0, 3, 4), target=(0, 0, -1))
            _, found, *_ = clusters_of(frame, clusters=kind)
            assert int((found.pixels > 0).sum()) == steps and int(found.planar.sum()) == steps, kind


def test_planes_tilted_by_a_few_degrees_are_told_apart():
    """Facets of one object, five degrees from each other: one planar cluster each."""
    parts = []
    for i, angle in enumerate(np.radians([0, 5, 10])):
        strip = np.array([[-2, 0, 0], [-2, 0, 1], [2, 0, 1], [2, 0, 0]]) @ np.array(
            [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
        )
        parts.append(Part("facets", strip - [0, 0, 1.2 * i - 1], QUAD, mirror("m")))
    _, found, *_ = clusters_of(frame_of([*parts, *checks("back")], eye=(0, 3, 4)))
    assert int((found.pixels > 0).sum()) == 3 and int(found.planar.sum()) == 3


def test_rays_that_turn_away_from_their_cluster_are_set_apart():
    mirrors = degenerate("one point")
    label = jnp.zeros(16, jnp.int32)
    wi = mirrors.wi.at[3].multiply(-1.0)
    moved = set_apart(dataclasses.replace(mirrors, wi=wi), label, capacity=4)
    assert moved[3] == 3 and int((moved == 0).sum()) == 15
    assert (set_apart(dataclasses.replace(mirrors, wi=wi), label, capacity=1) == 0).all()


# Eyes and cameras


def test_equation_1_makes_near_and_far_ends_look_alike():
    """Diverging rays in a plane: the equation's eye sees both extents alike, as similar triangles say."""
    behind, near, spread, reach = 2.0, 0.5, 30.0, 10.0
    far = spread * behind / (behind + reach)
    f = float(displacement(jnp.float32(near), jnp.float32(far), jnp.float32(spread)))
    np.testing.assert_allclose(f * behind, slow.displacement(near, spread, reach), rtol=1e-5)


@given(values=st.tuples(*[st.floats(0, 1e4, width=32, allow_subnormal=False)] * 3))
def test_equation_1_is_safe(values):
    f, slopes = jax.value_and_grad(displacement, (0, 1, 2))(*(jnp.float32(v) for v in values))
    assert 0 < float(f) <= 4 and all(np.isfinite(s) for s in slopes)


def test_equation_1_leaves_planes_and_single_pixels_alone():
    one = jnp.float32(1)
    assert float(displacement(one, one, 5 * one)) == 1 and float(displacement(0 * one, 0 * one, 0 * one)) == 1


def test_a_planar_cluster_has_the_viewers_mirror_image_as_its_eye():
    frame = frame_of([floor("m", mirror("m")), *checks("back")])
    for way in ("nearest", "equation", "fit"):
        mirrors, found, cameras, _ = clusters_of(frame, eye=way)
        assert int((found.pixels > 0).sum()) == 1 and bool(found.planar[0])
        eye = np.asarray(frame.camera.world_from_camera)[:3, 3] * [1, -1, 1]
        np.testing.assert_allclose(cameras.views.eye[0], eye, atol=1e-5)
        free = nearest_point(mirrors, found, mirrored_eye(found, frame.camera.world_from_camera[:3, 3]))
        np.testing.assert_allclose(free[0], eye, atol=2e-3)  # least squares in float32


def test_the_fitted_eye_is_no_worse_than_the_equations(ball_room: Frame):
    """Of eyes on one line the fit has the least squared disparity; the nearest point may lie beside that line."""
    total = {}
    for way in ("equation", "fit", "nearest"):
        mirrors, found, cameras, _ = clusters_of(ball_room, eye=way, clusters="octahedral")
        valid, view = found.label >= 0, jnp.maximum(found.label, 0)
        lines, _ = project_rays(cameras.views, view, Rays(mirrors.p, mirrors.wi), cameras.reach[view])
        pixels = (lines.end - lines.start) * cameras.views.pitch[view]
        usable = np.asarray(valid & cameras.usable[view])
        total[way] = np.median(np.linalg.norm(np.asarray(pixels), axis=-1)[usable])
    assert total["fit"] <= 1.05 * total["equation"] and total["nearest"] <= 1.05 * total["equation"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", ["nearest", "equation", "fit"])
@pytest.mark.parametrize("axis", ["rays", "normal"])
def test_every_camera_sees_both_ends_of_all_its_rays(kind: str, way: str, axis: str, ball_room: Frame):
    mirrors, found, cameras, _ = clusters_of(ball_room, clusters=kind, eye=way, axis=axis)
    view = jnp.maximum(found.label, 0)
    usable = np.asarray((found.label >= 0) & cameras.usable[view])
    far = mirrors.p + mirrors.wi * cameras.reach[view][:, None]
    assert usable.sum() > 100
    for end in (mirrors.p, far):
        assert np.asarray(seen_by(cameras.views, view, end))[usable].all()


def degenerate(kind: str) -> Mirrors:
    """Sixteen pixels that no camera likes."""
    n = 16
    rng = np.random.default_rng(1)
    p, normal = rng.uniform(-1, 1, (n, 3)), np.tile([0.0, 1.0, 0.0], (n, 1))
    if kind == "one point":
        p[:] = p[0]
    if kind == "opposite normals":
        normal[::2] *= -1
    if kind == "random normals":
        normal = rng.normal(size=(n, 3))
    eye = np.array([0.0, 0.5 if kind == "in the plane" else 3.0, 3.0])
    if kind == "in the plane":
        p[:, 1] = 0.5
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    wo = eye - p
    t = np.linalg.norm(wo, axis=-1)
    wo = wo / t[:, None]
    wi = 2 * (wo * normal).sum(-1, keepdims=True) * normal - wo
    zero = np.zeros(n)
    fields = (np.ones(n, bool), p, wi, normal, t, zero.astype(int), zero + 1e-6, zero == 0, zero, zero == 1)
    kinds = (bool, *[np.float32] * 4, np.int32, np.float32, bool, np.float32, bool)
    return Mirrors(*(jnp.asarray(x, k) for x, k in zip(fields, kinds, strict=True)))


@pytest.mark.parametrize("kind", ["one point", "opposite normals", "random normals", "in the plane"])
@pytest.mark.parametrize("way", ["nearest", "equation", "fit"])
def test_degenerate_clusters_have_finite_cameras_or_none(kind: str, way: str):
    mirrors = degenerate(kind)
    options = Options(eye=way, capacity=4)
    camera = look_at((0, 0.5 if kind == "in the plane" else 3.0, 3), (0, 0, 0), size=(4, 4))
    found = describe(mirrors, jnp.zeros(16, jnp.int32), capacity=4)
    cameras = cluster_cameras(camera, mirrors, found, jnp.float32(10), Params(), options=options, shape=(4, 4))
    assert all(bool(jnp.isfinite(x).all()) for x in jax.tree.leaves((found, cameras)))
    assert int((cameras.views.size[:, 0] * cameras.views.size[:, 1]).sum()) <= options.room(16)
    view = jnp.zeros(16, jnp.int32)
    if bool(cameras.usable[0]):
        assert bool(seen_by(cameras.views, view, mirrors.p).all())
