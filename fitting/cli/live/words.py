"""Texts of the live page as HTML: its state, the outcome of a motion, and computing times."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

import numpy as np

from fitting.cli.live.motion import ShownMotion
from fitting.cli.pages import sentence, template
from pftwin.results.plots import COLOURS

BEFORE, AFTER = COLOURS[:2]
PACE_COUNT = 50  # number of response times from which the median and the worst are shown
NOT_FOR_PATIENTS = "Research software: no treatment should be decided by it alone."


def times_taken(times: Sequence[float]) -> str:
    """Describes response times [s]: the last one, the median and the worst."""
    if not times:
        return "none yet"
    last, middle, worst = (f"{1e3 * t:.0f}" for t in (times[-1], median(times), max(times)))
    return f"{last} ms (of the last {len(times)}: median {middle}, worst {worst} ms)"


def _written(macro: str, *content: Any) -> str:
    return str(getattr(template("live.html").module, macro)(*content))


def state(tone: str, head: str, more: str = "") -> str:
    """A heading in the colour of its tone ("good", "bad", "wait" or "doubt"), and a smaller line below it."""
    return _written("state", tone, head, more)


def outcome(answer: ShownMotion) -> str:
    """Whether and when the patella dislocates, with reservations; for an INVALID motion, the reasons."""
    tracking, status, verdict = answer.result.tracking, answer.result.status.describe(), answer.recorded.verdict
    if not verdict.valid:
        return state("bad", verdict.describe(), "Do not interpret this motion.")
    doubts = "" if status == "ok" else f"Reservations in some frames: {status}."
    if answer.dislocates is None:
        return state("doubt", f"Dislocation: {tracking}", doubts)
    tone, word = ("bad", "yes") if answer.dislocates else ("good", "no")
    return state(tone, f"Dislocation: {word}", f"{sentence(tracking)} {doubts}")


def waiting(contact: str, shown: str) -> str:
    """Text shown while a contact is compiled."""
    return state("wait", f"Preparing contact {contact} ...", f"Until then the page and its sliders use {shown}.")


def whole_motion(motions: Sequence[ShownMotion], colours: Sequence[str]) -> str:
    """Table of the extremes of motions."""
    rows = []
    for answer, colour in zip(motions, colours, strict=True):
        out = {None: "—", True: "yes", False: "no"}[answer.dislocates]
        force = f"{answer.highest_force:.0f} N" if np.isfinite(answer.highest_force) else "—"
        rows.append((answer.recorded.name, colour, (_range(answer.tilt), _range(answer.shift), force, out)))
    return _written("whole_motion", rows)


def pace_text(motions: Sequence[float], drawings: Sequence[float], seconds: float) -> str:
    """Response times of the page, and the computing time of the last simulation [s]."""
    rows = {
        "slider to new motion": times_taken(motions),
        "slider to drawing sent": times_taken(drawings),
        "simulation and its numbers alone": "none yet" if not seconds else f"{1e3 * seconds:.0f} ms",
    }
    return _written("pace", rows)


def aside(*lines: str) -> str:
    """Small lines of text next to the curves."""
    return _written("aside", lines)


def with_margins(content: str) -> str:
    """Adds the page's margins to HTML of the viewer."""
    return f"<div style='padding:2px 12px'>{content}</div>"


def _range(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    text = f"{finite.min():.0f} to {finite.max():.0f}" if finite.size else "—"
    return text.replace("-", "−")
