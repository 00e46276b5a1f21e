"""Films of the page, drawn by a real browser: their pictures, their speed, and what is refused."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from small_scene import small_result

from pftwin.base.errors import InputError, MissingExtraError
from pftwin.results.viewer import view
from pftwin.results.viewer.film import RATE, write_film

pytest.importorskip("k3d", reason="the viewer needs the extra `viewer`")
SIZE = (320, 260)


@pytest.fixture(scope="module")
def plot():
    return view(small_result())


@pytest.mark.slow  # a browser
def test_a_film_shows_the_knee_move_at_the_speed_asked_for(plot, tmp_path):
    pytest.importorskip("playwright", reason="the extra `film`")
    if shutil.which("chromium") is None:
        pytest.skip("no chromium on the path")
    from PIL import Image

    calls = []
    write_film(plot, tmp_path / "knee.gif", camera="lateral", speed=0.5, size=SIZE, progress=lambda *a: calls.append(a))
    film = Image.open(tmp_path / "knee.gif")
    count = 1 + int(0.4 / 0.5 * RATE)  # 0.4 s
    assert (film.n_frames, film.info["duration"], film.info["loop"]) == (count, 1000 // RATE, 0)
    assert calls == [(k + 1, count) for k in range(count)]
    pictures = []
    for k in (0, count // 2):
        film.seek(k)
        pictures.append(np.asarray(film.convert("RGB")).astype(int))
    assert pictures[0].shape == (SIZE[1], SIZE[0], 3)
    assert (np.abs(pictures[1] - pictures[0]).max(axis=2) > 20).sum() > 200
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `film`")
    write_film(plot, tmp_path / "knee.mp4", see_through=True, size=SIZE)
    about = next(ffmpeg.read_frames(str(tmp_path / "knee.mp4")))
    assert about["size"] == SIZE
    assert about["duration"] == pytest.approx(9 / RATE)


@pytest.mark.slow  # a browser
def test_a_camera_that_there_is_not_leaves_no_file(plot, tmp_path):
    pytest.importorskip("playwright", reason="the extra `film`")
    if shutil.which("chromium") is None:
        pytest.skip("no chromium on the path")
    with pytest.raises(InputError, match="one of: anterior, lateral, medial, skyline"):
        write_film(plot, tmp_path / "knee.gif", camera="above")
    assert list(tmp_path.iterdir()) == []


def test_without_playwright_the_extra_is_named(plot, tmp_path, monkeypatch):
    monkeypatch.setattr("pftwin.results.viewer.film.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pftwin\[film\]"):
        write_film(plot, tmp_path / "knee.gif")
    assert list(tmp_path.iterdir()) == []


def test_without_a_browser_it_says_how_to_get_one(plot, tmp_path, monkeypatch):
    pytest.importorskip("playwright", reason="the extra `film`")
    monkeypatch.setattr("shutil.which", lambda name: str(Path(tmp_path / "absent")))
    with pytest.raises(InputError, match=r"no browser starts.*playwright install chromium"):
        write_film(plot, tmp_path / "knee.gif")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "speed"), [("knee.avi", 1.0), ("knee.gif", -1.0), ("knee.gif", float("nan"))])
def test_what_cannot_be_is_refused_before_a_browser_starts(plot, tmp_path, monkeypatch, name, speed):
    monkeypatch.setitem(sys.modules, "playwright.sync_api", None)
    with pytest.raises(InputError):
        write_film(plot, tmp_path / name, speed=speed)
