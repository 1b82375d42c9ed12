"""Metrics: against slow references, against scikit-image, properties, masks, and what the border refuses."""

import math
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.metrics import figures as reference_figures
from strategies import floats

from jaxrefl import metrics

HEIGHT, WIDTH = 17, 19
SINGLE = {"mae255": metrics.mae255, "rmse": metrics.rmse, "relmse": metrics.relmse, "psnr": metrics.psnr}
MASKED = {**SINGLE, "dssim": metrics.dssim, "ssim": metrics.ssim, "flip": metrics.flip}


def images() -> st.SearchStrategy:
    """Linear radiance around the displayable range, some of it clipped."""
    return floats(-0.1, 2.0, (HEIGHT, WIDTH, 3))


@pytest.fixture
def pair(rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An image, a reference close to it with dark and overexposed parts, and a mask of about a third."""
    reference = rng.gamma(0.7, 0.5, (HEIGHT, WIDTH, 3)).astype(np.float32)
    reference[:3] = 0
    image = (reference + rng.normal(0, 0.05, reference.shape)).astype(np.float32)
    return image, reference, rng.random((HEIGHT, WIDTH)) < 0.35


@pytest.mark.parametrize("exposure", [0.0, -2.0, 1.5])
def test_every_figure_agrees_with_its_definition(pair, exposure):
    expected = reference_figures(*pair, exposure)
    actual = metrics.compare(*pair, exposure=exposure)
    assert tuple(actual) == metrics.FIGURES == tuple(expected)
    for name in metrics.FIGURES:
        # Worst case measured 5e-7 (dssim): the sRGB curve is evaluated in float32.
        assert actual[name] == pytest.approx(expected[name], rel=5e-6), name


def test_compare_is_the_single_figures(pair):
    row = metrics.compare(*pair, exposure=0.5)
    assert row == {
        "mae255": metrics.mae255(*pair, exposure=0.5),
        "rmse": metrics.rmse(*pair),
        "relmse": metrics.relmse(*pair, exposure=0.5),
        "psnr": metrics.psnr(*pair, exposure=0.5),
        "dssim": metrics.dssim(*pair, exposure=0.5),
    }
    assert row["dssim"] == (1 - metrics.ssim(*pair, exposure=0.5)) / 2


def test_ssim_of_the_frame_is_scikit_images(pair):
    from skimage.metrics import structural_similarity

    image, reference = (np.clip(x, 0, 1) for x in pair[:2])
    coded = [np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055) for x in (image, reference)]
    expected = structural_similarity(
        *coded, data_range=1.0, channel_axis=-1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    assert metrics.ssim(image, reference, None) == pytest.approx(expected, rel=2e-5)


@given(images(), images())
def test_mae_is_the_mean_of_the_error_map_and_splits_over_masks(image, reference):
    error = metrics.error_map255(image, reference)
    mask = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 3 == 0
    inside, outside = metrics.mae255(image, reference, mask), metrics.mae255(image, reference, ~mask)
    whole = metrics.mae255(image, reference, None)
    assert error.min() >= 0 and error.max() <= 255
    assert inside == pytest.approx(float(error[mask].mean(dtype=np.float64)), rel=1e-5, abs=1e-5)
    assert whole == pytest.approx(mask.mean() * inside + (1 - mask.mean()) * outside, rel=1e-9, abs=1e-12)


@given(images())
def test_equal_images_have_no_error(image):
    row = metrics.compare(image, image, None)
    assert row == {"mae255": 0, "rmse": 0, "relmse": 0, "psnr": math.inf, "dssim": pytest.approx(0, abs=1e-7)}
    assert metrics.flip(image, image, None) == 0


@given(images(), images())
def test_symmetry_and_bounds(image, reference):
    for name in ("mae255", "rmse", "psnr", "dssim"):
        forward, backward = (getattr(metrics, name)(*pair, None) for pair in ((image, reference), (reference, image)))
        # The DSSIM window sums float64 products in another order: measured 1e-8.
        assert forward == pytest.approx(backward, rel=1e-6, abs=1e-7), name
    assert 0 <= metrics.dssim(image, reference, None) <= 1
    assert metrics.relmse(image, reference, None) >= 0
    assert 0 <= metrics.flip(image, reference, None) <= 1


@given(images(), images())
def test_exposure_is_the_same_as_brighter_light(image, reference):
    brighter = metrics.compare(image * 4, reference * 4, None)
    exposed = metrics.compare(image, reference, None, exposure=2.0)
    assert brighter.pop("rmse") == pytest.approx(4 * exposed.pop("rmse"), rel=1e-6)
    assert brighter == pytest.approx(exposed, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("name", MASKED)
def test_what_lies_far_outside_the_mask_does_not_count(pair, name):
    image, reference, _ = pair
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[6:9, 6:9] = True
    changed = image.copy()
    changed[-1, -1] += 0.5  # 8 pixels from the mask: beyond the SSIM window, not beyond FLIP's
    figure = MASKED[name]
    tolerance = 5e-3 if name == "flip" else 1e-12
    assert figure(changed, reference, mask) == pytest.approx(figure(image, reference, mask), rel=tolerance)
    changed[7, 7] += 0.5
    assert abs(figure(changed, reference, mask) - figure(image, reference, mask)) > 1e-4


def test_more_noise_is_worse_in_every_figure(rng):
    reference = np.full((32, 32, 3), 0.4, np.float32)
    noise = rng.normal(0, 1, reference.shape).astype(np.float32)
    small, large = (metrics.compare(reference + s * noise, reference, None) for s in (0.01, 0.05))
    for name in ("mae255", "rmse", "relmse", "dssim"):
        assert small[name] < large[name]
    assert small["psnr"] > large["psnr"]
    assert metrics.flip(reference + 0.01 * noise, reference, None) < metrics.flip(
        reference + 0.05 * noise, reference, None
    )


def test_known_values():
    black, white = np.zeros((12, 12, 3), np.float32), np.ones((12, 12, 3), np.float32)
    row = metrics.compare(white, black, None)
    assert row["mae255"] == pytest.approx(255)
    assert row["rmse"] == pytest.approx(1)
    assert row["relmse"] == pytest.approx(100)  # 1 / epsilon
    assert row["psnr"] == pytest.approx(0, abs=1e-6)
    assert metrics.mae255(2 * white, white, None) == 0  # both clipped


def test_jax_and_low_precision_inputs_are_taken(pair):
    image, reference, mask = pair
    expected = metrics.compare(image, reference, mask)
    assert metrics.compare(jnp.asarray(image), jnp.asarray(reference), jnp.asarray(mask)) == expected
    half = metrics.compare(jnp.asarray(image, jnp.bfloat16), image.astype(np.float64), mask)
    assert 0 < half["mae255"] < 2


def test_an_empty_mask_has_no_figures(pair):
    image, reference, _ = pair
    nothing = np.zeros((HEIGHT, WIDTH), bool)
    assert metrics.compare(image, reference, nothing) == dict.fromkeys(metrics.FIGURES)
    for figure in MASKED.values():
        with pytest.raises(ValueError, match="mask: expected at least one True pixel"):
            figure(image, reference, nothing)


def test_dssim_is_undefined_where_no_whole_window_fits(pair):
    image, reference, _ = pair
    edge = np.zeros((HEIGHT, WIDTH), bool)
    edge[: metrics.BORDER] = True
    row = metrics.compare(image, reference, edge)
    assert row["dssim"] is None and row["mae255"] > 0
    with pytest.raises(ValueError, match="more than 5 pixels from the frame's edge"):
        metrics.dssim(image, reference, edge)
    assert metrics.compare(image[:10], reference[:10], None)["dssim"] is None
    with pytest.raises(ValueError, match="at least 11 pixels"):
        metrics.ssim(image[:10], reference[:10], None)


def _broken(image: np.ndarray, value: float) -> np.ndarray:
    image = image.copy()
    image[2, 3, 1] = value
    return image


REFUSED = {
    "NaN image": (lambda x, y, m: (_broken(x, np.nan), y, m), "image: expected finite radiance.* 1 of 323 pixels"),
    "infinite reference": (lambda x, y, m: (x, _broken(y, np.inf), m), "reference: expected finite radiance"),
    "other size": (lambda x, y, m: (x, y[:-1], m), r"reference: expected the shape of image, \(17, 19, 3\)"),
    "8-bit picture": (
        lambda x, y, m: (x.astype(np.uint8), y, m),
        "image: expected linear radiance as floats.* uint8",
    ),
    "alpha channel": (lambda x, y, m: (np.pad(x, ((0, 0), (0, 0), (0, 1))), y, m), r"image: expected shape \(height"),
    "grey image": (lambda x, y, m: (x, y[..., 0], m), r"reference: expected shape \(height, width, 3\)"),
    "no pixels": (lambda x, y, m: (x[:0], y[:0], m[:0]), r"got \(0, 19, 3\)"),
    "other mask": (lambda x, y, m: (x, y, m[:, :-1]), r"mask: expected bool of shape \(17, 19\), got bool"),
    "float mask": (lambda x, y, m: (x, y, m.astype(np.float32)), "mask: expected bool .*, got float32"),
}


@pytest.mark.parametrize("case", REFUSED)
@pytest.mark.parametrize("name", [*MASKED, "compare"])
def test_bad_input_is_refused_by_name(pair, case, name):
    spoil, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        {**MASKED, "compare": metrics.compare}[name](*spoil(*pair))


@pytest.mark.parametrize("exposure", [math.nan, math.inf, 61.0])
@pytest.mark.parametrize("name", ["mae255", "relmse", "psnr", "dssim", "flip"])
def test_bad_exposure_is_refused(pair, name, exposure):
    with pytest.raises(ValueError, match="exposure: expected"):
        MASKED[name](*pair, exposure=exposure)


def test_bad_constants_are_refused(pair):
    with pytest.raises(ValueError, match="epsilon: expected"):
        metrics.relmse(*pair, epsilon=0.0)
    with pytest.raises(ValueError, match="pixels_per_degree: expected"):
        metrics.flip(*pair, pixels_per_degree=0.0)


def test_flip_survives_a_black_reference_and_missing_package(monkeypatch):
    black, grey = np.zeros((12, 12, 3), np.float32), np.full((12, 12, 3), 0.2, np.float32)
    assert metrics.flip(grey, black, None) > 0.1
    assert metrics.flip(black, black, None) == 0
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxrefl\[flip\]'"):
        metrics.flip(grey, black, None)


def test_importing_the_metrics_loads_no_image_library():
    code = "import sys, jaxrefl.metrics; print([m for m in ('skimage', 'flip_evaluator') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
