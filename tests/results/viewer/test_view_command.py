"""`pftwin view`: what it writes, says, and refuses."""

from __future__ import annotations

import json

import pytest
from small_scene import small_result
from typer.testing import CliRunner

from pftwin.cli import app


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("results") / "knee.nc"
    small_result().save(path)
    return path


def run(*arguments: object):
    return CliRunner().invoke(app, ["view", *map(str, arguments)], env={"COLUMNS": "160", "NO_COLOR": "1"})


def test_writes_a_page_beside_the_result(file):
    done = run(file)
    assert done.exit_code == 0, done.output
    page = file.with_suffix(".html")
    assert f"written: {page} (" in done.stdout
    assert "<title>knee</title>" in page.read_text(encoding="utf-8")


def test_overlays_results_under_names(file, tmp_path):
    page = tmp_path / "both.html"
    done = run(file, file, "--name", "before", "--name", "after", "-o", page, "--json", "-")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["results"] == [str(file)] * 2
    assert said["files"] == [{"file": str(page), "bytes": page.stat().st_size}]
    assert page.stat().st_size < 8e6
    assert "<title>before and after</title>" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("absent.nc",), "no such file"),
        (("{file}", "-o", "page.pdf"), "the page is HTML; try: page.html"),
        (("{file}", "--name", "a", "--name", "b"), "2 names for 1 results"),
        (("{file}", "-o", "absent/page.html"), "there is no folder absent"),
        (
            ("{file}", "{file}", "--side-by-side", "--record", "f.gif", "--camera", "medial"),
            "one knee hides the others",
        ),
        (("{file}", "--record", "film.avi"), "the suffix chooses the film's format; try: film.gif"),
        (("{file}", "--record", "film.gif", "--speed", "0"), "speed: found 0.0; expected: a positive number"),
        (
            ("{file}", "--record", "film.gif", "--speed", "0.001"),
            "8001 pictures of 0.4 s at 0.001 x speed; expected: 2000 pictures at most; try: a speed of 0.004",
        ),
    ],
)
def test_mistakes_are_named(file, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    done = run(*(a.format(file=file) for a in arguments))
    assert done.exit_code == 2
    assert words in done.stderr
    assert "Traceback" not in done.output
    assert not list(tmp_path.glob("*.html"))
