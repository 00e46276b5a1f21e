"""The page's text as HTML: its state, the outcome of a motion, and how long it took to compute."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

import numpy as np

from fitting.cli.live.motion import ShownMotion
from fitting.cli.pages import sentence, template
from pftwin.results.plots import COLOURS

BEFORE, AFTER = COLOURS[:2]
KEPT = 50  # times of answers of which the median and the worst are shown
NOT_FOR_PATIENTS = "Research software: no treatment should be decided by it alone."


def times_taken(times: Sequence[float]) -> str:
    """The last times that the page took to answer [s], in words."""
    if not times:
        return "none yet"
    last, middle, worst = (f"{1e3 * t:.0f}" for t in (times[-1], median(times), max(times)))
    return f"{last} ms (of the last {len(times)}: median {middle}, worst {worst} ms)"


def _written(macro: str, *content: Any) -> str:
    return str(getattr(template("live.html").module, macro)(*content))


def state(tone: str, head: str, more: str = "") -> str:
    """A line in the colour of its tone ("good", "bad", "wait" or "doubt"), and a smaller one below it."""
    return _written("state", tone, head, more)


def outcome(answer: ShownMotion) -> str:
    """Whether the patella dislocates and when, and how far to trust that."""
    tracking, status = answer.result.tracking, answer.result.status.describe()
    if not answer.result.verdict.valid:
        return state("bad", tracking, "Nothing can be said of this motion.")
    doubts = "" if status == "ok" else f"Reservations in some frames: {status}."
    if answer.dislocates is None:
        return state("doubt", f"Dislocation: {tracking}", doubts)
    tone, word = ("bad", "yes") if answer.dislocates else ("good", "no")
    return state(tone, f"Dislocation: {word}", f"{sentence(tracking)} {doubts}")


def waiting(contact: str, shown: str) -> str:
    """While a contact's program is compiled."""
    return state("wait", f"Preparing contact {contact} ...", f"Until then everything shown and turned is with {shown}.")


def whole_motion(motions: Sequence[ShownMotion], colours: Sequence[str]) -> str:
    """Extremes of motions in a table."""
    rows = []
    for answer, colour in zip(motions, colours, strict=True):
        out = {None: "—", True: "yes", False: "no"}[answer.dislocates]
        force = f"{answer.highest_force:.0f} N" if np.isfinite(answer.highest_force) else "—"
        rows.append((answer.recorded.name, colour, (_range(answer.tilt), _range(answer.shift), force, out)))
    return _written("whole_motion", rows)


def pace_text(motions: Sequence[float], drawings: Sequence[float], seconds: float) -> str:
    """How long the page takes."""
    rows = {
        "slider to new motion": times_taken(motions),
        "slider to drawing sent": times_taken(drawings),
        "simulation and its numbers alone": "none yet" if not seconds else f"{1e3 * seconds:.0f} ms",
    }
    return _written("pace", rows)


def aside(*lines: str) -> str:
    """Small lines beside the curves."""
    return _written("aside", lines)


def with_margins(content: str) -> str:
    """HTML of the viewer with the page's margins."""
    return f"<div style='padding:2px 12px'>{content}</div>"


def _range(values: np.ndarray) -> str:
    there = values[np.isfinite(values)]
    text = f"{there.min():.0f} to {there.max():.0f}" if there.size else "—"
    return text.replace("-", "−")
