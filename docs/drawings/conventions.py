"""Draws the frames and the signs of the angles with pftwin's own rotations: `python docs/drawings/conventions.py`.

Outlines are sketches of a right knee. What is turned is turned by `pftwin.base.rotations`, so a drawing cannot show
another sign than the code has.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Polygon

from pftwin.base.rotations import patellar_orientation, tibiofemoral_orientation
from pftwin.results.plots import COLOURS, STYLE

BLUE, RED, GREEN = COLOURS[0], COLOURS[1], COLOURS[2]
BONE, MOVED = "#e8e2d4", "#bcd3e6"
HERE = Path(__file__).parent
# What is to the right and what is up on paper, in (x proximal, y lateral, z anterior), for a right knee.
SAGITTAL = np.array([[0.0, 0, 1], [1, 0, 0]])  # from the lateral side: anterior to the right
FRONTAL = np.array([[0.0, -1, 0], [1, 0, 0]])  # from the front: lateral to the left
AXIAL = np.array([[0.0, -1, 0], [0, 0, 1]])  # from below: lateral to the left, anterior up
Points = np.ndarray


def main() -> None:
    """Both drawings, as SVG beside this file."""
    with rc_context({**STYLE, "axes.grid": False, "font.size": 10.0, "axes.titlesize": 10.0}):
        for name, figure in (("frames", frames()), ("angles", angles())):
            figure.savefig(HERE / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight")


def frames() -> Figure:
    """The three frames in a side and a front view of a knee bent by 30 deg."""
    figure = Figure(figsize=(9.0, 5.0))
    side, front = figure.subplots(1, 2)
    bend = np.radians(30)
    for axes, view, title in ((side, SAGITTAL, "From the lateral side"), (front, FRONTAL, "From the front")):
        _paper(axes, title, (-95, 95), (-125, 120))
        femur, tibia, patella = _bones(view)
        _outline(axes, femur, BONE)
        _outline(axes, _turned(tibia, tibiofemoral_orientation(bend, 0.0, 0.0)) @ view.T, BONE)
        place = np.array([14.0 if view is SAGITTAL else 62.0, 0, 52])
        turn = patellar_orientation(0.7 * bend, 0.0, 0.0)
        _outline(axes, (place + _turned(patella, turn)) @ view.T, MOVED)
        _triad(axes, view, np.zeros(3), patellar_orientation(0.0, 0.0, 0.0), "F", 58 if view is SAGITTAL else 36)
        _triad(axes, view, place, turn, "P", 28)
    shank = _turned(np.array([[-62.0, 0, 0]]), tibiofemoral_orientation(bend, 0.0, 0.0))[0]
    _triad(side, SAGITTAL, shank, tibiofemoral_orientation(bend, 0.0, 0.0), "T", 30)
    _triad(front, FRONTAL, shank, tibiofemoral_orientation(bend, 0.0, 0.0), "T", 30)
    return figure


def angles() -> Figure:
    """Each angle alone: grey before, blue after, the arrow in the positive sense."""
    figure = Figure(figsize=(9.0, 6.4))
    (flexion, rotation, tilt), (shift, adduction, internal) = figure.subplots(2, 3)
    _patella_turn(flexion, SAGITTAL, (0.6, 0.0, 0.0), "Patellar flexion", "front turns distally")
    _patella_turn(rotation, FRONTAL, (0.0, 0.5, 0.0), "Patellar rotation", "inferior pole turns medially")
    _patella_turn(tilt, AXIAL, (0.0, 0.0, 0.5), "Patellar tilt", "lateral edge turns posteriorly")
    _shift(shift)
    _tibia_turn(adduction, FRONTAL, (0.0, 0.35, 0.0), "Tibial adduction", "distal end moves medially (varus)")
    _tibia_turn(internal, AXIAL, (0.0, 0.0, 0.5), "Tibial internal rotation", "front turns medially")
    return figure


def _patella_turn(axes: Axes, view: Points, by: tuple[float, float, float], title: str, words: str) -> None:
    _paper(axes, title, (-50, 50), (-56, 48))
    patella = _bones(view)[2]
    _outline(axes, patella @ view.T, BONE)
    _outline(axes, _turned(patella, patellar_orientation(*by)) @ view.T, MOVED)
    tip = {0: [-33.0, 0, 0], 1: [0.0, 26, 0]}[int(view is AXIAL)]
    start = np.array([0.0, 0, 36]) if view is SAGITTAL else np.array(tip) * 1.15
    _sweep(axes, view, start, [patellar_orientation(*(s * a for a in by)) for s in np.linspace(0, 1, 9)])
    _compass(axes, view, words)


def _tibia_turn(axes: Axes, view: Points, by: tuple[float, float, float], title: str, words: str) -> None:
    across, up = ((-50, 50), (-56, 48)) if view is AXIAL else ((-67, 67), (-150, -10))
    _paper(axes, title, across, up)
    tibia = _bones(view)[1]
    _outline(axes, tibia @ view.T, BONE)
    _outline(axes, _turned(tibia, tibiofemoral_orientation(*by)) @ view.T, MOVED)
    start = np.array([0.0, 0, 33]) if view is AXIAL else np.array([-109.0, 0, 0])
    _sweep(axes, view, start, [tibiofemoral_orientation(*(s * a for a in by)) for s in np.linspace(0, 1, 9)])
    _compass(axes, view, words)


def _shift(axes: Axes) -> None:
    _paper(axes, "Shift", (-50, 50), (-56, 48))
    patella = _bones(FRONTAL)[2]
    _outline(axes, patella @ FRONTAL.T, BONE)
    _outline(axes, (patella + np.array([0.0, 14, 0])) @ FRONTAL.T, MOVED)
    _arrow(axes, (0, 0), FRONTAL @ np.array([0.0, 14, 0]), RED)
    _compass(axes, FRONTAL, "sphere centre moves laterally")


def _bones(view: Points) -> tuple[Points, Points, Points]:
    """Outlines of femur (on paper), tibia and patella (in their frames) as this view shows them [mm]."""
    t = np.linspace(0, 2 * np.pi, 80)
    if view is AXIAL:
        tibia = np.stack([0 * t, 40 * np.cos(t), 4 + 24 * np.sin(t) - 4 * np.cos(2 * t)], axis=1)
        patella = np.stack([0 * t, 24 * np.cos(t), np.where(np.sin(t) > 0, 10, 13) * np.sin(t)], axis=1)
        return np.zeros((0, 2)), tibia, patella
    round_ = np.stack([np.cos(t), np.sin(t)], axis=1)
    if view is SAGITTAL:
        arc = np.radians(np.linspace(150, 385, 60))
        femur = [*(34 * np.stack([np.cos(arc), np.sin(arc)], axis=1)), (17, 60), (14, 120), (-14, 120), (-14, 60)]
        tibia = [(-36, 30), (-37, -28), (-52, -24), (-72, -11), (-115, -9), (-115, 12), (-72, 15), (-56, 30)]
        outline = np.array([(x, 0, z) for x, z in tibia], dtype=float)
        patella = np.stack([27 * round_[:, 0], 0 * t, np.where(round_[:, 1] > 0, 10, 8) * round_[:, 1]], axis=1)
        return np.array(femur), outline, patella
    femur = [(-38, -10), (-34, -28), (-14, -32), (0, -24), (14, -32), (34, -28), (38, -10), (32, 22), (15, 55)]
    tibia = [(-38, 37), (-38, -37), (-54, -33), (-74, -15), (-115, -11), (-115, 11), (-74, 15), (-54, 33)]
    outline = np.array([(x, y, 0) for x, y in tibia], dtype=float)
    pointed = 1 - 0.25 * np.clip(-round_[:, 0], 0, None)
    patella = np.stack([27 * round_[:, 0], 23 * round_[:, 1] * pointed, 0 * t], axis=1)
    return np.array([*femur, (13, 120), (-13, 120), (-15, 55), (-32, 22)]), outline, patella


def _turned(points: Points, quaternion: Any) -> Points:
    turn = quaternion.rotation()
    columns = np.array([[float(c) for c in (e.x, e.y, e.z)] for e in (turn.ex, turn.ey, turn.ez)])
    return points @ columns


def _triad(axes: Axes, view: Points, origin: Points, quaternion: Any, letter: str, length: float) -> None:
    """Axes of a frame; one that points at the reader is a dot in a circle."""
    start = view @ origin
    for name, axis, colour in zip("xyz", np.eye(3), (BLUE, RED, GREEN), strict=True):
        tip = view @ _turned(axis[None, :], quaternion)[0]
        if np.hypot(*tip) < 0.6:
            axes.add_patch(Circle(tuple(start), 3.6, facecolor="white", edgecolor=colour, linewidth=1.4, zorder=6))
            axes.plot(*start, ".", color=colour, zorder=7, markersize=5)
            axes.text(start[0] - 5, start[1] - 5, name, color=colour, ha="right", va="top", zorder=8)
        else:
            _arrow(axes, start, start + length * tip, colour)
            axes.text(*(start + (length + 7) * tip), name, color=colour, ha="center", va="center", zorder=8)
    axes.text(start[0] - 5, start[1] + 4, letter, weight="bold", ha="right", va="bottom", zorder=8)


def _sweep(axes: Axes, view: Points, start: Points, turns: list[Any]) -> None:
    path = np.array([view @ _turned(start[None, :], q)[0] for q in turns])
    axes.plot(*path[:-1].T, color=RED, linewidth=1.6)
    _arrow(axes, path[-2], path[-1] + 0.4 * (path[-1] - path[-2]), RED)


def _compass(axes: Axes, view: Points, words: str) -> None:
    names = {(0, 0): "anterior", (0, 1): "medial"}
    right = names[0, int(view is not SAGITTAL)]
    left = {"anterior": "posterior", "medial": "lateral"}[right]
    up, down = ("anterior", "posterior") if view is AXIAL else ("proximal", "distal")
    for x, y, text, turn in (
        (0.5, 0.99, up, 0),
        (0.5, 0.085, down, 0),
        (0.99, 0.55, right, 90),
        (0.01, 0.55, left, 90),
    ):
        axes.text(x, y, text, transform=axes.transAxes, ha="center", va="center", color="0.5", size=8, rotation=turn)
    axes.text(0.5, 0.0, words, transform=axes.transAxes, ha="center", va="bottom", size=9.5)


def _outline(axes: Axes, points: Points, colour: str) -> None:
    axes.add_patch(Polygon(points, closed=True, facecolor=colour, edgecolor="0.35", linewidth=1.0, alpha=0.85))


def _arrow(axes: Axes, start: Any, end: Any, colour: str) -> None:
    style = {"arrowstyle": "-|>", "mutation_scale": 12, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.add_patch(FancyArrowPatch(tuple(start), tuple(end), color=colour, zorder=5, **style))


def _paper(axes: Axes, title: str, across: tuple[float, float], up: tuple[float, float]) -> None:
    axes.set_title(title, loc="center")
    axes.set(xlim=across, ylim=up, aspect="equal")
    axes.axis("off")


if __name__ == "__main__":
    main()
