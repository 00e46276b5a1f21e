"""Turns the outcome of a fit's method into an estimate, with residuals and checks."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fitting.channel_checks import Limits, residual_doubts, step_doubts
from fitting.estimate import Estimate, FittedTrial
from fitting.evaluation import Prediction, StepError
from fitting.methods.problem import Method, Problem, State
from fitting.nuisance import Nuisance
from fitting.objective import Objective
from fitting.programs import ORIENTATION, POSITION, TURNS
from fitting.sensors import noise_beside
from fitting.time_shift import TimeShift, late_channels, time_shifts
from fitting.trials import per_trial, trial_names
from fitting.uncertainty import relative, sizes, uncertainty
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, PftwinError
from pftwin.dynamics.simulate import simulate
from pftwin.dynamics.status import status_facts
from pftwin.model.measured import Measured
from pftwin.results.verdict import Verdict

if TYPE_CHECKING:
    from fitting.inference.infer import Inferred


_TRIED, _PER_PARAMETER = 63, 3  # draws tried if the posterior's mean fails: at least, and per parameter
_ANOTHER_DRAW = "the posterior's means give no finite motion; values are those of a draw next to them"
_NO_DRAW_RUNS = "neither the posterior's means nor the draws next to them give a finite motion"


class Outcome(NamedTuple):
    """Result of a method, before it becomes an estimate."""

    theta: Floats  # (p,)
    covariance: Floats  # (p, p)
    draws: Floats | None  # posterior samples (N, p), if the method gives them
    prediction: Prediction  # at theta, with derivatives
    steps: dict[str, StepError]  # errors of the time steps
    noise: dict[str, float]  # by channel
    serial: float  # correlation of neighbouring residuals
    condition: float
    doubts: list[str]
    reason: str
    interrupted: bool
    substeps: int  # time steps between two frames
    facts: dict[str, Any]  # seed, evaluations, iterations, starts, dropped, history

    @staticmethod
    def of_search(search: Method, state: State) -> Outcome:
        """Outcome of a finished search, at its best parameters."""
        problem, theta = search.problem, np.asarray(state["best_theta"])
        fitted, target = problem.prediction(theta, problem.evaluator.fine), problem.objective
        _check_usable(fitted, "the best parameters found with long time steps give no finite motion with short ones")
        r, j = (a[0] for a in target.linear(fitted))
        noise = target.noise or target.noise_of(r, len(problem.parameters))
        sure = uncertainty(target.known(noise), problem.parameters, r, j, theta)
        return Outcome(
            theta,
            sure.covariance,
            None,
            fitted,
            problem.evaluator.step_errors(theta, problem.evaluator.fine),
            noise,
            sure.serial,
            sure.condition,
            [],
            "interrupted; the best so far" if state["interrupted"] else str(state["stopped"]),
            state["interrupted"],
            problem.evaluator.fine,
            {
                **{key: int(state[key]) for key in ("evaluations", "starts", "dropped")},
                "iterations": int(state["iteration"]),
                "seed": search.seed,
                "history": state["history"],
                "notes": list(state.get("notes", [])),
            },
        )

    @staticmethod
    def of_simulations(problem: Problem, found: Inferred, seed: int, limits: Limits) -> Outcome:
        """Outcome of a posterior learned from simulations, at its mean, or at the nearest draw that can be simulated.
        Raises InputError if the measurements lie farther from the simulations than the limits allow."""
        draws, target = found.answer.draws, problem.objective
        mean, deviations = draws.mean(axis=0), np.maximum(draws.std(axis=0), 1e-300)
        count = max(_TRIED, _PER_PARAMETER * draws.shape[1])
        nearest = np.argsort(np.linalg.norm((draws - mean) / deviations, axis=1))[:count]
        tried = np.concatenate([mean[None], draws[nearest]])
        every = problem.evaluator.values(tried, found.substeps)
        best = int(np.argmax(every.usable))
        theta, at = tried[best], slice(best, best + 1)
        _check_usable(every._replace(usable=every.usable[at]), _NO_DRAW_RUNS)
        slopes = _slopes(tried[every.usable], every.values[every.usable])
        parameters = problem.parameters
        covariance = np.cov(draws.T).reshape(2 * [len(parameters)])
        size = sizes(parameters.names, parameters.upper - parameters.lower, theta, parameters.coordinates)
        doubts = [_ANOTHER_DRAW] if best else []
        squares = {channel: found.noise.deviations[rows] ** 2 for channel, _, rows in target.columns()}
        return Outcome(
            theta,
            covariance,
            draws,
            Prediction(every.values[at], slopes[None], every.usable[at]),
            problem.evaluator.step_errors(theta, found.substeps, slopes=False),
            {channel: float(np.sqrt(s.mean())) for channel, s in squares.items()},
            float(found.noise.correlations.mean()),
            float(np.linalg.cond(relative(size, covariance))),
            doubts + found.answer.doubts(target.source, limits),
            found.reason,
            found.interrupted,
            found.substeps,
            {
                "iterations": len(found.history),
                "evaluations": found.simulations,
                "starts": found.simulations,
                "dropped": found.dropped,
                "seed": seed,
                "history": found.history,
            },
        )


def _slopes(theta: Floats, values: Floats) -> Floats:
    """Derivatives (n, c, p) of values (N, n, c) with respect to parameters (N, p), by linear regression."""
    scale = np.maximum(theta.std(axis=0), 1e-300)
    x = (theta - theta.mean(axis=0)) / scale
    rows = (values - values.mean(axis=0)).reshape(len(values), -1)
    return (np.linalg.lstsq(x, rows, rcond=None)[0].T / scale).reshape(*values.shape[1:], -1)


def _check_usable(prediction: Prediction, found: str) -> None:
    if not prediction.usable[0]:
        raise PftwinError(f"{found}; try: narrower bounds, or another method")


def estimate_of(
    problem: Problem,
    found: Outcome,
    method: str,
    measured: Sequence[Measured],
    springs: Mapping[str, str],
    nuisance: Nuisance,
    doubts: list[str],
    limits: Limits,
    began: float,
) -> Estimate:
    """The estimate of a solved problem, with its doubts.

    Arguments are those of `fit_tendons`, and `doubts` about the measurements from before the search, and its start time
    `began` (`time.perf_counter`). Raises InputError if residuals or time shifts exceed the limits.
    """
    parameters, target, fitted = problem.parameters, problem.objective, found.prediction
    r = target.unweighted.residuals(fitted.values)[0]
    rmse = _rmse(target, r)
    scenes, names = problem.evaluator.scenes, trial_names(problem.evaluator.scenes)
    of_trials = zip(names, target.trials, target.frames, strict=True)
    trial_rmse = {name: _rmse(own, r[rows]) for name, own, rows in of_trials} if len(scenes) > 1 else {}
    shifts, late = _time_shifts(problem, fitted, limits)
    noise = None if target.noise is None else noise_beside(target.noise, nuisance, target)
    left = per_trial(scenes, target, lambda own, rows: residual_doubts(own, r[rows], limits, noise, doubts))
    moved = [s.change for s in shifts.values() if s.exceeds(limits["shift"][0])]
    draws = found.draws
    if draws is not None:
        random = np.random.default_rng(found.facts["seed"])
        draws = draws + sum(np.outer(random.standard_normal(len(draws)), change) for change in moved)
    return Estimate(
        names=parameters.names,
        units=tuple(p.unit for p in parameters.items),
        values=found.theta,
        covariance=found.covariance + sum(np.outer(change, change) for change in moved),
        draws=draws,
        lower=parameters.lower,
        upper=parameters.upper,
        nominal=parameters.nominal,
        objective=target.kind,
        objective_value=float(target.value(fitted)[0] + parameters.prior_terms(found.theta)[0]),
        objective_unit=target.unit,
        channels=target.channels,
        noise={k: float(v) for k, v in found.noise.items()},
        noise_known=target.noise is not None,
        serial_correlation=found.serial,
        share=target.share,
        condition=found.condition,
        rmse=rmse,
        method=method,
        reason=found.reason,
        **found.facts,
        seconds=time.perf_counter() - began,
        synthetic=target.synthetic,
        source=target.source,
        scene_name=" + ".join(names),
        priors={p.name: p.prior for p in parameters.items if p.prior is not None},
        springs=dict(springs),
        nuisance=nuisance,
        auxiliary=parameters.names[parameters.asked :],
        kinds=tuple(p.kind for p in parameters.items),
        varies=parameters.varies,
        differences=parameters.differences,
        doubts=[*doubts, *late, *left, *found.doubts, *step_doubts(found.steps, rmse, target.readings)],
        time_shifts={channel: (s.seconds, s.deviation) for channel, s in shifts.items() if not s.at_least},
        coordinates=parameters.coordinates,
        substeps=found.substeps,
        values_compared=int(target.present.sum()),
        readings=target.readings,
        covariances=target.covariances,
        step_error={channel: e.rms for channel, e in found.steps.items()},
        trial_rmse=trial_rmse,
        trials=tuple(FittedTrial(*each) for each in zip(scenes, measured, strict=True)),
    )


def _time_shifts(problem: Problem, fitted: Prediction, limits: Limits) -> tuple[dict[str, TimeShift], list[str]]:
    """Time shifts of all trials' channels, and those beyond the limit in words. Raises InputError as `late_channels`
    does."""
    assert fitted.slopes is not None
    shifts: dict[str, TimeShift] = {}
    late: list[str] = []
    scenes, target = problem.evaluator.scenes, problem.objective
    for scene, name, rows, own in zip(scenes, trial_names(scenes), target.frames, target.trials, strict=True):
        late_by = time_shifts(own, scene.motion.times, fitted.values[0][rows], fitted.slopes[0][rows])
        named = {channel if len(scenes) == 1 else f"{channel} of {name}": s for channel, s in late_by.items()}
        late += late_channels(named, own.source, limits)
        shifts |= named
    return shifts, late


def judge(estimate: Estimate) -> None:
    """Simulates the fitted motions and sets the estimate's verdict and status, which a fit itself does not check. A
    fitted scene that is refused, such as for its limits, makes the estimate INVALID."""
    scenes, reasons, flags = estimate.scenes, [], []
    for name, scene in zip(trial_names(scenes), scenes, strict=True):
        try:
            result = simulate(scene)
        except InputError as refused:
            own = (str(refused),)
        else:
            own = result.verdict.reasons
            flags.append(result.flags)
        reasons += [f"{reason} ({name})" if len(scenes) > 1 else reason for reason in own]
    estimate.verdict = Verdict(tuple(reasons)).describe()
    if flags:
        facts = status_facts(np.concatenate(flags))
        estimate.status, estimate.status_frames = facts["status"], facts["status_frames"]


def _rmse(target: Objective, r: Floats) -> dict[str, float]:
    """RMS of residuals (n, m) by channel and, for positions and rotations, by axis; without unmeasured channels."""
    squares, counts = np.sum(r**2, axis=0), target.present.sum(axis=0)
    parts = {channel: rows for channel, _, rows in target.columns() if counts[rows.start]}
    for channel, names in ((POSITION, "XYZ"), (ORIENTATION, TURNS)):
        if channel in parts:
            parts |= {name: slice(i, i + 1) for i, name in enumerate(names, parts[channel].start)}
    return {name: float(np.sqrt(squares[rows].sum() / counts[rows].sum())) for name, rows in parts.items()}
