"""Selects the measured channels of a scene that a fit compares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fitting.programs import ORIENTATION, POSITION
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

_SAME_TIME = 0.1  # share of a frame's interval, for times rounded in a file
_FORCE_KEYS = ("force", "tension")  # observables that a channel with an effect's name already stands for


def force_fields(scene: Scene, springs: Mapping[str, str]) -> dict[str, str]:
    """Field of `Measured` for each channel of a scene whose force is stored in such a field."""
    names = {e.name for e in scene.effects}
    own = {} if scene.contact is None else {scene.contact.name: "contact_force"}
    return own | {springs[s]: f"{s}_spring_force" for s in ("femoral", "tibial") if springs.get(s) in names}


def measured_channels(
    scene: Scene, measured: Measured, springs: Mapping[str, str]
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Measured channels of a scene, (n, columns) each, and the names of all channels that could be measured. Raises
    InputError for a reading that no effect reports, or that repeats a force already measured."""
    available: dict[str, Any] = {POSITION: measured.center, ORIENTATION: measured.quaternion}
    available |= {channel: getattr(measured, name) for channel, name in force_fields(scene, springs).items()}
    for name, values in measured.readings.items():
        reading = scene.reported(name)
        if reading.key in _FORCE_KEYS and available.get(reading.effect) is not None:
            found, expected = f"{name} and the force of {reading.effect}", "one of them: they are the same"
            raise InputError(found, where=measured.source, expected=expected)
        available[name] = values
    data = {
        c: np.asarray(v, dtype=float).reshape(len(measured.times), -1) for c, v in available.items() if v is not None
    }
    return {c: v for c, v in data.items() if np.isfinite(v).all(axis=1).any()}, tuple(available)


def chosen_channels(
    scene: Scene, measured: Measured, kind: str, use: str | Sequence[str], springs: Mapping[str, str]
) -> dict[str, Floats]:
    """The measured channels to compare, (n, columns) each. Raises InputError if one was not measured, or if there are
    none."""
    data, available = measured_channels(scene, measured, springs)
    wanted = tuple(data) if use == "all" else (use,) if isinstance(use, str) else tuple(use)
    if kind == "paper" and wanted != (POSITION,):
        expected = "position alone: the paper's objective has no other"
        raise InputError(f"found {', '.join(wanted)}", where="use", expected=expected)
    if missing := [c for c in wanted if c not in data]:
        raise InputError(
            f"no {missing[0]!r} was measured" if missing[0] in available else f"no channel {missing[0]!r}",
            where=measured.source,
            expected=f"one of: {', '.join(data)}" if data else "at least one measured frame",
        )
    if not wanted:
        problem = f"no measured variable for the objective {kind!r}"
        raise InputError(problem, where=measured.source, expected="positions or forces")
    return {c: data[c] for c in data if c in wanted}


def check_times(scene: Scene, measured: Measured) -> None:
    """Raises InputError unless the measurements have the number of frames, rate and start time of the scene."""
    ours, theirs, interval = scene.motion.times, measured.times, scene.motion.frame_interval
    if theirs.size != ours.size:
        rate = (theirs.size - 1) / (theirs[-1] - theirs[0]) if theirs.size > 1 else 0.0
        expected = f"the scene's {ours.size} frames at {1 / interval:.4g} Hz"
        remedy = "the measurements of the scene's motion, resampled at its frames"
        found = f"{theirs.size} frames at {rate:.4g} Hz"
        raise InputError(found, where=measured.source, expected=expected, remedy=remedy)
    if (bad := np.flatnonzero(np.abs(theirs - ours) > _SAME_TIME * interval)).size:
        i = int(bad[0])
        found = f"frame {i + 1} was measured at {theirs[i]:.6g} s"
        expected = f"{ours[i]:.6g} s as in the scene's motion"
        remedy = "measurements with the clock and rate of the scene's motion"
        raise InputError(found, where=measured.source, expected=expected, remedy=remedy)
