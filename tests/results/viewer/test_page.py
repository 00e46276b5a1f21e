"""The page in a real browser: loads offline without complaint, shows something, and its controls do what they say."""

from __future__ import annotations

import io
import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from small_scene import small_result
from viewer_pages import both, chromium

from pftwin.results.viewer import view
from pftwin.results.viewer.shapes import of_poses

pytestmark = pytest.mark.slow  # a browser

PIL = pytest.importorskip("PIL.Image")
VIEWER = "document.querySelector('.pftwin').viewer"
WRITTEN = 150  # pixels from the top for the legend, and from the bottom for the numbers
BLUE, ORANGE = (0, 114, 178), (213, 94, 0)  # of the first and the second result


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "view.html"
    view(both(), html=path)
    return path


@pytest.fixture(scope="module")
def seen():
    """What the browser said, and what it asked for."""
    return {"messages": [], "requests": []}


@pytest.fixture(scope="module")
def page(file, seen):
    with chromium() as browser:
        context = browser.new_context(viewport={"width": 1100, "height": 760}, offline=True)
        page = context.new_page()
        page.on("console", lambda m: seen["messages"].append((m.type, m.text)))
        page.on("pageerror", lambda e: seen["messages"].append(("error", str(e))))
        page.on("request", lambda r: seen["requests"].append(r.url))
        page.goto(file.as_uri())
        page.wait_for_function("document.querySelector('.pftwin')?.viewer !== undefined", timeout=120_000)
        settle(page)
        yield page


def settle(page):
    """Until what was asked for last is drawn."""
    page.wait_for_function(f"{VIEWER}.drawn()", timeout=60_000)
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def picture(page) -> np.ndarray:
    """The canvas between what is written on it, (height, width, 3)."""
    shot = page.locator("canvas").first.screenshot(timeout=60_000)
    return np.asarray(PIL.open(io.BytesIO(shot)).convert("RGB")).astype(int)[WRITTEN:-WRITTEN]


def slide(page, key: str) -> None:
    page.locator(".pftwin input[type=range]").focus()
    page.keyboard.press(key)
    settle(page)


def near(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    """Pixels of a colour's hue, whatever their brightness."""
    shares = image / np.maximum(image.sum(axis=2, keepdims=True), 1)
    return int((np.abs(shares - np.array(colour) / sum(colour)).max(axis=2) < 0.12).sum())


def test_loads_offline_without_a_complaint(page, seen, file):
    assert [m for m in seen["messages"] if m[0] == "error"] == []
    assert page.locator(".k3d-target, #K3D-error-console li").count() >= 1
    assert page.locator("#K3D-error-console li").count() == 0
    outside = [url for url in seen["requests"] if not url.startswith(("blob:", "data:"))]
    assert outside == [file.as_uri()]
    assert page.title() == "before and after <b>8 mm</b>"


def test_the_canvas_shows_both_results(page):
    slide(page, "Home")
    image = picture(page)
    drawn = (image < 245).any(axis=2).mean()
    assert 0.05 < drawn < 0.9
    assert near(image, BLUE) > 500
    assert near(image, ORANGE) > 500


def test_the_slider_moves_the_patella(page):
    result = small_result()
    slide(page, "Home")
    before, start = picture(page), patella(page)
    page.evaluate(f"{VIEWER}.show(0.2)")
    settle(page)
    after, middle = picture(page), patella(page)
    expected = of_poses(result.position, result.quaternion)
    np.testing.assert_allclose(start, expected[0], atol=1e-3)
    np.testing.assert_allclose(middle, expected[20], atol=1e-3)
    assert np.linalg.norm(middle[:3, 3] - start[:3, 3]) > 1.0  # mm: it does move
    assert (np.abs(after - before).max(axis=2) > 20).sum() > 1000
    slide(page, "End")
    np.testing.assert_allclose(patella(page), expected[-1], atol=1e-3)
    assert "0.40 s" in page.locator(".pftwin output").inner_text()


def patella(page) -> np.ndarray:
    """The model matrix of the first result's patella, as it is drawn."""
    code = f"{VIEWER}.k3d.getObjectById({VIEWER}.control.results[0].ids[0]).matrixWorld.elements"
    return np.array(page.evaluate(code)).reshape(4, 4).T


def test_play_runs_and_pauses(page):
    slide(page, "Home")
    page.locator(".pftwin select").select_option("0.1")
    page.get_by_role("button", name="Play").click()
    page.wait_for_function(f"{VIEWER}.k3d.parameters.time > 0.01", timeout=60_000)
    page.get_by_role("button", name="Pause").click()
    settle(page)
    paused = page.evaluate(f"{VIEWER}.k3d.parameters.time")
    page.wait_for_timeout(300)
    assert page.evaluate(f"{VIEWER}.k3d.parameters.time") == paused


def test_numbers_and_legend_are_written(page):
    slide(page, "Home")
    text = page.locator("body").inner_text()
    assert "after <b>8 mm</b>" in text  # the name as it was given, not as markup
    assert "schematic" in text
    flexion = np.degrees(small_result().knee.flexion[0])
    assert f"{flexion:.0f}°" in text


def test_a_result_can_be_hidden(page):
    slide(page, "Home")
    shown = near(picture(page), ORANGE)
    box = page.locator(".pftwin input[type=checkbox]").nth(1)
    box.uncheck()
    settle(page)
    hidden = picture(page)
    box.check()
    settle(page)
    assert near(hidden, ORANGE) < 0.1 * shown
    assert near(hidden, BLUE) > 500
    assert near(picture(page), ORANGE) == pytest.approx(shown, rel=0.1)


def test_views_change_the_camera_and_a_picture_is_saved(page, tmp_path):
    slide(page, "Home")
    folder = Path(os.environ.get("PFTWIN_ARTIFACTS", tmp_path))
    folder.mkdir(parents=True, exist_ok=True)
    pictures = {}
    for name in ("Anterior", "Lateral", "Medial", "Skyline"):
        page.get_by_role("button", name=name).click()
        settle(page)
        pictures[name] = picture(page)
        page.screenshot(path=folder / f"view_{name.lower()}.png", timeout=60_000)
    print(f"pictures: {folder}")
    for one, two in pairwise(pictures):
        assert (np.abs(pictures[one] - pictures[two]).max(axis=2) > 20).mean() > 0.02, (one, two)
    assert all((folder / f"view_{n.lower()}.png").stat().st_size > 5000 for n in pictures)
