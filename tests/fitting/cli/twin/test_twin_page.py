"""The page in Chromium, offline: asks for nothing, says what Python says, follows its sliders; and its command."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parents[3] / "results" / "viewer"))
from viewer_pages import chromium

import pftwin
from fitting.cli.live.knobs import Knobs, neutral
from fitting.cli.twin.command import MOST_BYTES
from pftwin.cli import app

RUNNER = CliRunner(env={"COLUMNS": "160", "NO_COLOR": "1"})


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "twin.html"
    done = RUNNER.invoke(app, ["twin", "--case", "2", "-o", str(path)])
    assert done.exit_code == 0, done.output
    return path


def until(page, code: str) -> None:
    """Waits; the page's own policy forbids what Playwright's waiting does."""
    began = time.monotonic()
    while not page.evaluate(f"() => Boolean({code})"):
        assert time.monotonic() - began < 120, code
        time.sleep(0.05)


@pytest.mark.slow
def test_the_page_is_small_and_complete(file):
    assert file.stat().st_size <= MOST_BYTES
    assert "http" not in file.read_text().replace("http-equiv", "")


@pytest.mark.slow
def test_the_page_says_what_python_says(file):
    scene = pftwin.rig.case(2, contact="P5")
    knobs = Knobs.of(scene)
    asked, messages = [], []
    with chromium() as browser:
        page = browser.new_context(viewport={"width": 390, "height": 844}, offline=True).new_page()
        page.on("request", lambda r: asked.append(r.url))
        page.on("console", lambda m: messages.append(m.text))
        page.on("pageerror", lambda e: messages.append(str(e)))
        page.add_init_script(
            "const pen = CanvasRenderingContext2D.prototype, fill = pen.fillText; window.written = [];"
            " pen.fillText = function (...a) { window.written.push(a[0]); fill.apply(this, a); };"
        )
        page.goto(file.as_uri())
        until(page, "window.twin?.after.finished")
        written = page.evaluate("() => window.written.slice(window.written.lastIndexOf('Tilt [°], lateral positive'))")
        assert written[1:6] == ["\N{MINUS SIGN}10", "0", "10", "20", "0.0"]  # of -17 to 29 deg; then the times
        assert page.locator("#state b").inner_text() == "Dislocation: yes"
        assert "Synthetic" in page.locator("body").inner_text()
        page.evaluate(
            "() => { const s = document.querySelector('input[name$=medialisation]');"
            " s.value = 12.5; s.dispatchEvent(new Event('input')); }"
        )
        until(page, "window.twin.after.finished && window.twin.after !== window.twin.before")
        treated = pftwin.simulate(knobs.scene_with(neutral() | {"tibial_tuberosity_transfer.medialisation": 12.5}))
        center = np.reshape(page.evaluate("() => Array.from(window.twin.after.center)"), (-1, 3))
        np.testing.assert_allclose(center, treated.center, rtol=0, atol=1e-9)
        assert page.locator("#state").inner_text().startswith("Dislocation: no")
        assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    assert messages == []
    assert [url for url in asked if not url.startswith(("blob:", "data:"))] == [file.as_uri()]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--case", "2", "-o", "twin.txt"), "the page is HTML"),
        (("-o", "twin.html"), "neither a scene file nor --case given"),
        (("--case", "2", "-o", "absent/twin.html"), "absent"),
        (("--knee", "normal", "-o", "twin.html"), "No such option: --knee"),  # its contacts are on meshes
    ],
)
def test_mistakes_are_named(arguments, words):
    done = RUNNER.invoke(app, ["twin", *arguments])
    assert done.exit_code == 2
    assert words in done.stderr
    assert "Traceback" not in done.output
