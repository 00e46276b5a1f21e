"""The page's text as HTML: its state, the outcome of a motion, and how long it took to compute."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from statistics import median
from typing import Any

import numpy as np

from fitting.cli.live.motion import ShownMotion
from fitting.cli.pages import sentence, template
from pftwin.results.plots import COLOURS

BEFORE, AFTER = COLOURS[:2]
KEPT = 50  # times whose median and worst are shown
NOT_FOR_PATIENTS = "Research software: no treatment should be decided by it alone."


class Clock:
    """The last times that the page took to answer, in seconds."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=KEPT)

    def add(self, seconds: float) -> None:
        """Keeps a time [s]."""
        self._times.append(seconds)

    @property
    def count(self) -> int:
        """How many are kept."""
        return len(self._times)

    def milliseconds(self) -> tuple[float, float, float]:
        """The last, the median and the worst [ms]; NaN before the first."""
        if not self._times:
            return float("nan"), float("nan"), float("nan")
        return 1e3 * self._times[-1], 1e3 * median(self._times), 1e3 * max(self._times)

    def words(self) -> str:
        """In words."""
        if not self._times:
            return "none yet"
        last, middle, worst = self.milliseconds()
        return f"{last:.0f} ms (of the last {self.count}: median {middle:.0f}, worst {worst:.0f} ms)"


def _written(macro: str, *content: Any) -> str:
    return str(getattr(template("live.html").module, macro)(*content))


def state(tone: str, head: str, more: str = "") -> str:
    """A line in the colour of its tone ("good", "bad", "wait" or "doubt"), and a smaller one below it."""
    return _written("state", tone, head, more)


def outcome(answer: ShownMotion) -> str:
    """Whether the patella dislocates and when, and how far to trust that."""
    if not answer.valid:
        return state("bad", answer.tracking, "Nothing can be said of this motion.")
    doubts = "" if answer.status == "ok" else f"Reservations in some frames: {answer.status}."
    if answer.dislocates is None:
        return state("doubt", f"Dislocation: {answer.tracking}", doubts)
    tone, word = ("bad", "yes") if answer.dislocates else ("good", "no")
    return state(tone, f"Dislocation: {word}", f"{sentence(answer.tracking)} {doubts}")


def refusal_text(why: str) -> str:
    """Why values gave no motion to draw."""
    return state("bad", f"Not drawn: {why}", "The drawing and the curves are those of the last values that worked.")


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


def pace_text(motions: Clock, drawings: Clock, seconds: float) -> str:
    """How long the page takes."""
    rows = {
        "slider to new motion": motions.words(),
        "slider to drawing sent": drawings.words(),
        "simulation and its numbers alone": "none yet" if not seconds else f"{1e3 * seconds:.0f} ms",
    }
    return _written("pace", rows)


def with_margins(content: str) -> str:
    """HTML of the viewer with the page's margins."""
    return f"<div style='padding:2px 12px'>{content}</div>"


def _range(values: np.ndarray) -> str:
    there = values[np.isfinite(values)]
    text = f"{there.min():.0f} to {there.max():.0f}" if there.size else "—"
    return text.replace("-", "−")
