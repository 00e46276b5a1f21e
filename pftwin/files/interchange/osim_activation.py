"""Muscles of an OpenSim model that pull at the patella as their activation says: tensions over a motion."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import refuse_repeated
from pftwin.files.interchange.osim_activation_file import activations
from pftwin.files.interchange.osim_document import Element, Frames
from pftwin.files.interchange.osim_knee import OsimKnee
from pftwin.files.interchange.osim_model import OsimModel, class_defaults
from pftwin.files.interchange.osim_motion import Motion
from pftwin.files.interchange.osim_muscle_force import MUSCLES, MuscleForce, read_force
from pftwin.files.interchange.osim_muscle_path import MovingBodies, PathOverMotion, path_over_motion
from pftwin.files.interchange.osim_muscle_wraps import wraps_of
from pftwin.files.interchange.osim_muscles import BODIES, PatellarMuscle
from pftwin.files.interchange.osim_wraps import Wraps
from pftwin.files.mocap.jumps import in_words, jumps
from pftwin.files.mocap.poses import PoseSeries

FILE = "tensions.csv"
_WHERE = "activation"
_STILL = 1e-6  # what moves by less stays where it is [m]
_BENT, _STAYED = np.radians(5.0), 1e-3  # a knee that bends, and a patella that does not move with it [m]


class Activated(NamedTuple):
    """Muscles, and what is written of them."""

    muscles: list[PatellarMuscle]  # with their ends in the first frame
    tensions: Floats  # (n, muscles) [N]
    origins: Floats  # (n, muscles, 3) in their bodies' frames [m]
    notes: list[str]

    @property
    def moving(self) -> set[str]:
        """Bodies on which the origin of a muscle moves."""
        moved = np.ptp(self.origins, axis=0).max(axis=-1) > _STILL
        return {m.body for m, own in zip(self.muscles, moved, strict=True) if own}

    def table(self, times: Floats) -> str:
        """The file of tensions, with the origins of muscles on bodies where they move."""
        names, columns = ["time_s"], [times]
        for k, muscle in enumerate(self.muscles):
            names.append(f"{muscle.line}_tension_N")
            columns.append(self.tensions[:, k])
            if muscle.body in self.moving:
                names += [f"{muscle.line}_origin_{axis}_m" for axis in "xyz"]
                columns += list(self.origins[:, k].T)
        lines = [",".join(f"{v:.12g}" for v in row) for row in np.column_stack(columns)]
        return "\n".join([",".join(names), *lines]) + "\n"


def activated(
    root: Element,
    model: OsimModel,
    knee: OsimKnee,
    motion: Motion,
    muscles: Sequence[PatellarMuscle],
    given: float | str | os.PathLike[str],
    objects: Wraps,
) -> Activated:
    """The tensions of muscles that end on the patella, by their activations.

    Args:
        root: the model's element.
        model: as it was read from it.
        knee: its bodies.
        motion: of the knee.
        muscles: those that end on the patella.
        given: their activations, as `activations` takes them.
        objects: that paths may wrap over.

    Raises:
        InputError: no such activation or file; no muscle that could have a tension; numbers that no muscle has.
    """
    frames, bodies = Frames(root), MovingBodies(model, knee, motion)
    notes: list[str] = []
    found = []
    for muscle, element in _elements(root, muscles):
        if _usable(element, notes):
            wraps, left = wraps_of(element, objects)
            path = path_over_motion(element, frames, bodies, wraps)
            found += [] if path is None else [_Pulling(muscle, element, path, left)]
    if not found:
        expected = f"one of {', '.join(MUSCLES)}, of whose path one piece ends on the patella"
        raise InputError("no muscle of the patella can have a tension", where=_WHERE, expected=expected)
    refuse_repeated([p.muscle.line for p in found], "muscles", where=_WHERE)
    forces = [read_force(p.element, class_defaults(root)) for p in found]
    said, values = activations(given, [p.muscle.name for p in found], motion.times)
    out = _out_of_line(motion, knee)
    lengths = [_mended(p.path.lengths, motion.times, out) for p in found]
    pulls = np.stack([f.tensions(x, a) for f, x, a in zip(forces, lengths, values.T, strict=True)], axis=1)
    ends = [p.ends() for p in found]
    notes = [*_described(said, pulls, ends), _lengths_said(motion, knee, out), *notes]
    notes += _remarks(found, forces, values)
    return Activated(ends, pulls, np.stack([p.path.origin for p in found], axis=1), notes)


class _Pulling(NamedTuple):
    """A muscle that can have a tension."""

    muscle: PatellarMuscle
    element: Element
    path: PathOverMotion
    straight: list[str]  # objects that its path wraps over in the model, and not here

    def ends(self) -> PatellarMuscle:
        """The muscle with its ends in the first frame."""
        path = self.path
        return self.muscle._replace(body=path.body, insertion=path.insertion, origin=path.origin[0])


def _elements(root: Element, muscles: Sequence[PatellarMuscle]) -> Iterator[tuple[PatellarMuscle, Element]]:
    held = [group.child("objects") for group in root.children if group.tag == "ForceSet"]
    known = {(f.tag, f.name): f for forces in held if forces is not None for f in forces.children}
    yield from ((m, known[m.kind, m.name]) for m in muscles)


def _usable(muscle: Element, notes: list[str]) -> bool:
    if muscle.tag not in MUSCLES:
        notes.append(f"{muscle.name}: no tension, for none follows from the activation of a <{muscle.tag}>")
    elif muscle.words("appliesForce") == "false":
        notes.append(f"{muscle.name}: no tension, it is switched off in the model")
    else:
        return True
    return False


def _patella(motion: Motion, knee: OsimKnee) -> PoseSeries:
    femur, patella = (PoseSeries(motion.times, *motion.poses[b]) for b in (knee.femur, knee.patella))
    return patella.relative_to(femur)


def _out_of_line(motion: Motion, knee: OsimKnee) -> np.ndarray:
    """Frames (n,) in which a measured patella is out of line, so that no length can be taken."""
    return jumps(_patella(motion, knee)) if motion.measured else np.zeros(motion.times.size, bool)


def _mended(lengths: Floats, times: Floats, out: np.ndarray) -> Floats:
    """Lengths, in frames that are out of line as between the frames around them."""
    return np.interp(times, times[~out], lengths[~out])


def _described(said: str, pulls: Floats, muscles: Sequence[PatellarMuscle]) -> Iterator[str]:
    whole = pulls.sum(axis=1)
    yield (
        f"tensions by activations {said}, at rest (fibre and tendon in equilibrium in every frame, no force-velocity),"
        f" in {FILE}: together {whole[0]:.3g} N in the first frame, {whole.min():.3g} to {whole.max():.3g} N over the"
        " motion"
    )
    each = (f"{m.name} {p[0]:.3g} N ({p.min():.3g} to {p.max():.3g})" for m, p in zip(muscles, pulls.T, strict=True))
    yield f"tension in the first frame, and its range: {', '.join(each)}"


def _lengths_said(motion: Motion, knee: OsimKnee, out: np.ndarray) -> str:
    """At which poses of the patella the lengths were taken."""
    text = "lengths of muscles: with the patella " + (
        "as it was measured" if motion.measured else "where the model has it"
    )
    if out.any():
        text += f", in {in_words(out)}, where that is out of line, as between the frames around"
    places = _patella(motion, knee).positions
    turns = PoseSeries(motion.times, *motion.poses[knee.tibia]).relative_to(
        PoseSeries(motion.times, *motion.poses[knee.femur])
    )
    bent = np.abs(turns.quaternions @ turns.quaternions[0]).min()
    if 2 * np.arccos(min(bent, 1.0)) > _BENT and np.ptp(places, axis=0).max() < _STAYED:
        text += (
            "; IT DOES NOT MOVE in the femur while the knee bends, so lengths and tensions are those of one place:"
            " give a --motion that moves the patella too"
        )
    return text


def _remarks(found: Sequence[_Pulling], forces: Sequence[MuscleForce], values: Floats) -> Iterator[str]:
    if elsewhere := [p.muscle for p in found if p.muscle.body not in BODIES]:
        which = ", ".join(f"{m.name} from the {m.body}" for m in elsewhere)
        yield (
            f"{which}: the line begins where the model's joints put that point in the femur's frame, at the motion's"
            " coordinates, or their defaults"
        )
    for p in found:
        if p.straight:
            yield f"{p.muscle.name}: left out of its length is wrapping over {', '.join(p.straight)}"
    if wrapped := [p.muscle.name for p in found if not p.straight and list(p.element.all("PathWrap"))]:
        yield f"wrapping is in the lengths of {', '.join(wrapped)}"
    raised = [f for f, a in zip(forces, values.T, strict=True) if a.min() < f.least_activation]
    if raised:
        which = ", ".join(f"{f.name} {f.least_activation:g}" for f in raised)
        yield f"activations below the model's minimum_activation count as that: {which}"
