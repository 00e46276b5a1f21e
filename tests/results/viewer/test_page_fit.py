"""What a page shows on screens of several sizes: whole knees beside legend and numbers, and every control."""

from __future__ import annotations

import dataclasses
import io

import numpy as np
import pytest
from small_scene import small_result
from viewer_pages import chromium

from pftwin.results.viewer import view

pytestmark = pytest.mark.slow  # a browser

PIL = pytest.importorskip("PIL.Image")
pytest.importorskip("k3d", reason="the viewer needs the extra `viewer`")
VIEWER = "document.querySelector('.pftwin').viewer"
PHONE = {"width": 390, "height": 844}
# Where points [mm] of the femur frame are on the page [px], by the camera's matrices.
PLACES = f"""points => {{
    const world = {VIEWER}.k3d.getWorld(), camera = world.camera, canvas = world.targetDOMNode;
    camera.updateMatrixWorld();
    const times = (m, p) => [0, 1, 2, 3].map(i => m[i] * p[0] + m[i + 4] * p[1] + m[i + 8] * p[2] + m[i + 12] * p[3]);
    return points.map(p => {{
        const c = times(camera.projectionMatrix.elements, times(camera.matrixWorldInverse.elements, [...p, 1]));
        return [(c[0] / c[3] + 1) / 2 * canvas.clientWidth, (1 - c[1] / c[3]) / 2 * canvas.clientHeight];
    }});
}}"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def dislocated():
    """The small knee, whose patella ends 60 mm lateral of where it was."""
    result = small_result()
    position = result.position.copy()
    position[-5:, 1] += 0.06
    return dataclasses.replace(result, position=position)


def opened(browser, results, tmp_path, viewport, **options):
    view(results, html=tmp_path / "view.html", **options)
    page = browser.new_context(viewport=viewport, offline=True).new_page()
    page.goto((tmp_path / "view.html").as_uri())
    page.wait_for_function("document.querySelector('.pftwin')?.viewer !== undefined", timeout=120_000)
    page.wait_for_function(f"{VIEWER}.drawn()", timeout=60_000)
    page.wait_for_timeout(500)  # k3d sets its own camera, if it has one, shortly after it has loaded
    return page


def around(result, aside: float = 0.0) -> list[list[float]]:
    """The patella in all frames, 18 mm to either side of its middle, and the condyles, [mm]."""
    ends = [1e3 * result.position + [0, aside + side, 0] for side in (-18.0, 18.0)]
    return np.concatenate([*ends, [[0.0, aside + 38, 0], [0.0, aside - 38, 0]]]).tolist()


def drawing_height(page) -> int:
    return page.evaluate(f"{VIEWER}.k3d.getWorld().targetDOMNode.clientHeight")


@pytest.mark.parametrize("view_name", [None, "Anterior", "Skyline"])
def test_on_a_phone_knees_side_by_side_are_whole(browser, tmp_path, view_name):
    result = small_result()
    page = opened(browser, {"before": result, "after": result}, tmp_path, PHONE, side_by_side=True)
    if view_name is not None:
        page.get_by_role("button", name=view_name).click()
    for aside in (65.0, -65.0):
        places = np.array(page.evaluate(PLACES, around(result, aside)))
        assert places.min() > 0
        assert places[:, 0].max() < PHONE["width"]
        assert places[:, 1].max() < drawing_height(page)


@pytest.mark.parametrize("view_name", ["Anterior", "Lateral", "Medial", "Skyline"])
def test_on_a_phone_a_dislocated_patella_stays_in_the_picture(browser, tmp_path, dislocated, view_name):
    page = opened(browser, dislocated, tmp_path, PHONE)
    page.get_by_role("button", name=view_name).click()
    places = np.array(page.evaluate(PLACES, around(dislocated)))
    assert places.min() > 0
    assert places[:, 0].max() < PHONE["width"]


@pytest.mark.parametrize("width", [390, 350])  # a phone, and the frame of a report on it
def test_every_control_is_in_reach_on_a_phone(browser, tmp_path, width):
    result = small_result()
    page = opened(browser, {"nominal": result, "fitted": result}, tmp_path, {**PHONE, "width": width})
    controls = page.locator(".pftwin button, .pftwin input, .pftwin select").all()
    assert len(controls) == 11  # play, time, speed; four views, two results, see-through, settings
    for control in controls:
        box = control.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
        assert box["y"] + box["height"] <= PHONE["height"]
    page.get_by_text("see-through patella").click(timeout=5000)
    bar = page.locator(".pftwin").bounding_box()
    assert bar["y"] == pytest.approx(drawing_height(page), abs=1)  # below the drawing, not over it


@pytest.mark.parametrize("viewport", [{"width": 1100, "height": 760}, PHONE])
def test_the_patella_opens_see_through_where_it_covers_contact_colours(browser, tmp_path, viewport):
    result = small_result()
    pressed = dataclasses.replace(result, position=result.position - [0, 0, 0.0005])  # 0.5 mm farther in
    page = opened(browser, pressed, tmp_path, viewport)
    clear = page.get_by_label("see-through patella")
    assert clear.is_checked()
    assert warm_pixels(page, pressed) > 20
    clear.uncheck()
    page.wait_for_timeout(500)
    assert warm_pixels(page, pressed) == 0
    overlaid = opened(browser, {"one": pressed, "two": result}, tmp_path, viewport)  # has no contact colours
    assert not overlaid.get_by_label("see-through patella").is_checked()


def warm_pixels(page, result) -> int:
    """Pixels within 8 mm of the button that are redder than blue: not of the first patella, nor of bare metal."""
    middle = 1e3 * result.position[0]
    ends = [np.add(middle, [x, y, 0]).tolist() for x, y in ((8, 8), (-8, -8))]
    left, top, right, bottom = np.array(page.evaluate(PLACES, ends)).ravel().astype(int)
    shot = PIL.open(io.BytesIO(page.locator("canvas").first.screenshot(timeout=60_000))).convert("RGB")
    red, _, blue = np.asarray(shot).astype(int)[top:bottom, left:right].transpose(2, 0, 1)
    return int((red > blue).sum())


def test_a_hidden_result_appears_with_its_box(browser, tmp_path):
    """A blue patella, and an orange one 5 mm in front of it."""
    result = small_result()
    orange = dataclasses.replace(result, position=result.position - [0, 0, -0.005])
    page = opened(browser, {"nominal": result, "fitted": orange}, tmp_path, PHONE, hidden=["fitted"])
    boxes = [page.get_by_label(name) for name in ("nominal", "fitted")]
    assert [box.is_checked() for box in boxes] == [True, False]
    alone = warm_pixels(page, result)
    boxes[1].check()
    page.wait_for_timeout(500)
    assert alone == 0 < warm_pixels(page, result)


def test_like_knees_side_by_side_look_alike(browser, tmp_path):
    """Their outlines differ by little more than an edge's blur; wide-angle cameras turn them against each other."""
    result = small_result()
    page = opened(browser, {"one": result, "two": result}, tmp_path, {"width": 1400, "height": 900}, side_by_side=True)
    page.evaluate(f"{VIEWER}.k3d.getWorld().overlayDOMNode.style.display = 'none'")
    shot = PIL.open(io.BytesIO(page.locator("canvas").first.screenshot(timeout=60_000))).convert("RGB")
    drawn = np.asarray(np.asarray(shot).astype(int).min(axis=2) < 235)
    one, two = (page.evaluate(PLACES, [[0.0, aside, 0.0]])[0][0] for aside in (65.0, -65.0))
    half, shift = int(abs(two - one) / 2), round(two - one)
    left = drawn[:, round(one) - half : round(one) + half]
    right = drawn[:, round(one) + shift - half : round(one) + shift + half]
    assert left.sum() > 20_000
    assert (left ^ right).sum() < 0.03 * left.sum()


@pytest.mark.parametrize(("width", "height"), [(720, 688), (350, 500)])  # of a film and its bar; of a report's frame
def test_legend_and_numbers_leave_the_knee_free(browser, tmp_path, width, height):
    """Nothing is written on the patella, or on the femur within 45 mm of the middle of its path."""
    result = small_result()
    made_up = dataclasses.replace(result, scene=dataclasses.replace(result.scene, synthetic=True))
    four = dict.fromkeys(("nominal", "fitted", "transfer", "release"), made_up)
    page = opened(browser, four, tmp_path, {"width": width, "height": height})
    middle = 1e3 * result.position[:, 0].mean()
    places = np.array(page.evaluate(PLACES, [*around(result), [middle + 45, 0, 0], [middle - 45, 0, 0]]))
    for name in ("schematic", "shift"):  # a word of the legend, and one of the numbers
        box = page.get_by_text(name).last.locator("xpath=ancestor::div[contains(@style, 'border-radius')]")
        box = box.first.bounding_box()
        inside = (places > [box["x"], box["y"]]) & (places < [box["x"] + box["width"], box["y"] + box["height"]])
        assert not inside.all(axis=1).any(), name


def test_the_view_follows_the_size_of_the_page_until_it_is_turned(browser, tmp_path, dislocated):
    page = opened(browser, dislocated, tmp_path, {"width": 1100, "height": 760})
    page.set_viewport_size(PHONE)
    page.wait_for_timeout(300)
    places = np.array(page.evaluate(PLACES, around(dislocated)))
    assert places.min() > 0
    assert places[:, 0].max() < PHONE["width"]
    page.mouse.move(200, 400)
    page.mouse.down()
    page.mouse.move(260, 420)
    page.mouse.up()
    page.wait_for_timeout(300)
    direction = f"(() => {{const w = {VIEWER}.k3d.getWorld(); return w.camera.position.toArray()}})()"
    turned = page.evaluate(direction)
    page.set_viewport_size({"width": 800, "height": 760})
    page.wait_for_timeout(300)
    np.testing.assert_allclose(page.evaluate(direction), turned, rtol=1e-6)
