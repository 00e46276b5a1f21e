"""Results to draw, and a browser to look at their pages with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import equinox as eqx
import pytest
from small_scene import small_result, small_scene

import pftwin

# No sandbox inside containers, WebGL in software, and nothing that calls home.
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
)


@cache
def treated_result() -> pftwin.Result:
    """The small knee with its tuberosity 8 mm medially: the same program as before."""
    scene = small_scene()
    k = scene.index("patellar_tendon")
    return pftwin.simulate(eqx.tree_at(lambda s: s.effects[k].origin.y, scene, scene.effects[k].origin.y - 0.008))


def both() -> dict[str, pftwin.Result]:
    return {"before": small_result(), "after <b>8 mm</b>": treated_result()}


@contextmanager
def chromium() -> Iterator[Any]:
    """A headless Chromium; the test is skipped, with the reason, where there is none."""
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no chromium on the path: apt-get install chromium")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        yield browser
        browser.close()
