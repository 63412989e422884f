"""The report page as its reader sees it: in a browser without a window, network or server."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from diagnose.report.page import page
from tests.helpers.browser import Browser, browser_program
from tests.helpers.handmade_diagnosis import handmade_diagnosis

PROGRAM = browser_program()
pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium is installed")

WIDE, NARROW = (1280, 800), (390, 844)
HOSTILE = "</script><script>alert(1)</script>"
NAMES = ["slow_a", "fast", HOSTILE]

# A line is anti-aliased: a good part of its pixels has its pure colour all the same. The panel of
# sinkage is some 600 pixels wide.
MIN_PIXELS = 100
# Time from one sample to the next, and a pixel's width in time [s].
SAMPLE = 0.06

# Pixels of a canvas with exactly this colour: how many, and their mean row in the left and in the
# right third.
PIXELS = """(() => {
  const canvas = document.querySelectorAll('#panels canvas')[%d];
  const {width, height} = canvas;
  const data = canvas.getContext('2d').getImageData(0, 0, width, height).data;
  const rows = [[], []];
  let count = 0;
  for (let at = 0; at < data.length; at += 4) {
    if ([%d, %d, %d, 255].some((value, part) => data[at + part] !== value)) continue;
    const column = (at / 4) %% width, row = Math.floor(at / 4 / width);
    count += 1;
    if (column < 70) continue; // labels of the axis
    if (column < width / 3) rows[0].push(row);
    if (column > 2 * width / 3) rows[1].push(row);
  }
  const mean = (of) => of.reduce((a, b) => a + b, 0) / of.length;
  return {count, left: mean(rows[0]), right: mean(rows[1])};
})()"""
IMAGES = "[...document.querySelectorAll('#panels canvas')].map(each => each.toDataURL())"

RECORDED, BEFORE, AFTER = (0, 0, 0), (213, 94, 0), (0, 114, 178)
DARK_RECORDED = (221, 221, 221)


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page(handmade_diagnosis(NAMES)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[Browser]:
    assert PROGRAM is not None
    with Browser(PROGRAM, tmp_path_factory.mktemp("browser")) as browser:
        yield browser


def bottom(browser: Browser, selector: str) -> float:
    """Lower edge of an element in the window [pixels]."""
    return browser.value(f"document.querySelector('{selector}').getBoundingClientRect().bottom")


def pixels(browser: Browser, canvas: int, colour: tuple[int, int, int]) -> dict[str, float]:
    return browser.value(PIXELS % (canvas, *colour))


@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_the_answer_is_on_the_first_screen_and_nothing_is_wider_than_it(browser, report, size):
    browser.open(report, *size)
    verdict = browser.value("document.querySelector('.verdict').innerText")
    assert verdict.startswith("These runs show horizontal_coulomb")
    assert bottom(browser, ".verdict") < size[1]
    assert bottom(browser, ".key") < size[1]
    width = browser.value("document.documentElement.scrollWidth")
    assert width <= size[0]
    if size == WIDE:
        assert bottom(browser, ".numbers") < size[1]
        assert bottom(browser, "#panels") < size[1]


def test_every_curve_is_drawn_and_sinkage_points_down(browser, report):
    browser.open(report, *WIDE)
    assert browser.value("document.querySelectorAll('#panels canvas').length") == 4
    for canvas in range(4):
        for colour in (BEFORE, AFTER):
            assert pixels(browser, canvas, colour)["count"] > MIN_PIXELS
    sinkage = pixels(browser, 0, BEFORE)
    recorded = pixels(browser, 0, RECORDED)
    assert recorded["count"] > MIN_PIXELS
    # The wheel sinks from 14 to 17 mm; what the reference model misses by shrinks it towards zero
    # on the right, where it is drawn above the recorded line.
    assert recorded["left"] < recorded["right"]
    assert sinkage["right"] < recorded["right"]
    # Travel grows, and its axis points up.
    travel = pixels(browser, 2, RECORDED)
    assert travel["left"] > travel["right"]


def test_nothing_is_loaded_and_nothing_in_a_name_is_run(browser, report):
    browser.open(report, *WIDE)
    assert {each.partition(":")[0] for each in browser.requests} == {"file", "data"}
    assert [each for each in browser.requests if each.startswith("file")] == [report.as_uri()]
    assert browser.complaints == []
    # The curves, the library and what draws them.
    assert browser.value("document.scripts.length") == 3
    assert browser.value("document.querySelectorAll('#run option')[2].textContent") == HOSTILE
    browser.value(
        "(() => { const more = document.createElement('script'); more.textContent = 'hit = 1';"
        " document.body.append(more); })()"
    )
    assert browser.value("typeof hit") == "undefined"
    assert "Content Security Policy" in json.dumps(browser.complaints)


def test_the_picker_shows_another_run(browser, report):
    browser.open(report, *WIDE)
    assert browser.value("document.getElementById('panels').dataset.run") == "slow_a"
    first = browser.value(IMAGES)
    for number in (2, 0):
        browser.value(
            "(() => { const picker = document.getElementById('run'); "
            f"picker.selectedIndex = {number}; picker.dispatchEvent(new Event('change')); }})()"
        )
        browser.settle()
        assert browser.value("document.getElementById('panels').dataset.run") == NAMES[number]
        shown = browser.value(IMAGES)
        same = [a == b for a, b in zip(first, shown, strict=True)]
        assert same == ([True] * 4 if number == 0 else [False] * 4)


def test_a_drag_looks_closer_in_every_panel_and_a_double_click_goes_back(browser, report):
    browser.open(report, *WIDE)
    whole = browser.value(IMAGES)
    box = browser.value(
        "(() => { const {left, top, width, height} = "
        "document.querySelector('.u-over').getBoundingClientRect(); "
        "return [left, top, width, height]; })()"
    )
    row = box[1] + box[3] / 2

    def mouse(kind: str, share: float, **more: object) -> None:
        at = {"x": box[0] + share * box[2], "y": row}
        browser.order("Input.dispatchMouseEvent", type=kind, **at, **more)

    held = {"button": "left", "buttons": 1, "clickCount": 1}
    mouse("mouseMoved", 0.2)
    browser.settle()
    # The time under the mouse is told beside both quantities: a fifth of the run's 24 s.
    times = browser.value(
        "[...document.querySelectorAll('.u-legend')].map(each => "
        "parseFloat(each.querySelector('.u-value').textContent))"
    )
    assert times == pytest.approx([0.2 * 24.0] * 2, abs=SAMPLE)
    mouse("mousePressed", 0.2, **held)
    mouse("mouseMoved", 0.3, buttons=1)
    mouse("mouseMoved", 0.4, buttons=1)
    mouse("mouseReleased", 0.4, button="left", clickCount=1)
    browser.settle()
    closer = browser.value(IMAGES)
    assert all(a != b for a, b in zip(whole, closer, strict=True))
    browser.value("document.querySelector('[data-zoom=closer]').click()")
    browser.settle()
    assert all(a != b for a, b in zip(closer, browser.value(IMAGES), strict=True))
    for count in (1, 2):
        mouse("mousePressed", 0.5, button="left", buttons=1, clickCount=count)
        mouse("mouseReleased", 0.5, button="left", clickCount=count)
    browser.settle()
    assert browser.value(IMAGES) == whole


def test_in_the_dark_paper_is_dark_and_the_recorded_line_light(browser, report):
    browser.open(report, *WIDE, dark=True)
    background = browser.value("getComputedStyle(document.body).backgroundColor")
    assert background == "rgb(22, 25, 28)"
    assert pixels(browser, 0, DARK_RECORDED)["count"] > MIN_PIXELS
    assert pixels(browser, 0, RECORDED)["count"] == 0
