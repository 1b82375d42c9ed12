"""Reprojection and naive warping as techniques: exact without motion, never a hidden point, never a ghost."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shapes import floor

from jaxrefl._status import Source
from jaxrefl._types import Frame
from jaxrefl.core import look_at
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, Material, Part, glossy, matte, mirror
from jaxrefl.surface import look, reflective
from jaxrefl.techniques import raytrace, temporal, warp
from jaxrefl.techniques._reproject import KeyOptions, wants_key
from jaxrefl.techniques.temporal import Reason, Taken
from pipelines.measure import compile_seconds
from scenes.shapes import box

SIZE = (64, 48)
"""One size and one set of parts for all tests, so that each stage compiles once."""
FRONT, BACK = (-0.15, 0.0, -1.0), (-0.75, 0.0, -2.6)
REFLECTING = {"mirror": mirror("polished"), "glossy": glossy("polished", (1, 1, 1), alpha=0.05, metallic=1.0)}


def pillar(name: str, colour, foot) -> Part:
    x, y, z = foot
    return box((x - 0.12, y, z - 0.12), (x + 0.12, y + 1.6, z + 0.12)).part(name, matte(name, colour))


def room(*, ground: str = "mirror", front=FRONT, scale: float = 1.0):
    """A polished floor, a wall, and two pillars, one behind the other: Fig. 9 of the paper. Light without noise."""
    wall = box((-4, 0, -4.2), (4, 4, -4)).part("wall", matte("wall", (0.5, 0.55, 0.6)))
    parts = [floor("ground", REFLECTING[ground]), wall, pillar("front", (0.9, 0.1, 0.1), front)]
    parts.append(pillar("back", (0.1, 0.8, 0.1), BACK))
    parts = [dataclasses.replace(p, vertices=np.asarray(p.vertices) * scale) for p in parts]
    return assemble(Description("pillars", parts, ambient=(1.0, 1.0, 1.0)))


def camera_at(step: float, scale: float = 1.0):
    eye, target = np.array([-0.9 + 0.06 * step, 0.9, 2.6]), np.array([-0.3, 0.1, -0.6])
    return look_at(scale * eye, scale * target, size=SIZE, fov_y=40)


def frame_of(scene, camera, tracer, number: int = 0, ahead=None) -> Frame:
    return Frame(scene, camera, look(scene, tracer, camera), jax.random.key(number), tracer, ahead)


def run(technique, steps, *, scene=None, options=None, params=None, scenes=None, ahead=None):
    """Frames at positions of the path, in order: frames, reflections and infos."""
    scenes = scenes or [scene or room()] * len(steps)
    tracers = {id(s): EmbreeTracer(s.mesh) for s in scenes}
    options = options or technique.Options(block=4096)
    params = params or technique.Params()
    state, done = technique.init(scenes[0], tracers[id(scenes[0])], options=options), []
    for number, (step, current) in enumerate(zip(steps, scenes, strict=True)):
        frame = frame_of(current, camera_at(step), tracers[id(current)], number, ahead)
        state, reflection, info = technique.step(state, frame, params, options=options)
        done.append((frame, reflection, info))
    return done


def traced(frame, bounces: int = 0):
    options = raytrace.Options(block=4096, bounces=bounces)
    _, reflection, _ = raytrace.step(raytrace.State(), frame, raytrace.Params(), options=options)
    return reflection


LOOSE = temporal.Params(threshold=1.0)
KEEP = temporal.Options(block=4096, policy="interval", interval=100)


def wrong(frame, reflection, *, far: float = 0.02) -> np.ndarray:
    """Reused mirror pixels whose reflected point is not what a ray finds."""
    truth = traced(frame)
    reused = np.asarray(reflection.source) == Source.REUSED
    off = np.linalg.norm(np.asarray(reflection.p - truth.p, np.float64), axis=-1)
    return reused & (off > far * np.maximum(np.asarray(truth.t), 0.1))


def test_the_same_camera_gives_the_key_frame_exactly():
    first, second = run(temporal, [0.0, 0.0], options=KEEP)
    assert (first[1].radiance == second[1].radiance).all() and (first[1].valid == second[1].valid).all()
    assert second[2].counts["traced_pixels"] == 0 and second[2].rays == 0
    reused = np.asarray(second[1].valid)
    assert (np.asarray(second[1].source)[reused] == Source.REUSED).all()
    assert (np.asarray(second[2].flow) == 0).all()


def test_pixels_that_are_traced_are_those_of_ray_tracing():
    first, second = run(temporal, [0.0, 1.0], options=KEEP)
    for frame, reflection, info in (first, second):
        mine = np.asarray(reflection.source) == Source.TRACED
        assert mine.sum() >= 10 and (np.asarray(reflection.confidence)[mine] == 1).all()
        np.testing.assert_array_equal(np.asarray(reflection.radiance)[mine], np.asarray(traced(frame).radiance)[mine])
        assert info.counts["traced_pixels"] >= mine.sum()


def test_reuse_is_right_and_knows_how_right():
    frames = run(temporal, [0.0, 1.0, 2.0, 3.0], options=KEEP)
    for frame, reflection, info in frames[1:]:
        wanted, reused = np.asarray(reflective(frame.gbuffer)), np.asarray(reflection.source) == Source.REUSED
        assert (np.asarray(reflection.valid) == wanted).all()
        assert reused.sum() > 0.6 * wanted.sum()
        assert (np.asarray(info.reason == int(Reason.REUSED)) == reused).all()
        error = np.abs(np.asarray(reflection.radiance - traced(frame).radiance)).max(-1)[reused]
        assert error.mean() < 2e-3 and np.quantile(error, 0.99) < 0.02  # measured: 2e-4 and 4e-3
        confidence = np.asarray(reflection.confidence)[reused]
        assert confidence.min() >= 0.5 - 1e-6 and confidence.max() <= 1
        assert set(np.unique(info.taken_from)) <= {0, int(Taken.KEY), int(Taken.RECENT)}


def test_a_hidden_point_is_never_valid():
    """Fig. 9: the back pillar comes out from behind the front one. No reused pixel shows what a ray does not find."""
    steps = [0.0, 2.0, 4.0, 6.0, 8.0]
    counted = {"refined": 0, "as_published": 0}
    for method in counted:
        options = dataclasses.replace(KEEP, method=method)
        for frame, reflection, info in run(temporal, steps, options=options)[1:]:
            counted[method] += int(wrong(frame, reflection).sum())
            hidden = np.asarray(info.reason) == Reason.HIDDEN
            assert method == "as_published" or not (hidden & (np.asarray(reflection.source) == Source.REUSED)).any()
    assert counted["refined"] == 0
    assert counted["as_published"] > 10  # what the paper's Fig. 9 is about: measured 40 and more


def test_what_moves_leaves_no_ghost():
    still, moved = room(), room(front=(0.5, 0.0, -1.0))
    for moving in ("retrace", "follow"):
        options = dataclasses.replace(KEEP, moving=moving)
        _, second = run(temporal, [0.0, 1.0], scenes=[still, moved], options=options)
        frame, reflection, info = second
        assert not wrong(frame, reflection).any()
        red = np.asarray(reflection.radiance)[..., 0] > 1.3 * np.asarray(reflection.radiance)[..., 2]
        expected = traced(frame).radiance
        true_red = np.asarray(expected)[..., 0] > 1.3 * np.asarray(expected)[..., 2]
        assert true_red.sum() > 20 and (red != true_red).sum() <= 2
        assert int(info.counts["traced_pixels"]) < int(info.counts["reflective_pixels"])


def test_a_reflector_that_moves_is_traced_or_followed():
    scene = room()
    vertices = scene.mesh.vertices + jnp.array([[0.0, 0.01, 0.0]])
    lifted = dataclasses.replace(scene, mesh=dataclasses.replace(scene.mesh, vertices=vertices))
    _, second = run(temporal, [0.0, 1.0], scenes=[scene, lifted], options=KEEP)
    assert set(np.unique(second[2].reason)) == {int(Reason.NONE), int(Reason.MOVED)}
    followed = dataclasses.replace(KEEP, moving="follow")
    _, second = run(temporal, [0.0, 1.0], scenes=[scene, lifted], options=followed)
    assert not wrong(second[0], second[1]).any()
    assert second[2].counts["share"] < 0.5


@pytest.mark.slow
def test_rough_reflections_are_reused_within_their_lobe():
    scene = room(ground="glossy")
    options = dataclasses.replace(KEEP, samples=4)
    near = run(temporal, [0.0, 0.02], scene=scene, options=options)[1]
    far = run(temporal, [0.0, 6.0], scene=scene, options=options)[1]
    assert near[2].counts["share"] < 0.2
    assert far[2].counts["share"] > 0.9
    assert (np.asarray(far[2].reason) == Reason.LOBE).any()
    wide = run(temporal, [0.0, 6.0], scene=scene, options=options, params=temporal.Params(lobe=2.0))[1]
    assert wide[2].counts["share"] < far[2].counts["share"]


def test_policies_decide_when_to_trace_anew():
    options = {name: KeyOptions(policy=name, interval=3) for name in ("share", "interval", "error", "balance")}
    params = temporal.Params(threshold=0.3, error=0.01)
    cases = {  # (age, share, spent, error) -> who wants a key frame
        (1, 0.31, 1.0, 0.0): {"share"},
        (3, 0.1, 1.2, 0.0): {"interval"},
        (2, 0.1, 1.1, 0.02): {"error"},
        (4, 0.4, 1.5, 0.0): {"share", "interval", "balance"},
        (1, 0.0, 1.0, 0.0): set(),
    }
    for (age, share, spent, error), expected in cases.items():
        found = {n for n, o in options.items() if wants_key(o, age, share, spent, error, params)}
        assert found == expected, (age, share, spent, error)


@pytest.mark.parametrize("technique", [temporal, warp])
def test_key_frames_come_when_the_policy_says(technique):
    options = technique.Options(block=4096, policy="interval", interval=2)
    keys = [info.counts["key_frame"] for _, _, info in run(technique, [0.0, 1.0, 2.0, 3.0], options=options)]
    assert keys == [1, 0, 1, 0]
    options = technique.Options(block=4096)
    infos = [i for _, _, i in run(technique, [0.0, 20.0], options=options, params=technique.Params(threshold=0.0))]
    assert [i.counts["key_frame"] for i in infos] == [1, 1] and infos[1].counts["share"] == 1


def test_two_key_frames_are_better_than_one():
    ahead = camera_at(4.0)
    options = dataclasses.replace(KEEP, interval=4, keys=2, recent=False)
    two = run(temporal, [0.0, 1.0, 2.0, 3.0, 4.0], options=options, ahead=ahead)
    one = run(temporal, [0.0, 1.0, 2.0, 3.0, 4.0], options=dataclasses.replace(options, keys=1))
    for (frame, reflection, info), (_, _, single) in list(zip(two, one, strict=True))[1:4]:
        assert info.counts["share"] < single.counts["share"]
        assert (np.asarray(info.taken_from) == Taken.AHEAD).any()
        assert not wrong(frame, reflection).any()
    last = two[4]  # arrived: the key frame that was traced ahead
    np.testing.assert_array_equal(last[1].radiance, traced(last[0]).radiance)
    assert last[2].counts["traced_pixels"] == 0


def test_the_budget_is_kept_and_what_is_beyond_it_is_counted():
    options = dataclasses.replace(KEEP, budget=1, recent=False)
    frame, reflection, info = run(temporal, [0.0, 3.0], options=options)[1]
    assert info.counts["traced_pixels"] <= 0.01 * SIZE[0] * SIZE[1]
    lost = np.asarray(reflective(frame.gbuffer)) & ~np.asarray(reflection.valid)
    assert 0 < lost.sum() <= info.counts["overflow"]
    assert (np.asarray(reflection.radiance)[lost] == 0).all()
    assert not wrong(frame, reflection).any()


def test_scaling_the_world_changes_nothing():
    big = room(scale=64.0)
    tracer, state = EmbreeTracer(big.mesh), temporal.State()
    small = run(temporal, [0.0, 1.0], options=KEEP)
    for number, step in enumerate([0.0, 1.0]):
        frame = frame_of(big, camera_at(step, 64.0), tracer, number)
        state, reflection, info = temporal.step(state, frame, LOOSE, options=KEEP)
        same = np.asarray(info.reason) == np.asarray(small[number][2].reason)
        assert same.mean() > 0.995
        reused = np.asarray(info.reason == int(Reason.REUSED)) & same
        np.testing.assert_allclose(reflection.radiance[reused], small[number][1].radiance[reused], atol=1e-4)


def test_nothing_is_compiled_from_frame_to_frame():
    scene = room()
    run(temporal, [0.0, 1.0, 2.0, 3.0], scene=scene, options=KEEP)
    with compile_seconds() as spent:
        run(temporal, [0.5, 1.5, 2.5, 3.5], scene=scene, options=KEEP, params=temporal.Params(contrast=0.03))
    assert not spent


def test_reusing_a_state_gives_the_same_frame_again():
    """The runner steps twice from one state to tell compile time; nothing in it may be consumed."""
    scene, tracer = room(), None
    tracer = EmbreeTracer(scene.mesh)
    state, _, _ = temporal.step(temporal.State(), frame_of(scene, camera_at(0), tracer), LOOSE, options=KEEP)
    state, _, _ = temporal.step(state, frame_of(scene, camera_at(1), tracer), LOOSE, options=KEEP)
    frame = frame_of(scene, camera_at(2), tracer)
    (_, a, _), (_, b, _) = (temporal.step(state, frame, LOOSE, options=KEEP) for _ in range(2))
    assert jax.tree.all(jax.tree.map(lambda x, y: bool((x == y).all()), a, b))


def test_warping_sticks_to_surfaces():
    """The control: the floor's points keep the radiance they had, which is wrong for a mirror."""
    frames = run(warp, [0.0, 2.0], options=warp.Options(block=4096, policy="interval", interval=100))
    frame, reflection, info = frames[1]
    reused = np.asarray(reflection.source) == Source.REUSED
    assert reused.sum() > 0.6 * np.asarray(reflective(frame.gbuffer)).sum()
    assert (np.asarray(info.traced) == (np.asarray(reflection.valid) & ~reused)).all()
    naive = np.abs(np.asarray(reflection.radiance - traced(frame).radiance)).mean()
    better = run(temporal, [0.0, 2.0], options=KEEP)[1][1]
    assert np.abs(np.asarray(better.radiance - traced(frame).radiance)).mean() < 0.1 * naive
    assert 0 < float(np.asarray(reflection.confidence)[reused].mean()) < 1
    same = run(warp, [0.0, 0.0], options=warp.Options(block=4096))
    np.testing.assert_allclose(same[1][1].radiance, same[0][1].radiance, atol=1e-5)


@pytest.mark.slow
def test_mirrors_seen_in_a_mirror_are_traced_or_reused_until_they_have_turned():
    """What is reflected may be a mirror itself; followed further it looks different from everywhere."""
    wall = box((-4, 0, -4.2), (4, 4, -4)).part(
        "wall", Material("shiny", metallic=1.0, alpha=0.0, base_colour=(1, 1, 1))
    )
    parts = [floor("ground", mirror("polished")), wall, pillar("front", (0.9, 0.1, 0.1), FRONT)]
    scene = assemble(Description("mirrors", parts, ambient=(1.0, 1.0, 1.0)))
    steps, changing, error = [0.0, 0.05, 3.0], {}, {}
    for inner in ("trace", "turn", "reuse"):
        done = run(temporal, steps, scene=scene, options=dataclasses.replace(KEEP, bounces=1, inner_mirrors=inner))
        changing[inner] = [int((np.asarray(info.reason) == Reason.CHANGING).sum()) for _, _, info in done[1:]]
        frame, reflection, _ = done[-1]
        error[inner] = float(np.abs(np.asarray(reflection.radiance - traced(frame, bounces=1).radiance)).mean())
    assert min(changing["trace"]) > 0 and max(changing["reuse"]) == 0
    assert changing["turn"][0] < changing["trace"][0] and changing["turn"][-1] > 0
    assert error["trace"] <= error["turn"] < error["reuse"]
