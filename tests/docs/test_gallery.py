"""Every picture of the page of figures stands under the code that drew it, and was drawn by that code."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def drawing() -> ModuleType:
    """docs/drawings/figures.py, which is in no package."""
    spec = importlib.util.spec_from_file_location("drawn_figures", DOCS / "drawings" / "figures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_picture_was_drawn_by_the_code_above_it(drawing) -> None:
    wanted = drawing.sources(drawing.blocks((DOCS / "figures.md").read_text(encoding="utf-8")))
    files = {path.stem: path for path in (DOCS / "figures").glob("*.png")}
    assert set(wanted) == set(files)
    for name, codes in wanted.items():
        with Image.open(files[name]) as picture:
            assert picture.info.get(drawing.KEPT) == "\n".join(codes), f"draw it anew: docs/drawings/figures.py {name}"
        assert files[name].stat().st_size < drawing.MOST, name


def test_blocks_without_a_picture_prepare_those_that_follow(drawing) -> None:
    page = (
        "text\n```python\na = 1\n```\n```python\nb = a + 1\nb\n```\n![of b](figures/two.png)\n"
        "```\nno Python\n```\n```python\nc = 3\n```\n\n```python\nc\n```\n![of c](figures/three.png)\n"
    )
    found = drawing.blocks(page)
    assert [block.picture for block in found] == [None, "two", None, "three"]
    assert drawing.sources(found) == {"two": ["a = 1\n", "b = a + 1\nb\n"], "three": ["a = 1\n", "c = 3\n", "c\n"]}
    names: dict[str, object] = {}
    assert [drawing.last_value(block.code, names) for block in found] == [None, 2, None, 3]
    with pytest.raises(ValueError, match="the picture two has no Python block of its own"):
        drawing.blocks("![of b](figures/two.png)\n")


def test_a_picture_keeps_its_code(drawing, tmp_path) -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    figure.subplots().plot([0, 1], [0, 1])
    drawing.save(figure, tmp_path / "a.png", "plot([0, 1])  # ±2 mm")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.info[drawing.KEPT] == "plot([0, 1])  # ±2 mm"
