"""Ligaments and muscles of an OpenSim model that insert on the patella, each with its wrapping obstacle.

A total tension can be distributed over the muscles.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import refuse_repeated
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_knee import OsimKnee
from pftwin.files.interchange.osim_model import LIGAMENT, LeftOut, OsimLigament, path_wraps, valid_name
from pftwin.files.interchange.osim_motion import Motion
from pftwin.files.interchange.osim_wraps import OsimWrap, Wraps

if TYPE_CHECKING:
    from pftwin.files.interchange.osim_activation import Activated
    from pftwin.files.interchange.osim_scene import Imported

BODIES = ("femur", "tibia", "ground")
POINTS = ("PathPoint", "ConditionalPathPoint", "MovingPathPoint")
_STRENGTH = "max_isometric_force"
_LEAST = 1e-6  # shorter lines have no direction [m]


class OsimStrand(NamedTuple):
    """A ligament's line, with its ends in the frames of the patella and of the other bone [m]."""

    ligament: OsimLigament
    insertion: Floats
    body: str  # the other bone
    origin: Floats

    @property
    def name(self) -> str:
        """Name of the ligament, without the strand's number."""
        return self.ligament.name.rstrip("0123456789") or self.ligament.name


class PatellarMuscle(NamedTuple):
    """The last segment of a muscle's path, which ends on the patella."""

    element: Element
    insertion: Floats  # on the patella, in its frame [m]
    origin: Floats  # the point before, in its body's frame [m]
    body: str  # part of the knee with that point, or the model's name of another body
    strength: float | None  # maximum isometric force [N]
    single_segment: bool = True  # whether it is the muscle's only segment at the patella, with two fixed end points
    wraps: tuple[str, ...] = ()  # names of the objects over which the segment may wrap
    coincident: bool = False  # whether the segment's ends coincide at the model's default coordinates

    @property
    def name(self) -> str:
        """Name in the model."""
        return self.element.name

    @property
    def line(self) -> str:
        """Name in a scene."""
        return valid_name(self.name)

    @property
    def takes_tension(self) -> bool:
        """Whether a scene can include it with a share of a total tension."""
        usable = self.single_segment and not self.coincident and self.body in BODIES
        return usable and self.strength is not None and self.strength > 0

    def describe(self) -> str:
        """Why it was left out, and its two ends, so that users can add it to the scene."""
        insertion, origin = (f"[{', '.join(f'{v:.6g}' for v in place)}]" for place in (self.insertion, self.origin))
        ends = f"insertion_m = {insertion}, origin_m = {origin} on the {self.body}"
        if self.body not in BODIES:
            return f"it comes from the {self.body}, which a scene does not have; {ends}"
        if not self.single_segment:
            return f"its points move, or it passes over the patella: only one line can be taken; {ends}"
        if self.coincident:
            return f"its line has no length where the model has the patella; {ends}"
        return f"its activation says how strongly it pulls: give a tension in [[prescribed_tension]]; {ends}"


def muscle_lines(
    knee: OsimKnee,
    moved: Motion | None,
    imported: Imported,
    quadriceps: float | None,
    activation: float | str | os.PathLike[str] | None,
    wraps: Wraps,
) -> tuple[list[tuple[PatellarMuscle, OsimWrap | None]], Activated | None]:
    """Muscles of the patella with their obstacles, and their tensions: shares of a total, or from activations."""
    muscles = imported.muscles = list(_muscles(knee))
    pulled = None
    if quadriceps is not None:
        imported.tensions = shared_tensions(muscles, quadriceps)
        each = ", ".join(f"{name} {newtons:.3g} N" for name, newtons in imported.tensions.items())
        imported.notes.append(f"tensions, constant, by maximum isometric force: {each}")
    elif activation is not None and moved is not None:
        from pftwin.files.interchange.osim_activation import activated

        pulled = activated(knee, moved, muscles, activation, wraps)
        imported.tensions = {m.name: float(t) for m, t in zip(pulled.muscles, pulled.tensions[0], strict=True)}
        imported.notes += pulled.notes
    if imported.tensions and (without := [m.name for m in muscles if m.name not in imported.tensions]):
        imported.notes.append(f"without a tension: {', '.join(without)}")
    found = []
    for muscle in [m for m in muscles if m.name in imported.tensions] if pulled is None else pulled.muscles:
        over, left = wraps.over(muscle.wraps)
        imported.notes += _straight({(muscle.name, tuple(left)): [muscle.name]})
        found.append((muscle, over))
    return found, pulled


def _muscles(knee: OsimKnee) -> Iterator[PatellarMuscle]:
    """The model's forces, except ligaments, that have a path from another body to the patella."""
    forces = (force for group in knee.model.root.children if group.tag == "ForceSet" for force in group.objects())
    for force in forces:
        points = [] if "Ligament" in force.tag else list(force.all(*POINTS))
        # A moving point has functions instead of a location.
        places = (p.numbers_of("location", (np.nan,) * 3) for p in points)
        at = [knee.point(knee.model.frames.of(p), place) for p, place in zip(points, places, strict=True)]
        pairs = [(i, j) for i in range(len(at)) for j in (i - 1, i + 1) if at[i][0] == "patella" and 0 <= j < len(at)]
        pairs = [(i, j) for i, j in pairs if at[j][0] != "patella"]
        if not pairs:
            continue
        i, j = pairs[0]
        strength = force.child(_STRENGTH)
        newtons = None if strength is None else float(strength.numbers(1)[0])
        single_segment = len(pairs) == 1 and points[i].tag == points[j].tag == POINTS[0]
        wraps = tuple(w.name for w in path_wraps(force) if w.covers(min(i, j), max(i, j)))
        coincident = single_segment and at[j][0] in BODIES and _distance(knee, at[i], at[j]) < _LEAST
        yield PatellarMuscle(force, at[i][1], at[j][1], at[j][0], newtons, single_segment, wraps, coincident)


def _distance(knee: OsimKnee, *points: tuple[str, Floats]) -> float:
    """Distance of two points, each in a part's frame, at the model's default coordinates [m]."""
    tree = knee.model.tree
    poses = (tree.pose(knee.name(part), tree.values({}, 1), 1)[0] for part, _ in points)
    start, end = (pose[:3, :3] @ own + pose[:3, 3] for pose, (_, own) in zip(poses, points, strict=True))
    return float(np.linalg.norm(end - start))


def shared_tensions(muscles: Sequence[PatellarMuscle], total: float) -> dict[str, float]:
    """Distributes a total tension [N] over muscles in proportion to their maximum isometric forces; by name [N].

    Raises InputError for an invalid total, no suitable muscle, and two muscles with the same name.
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


def ligament_lines(knee: OsimKnee, wraps: Wraps, imported: Imported) -> list[tuple[OsimStrand, OsimWrap | None]]:
    """Ligaments of the patella with their obstacles; others are added to what is left out."""
    found = []
    straight: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for ligament in knee.model.ligaments:
        places = [knee.point(*end) for end in ligament.ends]
        parts = [part for part, _ in places]
        if parts.count("patella") != 1 or not {*parts} - {"patella"} <= {"femur", "tibia", "ground"}:
            why = "pftwin knows femur, tibia and ground beside the patella"
            why = f": {why}" if "patella" in parts else ", whose motion is prescribed"
            imported.left_out.append(LeftOut(LIGAMENT, ligament.name, f"it joins {' and '.join(parts)}{why}"))
            continue
        k = parts.index("patella")
        over, left = wraps.over(ligament.wraps)
        strand = OsimStrand(ligament, places[k][1], *places[1 - k])
        straight.setdefault((strand.name, tuple(left)), []).append(ligament.name)
        found.append((strand, over))
    imported.notes += _straight(straight)
    return found


def _straight(lines: dict[tuple[str, tuple[str, ...]], list[str]]) -> Iterator[str]:
    """Notes on lines that do not wrap over some of their objects, grouped by name and objects."""
    for (_, objects), names in lines.items():
        if objects:
            which = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]} ({len(names)} strands)"
            yield f"{which}: not wrapped over {', '.join(objects)}"
