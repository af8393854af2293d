"""Laws of a page in a real browser: its player does what its controls say, from the keyboard too;
it raises no error, loads nothing, fits wide and narrow screens, and prints.

Skipped where there is no Chromium with its driver.
"""

import base64
import io
import json
import os
import shutil

import numpy as np
import pytest
from invented_laps import LIMITS, find_pose, invent_laps
from PIL import Image
from test_page import make_page, make_run

from jaxtube.reporting.document import render
from jaxtube.reporting.player import make_player

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
from selenium.webdriver.chrome.service import Service  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from selenium.webdriver.support.ui import Select, WebDriverWait  # noqa: E402

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    not (BROWSER and DRIVER), reason="Chromium and its driver are not installed"
)
WIDTHS = (1400, 390)
POSE = 5e-4
"""Of the 16-bit errors in a page, m and rad."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    wanted = ["--headless=new", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"]
    if os.geteuid() == 0:
        wanted.append("--no-sandbox")  # which the superuser cannot have
    for word in wanted:
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def laps():
    return invent_laps()


@pytest.fixture(scope="module")
def address(tmp_path_factory, laps):
    folder = tmp_path_factory.mktemp("page")
    page = make_page("a word", make_player(laps, "a note"))
    (folder / "report.html").write_text(render(page, make_run("a word")), encoding="utf-8")
    return (folder / "report.html").as_uri()


@pytest.fixture
def page(browser, address):
    """The page, just opened on a wide and light screen."""
    emulate(browser, WIDTHS[0], "light")
    browser.get(address)
    return browser


def emulate(browser, width, scheme, motion="no-preference"):
    screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    features = {"prefers-color-scheme": scheme, "prefers-reduced-motion": motion}
    listed = [{"name": name, "value": value} for name, value in features.items()]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": listed})


def state(browser):
    return browser.execute_script("return {...window.player.state}")


def pose(browser):
    """Return the pose of the robot that is shown."""
    return browser.execute_script(
        "const s = player.state; return player.pose(s.controller, s.lap, s.step)"
    )


def picture(browser, name):
    """Return what is drawn on a canvas, as its address."""
    return browser.execute_script(f"return document.getElementById('{name}').toDataURL()")


def find(browser, name):
    return browser.find_element(By.ID, name)


def lap_number(browser):
    return browser.execute_script("const s = player.state; return player.laps(s.controller)[s.lap]")


def test_it_begins_with_the_median_lap_of_the_last_controller_and_stands_still(page, laps):
    shown = state(page)
    assert page.execute_script("return player.controllers") == list(laps.laps)
    assert (shown["controller"], shown["step"], shown["playing"]) == (1, 0, False)
    assert lap_number(page) == laps.laps["tube_mpc"].numbers[laps.laps["tube_mpc"].find("median")]


def test_the_slider_moves_the_robot_to_where_it_was(page, laps):
    before = picture(page, "field")
    page.execute_script(
        "const t = document.getElementById('time'); t.value = 17;"
        "t.dispatchEvent(new Event('input', {bubbles: true}))"
    )
    assert state(page)["step"] == 17
    wanted = find_pose(laps, "tube_mpc", laps.laps["tube_mpc"].find("median"), 17)
    assert pose(page) == pytest.approx(wanted, abs=POSE)
    assert picture(page, "field") != before
    assert find(page, "time").get_attribute("aria-valuetext") == "1.70 s of 4.00 s"


def test_every_lap_of_every_controller_plays_as_it_was_kept(page, laps):
    for controller, (name, kept) in enumerate(laps.laps.items()):
        numbers = page.execute_script("return player.laps(arguments[0])", controller)
        for place, number in enumerate(numbers):
            source = int(np.flatnonzero(kept.numbers == number)[0])
            for instant in (0, 9, 40):
                shown = page.execute_script(
                    "return player.pose(...arguments)", controller, place, instant
                )
                assert shown == pytest.approx(find_pose(laps, name, source, instant), abs=POSE)


def test_the_choice_of_a_lap_changes_errors_and_path(page, laps):
    page.execute_script("player.seek(20)")
    fields = []
    for number in laps.laps["tube_mpc"].numbers[:3]:
        Select(find(page, "lap")).select_by_visible_text(str(number))
        assert lap_number(page) == number
        fields.append((picture(page, "field"), picture(page, "plots")))
    assert len(set(fields)) == 3


def test_the_choice_of_a_controller_keeps_the_lap_and_tells_which_leave_the_limits(page, laps):
    Select(find(page, "lap")).select_by_visible_text("14")
    Select(find(page, "controller")).select_by_visible_text("No slip compensation")
    assert state(page)["controller"] == 0
    assert lap_number(page) == 14
    assert "14, leaves E" in find(page, "lap").text
    beside = Select(find(page, "beside"))
    before = picture(page, "field")
    beside.select_by_visible_text("Tube MPC")
    assert picture(page, "field") != before
    assert "Tube MPC, lap 14" in find(page, "status").text


@pytest.mark.parametrize(
    ("keys", "step"),
    [
        ([Keys.ARROW_RIGHT] * 3, 8),
        ([Keys.ARROW_LEFT] * 2, 3),
        ([Keys.END], 40),
        ([Keys.HOME], 0),
        ([Keys.HOME, Keys.ARROW_LEFT], 0),
        ([Keys.END, Keys.ARROW_RIGHT], 40),
        ([Keys.SHIFT, Keys.ARROW_RIGHT], 15),
    ],
)
@pytest.mark.parametrize("focused", ["field", "time", "play"])
def test_keys_go_through_the_lap_wherever_the_focus_is(page, keys, step, focused):
    page.execute_script(f"player.seek(5); document.getElementById('{focused}').focus()")
    find(page, focused).send_keys(*keys)
    assert state(page)["step"] == step


@pytest.mark.parametrize("focused", ["field", "time", "play"])
def test_the_space_bar_plays_and_pauses(page, focused):
    page.execute_script(f"document.getElementById('{focused}').focus()")
    element = find(page, focused)
    element.send_keys(Keys.SPACE)
    WebDriverWait(page, 10).until(lambda _: state(page)["step"] > 0.2)
    assert find(page, "play").text == "Pause"
    element.send_keys(Keys.SPACE)
    stopped = state(page)
    assert not stopped["playing"] and stopped["step"] == round(stopped["step"])
    assert find(page, "play").text == "Play"


def test_a_lap_ends_by_itself_and_starts_anew(page):
    page.execute_script("player.set({step: 38, speed: 8}); player.play()")
    WebDriverWait(page, 10).until(lambda _: not state(page)["playing"])
    assert state(page)["step"] == 40
    page.execute_script("player.play()")
    assert state(page)["step"] < 40


def test_with_less_motion_the_robot_jumps_from_instant_to_instant(browser, address):
    emulate(browser, WIDTHS[0], "light", "reduce")
    browser.get(address)
    browser.execute_script(
        "window.seen = []; player.play();"
        "window.timer = setInterval(() => seen.push(player.state.step), 50)"
    )
    WebDriverWait(browser, 10).until(lambda _: state(browser)["step"] > 0)
    seen = browser.execute_script("clearInterval(window.timer); return window.seen")
    assert all(step == round(step) for step in seen)


def test_the_status_says_errors_limits_and_what_is_used_of_them(page, laps):
    page.execute_script("player.set({controller: 0, lap: 4, step: 8})")
    page.execute_script("player.pause()")
    kept = laps.laps["uncompensated"]
    errors = kept.errors[8, 4]
    told = find(page, "status").text
    assert "lap 14, at 0.80 s" in told
    for value, limit, unit in zip(errors[:2], LIMITS[:2], ("m", "m"), strict=True):
        assert f"{unit} ({100 * abs(value) / limit:.0f} % of ±{limit:g})" in told
    assert ("outside E" in told) == bool(np.any(np.abs(errors) > LIMITS))


def test_dragging_across_the_errors_chooses_an_instant(page):
    plots = find(page, "plots")
    width = plots.size["width"]
    webdriver.ActionChains(page).move_to_element(plots).click().perform()
    assert state(page)["step"] == pytest.approx(40 * (width / 2 - 58) / (width - 68), abs=1)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_cut_off_and_no_error_is_raised(browser, address, width, scheme):
    browser.get_log("browser")
    emulate(browser, width, scheme)
    browser.get(address)
    for view in ("near", "close", "whole"):
        for scale in ("limits", "data"):
            browser.execute_script("player.set(arguments[0])", {"view": view, "scale": scale})
    root = "document.documentElement"
    assert browser.execute_script(f"return {root}.scrollWidth") == width
    assert [entry["message"] for entry in browser.get_log("browser")] == []
    background = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    channels = [int(word) for word in background[4:-1].split(",")]
    assert (np.mean(channels) < 60) == (scheme == "dark")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_the_page(browser, address, scheme):
    """Contrast of at least 4.5, as the Web Content Accessibility Guidelines 2.2 ask (1.4.3)."""
    emulate(browser, WIDTHS[0], scheme)
    browser.get(address)
    paper = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    for selector in (
        "h1",
        ".lead",
        ".run",
        ".note",
        "nav a",
        "td .bad",
        "#status",
        "dt",
        "summary",
    ):
        colour = browser.execute_script(
            "return getComputedStyle(document.querySelector(arguments[0])).color", selector
        )
        assert contrast(colour, paper) >= 4.5, selector


def contrast(first, second):
    """Return the ratio of the relative luminances of two colours."""
    luminances = []
    for colour in (first, second):
        channels = np.array([int(word) for word in colour[4:-1].split(",")]) / 255
        linear = np.where(
            channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4
        )
        luminances.append(linear @ [0.2126, 0.7152, 0.0722])
    return (max(luminances) + 0.05) / (min(luminances) + 0.05)


def test_no_request_leaves_the_page(browser, address):
    browser.get_log("performance")
    browser.get(address)
    browser.execute_script("player.seek(12)")
    asked = []
    for entry in browser.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            asked.append(message["params"]["request"]["url"])
    assert [url for url in asked if not url.startswith("data:")] == [address]


def test_it_prints_in_black_on_white(browser, address):
    emulate(browser, WIDTHS[0], "dark")
    browser.get(address)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    shot = browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("L"))
    assert np.median(pixels) > 240
    hidden = browser.execute_script(
        "return ['nav', '.transport'].map((s) => document.querySelector(s).offsetHeight)"
    )
    assert hidden == [0, 0]
    pdf = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", {})["data"])
    assert pdf.startswith(b"%PDF")
