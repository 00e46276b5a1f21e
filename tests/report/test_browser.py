"""The report in a real browser, offline: no complaint, nothing fetched, the knee moves inside, and it prints on A4."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "viewer"))
from report_pages import fitted, prediction
from viewer_pages import chromium

from pftwin.cli.report.contents import report

pytest.importorskip("k3d")
VIEWER = "document.querySelector('.pftwin').viewer"


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    material = fitted(folder)
    material.treatment = prediction()
    (folder / "report.html").write_text(report(material, "pftwin report").page, encoding="utf-8")
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
    for width in (1100, 500):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_prints_on_a4_without_the_drawing(page):
    page.emulate_media(media="print")
    assert not page.locator("iframe").is_visible()
    assert page.locator(".on-paper").is_visible()
    printed = page.pdf(prefer_css_page_size=True)
    page.emulate_media(media="screen")
    assert b"/MediaBox [0 0 594" in printed or b"/MediaBox [0 0 595" in printed
