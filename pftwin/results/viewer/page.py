"""HTML page of the viewer: k3d's standalone snapshot with a control bar, legend and numbers; all names are escaped."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.output import check_place
from pftwin.base.text_files import write_text
from pftwin.results.verdict import INVALID
from pftwin.results.viewer.bones import HOT, tells_pressure
from pftwin.results.viewer.recorded import Recorded

if TYPE_CHECKING:
    from k3d.plot import Plot

_BOX = "font:min(13px,3vw)/1.45 system-ui,'Segoe UI',Helvetica,Arial,sans-serif;color:#222"
CONTINUED = "Pale: the fitted surface continued beyond its edge."
_RIGHT = "text-align:right;padding-right:8px;white-space:nowrap"
_TITLE = re.compile(r"<title>.*?</title>", re.DOTALL)
_CONTROL = "/*CONTROL*/null"  # placeholder in controls.js for the settings of the control bar


def title(results: Sequence[Recorded]) -> str:
    """Returns the page's title; it begins with "INVALID" if a motion is not valid."""
    names = " and ".join(r.name for r in results)
    return names if all(r.verdict.valid for r in results) else f"{INVALID}: {names}"


def notes(results: Sequence[Recorded], newtons: float, most: float | None = None) -> list[str]:
    """Returns the legend's notes; `newtons` is the force per 10 mm of arrow, `most` the largest coloured value."""
    said = [f"{r.verdict.describe()} ({r.name})." for r in results if not r.verdict.valid]
    said += list(dict.fromkeys(f"{r.note[0].upper()}{r.note[1:]}." for r in results if r.note))
    missing = [body for body in ("femur", "tibia", "patella") if any(r.mesh(f"{body}_bone") is None for r in results)]
    if missing:
        said.append(f"{', '.join(missing).capitalize()}: schematic, for want of a mesh.")
    if any(r.mesh("continuation") is not None for r in results):
        said.append(CONTINUED)
    if any(arrow.present.any() for r in results for arrow in r.contact_arrows):
        said.append(f"Arrows: contact force on the patella, 10 mm for {newtons:g}\u00a0N.")
    if most is not None:
        what, unit = ("pressure of", "MPa") if tells_pressure(results) else ("overlap with", "mm")
        said.append(f"Colours on the femur: {what} the patella, up to {most:.2g}\u00a0{unit}.")
    return said


def side(name: str) -> str:
    """Returns a label beside the knee as HTML in the page's font instead of the formula font."""
    return f"<span style=\"font-family:system-ui,'Segoe UI',Helvetica,Arial,sans-serif\">{escape(name)}</span>"


def legend(results: Sequence[Recorded], codes: Sequence[str], said: Sequence[str], bare: str | None = None) -> str:
    """Returns the legend as HTML: names with their colours, and the notes.

    Args:
        results: the results shown.
        codes: their colours.
        said: the notes.
        bare: colour of the femur without contact, which starts a colour bar below the notes; None without one.
    """
    rows = [
        "<span style='display:inline-block;margin-right:12px'>"
        f"<span style='display:inline-block;width:11px;height:11px;margin-right:6px;background:{code}'></span>"
        f"<b>{escape(r.name)}</b></span>"
        for r, code in zip(results, codes, strict=True)
    ]
    small = "".join(f"<div style='font-size:11px;color:#555'>{escape(line)}</div>" for line in said)
    scale = ""
    if bare is not None:
        stops = ",".join([bare, *(f"{code} {100 * share:g}%" for share, code in HOT)])
        scale = f"<div style='width:130px;height:7px;margin:3px 0;background:linear-gradient(90deg,{stops})'></div>"
    return f'<div class="pftwin-legend" style="{_BOX}">{"".join(rows)}{small}{scale}</div>'


def readout(results: Sequence[Recorded], codes: Sequence[str], time: float) -> str:
    """Returns the HTML table of numbers of each result at its frame nearest to `time` [s]."""
    out = [r.series("dislocated") for r in results]
    wide = "min-width:66px" if any(o is not None and (o > 0).any() for o in out) else ""
    rows = []
    for result, code, dislocated in zip(results, codes, out, strict=True):
        k = int(np.argmin(np.abs(result.times - time)))
        cells = [
            f"<td style='color:{code};font-weight:600;padding-right:8px'>{escape(result.name)}</td>",
            _cell(_at(result, "knee_flexion", k), "°", 0),
            _cell(_at(result, "patella_tilt", k), "°", 1),
            _cell(1e3 * _at(result, "patella_shift", k), " mm", 1),
            _cell(_contact_force(result, k), " N", 1),
            f"<td style='{wide}'>{'dislocated' if dislocated is not None and dislocated[k] > 0 else ''}</td>",
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = "".join(f"<td style='{_RIGHT};color:#555'>{h}</td>" for h in ("flexion", "tilt", "shift", "contact"))
    first = f"<tr><td style='padding-right:8px;white-space:nowrap'><b>{time:.2f} s</b></td>{head}<td></td></tr>"
    table = f"<table style='border-spacing:0;font:inherit'>{first}{''.join(rows)}</table>"
    return f'<div class="pftwin-numbers" style="{_BOX};font-variant-numeric:tabular-nums">{table}</div>'


def _cell(value: float, unit: str, digits: int) -> str:
    text = f"{value:.{digits}f}{unit}".replace("-", "−") if np.isfinite(value) else ""
    return f"<td style='{_RIGHT}'>{text}</td>"


def _at(result: Recorded, name: str, k: int) -> float:
    """A variable at a frame; NaN if the result lacks it."""
    values = result.series(name)
    return float("nan") if values is None else float(values[k])


def _contact_force(result: Recorded, k: int) -> float:
    """Sum of the forces of the result's contacts [N]; NaN without a contact."""
    names = {arrow.contact for arrow in result.contact_arrows}
    return sum(_at(result, f"{name}_force", k) for name in names) if names else float("nan")


def add_controls(plot: Plot, control: dict[str, Any]) -> None:
    """Adds the control bar to a plot: play, time slider, speed, views, and a switch for each result."""
    script = (files("pftwin.results.viewer") / "controls.js").read_text(encoding="utf-8")
    # "</" in a result's name would end the script element.
    settings = json.dumps(control).replace("<", "\\u003c")
    plot.additional_js_code = script.replace(_CONTROL, settings)


def page(plot: Plot) -> str:
    """Returns the self-contained HTML page of a plot."""
    text = plot.get_snapshot(compression_level=9)
    title = f"<title>{escape(plot.name or 'pftwin')}</title>"
    return _TITLE.sub(lambda _: title, text, count=1)


def write_page(plot: Plot, path: str | os.PathLike[str]) -> None:
    """Writes the page atomically.

    Raises:
        OutputError: the folder is missing, the path is a folder, or it is not writable.
    """
    write_text(check_place(path), page(plot))
