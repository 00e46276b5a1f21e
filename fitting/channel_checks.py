"""Checks that every measured channel is what it claims to be: before a fit against other readings of it (units, signs,
axes), after a fit by the residual.

Each limit is a pair: from the first value on a doubt is reported before any number of the estimate, and from the second
on the fit is refused. docs/fitting.md states what the rig's own measurements and faults reach.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.evaluation import StepError
from fitting.objective import Objective
from fitting.programs import ORIENTATION, POSITION, unit_of
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.quantities import shown
from pftwin.results.metrics import up_to_scale

Limits = Mapping[str, tuple[float, float]]
Faults = tuple[str, ...]  # what is wrong with a channel if a reading of it is right; none: as given

LIMITS: dict[str, tuple[float, float]] = {
    "reading": (1.5, 2.0),  # how many times closer to the twin a channel is in other units, signs or axes, or swapped
    "position": (0.01, 0.03),  # residual of positions, rms [m]
    "orientation": (0.26, 0.7),  # residual of orientations, rms [rad]
    "force": (0.15, 0.5),  # residual of a force or another reading, rms, as a share of it
    "noise": (30.0, 300.0),  # residual of a channel, rms, in units of its stated noise
    "shift": (0.02, 0.1),  # delay or lead of a channel [s]
    "simulated": (5.0, 15.0),  # distance from the simulations a posterior was learned from, in standard deviations
    "trained_noise": (3.0, 10.0),  # what simulations leave unexplained, in units of the training noise
    "set_up": (1.0, 3.0),  # error of a trained posterior for knees simulated in this set-up, in standard deviations
}
_UNITS: dict[str, dict[float, str]] = {  # factor for a channel, and what is wrong with it if that fits
    "m": {
        1e-3: "1000 times too large: in millimetres",
        1e-2: "100 times too large: in centimetres",
        0.0254: "39 times too large: in inches",
        1e3: "1000 times too small: turned from millimetres to metres twice",
    },
    "N": {
        1e-3: "1000 times too large: newtons written as millinewtons",
        1e3: "1000 times too small: in kilonewtons",
        4.4482216: "4.45 times too small: in pounds-force",
        9.80665: "9.81 times too small: in kilograms-force",
    },
}
_AXES = "xyz"
_SIMPLER = 1.1  # a simpler reading is preferred if it is at most this many times farther away,
_BOTH = 1.5  # and one of its two faults alone if it is less than so many times farther away
_FRAMES = 200  # most frames used to compare readings, spread evenly over the recording
_FLOOR = {POSITION: 1e-3, ORIENTATION: 0.02}  # distance below which all readings count as equally good [m], [rad]
_FORCE_FLOOR = 0.01  # the same for a force, as a share of the twin's
_PRESUMED = "gravity, loads and frame"  # a twin with wrong ones may lie closer to another reading of right data
_SLACK = 0.1  # least force of a trial to compare with, as a share of the strongest trial's or of the measured force


class Reading(NamedTuple):
    """A reading of a channel (unit, sign, axes) that lies closer to the twin than the values as given."""

    channels: tuple[str, ...]
    words: str  # what the channels look like
    times: float  # how many times closer


def limits_of(given: Mapping[str, tuple[float, float]] | None) -> dict[str, tuple[float, float]]:
    """`LIMITS` updated with those given by name. Raises InputError for an unknown name, or a pair that is not positive
    and in order."""
    for name, pair in (given or {}).items():
        if name not in LIMITS:
            raise InputError(f"no limit {name!r}", where="limits", expected=f"one of: {', '.join(LIMITS)}")
        if len(pair) != 2 or not 0 < pair[0] <= pair[1]:
            expected = "two positive numbers: named from, refused from"
            raise InputError(f"{name}: found {pair!r}", where="limits", expected=expected)
    return LIMITS | dict(given or {})


def limit_remedy(name: str, limits: Limits, value: float) -> str:
    """How to raise a limit above a value, for messages: in Python and on the command line."""
    named, refused = limits[name][0], float(f"{2 * value:.2g}")
    return f"limits={{{name!r}: ({named:g}, {refused:g})}} (--limit {name}={named:g}:{refused:g})"


def misread_channels(objective: Objective, trials: Floats, limits: Limits) -> list[str]:
    """Doubts: what channels look like, in words, if another reading lies closer to one of the trial motions (N, n, c).
    Raises InputError if another reading is closer by more than the limit allows."""
    found, (named, refused) = [], limits["reading"]
    for r in merged_readings((r for r in readings(objective, trials) if r.times >= named), objective.readings):
        said = f"{_listed(r.channels)} {r.words}"
        if r.times >= refused:
            raise InputError(
                f"{said}? Read like this, the values lie {r.times:.3g} times closer to what the scene can do",
                where=objective.source,
                expected=_expected(r.channels, objective.readings),
                remedy=f"correct the file, or the scene's {_PRESUMED}; if all are right, "
                + limit_remedy("reading", limits, r.times),
            )
        found.append(f"{said} ({r.times:.2g} times closer to the twin; if the scene's {_PRESUMED} are right)")
    return found


def merged_readings(found: Iterable[Reading], units: Mapping[str, str]) -> list[Reading]:
    """Merges readings that say the same of several channels of one unit, the most striking first, so that one message
    names all channels to correct."""
    together: dict[tuple[str, ...], Reading] = {}
    for r in found:
        alone = len(r.channels) == 1 and r.channels[0] not in _FLOOR
        key = (r.words, unit_of(r.channels[0], units)) if alone else r.channels
        before = together.get(key, Reading((), r.words, r.times))
        together[key] = Reading(before.channels + r.channels, r.words, max(before.times, r.times))
    return sorted(together.values(), key=lambda r: -r.times)


def readings(objective: Objective, trials: Floats) -> Iterator[Reading]:
    """The best other reading of each channel, and pairs of forces that fit better swapped.

    A reading of two faults has to be much better than the first alone: positions in millimetres are not called mirrored
    too because a twin with other loads happens to lie a little nearer to their mirror image.
    """
    for channel, at, rows in objective.columns():
        keep = _frames_compared(objective.present[:, rows.start])
        if not keep.size:
            continue
        data, twin = objective.measured[keep, at], trials[:, keep, at]
        if channel not in _FLOOR:
            twin = twin[_rms(twin) >= _SLACK * min(float(_rms(twin).max()), float(_rms(data)))]
        unit = unit_of(channel, objective.readings)
        tried = _poses(channel, data) if channel in _FLOOR else _readings(data, unit)
        # The median: in some trials the contact's force is hundreds of times larger than in the others.
        size = 1.0 if channel in _FLOOR else max(float(np.median(_rms(twin))), 1e-300)
        floor = _FLOOR.get(channel, _FORCE_FLOOR)
        if channel == POSITION:
            tried = _not_just_smaller(data, tried, twin)
        off = {faults: max(float(_distance(channel, values, twin).min()) / size, floor) for faults, values in tried}
        best = min(off.values())
        faults = next(f for f, value in off.items() if value <= _SIMPLER * best)  # the simplest comes first
        if off.get(faults[:1], np.inf) < _BOTH * off[faults]:
            faults = faults[:1]
        if faults:
            yield Reading((channel,), " and ".join(faults), off[()] / off[faults])
    single = [(channel, at.start, rows.start) for channel, at, rows in objective.columns() if channel not in _FLOOR]
    for (one, i, j), (other, k, m) in itertools.combinations(single, 2):
        keep = _frames_compared(objective.present[:, j] & objective.present[:, m])
        if not keep.size or unit_of(one, objective.readings) != unit_of(other, objective.readings):
            continue
        data, twin = objective.measured[keep][:, [i, k]], trials[:, keep][..., [i, k]]
        straight, swapped = (max(float(up_to_scale(d, twin).min()), _FORCE_FLOOR) for d in (data, data[:, ::-1]))
        if straight > swapped:
            yield Reading((one, other), "swapped", straight / swapped)


def residual_doubts(
    objective: Objective,
    residuals: Floats,
    limits: Limits,
    stated: Mapping[str, float] | None,
    doubts: Iterable[str] = (),
) -> list[str]:
    """Doubts in words: residuals (n, m) that a fit's noise does not explain. Raises InputError if they exceed the
    limits; its remedy begins with `doubts` about the measurements from before the fit."""
    found = []
    for channel, columns, rows in objective.columns():
        there = objective.present[:, rows.start]
        if not there.any():
            continue
        rms = float(_rms(residuals[there, rows]))
        kind = channel if channel in _FLOOR else "force"
        size, unit = float(_rms(objective.measured[there, columns])), unit_of(channel, objective.readings)
        said, cases = f"residual of {channel}: {shown(rms, unit, 3)} rms", []
        if kind != "force":
            cases.append((kind, rms, said))
        elif size > 0 or channel not in objective.readings:  # a reading that should be zero has no share
            said += f" of {shown(size, unit, 3)} measured"
            cases.append((kind, rms / max(size, 1e-300), said))
        if stated is not None:
            times = rms / (stated[channel] * np.sqrt(rows.stop - rows.start))
            cases.append(("noise", times, f"{said}, {times:.0f} times the stated noise"))
        why = ": within the bounds the twin does not move or pull like this"
        for limit, value, said in cases:
            remedy = "; ".join((*doubts, f"check unit, sign and channel of {channel}; or "))
            found += bounded(limit, value, said, objective.source, limits, why, remedy)
    return found


def bounded(
    limit: str, value: float, said: str, source: str, limits: Limits, why: str = "", remedy: str = ""
) -> list[str]:
    """The statement `said` about a value, if it reaches the named limit; otherwise nothing. Raises InputError if it
    reaches the limit for refusal."""
    named, refused = limits[limit]
    if value >= refused:
        expected = f"less than {refused:g} by the limit {limit!r}{why}"
        raise InputError(said, where=source, expected=expected, remedy=remedy + limit_remedy(limit, limits, value))
    return [said] if value >= named else []


def step_doubts(errors: Mapping[str, StepError], rmse: Mapping[str, float], readings: Mapping[str, str]) -> list[str]:
    """Channels in which the time steps' error is too large and at least half of the fit's residual (rms), in words;
    without `errors` the run with half the step failed. `readings`: units of channels neither poses nor forces."""
    if not errors:
        return ["with half the time step the simulation fails, so the error of the fit's time steps is not known"]
    found = []
    for channel, error in errors.items():
        if error.large and error.rms > 0.5 * rmse[channel]:
            off, rest = (shown(x, unit_of(channel, readings), 2) for x in (error.rms, rmse[channel]))
            found.append(f"the fit's time steps cause an error of {off} rms of {channel}, beside a residual of {rest}")
    return found


def _poses(channel: str, data: Floats) -> Iterator[tuple[Faults, Floats]]:
    """Positions in other axes, signs and units, or orientations inverted or reordered; first as given."""
    yield (), data
    if channel == ORIENTATION:
        yield ("turned the other way: the femur in the patella's frame",), data * [1.0, -1.0, -1.0, -1.0]
        yield ("written with the scalar last",), np.roll(data, 1, axis=1)
        return
    units = {1.0: "", **_UNITS["m"]}
    turns = itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3))
    every = [(unit, order, signs) for order, signs in turns for unit in units]
    odd = [(unit != 1.0) + sum(i != o for i, o in enumerate(order)) + signs.count(-1.0) for unit, order, signs in every]
    for unit, order, signs in [every[i] for i in np.argsort(odd, kind="stable")[1:]]:
        said = [units[unit]] if unit != 1.0 else []
        if order != (0, 1, 2) or -1.0 in signs:
            axes = ", ".join(f"{'-' if s < 0 else ''}{_AXES[i]}" for i, s in zip(order, signs, strict=True))
            mirrored = " (mirrored)" if np.linalg.det(np.eye(3)[list(order)] * signs) < 0 else ""
            said.append(f"like ({axes}) in the place of (x, y, z){mirrored}")
        yield tuple(said), unit * data[:, order] * np.array(signs)


def _readings(data: Floats, unit: str) -> Iterator[tuple[Faults, Floats]]:
    """A force or other scalar as given, in other units, and with the other sign."""
    units = _UNITS.get(unit, {})
    yield from (((), data), (("negated",), -data))
    yield from (((words,), factor * data) for factor, words in units.items())
    yield from ((("negated", words), -factor * data) for factor, words in units.items())


def _rms(values: Floats) -> Floats:
    """Root mean square length over the frames (..., n, k)."""
    return np.sqrt(np.mean(np.sum(values**2, axis=-1), axis=-1))


def _distance(channel: str, data: Floats, twin: Floats) -> Floats:
    """Distance of a channel (n, k) from each trial (N, n, k); q and -q are the same orientation."""
    if channel == ORIENTATION:
        data = data * np.where(np.sum(data * twin, axis=-1, keepdims=True) < 0, -1.0, 1.0)
    return _rms(data - twin)


def _not_just_smaller(
    data: Floats, tried: Iterator[tuple[Faults, Floats]], twin: Floats
) -> Iterator[tuple[Faults, Floats]]:
    """Omits readings of positions that only shrink the values and fit worse than the values with a constant offset.

    Positions in a frame far away come closer with any reading that shrinks them; an offset explains them better.
    """
    residuals = data - twin
    set_off = float(_rms(residuals - residuals.mean(axis=1, keepdims=True)).min())
    for faults, values in tried:
        if (
            not faults
            or _rms(values) > 0.5 * _rms(data)
            or _SIMPLER * _distance(POSITION, values, twin).min() < set_off
        ):
            yield faults, values


def _frames_compared(present: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Up to `_FRAMES` of the measured frames, evenly spaced."""
    there = np.flatnonzero(present)
    return there[np.unique(np.linspace(0, there.size - 1, _FRAMES).round().astype(int))] if there.size else there


def _expected(channels: tuple[str, ...], readings: Mapping[str, str]) -> str:
    if channels == (POSITION,):
        return "the button's centre in the femur frame (x, y, z), in metres"
    if channels == (ORIENTATION,):
        return "unit quaternions (w, x, y, z) of the patella in the femur"
    if all(unit_of(channel, readings) == "N" for channel in channels):
        return "tensions and contact forces in newtons, none negative, each under its own name"
    return "readings as the effects report them, each under its own name"


def _listed(channels: tuple[str, ...]) -> str:
    """The channels as subject, with their verb."""
    if channels == (POSITION,):
        return "measured positions look"
    first, last = ", ".join(channels[:-1]), channels[-1]
    return f"measured {first} and {last} look" if first else f"measured {last} looks"
