"""`pftwin app` from its start to Ctrl-C, in a real browser: a drag that cures case 2, and two pages at once."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser")
PIL = pytest.importorskip("PIL.Image")
sys.path.append(str(Path(__file__).parents[3] / "results" / "viewer"))
from viewer_pages import chromium  # noqa: E402

from pftwin.base import cache_folder  # noqa: E402
from pftwin.model.measured import SYNTHETIC  # noqa: E402

pytestmark = pytest.mark.slow
SLIDER = "xpath=(//*[normalize-space(text())='{}']/ancestor::*[.//*[@role='slider']][1])[1]"
PALE = "Pale: the fitted surface continued beyond its edge."  # where the patella dislocates to
ORANGE = (213, 94, 0)  # of the treated knee


@pytest.fixture(scope="module")
def command():
    """The program, serving case 2 at some port."""
    kept = {"PFTWIN_CACHE": str(cache_folder.chosen()), "PYTHONUNBUFFERED": "1"}
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from pftwin.cli import main; main()"
    )
    started = subprocess.Popen(
        [sys.executable, "-c", code, "app", "--case", "2", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **kept, "NO_COLOR": "1", "COLUMNS": "160"},
    )
    assert started.stdout is not None
    said = started.stdout.readline()
    try:
        assert re.match(r"ready after \d+\.\d s: http://127\.0\.0\.1:\d+  \(Ctrl-C ends it\)$", said), (
            said or started.communicate(timeout=30)
        )
        yield started, said.split()[4]
    finally:
        if started.poll() is None:
            started.kill()
            started.communicate(timeout=30)


@pytest.fixture(scope="module")
def browser(command):
    with chromium() as made:
        yield made


@contextmanager
def opened(browser, address, width: int = 1000):
    """A page that is drawn, and what its browser said and asked for. The narrower, the less is drawn by software."""
    context = browser.new_context(viewport={"width": width, "height": 560})
    page, seen = context.new_page(), {"messages": [], "requests": []}
    page.on("console", lambda m: seen["messages"].append((m.type, m.text)))
    page.on("pageerror", lambda e: seen["messages"].append(("error", str(e))))
    page.on("request", lambda r: seen["requests"].append(r.url))
    page.goto(address)
    says(page, "Dislocation:")
    yield page, seen
    context.close()


def says(page, words: str) -> None:
    page.wait_for_function("words => document.body.innerText.includes(words)", arg=words, timeout=180_000)


def show_times(page) -> None:
    """Those of the program, which have a tab of their own."""
    page.get_by_role("tab", name="Times").click()


def drag(page, label: str, share: float) -> None:
    """Takes a slider to a share of its length, by the mouse."""
    slider = page.locator(SLIDER.format(label))
    thumb, track = (slider.locator(part).first.bounding_box() for part in ("[role=slider]", "[class*=Slider-track]"))
    y = thumb["y"] + thumb["height"] / 2
    begin, end = thumb["x"] + thumb["width"] / 2, track["x"] + share * track["width"]
    page.mouse.move(begin, y)
    page.mouse.down()
    for k in range(1, 9):
        page.mouse.move(begin + (end - begin) * k / 8, y)
    page.mouse.up()


def picture(page) -> np.ndarray:
    """What is between the panels."""
    shot = page.screenshot(timeout=120_000, clip={"x": 410, "y": 200, "width": 190, "height": 350})
    return np.asarray(PIL.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def near(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    """Pixels of a colour's hue, whatever their brightness."""
    shares = image / np.maximum(image.sum(axis=2, keepdims=True), 1)
    return int((np.abs(shares - np.array(colour) / sum(colour)).max(axis=2) < 0.12).sum())


def test_the_page_loads_without_a_complaint_and_asks_nobody_else(browser, command):
    with opened(browser, command[1]) as (page, seen):
        says(page, "Dislocation: yes")
        says(page, f"{SYNTHETIC[0].upper()}{SYNTHETIC[1:]}.")
        show_times(page)
        says(page, "slider to new motion: none yet")
        page.wait_for_timeout(500)
        assert near(picture(page), ORANGE) > 500
        assert [m for m in seen["messages"] if m[0] == "error"] == []
        own = (command[1], f"blob:{command[1]}", "data:")
        assert [url for url in seen["requests"] if not url.startswith(own)] == []


def test_dragging_the_tuberosity_medially_cures_case_2_on_this_page_alone(browser, command, tmp_path):
    with opened(browser, command[1]) as (page, seen), opened(browser, command[1], 820) as (other, _):
        says(page, "Dislocation: yes")
        says(page, PALE)
        before = picture(page)
        drag(page, "medialisation [mm]", 0.72)  # to 16 mm
        says(page, "Dislocation: no")
        page.wait_for_function("words => !document.body.innerText.includes(words)", arg=PALE, timeout=60_000)
        show_times(page)
        timing = r"slider to new motion: \d+ ms \(of the last \d+: median \d+, worst \d+ ms\)"
        page.wait_for_function("told => new RegExp(told).test(document.body.innerText)", arg=timing, timeout=180_000)
        value = float(page.locator(SLIDER.format("medialisation [mm]")).locator("input").last.input_value())
        assert 13 < value < 19
        page.wait_for_timeout(500)
        assert (np.abs(picture(page) - before).max(axis=2) > 20).sum() > 1000
        says(other, "Dislocation: yes")
        drag(other, "distalisation [mm]", 0.6)
        show_times(other)
        other.wait_for_function("() => document.body.innerText.includes('of the last')", timeout=180_000)
        assert "Dislocation: no" in page.locator("body").inner_text()
        assert [m for m in seen["messages"] if m[0] == "error"] == []
        folder = Path(os.environ.get("PFTWIN_ARTIFACTS", tmp_path))
        page.screenshot(path=folder / "app.png", timeout=120_000)
        page.get_by_role("button", name="Reset").click()
        says(page, "Dislocation: yes")


def test_ctrl_c_ends_it_cleanly(command):
    started, _ = command
    started.send_signal(signal.SIGINT)
    out, errors = started.communicate(timeout=60)
    assert started.returncode == 0
    assert out == "ended\n"
    assert errors == ""
