"""The report in a browser, offline: nothing fetched, the knee moves; on A4 one sheet comes before the appendix."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3] / "results" / "viewer"))
from report_pages import fitted, prediction
from viewer_pages import chromium

from fitting.cli.report.command import report_page as report

pytestmark = pytest.mark.slow  # a browser

pytest.importorskip("k3d")
PRINTED = (210 - 2 * 14, 297 - 2 * 15)  # A4 between the margins [mm]
PIXELS = 96 / 25.4  # of a style sheet, for a millimetre
VIEWER = "document.querySelector('.pftwin').viewer"


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    material = fitted(folder)
    material.treatment = prediction()
    (folder / "report.html").write_text(report(material, "pftwin report")[0], encoding="utf-8")
    return folder / "report.html"


@pytest.fixture(scope="module")
def seen():
    """What the browser said, and what it asked for."""
    return {"messages": [], "requests": []}


@pytest.fixture(scope="module")
def page(file, seen):
    with chromium() as browser:
        page = browser.new_context(viewport={"width": 1100, "height": 900}, offline=True).new_page()
        page.on("console", lambda m: seen["messages"].append((m.type, m.text)))
        page.on("pageerror", lambda e: seen["messages"].append(("error", str(e))))
        page.on("request", lambda r: seen["requests"].append(r.url))
        page.goto(file.as_uri())
        page.locator("iframe").scroll_into_view_if_needed()
        inside(page).wait_for_function("document.querySelector('.pftwin')?.viewer !== undefined", timeout=120_000)
        inside(page).wait_for_function(f"{VIEWER}.drawn()", timeout=60_000)
        yield page


def inside(page):
    """The frame of the viewer."""
    return next(f for f in page.frames if f != page.main_frame)


def test_loads_offline_without_a_complaint(page, seen, file):
    assert [m for m in seen["messages"] if m[0] == "error"] == []
    outside = [url for url in seen["requests"] if not url.startswith(("blob:", "data:"))]
    assert outside == [file.as_uri()]


def test_all_pictures_are_there(page):
    widths = page.evaluate("[...document.images].map(i => i.naturalWidth)")
    assert len(widths) >= 4
    assert min(widths) > 100


def test_the_knee_moves_inside(page):
    frame = inside(page)
    matrix = f"{VIEWER}.k3d.getObjectById({VIEWER}.control.results[0].ids[0]).matrixWorld.elements.join()"
    begin = frame.evaluate(matrix)
    frame.evaluate(f"{VIEWER}.show(0.2)")
    frame.wait_for_function(f"{VIEWER}.drawn() && {matrix} !== '{begin}'", timeout=60_000)


def test_nothing_is_wider_than_the_page(page):
    for width in (1100, 390):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_what_the_treatment_does_keeps_its_letters_size_on_a_phone(page):
    """Elsewhere as wide as a page; scaled down to a phone, letters of 9 points would be 6 pixels high."""
    shown = "[...document.querySelectorAll('#treatment img')].map(i => [i.naturalWidth, i.clientWidth])"
    page.set_viewport_size({"width": 1100, "height": 900})
    page.wait_for_timeout(300)
    ((width, drawn),) = page.evaluate(shown)
    assert drawn == width > 600
    page.set_viewport_size({"width": 390, "height": 900})
    page.wait_for_timeout(300)
    ((width, drawn),) = page.evaluate(shown)
    assert 0.95 * width < drawn < 390
    page.set_viewport_size({"width": 1100, "height": 900})


@pytest.fixture
def on_paper(page):
    """The page as it is printed, as wide as the paper between its margins."""
    page.set_viewport_size({"width": round(PRINTED[0] * PIXELS), "height": 900})
    page.emulate_media(media="print")
    yield page
    page.emulate_media(media="screen")
    page.set_viewport_size({"width": 1100, "height": 900})


def test_prints_on_a4_with_the_knee_as_it_stands(on_paper):
    assert on_paper.locator("iframe").is_visible()
    assert not inside(on_paper).locator(".pftwin").is_visible()
    assert on_paper.locator(".on-paper").is_visible()
    assert not on_paper.get_by_text("Drag to turn").is_visible()
    printed = on_paper.pdf(prefer_css_page_size=True)
    assert b"/MediaBox [0 0 594" in printed or b"/MediaBox [0 0 595" in printed


def test_no_figure_is_cut_on_paper(on_paper):
    """Each fits a sheet, with its words below it, and is kept together; so are rows of tables."""
    boxes = "[...document.querySelectorAll('figure')].map(f => f.getBoundingClientRect())"
    sizes = on_paper.evaluate(f"{boxes}.map(b => [b.width, b.height])")
    assert len(sizes) >= 4
    assert (np.array(sizes) <= np.array(PRINTED) * PIXELS + 1).all()
    for kind in ("figure", "tr", ".label", ".finding"):
        kept = on_paper.evaluate(f"[...document.querySelectorAll('{kind}')].map(e => getComputedStyle(e).breakInside)")
        assert set(kept) == {"avoid"}, kind
    assert on_paper.evaluate("document.documentElement.scrollWidth") <= round(PRINTED[0] * PIXELS)


def test_every_sheet_bears_the_labels_and_the_appendix_begins_on_the_second(on_paper, tmp_path):
    if shutil.which("pdftotext") is None:
        pytest.skip("no pdftotext on the path: apt-get install poppler-utils")
    (tmp_path / "report.pdf").write_bytes(on_paper.pdf(prefer_css_page_size=True))
    text = subprocess.run(
        ["pdftotext", "-layout", "report.pdf", "-"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    sheets = text.split("\f")[:-1]
    assert len(sheets) >= 4
    for k, sheet in enumerate(sheets, start=1):
        assert "Fitted knee: small knee" in sheet
        assert "Research use, not a medical device." in sheet
        assert re.search(rf"\b{k} ?/ ?{len(sheets)}\b", sheet)
        assert len(sheet.split()) > 25  # nothing stands on a sheet alone
    lines = [[line.strip() for line in sheet.splitlines()] for sheet in sheets]
    assert {"Verdict", "The knee", "What the treatment does", "How sure, and why"} <= set(lines[0])
    assert [k for k, found in enumerate(lines) if "Appendix" in found] == [1]
    assert sheets[1][: sheets[1].index("Appendix")].split() == ["Fitted", "knee:", "small", "knee"]
