"""Ligaments of an OpenSim model: strands between two points; what a file does not say is filled in as OpenSim does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_frames import Frames, OsimFrame

Floats = NDArray[np.float64]
LIGAMENT = "Blankevoort1991Ligament"
# What a file leaves out has these values: the classes' own defaults in OpenSim.
_DEFAULTS = {
    LIGAMENT: {"transition_strain": 0.06, "damping_coefficient": 0.003, "linear_stiffness": 1.0, "slack_length": 0.0},
    "Smith2018ContactMesh": {"elastic_modulus": 1e6, "poissons_ratio": 0.5, "thickness": 0.005},
}


class LeftOut(NamedTuple):
    """Something that was not imported."""

    kind: str
    name: str
    why: str


class OsimLigament(NamedTuple):
    """A strand between two points."""

    name: str
    ends: tuple[tuple[OsimFrame, Floats], tuple[OsimFrame, Floats]]
    stiffness: float  # [N per strain]
    slack_length: float  # [m]
    toe_strain: float
    damping_time: float  # [s]
    wraps: tuple[str, ...]  # names of the objects that its path wraps over
    where: str


def ligaments(
    model: Element, defaults: dict[str, Element], frames: Frames, left: list[LeftOut]
) -> Iterator[OsimLigament]:
    """Those that are straight lines; the others are added to what is left out.

    Raises:
        InputError: numbers that cannot be a ligament's.
    """
    for element in model.all(LIGAMENT):
        if element.words("appliesForce") == "false":
            left.append(LeftOut(LIGAMENT, element.name, "it is switched off in the model"))
            continue
        points = list(element.all("PathPoint", "ConditionalPathPoint", "MovingPathPoint"))
        if len(points) != 2 or any(p.tag != "PathPoint" for p in points):
            why = f"its path has {len(points)} points, some of them may move: only straight lines between two are taken"
            left.append(LeftOut(LIGAMENT, element.name, why))
            continue
        ends = [
            (frames.find(p.needed("socket_parent_frame").text, p, p.where), p.needed("location").numbers(3))
            for p in points
        ]
        wraps = tuple(w.words("wrap_object") for w in element.all("PathWrap"))
        k, slack, toe, damping = (
            value(element, tag, defaults)
            for tag in ("linear_stiffness", "slack_length", "transition_strain", "damping_coefficient")
        )
        if not (k > 0 and slack > 0 and toe > 0 and damping >= 0):
            raise InputError(
                f"stiffness {k:g} N, slack length {slack:g} m, transition strain {toe:g}, damping {damping:g} s",
                where=element.where,
                expected="positive numbers",
            )
        yield OsimLigament(element.name, (ends[0], ends[1]), k, slack, toe, damping, wraps, element.where)


def value(element: Element, tag: str, defaults: dict[str, Element]) -> float:
    """As the element has it, else the model's defaults for its class, else the class's own."""
    for holder in (element, defaults.get(element.tag)):
        found = None if holder is None else holder.child(tag)
        if found is not None:
            return float(found.numbers(1)[0])
    return _DEFAULTS[element.tag][tag]
