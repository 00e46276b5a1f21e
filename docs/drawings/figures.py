"""Draws the pictures of docs/figures.md from the code above each: `python docs/drawings/figures.py [NAME ...]`.

The page is the only source: its Python blocks run in order, those without a picture prepare the next ones, and the last
expression of a block with a picture is the figure. Each PNG file keeps the code that drew it, and a test compares it
with the page. The fit and the posterior take minutes the first time; programs that were compiled are kept.
"""

from __future__ import annotations

import ast
import os
import re
import sys
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "figures.md"
FOLDER = PAGE.parent / "figures"
KEPT = "code"  # name of the text in a PNG file
MOST = 80_000  # bytes of a picture
_DPI = 110
_COLOURS = 256  # of a picture: lines on white need no more
_PARTS = re.compile(r"^```python\n(?P<code>.*?)^```$|^!\[[^\]]*\]\(figures/(?P<name>\w+)\.png\)", re.M | re.S)


class Block(NamedTuple):
    """A Python block of the page, and the picture below it; None: it prepares those that follow."""

    code: str
    picture: str | None


def blocks(page: str) -> list[Block]:
    """The blocks of a page in their order, each ended by the next one or by its picture.

    Raises:
        ValueError: a picture without a block of its own.
    """
    found: list[Block] = []
    for part in _PARTS.finditer(page):
        name = part["name"]
        if name is None:
            found.append(Block(part["code"], None))
        elif not found or found[-1].picture is not None:
            raise ValueError(f"the picture {name} has no Python block of its own above it")
        else:
            found[-1] = found[-1]._replace(picture=name)
    return found


def sources(found: Sequence[Block]) -> dict[str, list[str]]:
    """What has to run for each picture: the blocks before it that prepare, and its own."""
    return {
        block.picture: [b.code for b in found[:i] if b.picture is None] + [block.code]
        for i, block in enumerate(found)
        if block.picture is not None
    }


def last_value(code: str, names: dict[str, Any]) -> Any:
    """Runs code among names; the value of its last line, None where that is no expression."""
    *before, last = ast.parse(code).body
    ends = [] if isinstance(last, ast.Expr) else [last]
    exec(compile(ast.Module([*before, *ends], []), str(PAGE), "exec"), names)
    return eval(compile(ast.Expression(last.value), str(PAGE), "eval"), names) if isinstance(last, ast.Expr) else None


def save(figure: Figure, path: Path, code: str) -> None:
    """As a PNG of few colours that keeps its code."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    from pftwin.results.plots import house_style

    raw, kept = BytesIO(), PngInfo()
    kept.add_text(KEPT, code)
    with house_style():
        figure.savefig(raw, format="png", dpi=_DPI)
    picture = Image.open(raw).convert("RGB")
    few = picture.quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(path, optimize=True, pnginfo=kept)
    print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB", flush=True)


def main(wanted: list[str]) -> None:
    """Draws those that are named, all without a name."""
    import pftwin

    os.chdir(ROOT)
    pftwin.configure(cache_dir=True)
    FOLDER.mkdir(exist_ok=True)
    names: dict[str, Any] = {}
    prepared = 0
    for picture, codes in sources(blocks(PAGE.read_text(encoding="utf-8"))).items():
        if wanted and picture not in wanted:
            continue
        for code in codes[prepared:-1]:
            last_value(code, names)
        prepared = len(codes) - 1
        save(last_value(codes[-1], names), FOLDER / f"{picture}.png", "\n".join(codes))


if __name__ == "__main__":
    main(sys.argv[1:])
