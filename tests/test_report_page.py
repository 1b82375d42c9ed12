"""The report: what it shows is what the folder holds, and a folder that does not hold together is refused."""

import base64
import io
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from report_folder import write_frame, write_results

from pipelines import report_images, report_plots
from pipelines.report import write_report
from pipelines.report_images import error_scale, scale_ticks, thinned
from pipelines.report_results import read_results
from pipelines.report_tables import decimals, text

SCENE = 'mirror <box> & "glass"</script><script>alert(1)</script>'


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A finished comparison of two techniques over three frames."""
    return write_results(tmp_path_factory.mktemp("results"), frames=3, scene=SCENE)


@pytest.fixture(scope="module")
def page(folder) -> str:
    """Its report."""
    return write_report(folder).read_text()


@pytest.fixture
def copy(folder, tmp_path) -> Path:
    """A copy to break."""
    return Path(shutil.copytree(folder, tmp_path / "copy"))


class Outline(HTMLParser):
    """Open tags that were never closed, and every address."""

    VOID = frozenset({"meta", "link", "img", "input", "br"})

    def __init__(self):
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]
        self.ids += [value or "" for name, value in attrs if name == "id"]

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)


def outline(page: str) -> Outline:
    """The parsed page; fails on tags that do not match."""
    parser = Outline()
    parser.feed(page)
    parser.close()
    return parser


def viewer(page: str) -> dict:
    """What the page's script is given."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found
    return json.loads(found[1])


def picture(uri: str) -> np.ndarray:
    """Pixels of a data URI."""
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))).convert("RGB"))


def test_the_page_is_well_formed_self_contained_and_escaped(page):
    parsed = outline(page)
    assert parsed.open == []
    assert len(parsed.ids) == len(set(parsed.ids))
    assert all(address.startswith("data:") for address in parsed.addresses)
    assert "default-src 'none'" in page and not re.search(r"url\(|@import|https?://", page)
    assert "alert(1)</script>" not in page
    assert SCENE in "".join(parsed.text)


def test_pictures_are_those_of_the_folder(folder, page):
    data = viewer(page)
    assert data["frames"] == [0, 1, 2]
    assert [source["name"] for source in data["sources"]] == ["raytrace", "envmap", "reference"]
    for source in data["sources"]:
        for frame, uri in zip(data["frames"], source["pictures"], strict=True):
            expected = np.asarray(Image.open(folder / source["name"] / f"frame_{frame:04d}.png"))
            np.testing.assert_array_equal(picture(uri), expected)


def test_error_maps_show_the_mean_absolute_difference(folder, page):
    data = viewer(page)
    results = read_results(folder)
    scale = report_images.embed_pictures(results).error_scale
    table = (255 * matplotlib.colormaps["inferno"](np.linspace(0, 1, 256))[:, :3]).astype(int)
    for source in data["sources"][:2]:
        for frame, uri in enumerate(source["errors"]):
            shown = picture(uri).astype(int)
            nearest = np.abs(shown[..., None, :] - table).sum(-1).argmin(-1)
            error = scale * (nearest / 255) ** 2
            row = results.of(source["name"], "frame")[frame]
            # 256 colours on a square-root scale, and the half per cent beyond its end: measured 2 % at the most.
            assert error.mean() == pytest.approx(row.numbers["mae255"], rel=0.05)
    assert data["sources"][2]["errors"] == [None] * 3


def test_tables_hold_means_and_worst_frames(folder, page):
    rows = json.loads((folder / "metrics.json").read_text())
    plain = re.sub(r"\s+", " ", " ".join(outline(page).text))
    for mask in ("reflective", "frame"):
        for name, choose in (("mae255", max), ("psnr", min)):
            values = {
                t: [r[name] for r in rows if (r["technique"], r["mask"]) == (t, mask)] for t in ("raytrace", "envmap")
            }
            digits = decimals([float(np.mean(v)) for v in values.values()])
            for series in values.values():
                worst = choose(series)
                cell = f"{np.mean(series):.{digits}f} {worst:.{digits}f} frame {series.index(worst)}"
                assert cell in plain


def test_the_same_folder_elsewhere_gives_the_same_page(page, copy):
    assert write_report(copy).read_text() == page
    assert not list(copy.glob(".*")) and not list(copy.glob("*.part"))


def test_without_a_reference_there_are_no_errors(tmp_path):
    folder = write_results(tmp_path / "plain", frames=2, reference=False, techniques=("raytrace",))
    page = write_report(folder).read_text()
    assert outline(page).open == []
    assert "Rendered without a reference" in page and 'value="errors"' not in page
    assert "Seconds per frame" in page and "MAE" not in page
    assert [source["name"] for source in viewer(page)["sources"]] == ["raytrace"]


def test_one_frame_has_no_plots_over_frames(tmp_path):
    page = write_report(write_results(tmp_path / "still", frames=1)).read_text()
    assert "data-first=" not in page and 'id="scrubber"' not in page and "Over the frames" not in page
    assert "Error against time" in page


def test_many_wide_frames_are_thinned_and_scaled_and_the_page_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(report_images, "MAX_FRAMES", 4)
    monkeypatch.setattr(report_images, "MAX_WIDTH", 32)
    page = write_report(write_results(tmp_path / "long", frames=9, size=(48, 27))).read_text()
    data = viewer(page)
    assert data["frames"] == [0, 3, 6]
    for kind in ("pictures", "errors"):
        assert picture(data["sources"][0][kind][1]).shape == (18, 32, 3)
    assert "Every 3rd of 9 frames is shown" in page and "scaled down from 48 to 32" in page


def test_more_pictures_than_a_few_are_webp(tmp_path, monkeypatch, page):
    assert "image/webp" not in page
    monkeypatch.setattr(report_images, "MAX_LOSSLESS", 3)
    lossy = write_report(write_results(tmp_path / "webp", frames=3)).read_text()
    assert "embedded as WebP" in lossy and "data:image/webp" in lossy
    exact, close = (viewer(p)["sources"][0]["pictures"][0] for p in (page, lossy))
    # Measured 4.2 of 255 on 64 x 36 pixels of noise and checks.
    assert np.abs(picture(exact).astype(int) - picture(close)).mean() < 8


def test_jobs_without_png_or_exr(copy):
    for path in copy.glob("*/*.png"):
        path.unlink()
    same = viewer(write_report(copy).read_text())
    assert all(source["pictures"][0] for source in same["sources"])
    write_frame(copy / "raytrace", 1, np.zeros((36, 64, 3), np.float32), 0.0)
    for path in copy.glob("envmap/*.exr"):
        write_frame(path.parent, int(path.stem[-4:]), np.zeros((36, 64, 3), np.float32), 0.0)
        path.unlink()
    page = write_report(copy).read_text()
    assert viewer(page)["sources"][1]["errors"] == [None] * 3
    assert "3 error maps are missing, for want of an EXR file: envmap 0, envmap 1, envmap 2." in page


def test_undefined_figures_are_said_to_be_so(copy):
    def change(rows):
        for row in rows:
            if row["technique"] == "raytrace" and row["mask"] == "reflective":
                exact = row["frame"] == 0
                row.update(mae255=0.0 if exact else None, psnr=None, rmse=None, relmse=None, dssim=None)

    edit_rows(copy, change)
    page = write_report(copy).read_text()
    assert "2 undefined" in page and "∞" in page
    assert "nan" not in re.sub(r"<script.*", "", page, flags=re.DOTALL)


def test_exposure_of_the_job_reaches_the_error_maps(tmp_path):
    scales = []
    for exposure in (0.0, -6.0):
        folder = write_results(tmp_path / str(exposure), frames=1, exposure=exposure)
        scales.append(report_images.embed_pictures(read_results(folder)).error_scale)
    assert scales[1] < scales[0]


def edit_rows(folder: Path, change) -> None:
    """Rewrite metrics.json."""
    path = folder / "metrics.json"
    rows = json.loads(path.read_text())
    result = change(rows)
    path.write_text(json.dumps(rows if result is None else result))


def _row(**changes):
    return lambda folder: edit_rows(folder, lambda rows: rows[0].update(changes))


def _write(name: str, content: str):
    return lambda folder: (folder / name).write_text(content)


BROKEN = {
    "no job": (lambda f: (f / "job.toml").unlink(), r"job\.toml: missing; expected a folder written by"),
    "job is no TOML": (_write("job.toml", "a = ["), r"job\.toml: not valid TOML"),
    "job is not text": (lambda f: (f / "job.toml").write_bytes(b"\xff\xfe"), r"job\.toml: cannot be read"),
    "no figures": (lambda f: (f / "metrics.json").unlink(), r"metrics\.json: missing"),
    "half a file": (_write("metrics.json", '[{"scene": "a"'), r"metrics\.json: not valid JSON"),
    "NaN": (_write("metrics.json", '[{"rmse": NaN}]'), r"metrics\.json: NaN is not valid JSON"),
    "no rows": (_write("metrics.json", "[]"), r"metrics\.json: expected a list of at least one row, got list"),
    "an object": (_write("metrics.json", '{"rows": 1}'), r"metrics\.json: expected a list .* got dict"),
    "row is no object": (_write("metrics.json", "[3]"), r"row 0: expected an object, got 3"),
    "no technique": (_row(technique=None), r"row 0: technique: expected str, got None"),
    "frame is text": (_row(frame="1"), r"row 0: frame: expected int, got '1'"),
    "frame is true": (_row(frame=True), r"row 0: frame: expected int, got True"),
    "negative frame": (_row(frame=-1), r"row 0: expected a frame from 0"),
    "way out": (_row(technique="../elsewhere"), r"row 0: expected .* a plain technique name, got '\.\./elsewhere'"),
    "unknown mask": (_row(mask="sky"), r"row 0: mask: expected one of reflective, frame, got 'sky'"),
    "figure is text": (_row(rmse="small"), r"row 0: rmse: expected a finite number or null, got 'small'"),
    "stages is a list": (_row(stages=[1]), r"row 0: stages: expected an object"),
    "stage is text": (_row(stages={"a": "b"}), r"row 0: stages\.a: expected a finite number"),
    "rows twice": (lambda f: edit_rows(f, lambda rows: rows.append(rows[0])), r"rows 0 and \d+ are both raytrace"),
    "only the reference": (
        lambda f: edit_rows(f, lambda rows: [{**rows[0], "technique": "reference"}]),
        "expected rows of at least one technique",
    ),
    "no picture": (
        lambda f: [(f / "envmap" / f"frame_0001.{kind}").unlink() for kind in ("png", "exr")],
        r"envmap/frame_0001\.png: missing",
    ),
    "broken picture": (_write("raytrace/frame_0002.png", "not a picture"), r"frame_0002\.png: not a readable PNG"),
    "cut picture": (
        lambda f: (f / "raytrace/frame_0002.png").write_bytes((f / "raytrace/frame_0002.png").read_bytes()[:300]),
        r"frame_0002\.png: not a readable PNG",
    ),
    "broken EXR": (_write("reference/frame_0000.exr", "not a picture"), r"reference/frame_0000\.exr"),
    "other size": (
        lambda f: write_frame(f / "envmap", 1, np.zeros((4, 5, 3), np.float32), 0.0),
        r"envmap/frame_0001\.exr, against .*reference/frame_0001\.exr: reference: expected the shape",
    ),
    "exposure is text": (_write("job.toml", '[outputs]\nexposure = "bright"'), r"job\.toml: outputs\.exposure"),
    "outputs is a number": (_write("job.toml", "outputs = 3"), r"job\.toml: outputs: expected a table"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_folder_is_refused_and_its_old_report_kept(copy, case):
    spoil, message = BROKEN[case]
    (copy / "report.html").write_text("old")
    spoil(copy)
    with pytest.raises(ValueError, match=message):
        write_report(copy)
    assert (copy / "report.html").read_text() == "old"


def test_no_folder_is_refused(tmp_path):
    with pytest.raises(ValueError, match="expected a results folder, found nothing"):
        write_report(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="expected a results folder, found a file"):
        write_report(tmp_path / "file")


@given(st.lists(st.floats(-1e6, 1e6, allow_subnormal=False), min_size=1, max_size=8), st.booleans())
def test_an_axis_holds_its_values_and_has_few_ticks(values, force_log):
    values = [value if abs(value) > 1e-6 else 0.0 for value in values]
    axis = report_plots.axis(values, force_log=force_log)
    assert axis.low < axis.high
    assert all(-1e-3 <= axis.share(value) <= 1 + 1e-3 for value in values)
    shares = [share for share, _ in axis.ticks]
    assert 2 <= len(shares) <= 8 and shares == sorted(shares)
    assert shares[0] >= 0 and shares[-1] <= 1 + 1e-9


@given(st.integers(1, 2000))
def test_thinning_keeps_the_first_frame_and_the_step(count):
    shown = thinned(tuple(range(count)))
    assert shown[0] == 0 and len(shown) <= report_images.MAX_FRAMES
    assert len(set(np.diff(shown))) <= 1
    assert count <= report_images.MAX_FRAMES or len(shown) > report_images.MAX_FRAMES // 2


@pytest.mark.parametrize(("worst", "expected"), [(0.0, 0.1), (0.7, 1.0), (20.0, 20.0), (21.0, 50.0), (255.0, 200.0)])
def test_the_error_scale_ends_at_a_round_number(worst, expected):
    assert error_scale([np.full((3, 4), worst, np.float32)]) == pytest.approx(expected)
    assert error_scale([]) is None
    assert scale_ticks(expected)[0] == (0.0, "0") and scale_ticks(expected)[-1] == (100.0, f"≥ {expected:g}")


def test_numbers_as_text():
    assert decimals([0.00123, 7.0]) == 5 and decimals([1234.5]) == 0 and decimals([0.0]) == 0 and decimals([1e-30]) == 6
    assert text(1234567.0, 0) == "1\u202f234\u202f567" and text(float("nan"), 2) == "–" and text(float("inf"), 1) == "∞"


def test_costs_and_stage_bars_are_means_of_the_rows(folder, page):
    results = read_results(folder)
    rows = {t: list(results.of(t, "frame").values()) for t in results.techniques}
    plain = re.sub(r"\s+", " ", " ".join(outline(page).text))
    seconds = {t: float(np.mean([row.numbers["seconds"] for row in rows[t]])) for t in rows}
    digits = decimals(seconds.values())
    assert f"envmap {seconds['envmap']:.{digits}f} 0.50 2.50 2 304 311" in plain
    bars, stages = report_plots.stage_bars(results)
    assert [bar.technique for bar in bars] == ["raytrace", "envmap", "shared by all"]
    assert stages == ["surface", "rays", "shade", "not in a stage", "diffuse", "composite"]
    for bar in bars:
        assert sum(share for _, share, _, _ in bar.parts) == pytest.approx(100)
    shares = {stage: share for stage, share, _, _ in bars[0].parts}
    assert shares == pytest.approx({"surface": 20, "rays": 50, "shade": 28, "not in a stage": 2})
    assert bars[0].width == 100 and bars[1].width == pytest.approx(100 * seconds["envmap"] / seconds["raytrace"])
