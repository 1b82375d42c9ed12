"""The gloss filter against its definition, and what it promises: fixed points, ranges, edges, holes, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.gloss import filtered
from scipy.ndimage import map_coordinates

from jaxrefl.filters import Footprint, GlossOptions, GlossParams, Guides, gloss
from jaxrefl.filters.gloss_layers import Layer
from jaxrefl.filters.gloss_window import spread_ratio

H, W = 32, 40
SIZE = (H, W)
WINDOW, FOUR = GlossOptions("window", 10, 1), GlossOptions("four_pass", 10, 1)
PYRAMID = GlossOptions("window", 4, 4)
ONES = jnp.ones(SIZE)


def guides(ids=None, normal=None, depth=None) -> Guides:
    up = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0]), (*SIZE, 3))
    return Guides(
        jnp.zeros(SIZE, jnp.int32) if ids is None else jnp.asarray(ids, jnp.int32),
        up if normal is None else jnp.asarray(normal, jnp.float32),
        ONES if depth is None else jnp.asarray(depth, jnp.float32),
        jnp.zeros((*SIZE, 2)),
    )


def round_footprint(sigma, mean=(0.0, 0.0)) -> Footprint:
    variance = jnp.broadcast_to(jnp.asarray(sigma, jnp.float32) ** 2, SIZE)
    return general_footprint(jnp.stack([variance, 0 * variance, variance], -1), mean)


def general_footprint(covariance, mean=(0.0, 0.0)) -> Footprint:
    covariance = jnp.broadcast_to(jnp.asarray(covariance, jnp.float32), (*SIZE, 3))[..., None, :]
    return Footprint(jnp.ones((*SIZE, 1)), jnp.broadcast_to(jnp.asarray(mean, jnp.float32), (*SIZE, 1, 2)), covariance)


def run(image, shape, options=WINDOW, guide=None, confidence=ONES, tau=ONES):
    guide = guides() if guide is None else guide
    image = jnp.asarray(image, jnp.float32)
    image = image if image.ndim == 3 else jnp.broadcast_to(image[..., None], (*SIZE, 3))
    radiance, known = gloss(
        image, jnp.asarray(confidence, jnp.float32), tau, guide, shape, GlossParams(), options=options
    )
    return np.asarray(radiance), np.asarray(known)


def noise(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((*SIZE, 3)).astype(np.float32)


def smooth() -> np.ndarray:
    y, x = np.mgrid[:H, :W]
    return (0.5 + 0.5 * np.sin(x / 5) * np.cos(y / 7))[..., None] * np.ones(3, np.float32)


def test_the_window_is_equation_4():
    """Ids, normals, depths, holes, confidences, off-centre Gaussians: all at once, against loops in float64."""
    rng = np.random.default_rng(1)
    image, ids = noise(), (np.mgrid[:H, :W][1] > 22).astype(int)
    normal = np.zeros((*SIZE, 3))
    normal[..., 2] = 1
    normal[:10, :, :] = [0, 1, 0]
    depth = np.where(np.mgrid[:H, :W][0] > 24, 1.5, 1.0)
    confidence = np.where(rng.random(SIZE) < 0.2, 0, rng.uniform(0.2, 1, SIZE))
    found, known = run(
        image, general_footprint((6.0, 2.0, 3.0), (1.0, -0.5)), guide=guides(ids, normal, depth), confidence=confidence
    )  # fmt: skip
    gaussian = [(1.0, np.array([1.0, -0.5]), np.array([[6.0, 2.0], [2.0, 3.0]]))]
    expected = filtered(
        image.astype(np.float64), confidence > 0, confidence, ids, normal, depth, np.zeros((*SIZE, 2)),
        [[gaussian] * W] * H, (0.8, 0.1),
    )  # fmt: skip
    assert known.all()
    # 1e-3 of a pixel squared is added to every variance, and the window ends at 4 deviations.
    np.testing.assert_allclose(found, expected, atol=2e-3)


@pytest.mark.parametrize(
    "options", [WINDOW, FOUR, pytest.param(PYRAMID, marks=pytest.mark.slow)], ids=["window", "four_pass", "pyramid"]
)
def test_constant_images_ranges_and_zero_footprints(options):
    sigma = np.linspace(0, 6, W)[None, :] * np.ones((H, 1))
    constant, _ = run(np.full(SIZE, 0.7), round_footprint(sigma), options)
    np.testing.assert_allclose(constant, 0.7, rtol=1e-5)
    image = noise()
    blurred, _ = run(image, round_footprint(sigma), options)
    assert blurred.min() >= image.min() - 1e-6 and blurred.max() <= image.max() + 1e-6
    assert np.std(blurred[:, -8:]) < 0.3 * np.std(image[:, -8:])
    identity, _ = run(image, round_footprint(0.0), options)
    np.testing.assert_allclose(identity, image, atol=1e-6)


@pytest.mark.parametrize(
    "options", [WINDOW, FOUR, pytest.param(PYRAMID, marks=pytest.mark.slow)], ids=["window", "four_pass", "pyramid"]
)
def test_nothing_leaks_and_holes_are_filled(options):
    """Two halves that differ in id, normal or depth keep their colours; unknown pixels take that of their half."""
    right = np.mgrid[:H, :W][1] >= 17
    image = np.where(right, 1.0, 0.0)
    normal = np.zeros((*SIZE, 3))
    normal[..., 0], normal[..., 2] = right, ~right
    hole = np.zeros(SIZE, bool)
    hole[5:9, 10:24] = True
    image = np.where(hole, 1e6, image)
    for guide in (guides(ids=right), guides(normal=normal), guides(depth=np.where(right, 2.0, 1.0))):
        found, known = run(image, round_footprint(4.0), options, guide, confidence=np.where(hole, 0, 1))
        assert known.all()
        np.testing.assert_allclose(found, np.where(right, 1.0, 0.0)[..., None] * np.ones(3), atol=1e-6)


@pytest.mark.parametrize("options", [WINDOW, FOUR], ids=["window", "four_pass"])
def test_turning_the_image_by_half_a_turn_turns_the_result(options):
    image, shape = noise(), general_footprint((9.0, 3.0, 4.0))
    straight, _ = run(image, shape, options)
    turned, _ = run(image[::-1, ::-1], shape, options)
    np.testing.assert_allclose(turned[::-1, ::-1], straight, atol=2e-5)


@pytest.mark.parametrize("options", [WINDOW, FOUR], ids=["window", "four_pass"])
def test_exchanging_the_axes_exchanges_the_result(options):
    """With the two half turns, all rotations by quarters: here in a square part, away from the border."""
    image = np.zeros((*SIZE, 3), np.float32)
    image[16, 20] = 1.0
    one, _ = run(image, general_footprint((6.0, 2.0, 2.0)), options)
    other, _ = run(image, general_footprint((2.0, 2.0, 6.0)), options)
    cut = slice(16 - 9, 16 + 10), slice(20 - 9, 20 + 10)
    np.testing.assert_allclose(one[cut], other[cut].swapaxes(0, 1), atol=1e-5)


def turned(angle: float, options: GlossOptions) -> np.ndarray:
    """A smooth image on a slanted plane, with a footprint that changes from place to place: all turned by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    y, x = np.mgrid[:H, :W] - np.array([H - 1, W - 1])[:, None, None] / 2
    u, v = c * x + s * y, c * y - s * x  # where each pixel was before the turn
    waves = [0.5 + 0.5 * np.sin(a * u + b * v + k) for a, b, k in ((0.3, 0.1, 0), (-0.1, 0.25, 1), (0.2, -0.2, 2))]
    deviations = 2 + 0.04 * u, 1.2 - 0.02 * v
    axis = np.cos(0.5 + 0.02 * u + angle), np.sin(0.5 + 0.02 * u + angle)
    a, b = (d**2 for d in deviations)
    covariance = [a * axis[0] ** 2 + b * axis[1] ** 2, (a - b) * axis[0] * axis[1], a * axis[1] ** 2 + b * axis[0] ** 2]
    slope = 0.02 * np.array([c, s])  # a window of 10 pixels sees twice the limit in depth
    guide = Guides(
        jnp.zeros(SIZE, jnp.int32),
        jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0]), (*SIZE, 3)),
        jnp.asarray(1 / (1 + 0.02 * u), jnp.float32),
        jnp.broadcast_to(jnp.asarray(slope, jnp.float32), (*SIZE, 2)),
    )
    tau = jnp.asarray(0.5 + 0.01 * u, jnp.float32)
    return run(np.stack(waves, -1), general_footprint(np.stack(covariance, -1)), options, guide, tau=tau)[0]


@pytest.mark.parametrize(
    ("options", "most"),
    # Measured worst of 52 angles: 3e-5, 5e-3, 9e-3. Lines change with place, and a pyramid's own grid does not turn.
    [
        pytest.param(WINDOW, 1e-4, id="window"),
        pytest.param(GlossOptions("four_pass", 10, 1, "linear"), 0.01, marks=pytest.mark.slow, id="four_pass"),
        pytest.param(PYRAMID, 0.015, marks=pytest.mark.slow, id="pyramid"),
    ],
)
@given(degrees=st.floats(0, 360))
def test_turning_everything_by_any_angle_turns_the_result(options, most, degrees):
    """The image is analytic, so only the result has to be read between pixels: by cubic splines, to within 2e-5."""
    angle = np.radians(degrees)
    c, s = np.cos(angle), np.sin(angle)
    straight, found = turned(0.0, options), turned(angle, options)
    y, x = np.mgrid[:H, :W] - np.array([H - 1, W - 1])[:, None, None] / 2
    places = [c * y - s * x + (H - 1) / 2, c * x + s * y + (W - 1) / 2]
    expected = np.stack([map_coordinates(straight[..., i], places, order=3, mode="nearest") for i in range(3)], -1)
    inside = np.hypot(x, y) < 7  # no window of three deviations leaves the picture
    np.testing.assert_allclose(found[inside], expected[inside], atol=most)


def test_two_half_steps_are_a_whole_step():
    image = noise()
    half, _ = run(image, round_footprint(np.sqrt(2.0)))
    twice, _ = run(half, round_footprint(np.sqrt(2.0)))
    once, _ = run(image, round_footprint(2.0))
    inside = np.s_[8:-8, 8:-8]
    np.testing.assert_allclose(twice[inside], once[inside], atol=2e-3)


def test_four_passes_are_near_the_window():
    shape = general_footprint((5.0, 1.5, 3.0))
    for image, most in ((smooth(), 0.01), (noise(), 0.03)):
        exact, _ = run(image, shape)
        fast, _ = run(image, shape, FOUR)
        assert np.sqrt(np.mean((exact - fast)[6:-6, 6:-6] ** 2)) < most


@pytest.mark.slow
def test_coarse_layers_stand_for_wide_footprints():
    """Away from the border a window of 9 pixels on the pyramid is one of 21 on the image."""
    y, x = np.mgrid[:H, :W]
    image = 0.5 + 0.5 * np.sin(0.2 * x + 0.15 * y)
    shape = round_footprint(2.8)
    exact, _ = run(image, shape)
    fast, _ = run(image, shape, PYRAMID)
    assert np.sqrt(np.mean((exact - fast)[8:-8, 8:-8] ** 2)) < 0.012  # measured 0.0098; the rest is the border's


def test_near_things_stay_sharp_before_far_ones():
    """`spread`: an edge at tau 0.2 before a background at tau 0.8 is blurred as its own distance says on both sides."""
    near = np.mgrid[:H, :W][1] < 20
    tau = jnp.asarray(np.where(near, 0.2, 0.8), jnp.float32)
    sigma = 5 * np.where(near, 0.2, 0.8)
    spread, _ = run(near.astype(np.float32), round_footprint(sigma), tau=tau)
    plain, _ = run(
        near.astype(np.float32), round_footprint(sigma), GlossOptions("window", 10, 1, spread=False), tau=tau
    )
    assert spread[16, 23, 0] < 0.02 < 0.1 < plain[16, 23, 0]


def test_rays_of_the_lobe_start_at_the_pixels_own_point(rng):
    """What a neighbour shows at V is seen from p under the tangent that image offset, tau and the ratio say."""
    depth, beyond = rng.uniform(1, 5, 100), rng.uniform(0.5, 5, 100)
    lateral, mirrored = rng.uniform(-0.3, 0.3, (2, 100))
    p, v = lateral * depth, mirrored * (depth + beyond)  # on one axis of an image with focal length 1
    tangent = (v - p * (depth + beyond) / depth) / beyond  # of V beside the line of sight through p
    own_image = depth + rng.uniform(0.5, 5, 100)
    data = [jnp.zeros(100, jnp.float32) for _ in range(16)]
    data[3], data[9] = jnp.asarray(1 / depth, jnp.float32), jnp.asarray(1 / own_image, jnp.float32)
    own = Layer(jnp.zeros(100, jnp.int32), tuple(data))
    ratio = spread_ratio(own)(jnp.asarray(1 / (depth + beyond), jnp.float32))
    tau = 1 - depth / own_image
    kept = np.abs(np.log(np.asarray(ratio))) < np.log(7.9)  # the others are clipped
    np.testing.assert_allclose(((v / (depth + beyond) - p / depth) * ratio / tau)[kept], tangent[kept], rtol=5e-3)
    assert kept.mean() > 0.9


def test_footprints_far_beyond_the_image_leave_pixels_as_they_are():
    """Weights too small to divide by count as nothing: values and gradients stay finite."""
    image = jnp.asarray(noise())
    found, known = run(image, general_footprint((1.0, 0.0, 1.0), (9.0, 9.0)))
    assert known.all() and np.isfinite(found).all()
    far, _ = run(image, general_footprint((1.0, 0.0, 1.0), (5e3, 5e3)))
    np.testing.assert_array_equal(far, image)


def test_thin_footprints_far_off_their_middle_stay_finite(rng):
    """Where the terms of the exponent cancel, rounding must not make it positive: its exponential would be infinite."""
    angle, major, minor = rng.uniform(0, np.pi, SIZE), 10 ** rng.uniform(6, 9, SIZE), 10 ** rng.uniform(-2, 2, SIZE)
    c, s = np.cos(angle), np.sin(angle)
    covariance = np.stack(
        [major * c * c + minor * s * s, (major - minor) * c * s, major * s * s + minor * c * c], -1
    )  # fmt: skip
    mean = 0.7 * np.sqrt(major)[..., None] * np.stack([c, s], -1)
    mean, covariance = (jnp.asarray(x, jnp.float32)[..., None, :] for x in (mean, covariance))
    shape = Footprint(jnp.ones((*SIZE, 1)), mean, covariance)
    image = noise()
    found, _ = run(image, shape)
    assert np.isfinite(found).all() and found.min() >= image.min() - 1e-6 and found.max() <= image.max() + 1e-6


def mean_square(image, covariance, tau, options):
    shape = general_footprint(covariance)
    return (gloss(image, ONES, tau, guides(), shape, GlossParams(), options=options)[0] ** 2).mean()


GRADIENTS = jax.jit(jax.value_and_grad(mean_square, (0, 1, 2)), static_argnums=3)


@pytest.mark.parametrize(
    "options",
    [WINDOW, *(pytest.param(o, marks=pytest.mark.slow) for o in (FOUR, GlossOptions("window", 4, 2)))],
    ids=["window", "four_pass", "pyramid"],
)
def test_values_and_gradients_are_finite_for_degenerate_footprints(options):
    """Condition numbers up to 1e8, sizes from nothing to far beyond the image."""
    scales = jnp.asarray([0.0, 1e-30, 1e-4, 1.0, 1e4, 1e8])
    thin = jnp.stack([scales, 0.999 * jnp.sqrt(scales * 1e-8 * scales), 1e-8 * scales], -1)
    covariance = jnp.tile(jnp.concatenate([thin, thin[:, ::-1]]), (H * W // 12 + 1, 1))[: H * W].reshape(H, W, 3)
    for tau in (0.0, 0.5, 1.0):
        value, gradients = GRADIENTS(jnp.asarray(noise()), covariance, ONES * tau, options)
        assert np.isfinite(float(value)) and all(np.isfinite(np.asarray(g)).all() for g in gradients)


def test_gradients_with_respect_to_width_are_right():
    image, step = jnp.asarray(smooth()), 1e-2

    def at(sigma):
        covariance = jnp.broadcast_to(jnp.asarray([sigma**2, 0, sigma**2], jnp.float32), (*SIZE, 3))
        return GRADIENTS(image, covariance, ONES, WINDOW)

    expected = (float(at(2.0 + step)[0]) - float(at(2.0 - step)[0])) / (2 * step)
    change = at(2.0)[1][1]
    assert 2 * 2.0 * float(change[..., 0].sum() + change[..., 2].sum()) == pytest.approx(expected, rel=0.02)


def test_values_of_thresholds_compile_once():
    before = gloss._cache_size()  # type: ignore[attr-defined]
    for normal in (0.7, 0.9):
        gloss(jnp.asarray(noise()), ONES, ONES, guides(), round_footprint(1.0), GlossParams(normal), options=WINDOW)
    assert gloss._cache_size() <= before + 1  # type: ignore[attr-defined]


def test_options_are_checked():
    for make in (lambda: GlossOptions("fast"), lambda: GlossOptions(taps="cubic"), lambda: GlossOptions(radius=0)):
        with pytest.raises(ValueError, match="expected"):
            make()
