"""The page: k3d's own standalone snapshot, with a title and a bar of controls that drive k3d's public functions."""

from __future__ import annotations

import json
import os
import re
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from pftwin.base.output import check_place
from pftwin.base.text_files import write_text

if TYPE_CHECKING:
    from k3d.plot import Plot

_TITLE = re.compile(r"<title>.*?</title>", re.DOTALL)
_CONTROL = "/*CONTROL*/null"  # in controls.js, where what the bar has to know goes


def add_controls(plot: Plot, control: dict[str, Any]) -> None:
    """Gives the pages made of a plot their bar: play, time slider, speed, views, and a switch for each result."""
    script = (files("pftwin.results.viewer") / "controls.js").read_text(encoding="utf-8")
    # Inside a script element "</" must not occur, whatever a result is called.
    told = json.dumps(control).replace("<", "\\u003c")
    plot.additional_js_code = script.replace(_CONTROL, told)


def page(plot: Plot) -> str:
    """The HTML, with everything it needs inside."""
    text = plot.get_snapshot(compression_level=9)
    title = f"<title>{escape(plot.name or 'pftwin')}</title>"
    return _TITLE.sub(lambda _: title, text, count=1)


def write_page(plot: Plot, path: str | os.PathLike[str]) -> None:
    """Writes the page, whole or not at all.

    Raises:
        OutputError: the folder is missing, the path is a folder, or the place cannot be written to.
    """
    write_text(check_place(path), page(plot))
