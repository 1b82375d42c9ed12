"""The report in a real browser: it opens from disk without a console error, and what it offers works.

Needs Debian's chromium and chromium-driver; skipped where they are missing, unless JAXREFL_REQUIRE_BROWSER=1.
"""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from report_folder import write_results

from pipelines.report import write_report

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")

from selenium.webdriver.chrome.service import Service  # noqa: E402
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from selenium.webdriver.support.ui import WebDriverWait  # noqa: E402

FLAGS = (
    "--headless=new --no-sandbox --disable-gpu --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --window-size=1280,1000"
).split()


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """A report of two techniques and a reference over four frames."""
    return write_report(write_results(tmp_path_factory.mktemp("results"), frames=4, size=(160, 90)))


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """Headless chromium."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and driver):
        message = "chromium or chromedriver is missing (apt-get install chromium chromium-driver)"
        if os.environ.get("JAXREFL_REQUIRE_BROWSER") == "1":
            pytest.fail(message)
        pytest.skip(message)
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    session = webdriver.Chrome(options=options, service=Service(driver))
    yield session
    session.quit()


@pytest.fixture
def report(browser, page):
    """The page, freshly opened; its console must still be empty at the end."""
    browser.get(page.as_uri())
    WebDriverWait(browser, 10).until(lambda b: shown(b, "left")["width"] > 0)
    yield browser
    assert browser.get_log("browser") == []


def shown(browser, side: str) -> dict:
    """What one side of the viewer shows."""
    return browser.execute_script(
        "const i = document.getElementById(arguments[0] + '-picture');"
        "return {...i.dataset, src: i.src, width: i.complete ? i.naturalWidth : 0, alt: i.alt}",
        side,
    )


def wipe(browser) -> float:
    """Position of the divider in percent, as told to assistive technology."""
    return float(browser.find_element(By.ID, "handle").get_attribute("aria-valuenow"))


def visible_share(browser) -> float:
    """Percent of the stage that the left picture covers, as drawn."""
    clip = browser.execute_script("return getComputedStyle(document.getElementById('left-layer')).clipPath")
    return 100 - float(clip.removeprefix("inset(").split()[1].rstrip("%)").removesuffix("px") or 0)


def masks_shown(browser) -> set[str | None]:
    """Masks whose tables and plots are on the page."""
    blocks = browser.find_elements(By.CSS_SELECTOR, ".masked")
    return {block.get_attribute("data-mask") for block in blocks if block.is_displayed()}


def choose(browser, name: str, value: str) -> None:
    """Pick a radio button."""
    browser.find_element(By.CSS_SELECTOR, f"input[name={name}][value='{value}']").click()


def test_it_opens_and_shows_pictures(report):
    for side, source in (("left", "raytrace"), ("right", "reference")):
        picture = shown(report, side)
        assert (picture["source"], picture["width"], picture["frame"]) == (source, 160, "0")
        assert picture["alt"] == f"{source}, frame 0"
    assert report.title == 'mirror <box> & "glass" – jaxrefl'
    fetched = report.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
    assert [name for name in fetched if not name.startswith("data:")] == []


def test_the_divider_follows_the_pointer(report):
    stage = report.find_element(By.ID, "stage")
    width = stage.rect["width"]
    assert wipe(report) == 50
    handle = report.find_element(By.ID, "handle")
    ActionChains(report).click_and_hold(handle).move_by_offset(width // 4, 0).release().perform()
    assert wipe(report) == pytest.approx(75, abs=1)
    assert visible_share(report) == pytest.approx(75, abs=1)
    ActionChains(report).move_to_element_with_offset(stage, -int(0.4 * width), 0).click().perform()
    assert wipe(report) == pytest.approx(10, abs=1)
    ActionChains(report).move_by_offset(int(0.5 * width), 0).perform()
    assert wipe(report) == pytest.approx(10, abs=1)  # released: it follows no longer


def test_the_divider_follows_the_keys(report):
    handle = report.find_element(By.ID, "handle")
    handle.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    assert wipe(report) == 56 and visible_share(report) == pytest.approx(56)
    handle.send_keys(Keys.ARROW_LEFT)
    assert wipe(report) == 54
    handle.send_keys(Keys.END)
    assert wipe(report) == 100
    handle.send_keys(Keys.HOME, Keys.ARROW_LEFT)
    assert wipe(report) == 0 and visible_share(report) == pytest.approx(0)


def test_toggling_switches_the_picture_in_place(report):
    button, stage = report.find_element(By.ID, "toggle"), report.find_element(By.ID, "stage")
    for expected, share in (("left", 100), ("right", 0), ("left", 100)):
        button.click()
        assert stage.get_attribute("data-solo") == expected
        assert visible_share(report) == pytest.approx(share)
    assert button.text == "Toggle: raytrace"
    button.send_keys("t")
    assert stage.get_attribute("data-solo") == "right" and button.text == "Toggle: reference"


def test_each_side_shows_what_is_chosen(report):
    before = shown(report, "left")["src"]
    choose(report, "left", "1")
    WebDriverWait(report, 5).until(lambda b: shown(b, "left")["width"] == 160)
    after = shown(report, "left")
    assert after["source"] == "envmap" and after["src"] != before
    assert report.find_element(By.ID, "left-tag").text == "envmap"
    assert "MAE" in report.find_element(By.ID, "left-caption").text


def test_error_maps_replace_pictures_but_the_reference_stays(report):
    picture = shown(report, "left")["src"]
    assert not report.find_element(By.ID, "scale").is_displayed()
    choose(report, "show", "errors")
    WebDriverWait(report, 5).until(lambda b: shown(b, "left")["width"] == 160)
    assert shown(report, "left")["kind"] == "error" and shown(report, "left")["src"] != picture
    assert shown(report, "right")["kind"] == "picture"
    assert report.find_element(By.ID, "scale").is_displayed()
    report.find_element(By.ID, "handle").send_keys("e")
    assert shown(report, "left")["src"] == picture


def test_the_scrubber_and_its_keys_change_the_frame(report):
    seen = {shown(report, "left")["src"]}
    scrubber = report.find_element(By.ID, "scrubber")
    scrubber.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    assert shown(report, "left")["frame"] == shown(report, "right")["frame"] == "2"
    assert report.find_element(By.ID, "frame-label").text == "Frame 2"
    seen.add(shown(report, "left")["src"])
    report.find_element(By.ID, "next").click()
    seen.add(shown(report, "left")["src"])
    report.find_element(By.ID, "handle").send_keys(",", ",")
    assert shown(report, "left")["frame"] == "1"
    seen.add(shown(report, "left")["src"])
    assert len(seen) == 4
    line = report.find_element(By.CSS_SELECTOR, ".masked:not([data-hidden]) svg[data-first] .now")
    assert float(line.get_attribute("x1")) == pytest.approx(58 + 350 / 3, abs=0.1)
    report.find_element(By.ID, "play").click()
    wait = WebDriverWait(report, 5, poll_frequency=0.03)
    wait.until(lambda b: shown(b, "left")["frame"] == "0")  # goes round


def test_worst_frames_and_plots_lead_to_their_frame(report):
    worst = report.find_element(By.CSS_SELECTOR, ".masked:not([data-hidden]) .goto")
    frame = worst.get_attribute("data-frame")
    worst.click()
    assert shown(report, "left")["frame"] == frame
    plot = report.find_element(By.CSS_SELECTOR, ".masked:not([data-hidden]) svg[data-first]")
    ActionChains(report).move_to_element_with_offset(plot, int(0.45 * plot.rect["width"]), 0).click().perform()
    assert shown(report, "left")["frame"] == "3"


def test_zoom_enlarges_and_drags(report):
    def transform() -> str:
        return report.execute_script("return document.getElementById('left-picture').style.transform")

    report.find_element(By.ID, "zoom-in").click()
    assert "scale(1.5)" in transform() and report.find_element(By.ID, "zoom-reset").text == "150 %"
    before, position = transform(), wipe(report)
    stage = report.find_element(By.ID, "stage")
    drag = ActionChains(report).move_to_element_with_offset(stage, 150, 60).click_and_hold()
    drag.move_by_offset(-50, 0).release().perform()
    assert transform() != before and wipe(report) == position
    report.find_element(By.ID, "zoom-reset").click()
    assert "scale(1)" in transform()


def test_the_masks_switch_tables_and_plots(report):
    assert masks_shown(report) == {"reflective"}
    caption = report.find_element(By.ID, "left-caption").text
    choose(report, "mask", "frame")
    assert masks_shown(report) == {"frame"}
    assert report.find_element(By.ID, "left-caption").text != caption


def test_it_fits_a_phone(report):
    metrics = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    report.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        assert report.execute_script("return document.documentElement.scrollWidth") <= 390
        assert report.find_element(By.ID, "stage").rect["width"] <= 390
    finally:
        report.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_plain_render_opens_too(browser, tmp_path):
    folder = write_results(tmp_path / "plain", frames=1, techniques=("raytrace",), reference=False)
    browser.get(write_report(folder).as_uri())
    WebDriverWait(browser, 10).until(lambda b: shown(b, "left")["width"] > 0)
    assert not browser.find_element(By.ID, "handle").is_displayed()
    ActionChains(browser).click(browser.find_element(By.ID, "stage")).send_keys("t").perform()
    assert browser.get_log("browser") == []
