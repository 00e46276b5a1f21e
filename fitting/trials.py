"""Joins several trials of one knee to one long recording: motions in sequence, with one empty frame between two.

Trials share all parameters, except for stated differences, `fit_tendons([...], varies={"L1": 0.5e-3})`:

    value in trial k = shared value + difference k,    difference k ~ N(0, sd)

The smaller the standard deviation, the more the trials support each other. The shared value is the mean over all
possible trials, and is what is reported and applied to other knees. A coordinate of a point moves by the same amount in
every trial, and its value in the first trial is reported: a tuberosity that lies 2 mm more distal does so in the
treated knee too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from numbers import Real

import numpy as np

from fitting.measured_channels import measured_channels
from fitting.metric import Metric, StatedNoise
from fitting.nuisance import REACH, Nuisance
from fitting.objective import Objective, channel_of_columns
from fitting.parameters import BETWEEN_TRIALS, Bounds, Parameter, Parameters, with_nuisance
from fitting.programs import ORIENTATION, POSITION, channel_widths, columns_of, with_readings
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.number_place import named_arrays
from pftwin.model.scene import Scene, check

Scenes = Scene | Sequence[Scene]  # of one trial, or of several
Recordings = Measured | Sequence[Measured | None] | None  # of each trial; None: the scene's own measurements

_ANY = (-1e12, 1e12)  # bounds of other trials, where the first trial's apply
_EQUAL = 1e-6  # relative difference below which values of two scenes count as equal: rounding in files


def trials_of(scene: Scenes, measured: Recordings) -> tuple[list[Scene], list[Measured]]:
    """Scene and measurements of every trial, for one or several; by default the scenes' own measurements. Raises
    InputError if there is no scene, one is not a scene or fails `check`, one has no measurements, or the numbers of
    scenes and measurements differ."""
    scenes = list(scene) if isinstance(scene, Sequence) else [scene]
    if not scenes:
        raise InputError("no trial", where="scene", expected="a scene, or several")
    if stray := [s for s in scenes if not isinstance(s, Scene)]:
        raise InputError(f"found {type(stray[0]).__name__}", where="scene", expected="a scene, or several")
    own: Sequence[Measured | None] = [None] * len(scenes)
    given = own if measured is None else [measured] if isinstance(measured, Measured) else measured
    if len(given) != len(scenes):
        found = f"{len(given)} given, and {len(scenes)} scenes"
        raise InputError(found, where="measured", expected="measurements for each scene")
    found = [measured_of(s) if m is None else m for s, m in zip(scenes, given, strict=True)]
    for each in scenes:
        check(each)
    return scenes, found


def measured_of(scene: Scene) -> Measured:
    """The measurements that a scene carries. Raises InputError if it carries none."""
    if scene.measured is None:
        raise InputError("nothing to compare with", where="measured", expected="measurements of this scene's motion")
    return scene.measured


def trial_names(scenes: Sequence[Scene]) -> list[str]:
    """Names of the trials; repeated names get a number."""
    found: list[str] = []
    for scene in scenes:
        numbered = (f"{scene.name} ({n})" for n in range(2, len(scenes) + 2))
        found.append(next(name for name in (scene.name, *numbered) if name not in found))
    return found


def per_trial(
    scenes: Sequence[Scene], objective: Objective, check_trial: Callable[[Objective, slice], list[str]]
) -> list[str]:
    """Statements of `check_trial(objective, frames)` about each trial, with its name if there are several."""
    names, found = trial_names(scenes), []
    for name, own, rows in zip(names, objective.trials, objective.frames, strict=True):
        found += [said if len(names) == 1 else f"{said} (in {name})" for said in check_trial(own, rows)]
    return found


def objective_of(
    scenes: Sequence[Scene],
    measured: Sequence[Measured],
    kind: str,
    use: str | Sequence[str],
    noise: StatedNoise | None,
    loss: str,
    springs: Mapping[str, str],
) -> Objective:
    """The objective of all trials' measurements, of each the channels measured in it. Raises InputError as
    `Objective.of` does, and for a trial in which no channel of `use` was measured."""
    there = [tuple(measured_channels(*each, springs)[0]) for each in zip(scenes, measured, strict=True)]
    found = []
    for scene, data, channels in zip(scenes, measured, there, strict=True):
        wanted: str | Sequence[str] = use
        if len(scenes) > 1 and use != "all":
            names = [use] if isinstance(use, str) else list(use)
            elsewhere = {c for other in there for c in other}
            wanted = [c for c in names if c in channels or c not in elsewhere]  # a channel measured nowhere is refused
            if not wanted:
                raise InputError(
                    f"nothing of {', '.join(names)} was measured in {scene.name}",
                    where=data.source,
                    expected=f"one of: {', '.join(channels)}" if channels else "at least one measured frame",
                )
        found.append(Objective.of(scene, data, kind, use=wanted, noise=noise, loss=loss, springs=springs))
    joined = joined_objective(found)
    check_channels(scenes, joined.channels)
    return joined


def check_channels(scenes: Sequence[Scene], channels: Sequence[str]) -> None:
    """Raises InputError if a trial lacks one of the channels, which are predicted for every trial."""
    for scene in scenes:
        known = with_readings(scene)
        if missing := [c for c in channels if c not in known]:
            found = f"{scene.name} has no {missing[0]!r}, which another trial has"
            raise InputError(found, where="trials", expected=f"effects of the same names; here {', '.join(known)}")


def rows_of_trials(lengths: Sequence[int]) -> tuple[slice, ...]:
    """Rows of each trial in the joined recording."""
    starts = np.cumsum([0, *(n + 1 for n in lengths[:-1])]).tolist()
    return tuple(slice(start, start + n) for start, n in zip(starts, lengths, strict=True))


def free_in_trials(
    scenes: Sequence[Scene],
    names: Sequence[str],
    bounds: Bounds,
    priors: Mapping[str, tuple[float, float]] | None,
    nuisance: Nuisance,
    varies: Mapping[str, float] | None = None,
) -> tuple[list[Scene], list[Parameters]]:
    """Scene of every trial with nuisance effects added, and its free parameters; bounds, priors and differences are
    those of the first trial. Raises InputError as `with_nuisance` and `with_differences` do, and if the free parameters
    of two trials differ, or a parameter that does not vary has another value."""
    first, own = with_nuisance(scenes[0], names, bounds, priors, nuisance)
    found, free = [first], [own]
    for scene in scenes[1:]:
        prepared, there = with_nuisance(scene, names, dict.fromkeys(names, _ANY), None, nuisance)
        found.append(prepared)
        _check_ties(own, first, prepared)
        free.append(_with_values_of_first(own, there, len(found), varies or {}))
    free[0] = with_differences(first, own, varies or {}, trial_names(scenes))
    return found, free


def _check_ties(own: Parameters, first: Scene, scene: Scene) -> None:
    """Raises InputError if tied parameters have other proportions in a trial than in the first."""
    for p in own.items:
        here, there = ([] if p.coordinate else p.place.proportions(s) for s in (first, scene))
        if len(here) != len(there) or not np.allclose(here, there, rtol=_EQUAL, atol=0):
            found = f"{p.name} has other proportions in {scene.name} than in {first.name}"
            raise InputError(found, where="trials", expected="numbers that trials share")


def _with_values_of_first(first: Parameters, own: Parameters, number: int, varies: Mapping[str, float]) -> Parameters:
    """Free parameters of trial `number`, with the first's values, bounds and priors; coordinates are shifted."""
    here, there = ({p.place.name: p for p in both.items} for both in (first, own))
    if here.keys() != there.keys():
        differing = ", ".join(sorted(here.keys() ^ there.keys()))
        expected = "trials of one knee, with the same tendons, damping and friction; or full names of parameters"
        raise InputError(f"only one of trials 1 and {number} has {differing} free", where="trials", expected=expected)
    if odd := [name for name, p in here.items() if p.place.meaning != "value"]:
        expected = "the slack length itself: each trial begins at another length"
        raise InputError(f"{odd[0]} is no number that trials share", where="free", expected=expected)
    for name, ours in here.items():
        theirs = there[name].nominal
        if not (ours.coordinate or ours.name in varies or np.isclose(theirs, ours.nominal, rtol=_EQUAL, atol=0)):
            found = f"{ours.name} is {ours.nominal:g} in trial 1 and {theirs:g} in trial {number}"
            remedy = f"varies={{{ours.name!r}: ...}}, the deviation of its differences; or scenes with equal values"
            raise InputError(found, where="trials", expected="numbers that trials share", remedy=remedy)
    items = []
    for name, ours in here.items():
        by = there[name].nominal - ours.nominal if ours.coordinate else 0.0
        prior = None if ours.prior is None else (ours.prior[0] + by, ours.prior[1])
        moved = {"nominal": ours.nominal + by, "lower": ours.lower + by, "upper": ours.upper + by, "prior": prior}
        items.append(replace(there[name], **moved))
    return Parameters(tuple(items))


def with_differences(
    scene: Scene, parameters: Parameters, varies: Mapping[str, float], trials: Sequence[str]
) -> Parameters:
    """The shared parameters of trials with these names and, for each that varies, the differences of all trials at the
    end; `scene` is the first trial's, with nuisance effects. Raises InputError for a name that is not free, an invalid
    standard deviation, a single trial, or bounds that leave no room."""
    if not varies:
        return parameters
    if len(trials) < 2:
        raise InputError("a single trial", where="varies", expected="several trials, which differ")
    names = parameters.names
    if strange := [name for name in varies if name not in names]:
        known = [name for name in names if name.startswith(f"{strange[0]}[")] or names
        raise InputError(f"{strange[0]!r} is not free", where="varies", expected=f"some of: {', '.join(known)}")
    items = list(parameters.items)
    for p in parameters.items:
        if p.name in varies:
            sd = _deviation(scene, p, varies[p.name])
            own = replace(p, nominal=0.0, lower=-REACH * sd, upper=REACH * sd, prior=(0.0, sd), kind=BETWEEN_TRIALS)
            named = [(trial, f"{p.name} difference in {name}") for trial, name in enumerate(trials)]
            items += [replace(own, name=name, coordinate=True, trial=trial) for trial, name in named]
    return Parameters(tuple(items))


def _deviation(scene: Scene, p: Parameter, sd: float) -> float:
    """The standard deviation `sd`. Raises InputError if it is not positive, or if the bounds widened by so many
    standard deviations contain impossible values."""
    if not (isinstance(sd, Real) and np.isfinite(float(sd)) and float(sd) > 0):
        raise InputError(f"{p.name}: found {sd!r}", where="varies", expected="a positive standard deviation")
    declared = named_arrays(scene)[p.place.names[0].partition("[")[0]].quantity
    if declared is not None and not (declared.holds(p.lower - REACH * sd) and declared.holds(p.upper + REACH * sd)):
        raise InputError(
            f"{p.name}: bounds {p.lower:g} to {p.upper:g} and {REACH:g} deviations of {sd:g} leave room for values"
            " that it cannot have",
            where="varies",
            expected=declared.expected,
            remedy="narrower bounds, or a smaller deviation; what may be zero, such as friction, cannot vary",
        )
    return float(sd)


def joined_objective(trials: Sequence[Objective]) -> Objective:
    """Joins the measurements of all trials; a channel that a trial lacks is missing there."""
    if len(trials) == 1:
        return trials[0]
    pose = [c for c in (POSITION, ORIENTATION) if any(c in t.channels for t in trials)]
    channels = tuple(dict.fromkeys([*pose, *(c for t in trials for c in t.channels)]))
    lengths, sources = [len(t.measured) for t in trials], tuple(t.source for t in trials)
    frames, column_channel = rows_of_trials(lengths), channel_of_columns(channels)
    measured = np.full((frames[-1].stop, sum(channel_widths(channels))), np.nan)
    present = np.zeros((frames[-1].stop, len(channels)), bool)
    for trial, rows in zip(trials, frames, strict=True):
        measured[rows][:, columns_of(trial.channels, channels)] = trial.measured
        for channel, _, columns in trial.columns():
            present[rows, channels.index(channel)] = trial.present[:, columns.start]
    whole = replace(
        trials[0],
        channels=channels,
        measured=measured,
        present=present[:, column_channel],
        synthetic=any(t.synthetic for t in trials),
        source="; ".join(dict.fromkeys(sources)),
        frames=frames,
        sources=sources,
        metric=Metric.joined([t.metric for t in trials], lengths),
        covariances={c: v for t in trials for c, v in t.covariances.items()},
        readings={c: unit for t in trials for c, unit in t.readings.items()},
    )
    if whole.kind == "paper":
        return whole
    noise = None if whole.noise is None else {c: v for t in trials for c, v in (t.noise or {}).items()}
    return replace(whole, groups=channels, group_of=column_channel, noise=noise)
