"""Muscles that end on the patella: where they pull, and a tension for each from one for all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import refuse_repeated
from pftwin.files.interchange.osim_document import Element, Frames
from pftwin.files.interchange.osim_knee import OsimKnee, part_and_pose
from pftwin.files.interchange.osim_model import OsimModel, path_wraps, plain_name

BODIES = ("femur", "tibia", "ground")
_STRENGTH = "max_isometric_force"
POINTS = ("PathPoint", "ConditionalPathPoint", "MovingPathPoint")


class PatellarMuscle(NamedTuple):
    """The piece of a muscle's path that ends on the patella, from the point before."""

    kind: str
    name: str
    insertion: Floats  # on the patella, in its frame [m]
    origin: Floats  # the point before, in its body's frame [m]
    body: str  # part of the knee that has that point, or the model's name for another body
    strength: float | None  # its maximum isometric force [N]
    plain: bool = True  # whether it is all of the muscle at the patella, between two points that stay where they are
    wraps: tuple[str, ...] = ()  # names of the objects over which that piece may wrap

    @property
    def line(self) -> str:
        """Its name in a scene."""
        return plain_name(self.name)

    @property
    def takes_tension(self) -> bool:
        """Whether a scene can have it with a tension that is shared out."""
        return self.plain and self.body in BODIES and self.strength is not None and self.strength > 0

    def describe(self) -> str:
        """Why it was left out, and its two ends, for whoever adds it to the scene."""
        ends = f"insertion_m = {_point(self.insertion)}, origin_m = {_point(self.origin)} on the {self.body}"
        if self.body not in BODIES:
            return f"it comes from the {self.body}, which a scene does not have; {ends}"
        if not self.plain:
            return f"its points move, or it passes over the patella: only one line can be taken; {ends}"
        return f"its activation says how strongly it pulls: give a tension in [[prescribed_tension]]; {ends}"


def muscles_of(root: Element, model: OsimModel, knee: OsimKnee) -> Iterator[PatellarMuscle]:
    """Those of a document's forces that end on the patella, ligaments apart."""
    frames = Frames(root)
    for group in root.children:
        held = group.child("objects") if group.tag == "ForceSet" else None
        for force in [] if held is None else held.children:
            muscle = None if "Ligament" in force.tag else _at_patella(force, model, knee, frames)
            if muscle is not None:
                yield muscle


def _at_patella(force: Element, model: OsimModel, knee: OsimKnee, frames: Frames) -> PatellarMuscle | None:
    """Of a force with a path from elsewhere to the patella; None of any other."""
    at = []
    for p in force.all(*POINTS):
        frame = frames.find(p.needed("socket_parent_frame").text, p, p.where)
        part, pose = part_and_pose(model, knee, frame)
        place = p.numbers_of("location", (np.nan,) * 3)  # one that moves has functions in its place
        at.append((part, pose[:3, :3] @ place + pose[:3, 3], p.tag == POINTS[0]))
    pairs = [(i, j) for i in range(len(at)) for j in (i - 1, i + 1) if at[i][0] == "patella" and 0 <= j < len(at)]
    pairs = [(i, j) for i, j in pairs if at[j][0] != "patella"]
    if not pairs:
        return None
    i, j = pairs[0]
    strength = force.child(_STRENGTH)
    newtons = None if strength is None else float(strength.numbers(1)[0])
    plain = len(pairs) == 1 and at[i][2] and at[j][2]
    wraps = tuple(w.name for w in path_wraps(force) if w.covers(min(i, j), max(i, j)))
    return PatellarMuscle(force.tag, force.name, at[i][1], at[j][1], at[j][0], newtons, plain, wraps)


def shared_tensions(muscles: Sequence[PatellarMuscle], total: float) -> dict[str, float]:
    """A tension for each muscle by name [N]: of all together, by their maximum isometric forces.

    Raises:
        InputError: a total that is no tension; no muscle that could have one; two of one name.
    """
    if not (np.isfinite(total) and total > 0):
        raise InputError(f"found {total!r}", where="quadriceps", expected="a tension, a positive number of newtons")
    refuse_repeated([m.line for m in muscles], "muscles", where="quadriceps")
    taken = [m for m in muscles if m.takes_tension]
    if not taken:
        expected = f"one whose path comes to it from the {', '.join(BODIES)}, with {_STRENGTH}"
        raise InputError("no muscle of the patella can have a tension", where="quadriceps", expected=expected)
    whole = sum(m.strength or 0.0 for m in taken)
    return {m.name: total * (m.strength or 0.0) / whole for m in taken}


def _point(values: Floats) -> str:
    return "[" + ", ".join(f"{v:.6g}" for v in values) + "]"
