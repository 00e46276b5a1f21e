"""Makes the notebooks of their sources: `python notebooks/render_notebooks.py [NAME ...]`.

The sources NAME.py (jupytext's percent format) are the truth. Each is run in a fresh kernel and written, outputs
included, as NAME.ipynb beside it. The CPU time is told, so that a notebook that grows slow is seen.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parent
LONGEST = 900  # [s] that a cell may take, on a busy machine


def names() -> list[str]:
    """Of all notebooks."""
    return sorted(p.stem for p in FOLDER.glob("[0-9]*.py"))


def unexecuted(name: str) -> nbformat.NotebookNode:
    """The source as a notebook without outputs. Cells are numbered, so that the same source makes the same file."""
    book = jupytext.read(FOLDER / f"{name}.py")
    for k, cell in enumerate(book.cells):
        cell["id"] = f"cell-{k:02d}"
    return book


def executed(name: str, folder: Path) -> nbformat.NotebookNode:
    """The notebook run from beginning to end in a folder.

    Raises:
        CellExecutionError: a cell, or an assertion in it, fails.
    """
    book = unexecuted(name)
    NotebookClient(
        book,
        timeout=LONGEST,
        kernel_name="python3",
        record_timing=False,
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
    ).execute()
    book.metadata.pop("language_info", None)  # the version of whoever rendered it
    book.metadata["jupytext"].pop("text_representation", None)  # as jupytext itself writes a notebook
    return book


def main(wanted: list[str]) -> None:
    """Renders the notebooks of these names, or all."""
    if unknown := set(wanted) - set(names()):
        sys.exit(f"no notebook {', '.join(sorted(unknown))}; there are: {', '.join(names())}")
    for name in wanted or names():
        before = os.times()
        with tempfile.TemporaryDirectory() as folder:
            book = executed(name, Path(folder))
        target = FOLDER / f"{name}.ipynb"
        nbformat.write(book, target)
        after = os.times()
        cpu = sum(after[2:4]) - sum(before[2:4])  # of the kernel, which has ended
        size, passed = target.stat().st_size / 1e3, after.elapsed - before.elapsed
        print(f"{target.name}: {size:.0f} kB, {cpu:.0f} s of CPU time, {passed:.0f} s in all", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
