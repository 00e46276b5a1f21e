"""Checks before a search: evaluates the nominal and other parameters, and refuses measurements that none could fit."""

from __future__ import annotations

import numpy as np

from fitting.channel_checks import Limits, misread_channels
from fitting.evaluation import Prediction
from fitting.methods.problem import Problem, Request
from fitting.programs import POSITION
from fitting.trials import per_trial
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError

_UNFELT = 1e-7  # smallest effect of a parameter's whole range that counts, in metres or newtons
_FAR = 0.1  # median distance between measured and predicted positions that indicates another frame [m]
_SMALL = 0.02  # share of a parameter's range by which it is moved to test whether anything reacts
_TRIALS, _COLUMNS = 16, 256  # most motions with which measurements are compared; most motions times parameters
_EXPECTED = "the button's centre in the femur frame, in metres"
_SEED = 20240418  # for the parameters of these motions: the same for every fit


def check_by_derivatives(problem: Problem, first: Request | None, limits: Limits) -> list[str]:
    """Evaluates the nominal parameters and others within the bounds, and refuses what no search could fit. Returns
    doubts: what a measured channel looks like, if another reading of it (unit, sign, axes) fits better.

    Raises InputError for measurements in other units, signs or axes, or swapped; for requested parameters that affect
    no compared channel; for positions measured in another frame.
    """
    evaluator, at = problem.evaluator, problem.parameters.nominal
    count = max(1, min(_TRIALS, _COLUMNS // len(at)))
    if first is None or first.want != "normal" or len(first.theta) < count:
        others = problem.parameters.scattered(count, np.random.default_rng(_SEED))
        first = Request(np.concatenate([at[None], others[1:]]), evaluator.coarse, "normal")
    trials = evaluator.with_slopes(first.theta, first.substeps)
    found = problem.prediction(at, evaluator.coarse)
    if not found.usable[0]:
        return _misread(problem, trials, limits)  # the nominal scene does not run, but other starts may
    assert found.slopes is not None
    span = problem.parameters.upper - problem.parameters.lower
    return _judged(problem, trials, found.values[0], np.abs(found.slopes[0] * span).max(axis=(0, 1)), limits)


def check_by_differences(problem: Problem, limits: Limits) -> list[str]:
    """As `check_by_derivatives`, with parameters moved by a small share of their range instead of derivatives."""
    parameters, at = problem.parameters, problem.parameters.nominal
    asked = np.arange(parameters.asked)
    span = parameters.upper - parameters.lower
    inward = np.where(at + _SMALL * span < parameters.upper, _SMALL, -_SMALL) * span
    moved = at + np.eye(len(at))[asked] * inward
    others = parameters.scattered(_TRIALS, np.random.default_rng(_SEED))
    found = problem.evaluator.values(np.concatenate([at[None], moved, others]), problem.evaluator.first)
    if not found.usable[0]:
        return _misread(problem, found, limits)
    effect = np.full(len(at), np.inf)
    ran, values = found.usable[1 : 1 + len(asked)], found.values[1 : 1 + len(asked)]
    effect[asked[ran]] = np.abs(values[ran] - found.values[0]).max(axis=(1, 2)) / _SMALL
    return _judged(problem, found, found.values[0], effect, limits)


def _misread(problem: Problem, trials: Prediction, limits: Limits) -> list[str]:
    if not trials.usable.any():
        return []
    values, scenes = trials.values[trials.usable], problem.evaluator.scenes
    return per_trial(scenes, problem.objective, lambda own, at: misread_channels(own, values[:, at], limits))


def _judged(problem: Problem, trials: Prediction, nominal: Floats, effect: Floats, limits: Limits) -> list[str]:
    """Doubts, given trial motions, the nominal one (n, c), and the effect of each parameter's whole range (p,)."""
    doubts = _misread(problem, trials, limits)
    known = np.arange(len(effect)) >= problem.parameters.asked  # nuisance parameters, which have priors
    if (unfelt := np.flatnonzero((effect < _UNFELT) & ~known)).size:
        names = ", ".join(problem.parameters.names[i] for i in unfelt)
        found = f"nothing that is compared ({', '.join(problem.objective.channels)}) reacts to {names}"
        remedy = "leave them out, or measure something that reacts to them"
        raise InputError(found, where="free", expected="parameters that make a difference", remedy=remedy)
    if problem.objective.channels[0] == POSITION:
        for own, rows in zip(problem.objective.trials, problem.objective.frames, strict=True):
            off = np.linalg.norm(nominal[rows, :3] - own.measured[:, :3], axis=1)
            if own.present[:, 0].any() and (far := float(np.nanmedian(off))) > _FAR:
                found, expected = f"measured positions lie {1e3 * far:.0f} mm from the scene's", _EXPECTED
                raise InputError(found, where=own.source, expected=expected, remedy="the frame and units of the scene")
    return doubts
