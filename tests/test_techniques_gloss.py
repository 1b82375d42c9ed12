"""Mirror rays with the gloss filter, and gathering: right blur at known distances, contact hardening, fewer errors."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.gloss import edge_profile, lobe
from shapes import floor

from jaxrefl._types import Frame
from jaxrefl.core import look_at
from jaxrefl.filters import GlossOptions, GlossParams, footprint, gloss, guides_of, load_table, relative_distance
from jaxrefl.filters.lobe import WIDEST
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, Part, glossy, matte
from jaxrefl.surface import look
from jaxrefl.techniques import gather, mirror_gloss, raytrace

HEIGHT = 0.2
"""Of the camera over the floor."""
SIZE = (96, 24)


def panel(name: str, corners, colour) -> Part:
    """A quadrilateral whose ambient light is its colour."""
    return Part(name, np.asarray(corners, np.float64), np.array([[0, 1, 2], [0, 2, 3]]), matte(name, colour))


def framed(alpha: float, panels, camera) -> Frame:
    parts = [floor("floor", glossy("g", (1, 1, 1), alpha=alpha, metallic=1.0), size=20.0), *panels]
    scene = assemble(Description("edge", parts, ambient=(1.0, 1.0, 1.0)))
    tracer = EmbreeTracer(scene.mesh)
    return Frame(scene, camera, look(scene, tracer, camera), jax.random.key(0), tracer)


def looking_down(alpha: float, height: float, size=SIZE) -> Frame:
    """A glossy floor from above, under a ceiling that is white where x > 0 and black elsewhere.

    The edge's blur, 2 alpha tau, is a sixteenth of the image wide: nothing that matters lies outside.
    """
    halves = (("white", 0, 40, (1, 1, 1)), ("black", -40, 0, (0, 0, 0)))
    panels = [
        panel(name, [[low, height, -40], [high, height, -40], [high, height, 40], [low, height, 40]], colour)
        for name, low, high, colour in halves
    ]
    focal = size[0] / 16 / (2 * alpha * height / (HEIGHT + height)) if alpha else 100.0
    fov = 2 * np.degrees(np.arctan(size[1] / 2 / focal))
    return framed(alpha, panels, look_at((0, HEIGHT, 0), (0, 0, 0), up=(0, 0, -1), fov_y=fov, size=size))


def before_a_wall(alpha: float) -> Frame:
    """A glossy floor before a wall that stands on it, white where x > 0 and black elsewhere."""
    halves = (("white", 0, 40, (1, 1, 1)), ("black", -40, 0, (0, 0, 0)))
    panels = [
        panel(name, [[low, 0, 0], [high, 0, 0], [high, 30, 0], [low, 30, 0]], colour)
        for name, low, high, colour in halves
    ]
    return framed(alpha, panels, look_at((0, 2, 4), (0, 0, 1.2), fov_y=35, size=(96, 64)))


def step(technique, frame, **knobs):
    options = technique.Options(**knobs)
    state = technique.init(frame.scene, frame.tracer, options=options)
    _, reflection, info = technique.step(state, frame, technique.Params(), options=options)
    return np.asarray(reflection.radiance), info


def profile_errors(frame: Frame, alpha: float, height: float, **knobs) -> tuple[float, float]:
    """RMSE of the blurred edge against the frontal lobe's, and the relative error of its width."""
    image, _ = step(mirror_gloss, frame, **knobs)
    found = image[image.shape[0] // 2, :, 0]
    x = np.arange(len(found)) + 0.5 - len(found) / 2
    tangents, weights = lobe(alpha, 1.0)
    seen = (tangents**2).sum(-1) < WIDEST**2
    tau = height / (HEIGHT + height)
    scale = float(frame.camera.focal[0]) * tau
    true = edge_profile(x / scale, tangents[seen, 0], weights[seen] / weights[seen].sum())
    widths = [np.diff(np.interp([0.3, 0.7], p, x))[0] for p in (found, true)]
    middle = slice(len(x) // 4, -(len(x) // 4))
    return float(np.sqrt(np.mean((found - true)[middle] ** 2))), float(widths[0] / widths[1] - 1)


@pytest.mark.slow
def test_an_edge_at_a_known_distance_is_blurred_as_the_lobe_says():
    rmse, width = profile_errors(looking_down(0.05, 1.0), 0.05, 1.0)
    assert rmse < 0.02 and abs(width) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.25, 1.0, 4.0])
@pytest.mark.parametrize("alpha", [0.02, 0.05])
def test_edges_at_three_distances(alpha: float, height: float):
    """Wider lobes need a field of view over which they change; there the table is tested on its own."""
    frame = looking_down(alpha, height, size=(384, 96))
    rmse, width = profile_errors(frame, alpha, height)
    assert rmse < 0.02 and abs(width) < 0.05


@pytest.mark.slow
def test_contacts_are_sharp_and_blur_grows_with_the_distance():
    """The reflection of a vertical edge that stands on the floor: row by row as wide as the slanted lobe says."""
    frame, alpha = before_a_wall(0.06), 0.06
    image, _ = step(mirror_gloss, frame)
    g, matrix = frame.gbuffer, np.asarray(frame.camera.world_from_camera, np.float64)
    x, widths = np.arange(96) - 47.5, []
    contact = np.flatnonzero(np.asarray(g.object)[:, 48] == 0).min()
    for row in range(contact + 1, 62, 6):
        p, wo = (np.asarray(v, np.float64)[row, 48] for v in (g.p, g.wo))
        t_camera, t_wall = np.linalg.norm(p - matrix[:3, 3]), p[2] / wo[2]  # the mirror ray goes to z = 0
        tangents, weights = lobe(alpha, wo[1])
        order = np.argsort(tangents[:, 1])
        places = np.interp([0.3, 0.7], np.cumsum(weights[order]), tangents[order, 1])
        true = np.diff(places)[0] * t_wall / (t_camera + t_wall) * float(frame.camera.focal[0]) / (wo @ matrix[:3, 2])
        found = np.diff(np.interp([0.3, 0.7], image[row, :, 0], x))[0]
        widths.append(found)
        if true > 2:  # narrower ones are a matter of pixels
            # Measured up to 15 %: coarse layers take too much for their own blur across long, narrow footprints.
            assert found == pytest.approx(true, rel=0.2)
    assert widths[0] < 1 and (np.diff(widths) > 0).all() and widths[-1] > 4


@pytest.mark.slow
def test_filtering_beats_gathering_and_one_sample():
    frame = looking_down(0.05, 1.0)
    truth, _ = step(raytrace, frame, samples=256)
    errors = {
        name: np.sqrt(np.mean((step(technique, frame)[0] - truth)[:, 4:-4] ** 2))
        for name, technique in (("mirror_gloss", mirror_gloss), ("gather", gather), ("raytrace", raytrace))
    }
    assert errors["mirror_gloss"] < errors["gather"] < errors["raytrace"]


def test_a_smooth_scene_needs_no_table_and_no_filter():
    frame = looking_down(0.0, 1.0)
    assert mirror_gloss.init(frame.scene, frame.tracer).table is None
    for technique in (mirror_gloss, gather):
        np.testing.assert_array_equal(step(technique, frame)[0], step(raytrace, frame)[0])


@pytest.mark.slow
def test_pictures_and_their_gradients_are_finite_from_smooth_to_rough_and_from_contact_to_infinity():
    """Through footprint and filter: alpha 0 and 1, distances 0 and infinity; in between as finite differences say."""
    frame = looking_down(0.1, 1.0, size=(24, 16))
    camera, gbuffer, table, guide = frame.camera, frame.gbuffer, load_table(), guides_of(frame.camera, frame.gbuffer)
    sharp = jnp.asarray((np.arange(24) > 11).astype(np.float32))[None, :, None] * jnp.ones((16, 24, 3))
    ones = jnp.ones(gbuffer.t.shape)

    @jax.jit
    @jax.value_and_grad
    def mean_square(alpha, distance):
        tau = relative_distance(gbuffer.t, distance * ones)
        shape = footprint(table, camera, gbuffer, tau, alpha=alpha * ones)
        return (
            gloss(sharp, ones, tau, guide, shape, GlossParams(), options=GlossOptions("window", 6, 1))[0] ** 2
        ).mean()

    for alpha in (0.0, 0.02, 1.0):
        for distance in (0.0, 1.0, np.inf):
            found = mean_square(jnp.float32(alpha), jnp.float32(distance))
            assert all(np.isfinite(float(x)) for x in found), (alpha, distance)
            if alpha == 0 or distance == 0:
                assert float(found[0]) == pytest.approx(0.5, abs=1e-6), "nothing to blur"
    for alpha in (0.03, 0.1, 0.3):
        low, high = (float(mean_square(jnp.float32(alpha * f), jnp.float32(1.0))[0]) for f in (0.95, 1.05))
        gradient = float(mean_square(jnp.float32(alpha), jnp.float32(1.0))[1])
        assert gradient == pytest.approx((high - low) / (0.1 * alpha), rel=0.02), alpha


@pytest.mark.slow
def test_the_example_recovers_the_roughness_of_a_floor(capsys):
    """The example of the documentation, as it is printed."""
    page = Path(__file__).parent.parent / "docs" / "pages" / "gloss.md"
    (code,) = (c for c in re.findall(r"```python\n(.*?)```", page.read_text(), re.S) if "optimistix" in c)
    found: dict = {}
    exec(code, found)
    assert found["found"] == pytest.approx(0.12, rel=0.1)
    assert capsys.readouterr().out.strip() in page.read_text()
