"""Muscles that end on the patella: where they pull, and a tension for each from one for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element, Frames
from pftwin.files.interchange.osim_knee import OsimKnee, part_and_pose
from pftwin.files.interchange.osim_model import OsimModel, plain_name

Floats = NDArray[np.float64]

TENSIONS = "tensions.csv"
_BODIES = ("femur", "tibia", "ground")
_STRENGTH = "max_isometric_force"


class PatellarMuscle(NamedTuple):
    """The last straight piece of a muscle's path before the patella."""

    kind: str
    name: str
    insertion: Floats  # on the patella, in its frame [m]
    origin: Floats  # the point before, in its body's frame [m]
    body: str  # part of the knee that has that point, or the model's name for another body
    strength: float | None  # its maximum isometric force [N]

    @property
    def line(self) -> str:
        """Its name in a scene."""
        return plain_name(self.name)

    @property
    def takes_tension(self) -> bool:
        """Whether a scene can have it with a tension that is prescribed."""
        return self.body in _BODIES and self.strength is not None and self.strength > 0

    def describe(self) -> str:
        """Why it was left out, and its two ends, for whoever adds it to the scene."""
        ends = f"insertion_m = {_point(self.insertion)}, origin_m = {_point(self.origin)} on the {self.body}"
        return f"its activation says how strongly it pulls: give a tension in [[prescribed_tension]]; {ends}"


def muscle_at_patella(force: Element, model: OsimModel, knee: OsimKnee, frames: Frames) -> PatellarMuscle | None:
    """Of a force with a path from elsewhere to the patella; None of any other."""
    at = []
    for p in [] if force.tag == "Ligament" else force.all("PathPoint"):
        frame = frames.find(p.needed("socket_parent_frame").text, p, p.where)
        part, pose = part_and_pose(model, knee, frame)
        at.append((part, pose[:3, :3] @ p.needed("location").numbers(3) + pose[:3, 3]))
    parts = [part for part, _ in at]
    if "patella" not in parts:
        return None
    k = parts.index("patella")
    other = next((j for j in (k - 1, k + 1) if 0 <= j < len(at) and parts[j] != "patella"), None)
    if other is None:
        return None
    strength = force.child(_STRENGTH)
    newtons = None if strength is None else float(strength.numbers(1)[0])
    return PatellarMuscle(force.tag, force.name, at[k][1], at[other][1], parts[other], newtons)


def shared_tensions(muscles: Sequence[PatellarMuscle], total: float) -> dict[str, float]:
    """A tension for each muscle by name [N]: of all together, by their maximum isometric forces.

    Raises:
        InputError: a total that is no tension; no muscle that could have one.
    """
    if not (np.isfinite(total) and total > 0):
        raise InputError(f"found {total!r}", where="quadriceps", expected="a tension, a positive number of newtons")
    taken = [m for m in muscles if m.takes_tension]
    if not taken:
        expected = f"one whose path comes to it from the {', '.join(_BODIES)}, with {_STRENGTH}"
        raise InputError("no muscle of the patella can have a tension", where="quadriceps", expected=expected)
    whole = sum(m.strength or 0.0 for m in taken)
    return {m.name: total * (m.strength or 0.0) / whole for m in taken}


def tensions_csv(times: Floats, tensions: dict[str, float]) -> str:
    """time_s and LINE_tension_N, the same from the first frame to the last."""
    head = ",".join(["time_s", *(f"{plain_name(name)}_tension_N" for name in tensions)])
    row = ",".join(f"{newtons:.12g}" for newtons in tensions.values())
    return "\n".join([head, *(f"{t:.12g},{row}" for t in (times[0], times[-1]))]) + "\n"


def _point(values: Floats) -> str:
    return "[" + ", ".join(f"{v:.6g}" for v in values) + "]"
