"""Tensions over a motion, from activations, of an OpenSim model's muscles that insert on the patella.

Activations are one number for all muscles, or a file with a time course for each.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import refuse_repeated
from pftwin.files.interchange.osim_knee import OsimKnee
from pftwin.files.interchange.osim_lines import BODIES, PatellarMuscle
from pftwin.files.interchange.osim_model import class_defaults
from pftwin.files.interchange.osim_motion import Motion
from pftwin.files.interchange.osim_muscle_force import MUSCLES, MuscleForce, read_force
from pftwin.files.interchange.osim_muscle_path import MovingBodies, PathOverMotion, path_over_motion
from pftwin.files.interchange.osim_toml import csv_text
from pftwin.files.interchange.osim_wraps import Wraps, wraps_of
from pftwin.files.mocap.bones import in_words, jumps
from pftwin.files.mocap.csv_files import read_csv
from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.mocap.sto import read_sto

FILE = "tensions.csv"
_WHERE = "activation"
_ROUNDED = 1e-6  # tolerance on the range of activations, for the rounding of optimisers
_STILL = 1e-6  # smaller motions do not count [m]
_BENT, _STAYED = np.radians(5.0), 1e-3  # [rad] flexion of a bending knee, [m] motion of a fixed patella


class Activated(NamedTuple):
    """Muscles with their tensions and origins."""

    muscles: list[PatellarMuscle]  # with the end points of the first frame
    tensions: Floats  # (n, muscles) [N]
    origins: Floats  # (n, muscles, 3) in their bodies' frames [m]
    notes: list[str]  # for the user

    @property
    def moving(self) -> set[str]:
        """Bodies relative to which the origin of a muscle moves."""
        moved = np.ptp(self.origins, axis=0).max(axis=-1) > _STILL
        return {m.body for m, own in zip(self.muscles, moved, strict=True) if own}

    def table(self, times: Floats) -> str:
        """CSV text of tensions, and of the origins on the bodies in `moving`."""
        names, columns = ["time_s"], [times]
        for k, muscle in enumerate(self.muscles):
            names.append(f"{muscle.line}_tension_N")
            columns.append(self.tensions[:, k])
            if muscle.body in self.moving:
                names += [f"{muscle.line}_origin_{axis}_m" for axis in "xyz"]
                columns.append(self.origins[:, k])
        return csv_text(names, columns)


class _Pulling(NamedTuple):
    """A muscle whose tension can be computed."""

    muscle: PatellarMuscle
    path: PathOverMotion
    straight: list[str]  # wrap objects of the model that are not supported here


def activated(
    knee: OsimKnee,
    motion: Motion,
    muscles: Sequence[PatellarMuscle],
    given: float | str | os.PathLike[str],
    objects: Wraps,
) -> Activated:
    """Computes the tensions of muscles that insert on the patella; `given` is as for `_activations`.

    Raises InputError for an invalid activation, file or muscle parameter, and for no muscle with a computable tension.
    """
    bodies = MovingBodies(knee, motion)
    notes: list[str] = []
    found = []
    for muscle in muscles:
        element = muscle.element
        if element.tag not in MUSCLES:
            notes.append(f"{muscle.name}: no tension, for none follows from the activation of a <{element.tag}>")
        elif element.words("appliesForce") == "false":
            notes.append(f"{muscle.name}: no tension, it is switched off in the model")
        else:
            wraps, left = wraps_of(element, objects)
            path = path_over_motion(element, bodies, wraps)
            found += [] if path is None else [_Pulling(muscle, path, left)]
    if not found:
        expected = f"one of {', '.join(MUSCLES)}, of whose path one piece ends on the patella"
        raise InputError("no muscle of the patella can have a tension", where=_WHERE, expected=expected)
    refuse_repeated([p.muscle.line for p in found], "muscles", where=_WHERE)
    forces = [read_force(p.muscle.element, class_defaults(knee.model.root)) for p in found]
    said, values = _activations(given, [p.muscle.name for p in found], motion.times)
    patella, tibia = (motion.poses[body].relative_to(motion.poses[knee.femur]) for body in (knee.patella, knee.tibia))
    # In outlier frames of a measured patella, lengths are interpolated from the frames around.
    out = jumps(patella) if motion.measured else np.zeros(motion.times.size, bool)
    lengths = [np.interp(motion.times, motion.times[~out], p.path.lengths[~out]) for p in found]
    pulls = np.stack([f.tensions(x, a) for f, x, a in zip(forces, lengths, values.T, strict=True)], axis=1)
    ends = [p.muscle._replace(body=p.path.body, insertion=p.path.insertion, origin=p.path.origin[0]) for p in found]
    where = "as it was measured" if motion.measured else "where the model has it"
    text = f"lengths of muscles: with the patella {where}{_lengths_said(patella, tibia, out)}"
    notes = [*_described(said, pulls, ends), text, *notes, *_remarks(found, forces, values)]
    return Activated(ends, pulls, np.stack([p.path.origin for p in found], axis=1), notes)


def _lengths_said(patella: PoseSeries, tibia: PoseSeries, out: np.ndarray) -> str:
    """Remarks on the patella's poses for which the lengths were computed."""
    text = f", in {in_words(out)}, where that is out of line, as between the frames around" if out.any() else ""
    bent = np.abs(tibia.quaternions @ tibia.quaternions[0]).min()
    if 2 * np.arccos(min(bent, 1.0)) > _BENT and np.ptp(patella.positions, axis=0).max() < _STAYED:
        text += (
            "; IT DOES NOT MOVE in the femur while the knee bends, so lengths and tensions are those of one place:"
            " give a --motion that moves the patella too"
        )
    return text


def _described(said: str, pulls: Floats, muscles: Sequence[PatellarMuscle]) -> Iterator[str]:
    whole = pulls.sum(axis=1)
    yield (
        f"tensions by activations {said}, at rest (fibre and tendon in equilibrium in every frame, no force-velocity),"
        f" in {FILE}: together {whole[0]:.3g} N in the first frame, {whole.min():.3g} to {whole.max():.3g} N over the"
        " motion"
    )
    each = (f"{m.name} {p[0]:.3g} N ({p.min():.3g} to {p.max():.3g})" for m, p in zip(muscles, pulls.T, strict=True))
    yield f"tension in the first frame, and its range: {', '.join(each)}"


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
    if wrapped := [p.muscle.name for p in found if not p.straight and next(p.muscle.element.all("PathWrap"), None)]:
        yield f"wrapping is in the lengths of {', '.join(wrapped)}"
    raised = [f for f, a in zip(forces, values.T, strict=True) if a.min() < f.least_activation]
    if raised:
        which = ", ".join(f"{f.name} {f.least_activation:g}" for f in raised)
        yield f"activations below the model's minimum_activation count as that: {which}"


def _activations(given: float | str | os.PathLike[str], names: Sequence[str], times: Floats) -> tuple[str, Floats]:
    """Activations (n, muscles) of named muscles at the times of a motion (n,) [s], and a description of their source.

    `given` is one activation for all muscles, 0 to 1, or a STO, MOT or CSV file of activations over time, with columns
    named by the muscles or their paths ("/forceset/NAME/activation"). Raises InputError for no such file, no column for
    a muscle, times that do not cover the motion, and values outside 0 to 1.
    """
    try:
        number = float(str(given))
    except ValueError:
        return f"from {given}", _recorded(Path(str(given)), names, times)
    if not 0 <= number <= 1:
        raise InputError(
            f"found {number:g}", where="activation", expected="an activation from 0 to 1, or a file of them"
        )
    return f"of {number:g}", np.full((times.size, len(names)), number)


def _recorded(path: Path, names: Sequence[str], times: Floats) -> Floats:
    """Activations at the motion's times, by linear interpolation in a file."""
    table = read_csv(path, units="1") if path.suffix.lower() == ".csv" else read_sto(path, rotational=())
    labels = {n.removesuffix("/activation").removesuffix(".activation").rpartition("/")[2]: n for n in table.names}
    if missing := [name for name in names if name not in labels]:
        expected = f"columns called like the muscles, or such as /forceset/{missing[0]}/activation"
        raise InputError(f"no activation of {', '.join(missing)}", where=table.source, expected=expected)
    slack = 0.5 * float(np.max(np.diff(times))) if times.size > 1 else 0.0
    if table.times[0] > times[0] + slack or table.times[-1] < times[-1] - slack:
        raise InputError(
            f"activations from {table.times[0]:g} s to {table.times[-1]:g} s",
            where=table.source,
            expected=f"for the whole motion, {times[0]:g} s to {times[-1]:g} s",
        )
    found = table.select([labels[name] for name in names]).values
    low, high = -_ROUNDED, 1 + _ROUNDED
    if (bad := np.argwhere(~((found >= low) & (found <= high)))).size:
        row, k = bad[0]
        where = f"{table.source}, row {row + 1}, {names[k]}"
        raise InputError(f"an activation of {found[row, k]:g}", where=where, expected="0 to 1 in every row")
    return np.stack([np.interp(times, table.times, np.clip(values, 0, 1)) for values in found.T], axis=1)
