"""What is written on the page: how it stands, what came out, how long it took. HTML, everything foreign escaped."""

from __future__ import annotations

from html import escape

import numpy as np

from fitting.cli.live.answer import ShownMotion
from fitting.cli.live.clock import Clock
from fitting.cli.live.curves import AFTER, BEFORE

_FONT = "font:13px/1.4 system-ui,'Segoe UI',Helvetica,Arial,sans-serif"
_TONES = {"good": "#1B7F4B", "bad": "#B3261E", "wait": "#1F5FA8", "doubt": "#9A6700"}
NOT_FOR_PATIENTS = "Research software: no treatment should be decided by it alone."


def state(tone: str, head: str, more: str = "") -> str:
    """How it stands: a coloured line, and what is to be added to it."""
    small = f"<div style='font-size:11.5px;color:#555'>{escape(more)}</div>" if more else ""
    lead = f"<b style='color:{_TONES[tone]}'>{escape(head)}</b>"
    return f'<div style="{_FONT};padding:4px 12px;border-left:4px solid {_TONES[tone]}">{lead}{small}</div>'


def outcome(answer: ShownMotion) -> str:
    """Of a motion that is drawn: does the patella dislocate, and when; reservations."""
    doubts = "" if answer.status == "ok" else f"Reservations in some frames: {answer.status}."
    if answer.dislocates is None:
        return state("doubt", f"Dislocation: not assessed, {answer.tracking}", doubts)
    if answer.dislocates:
        return state("bad", "Dislocation: yes", f"{_capital(answer.tracking)} {doubts}")
    return state("good", "Dislocation: no", f"{_capital(answer.tracking)} {doubts}")


def refused(why: str) -> str:
    """Of values that gave no motion to draw."""
    return state("bad", f"Not drawn: {why}", "The drawing and the curves are those of the last values that worked.")


def waiting(contact: str, shown: str) -> str:
    """While a contact's program is compiled."""
    return state("wait", f"Preparing contact {contact} ...", f"Until then everything shown and turned is with {shown}.")


def comparison(before: ShownMotion, after: ShownMotion) -> str:
    """Extremes of both motions in a table."""
    head = "".join(
        f"<td style='{_CELL};color:#555'>{h}</td>" for h in ("tilt [°]", "shift [mm]", "force", "dislocated")
    )
    rows = []
    for answer, code in ((before, BEFORE), (after, AFTER)):
        out = {None: "—", True: "yes", False: "no"}[answer.dislocates]
        cells = (_range(answer.tilt), _range(answer.shift), _most(answer.highest_force), out)
        rows.append(
            f"<tr><td style='color:{code};font-weight:600'>{escape(answer.recorded.name)}</td>"
            + "".join(f"<td style='{_CELL}'>{c}</td>" for c in cells)
            + "</tr>"
        )
    table = f"<table style='border-spacing:0;font:inherit;width:100%'><tr><td></td>{head}</tr>{''.join(rows)}</table>"
    title = "<b>Whole motion</b> <span style='color:#555'>(range; highest force)</span>"
    return f'<div style="{_FONT};padding:4px 12px;font-variant-numeric:tabular-nums">{title}{table}</div>'


def pace(motions: Clock, drawings: Clock, seconds: float) -> str:
    """How long the page takes."""
    rows = (
        ("slider to new motion", motions.words()),
        ("slider to drawing sent", drawings.words()),
        ("simulation and its numbers alone", "none yet" if not seconds else f"{1e3 * seconds:.0f} ms"),
    )
    lines = "".join(f"<div>{escape(a)}: <b>{escape(b)}</b></div>" for a, b in rows)
    return f'<div style="{_FONT};font-size:11.5px;color:#333;padding:2px 12px">{lines}</div>'


def boxed(content: str) -> str:
    """HTML of the viewer with the page's margins."""
    return f"<div style='padding:2px 12px'>{content}</div>"


_CELL = "text-align:right;padding-left:8px;white-space:nowrap"


def _range(values: np.ndarray) -> str:
    there = values[np.isfinite(values)]
    text = f"{there.min():.0f} to {there.max():.0f}" if there.size else "—"
    return text.replace("-", "−")


def _most(force: float) -> str:
    return f"{force:.0f} N" if np.isfinite(force) else "—"


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
