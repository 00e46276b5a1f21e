"""Notebooks are what their sources make of them, read well where nothing is run, and run, with all their assertions."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest
from render_notebooks import FOLDER, executed, names, unexecuted

LARGEST = 400e3  # bytes of a notebook with its figures
SAVED = {"01_quick_start": {"after.nc", "after.csv"}}  # by notebooks that show how a result is saved
PLACES = re.compile(r"(?<![\w.:/])/(?:home|root|tmp|work|usr|opt|var|mnt|Users|private)/|[A-Z]:\\\\|file://")


@pytest.fixture(params=names())
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def book(name: str) -> nbformat.NotebookNode:
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def outputs(book: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [output for cell in book.cells for output in cell.get("outputs", [])]


def test_there_are_notebooks():
    assert len(names()) >= 7
    assert {p.stem for p in FOLDER.glob("*.ipynb")} == set(names())


def test_a_notebook_has_the_cells_of_its_source(name: str, book: nbformat.NotebookNode):
    """Whoever changes one of the two and forgets the other is told so."""
    wanted = [(cell.cell_type, cell.source) for cell in unexecuted(name).cells]
    assert [(cell.cell_type, cell.source) for cell in book.cells] == wanted, (
        f"render it: python notebooks/render_notebooks.py {name}"
    )


def test_a_notebook_was_run_in_one_go(book: nbformat.NotebookNode):
    nbformat.validate(book)
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert sum("image/png" in output.get("data", {}) for output in outputs(book)) >= 2


def test_a_notebook_shows_no_errors_and_no_places(name: str, book: nbformat.NotebookNode):
    """Neither a traceback nor a warning, nor where on a machine it was rendered."""
    assert not [o for o in outputs(book) if o.output_type == "error" or o.get("name") == "stderr"]
    text = re.sub(r'"image/png": "[^"]*"', "", (FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    assert not PLACES.findall(text)


def test_a_notebook_is_small(name: str):
    assert (FOLDER / f"{name}.ipynb").stat().st_size < LARGEST


def test_the_index_names_every_notebook(name: str):
    assert f"({name}.ipynb)" in (FOLDER / "README.md").read_text(encoding="utf-8")


def test_places_are_recognised():
    """The test of places can fail."""
    assert PLACES.search("read /home/someone/knee.toml")
    assert not PLACES.search("see [docs](../docs/accuracy.md), https://doi.org/10.3389/work/1")


@pytest.mark.slow
def test_a_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """From beginning to end, in an empty folder: an assertion in it that fails is an error here."""
    import jax

    monkeypatch.setenv("PFTWIN_CACHE", str(jax.config.jax_compilation_cache_dir))  # pyright: ignore
    executed(name, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == SAVED.get(name, set())
