"""`fit_tendons`: one verb for every method, and the loop on the host that they share."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from fitting.channel_checks import limits_of
from fitting.estimate import Estimate
from fitting.finish import finished
from fitting.first_look import first_look, plain_look
from fitting.inference.besides import at_own_lengths
from fitting.inference.infer import PER_ROUND, ROUNDS, TOGETHER, check_size, infer
from fitting.methods.problem import MOST_SEED, Method, Problem, State, load_checkpoint, save_checkpoint
from fitting.metric import StatedNoise
from fitting.nuisance import EXACT, Nuisance
from fitting.objective import SPRINGS, Objective
from fitting.outcome import Outcome, estimate_of, judge
from fitting.parameters import Bounds
from fitting.programs import POSITION, with_readings
from fitting.trials import Recordings, free_in_trials, objective_of, trials_of
from pftwin.base.errors import InputError
from pftwin.base.output import check_place
from pftwin.dynamics.batch.devices import Devices
from pftwin.dynamics.simulate import compiled_aside
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

METHODS = {  # module and class
    "least_squares": ("least_squares", "LeastSquares"),
    "gradient": ("gradient", "Gradient"),
    "genetic": ("populations", "Genetic"),
    "matlab_ga": ("matlab_ga", "MatlabGa"),
    "cma_es": ("strategies", "CmaEs"),
    "differential_evolution": ("strategies", "DifferentialEvolution"),
}
SIMULATIONS = "simulations"  # no search: see `fitting.inference`
SPRING_PARAMETERS = ("K1", "L1", "K2", "L2")
_BETWEEN_CHECKPOINTS = 1.0  # [s]


class Progress(NamedTuple):
    """Progress of a fit."""

    method: str
    iteration: int
    of: int  # at most
    best: float
    spread: float


Tell = Callable[[Progress], None]


def fit_tendons(
    scene: Scene | Sequence[Scene],
    measured: Measured | Sequence[Measured | None] | None = None,
    *,
    method: str = "least_squares",
    objective: str = "likelihood",
    free: Sequence[str] = SPRING_PARAMETERS,
    bounds: Bounds = 0.3,
    priors: Mapping[str, tuple[float, float]] | None = None,
    nuisance: str | Nuisance | None = None,
    varies: Mapping[str, float] | None = None,
    seed: int = 0,
    use: str | Sequence[str] = POSITION,
    noise: StatedNoise | None = None,
    loss: str = "linear",
    springs: Mapping[str, str] = SPRINGS,
    progress: Callable[[Progress], None] | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    computed: Sequence[str] | None = None,
    devices: Devices = "all",
    limits: Mapping[str, tuple[float, float]] | None = None,
    **options: Any,
) -> Estimate:
    """Parameters of a scene from measurements of its motion, and how sure they are.

    Args:
        scene: the nominal one; its values are where the search begins. Or several, of trials of one knee, which share
            all parameters: values are those of the first, and coordinates of points move in each by as much.
        measured: at the scene's frames; by default those that the scene carries: a case's of the rig, or those of the
            scene file's table [measured]. Of several trials, those of each.
        method: "least_squares" (multi-start Levenberg-Marquardt), "gradient" (Adam, then L-BFGS, by reverse mode, for
            many parameters), "genetic", "matlab_ga" (after Matlab's `ga`), "cma_es", "differential_evolution" (these
            two need the extra `evosax`); or "simulations": no search, but a posterior learned from some 30,000
            simulated recordings (`fitting.inference`), whose intervals are those to report.
        objective: "likelihood", or "paper": the sum over X, Y, Z of the root mean square error of the sphere's centre
            in the femur frame, without forces.
        free: names of parameters; see `free_parameters`.
        bounds: to either side as a share of the nominal values, or by name; of several trials, in the first.
        priors: by name, mean and standard deviation of a normal prior, likewise.
        nuisance: what the scene lacks or knows roughly, fitted besides: "rig", "mocap", "mri" or a `fitting.Nuisance`;
            by default nothing, and whatever it lacks goes into what is free.
        varies: of several trials, by name of what is free or nuisance, the standard deviation by which it differs from
            trial to trial. What is told is the mean of all trials that there might be; each trial's difference is
            fitted besides. By default nothing differs.
        seed: of all random choices: the same seed gives the same result; by simulations only where rounding is the same
            too, which the number of threads may change.
        use: channels to compare: "position", "orientation", effects' names for their forces, whatever else effects
            report ("contact.force_medial"), or "all" that were measured; see `Objective.of`. Of several trials each
            gives what was measured there.
        noise: standard deviations of the measurements by channel, or covariances of positions and turns; by default
            estimated from the residuals.
        loss: "linear", "huber" or "soft_l1".
        springs: names of the effects whose tensions the "femoral" and the "tibial" spring forces are.
        progress: called after every iteration.
        checkpoint: file in which the state is kept while the fit runs.
        resume: go on from that file.
        computed: channels that the compiled program computes, those compared among them; by default no others. Fits
            that compare different channels share one program where they compute the same; so does `plan_experiment`
            with fits that compute `fitting.channels_of(scene)`.
        devices: over which trial parameters are laid, as `pftwin.simulate_batch` has them. The course of a fit is the
            same for any number, to rounding.
        limits: of the checks of what was measured, by name: from which value on a fault is named before any number, and
            from which the fit is refused; see `fitting.channel_checks`.
        options: of the method: `starts` (least squares), `generations`, `population`, `populations` (genetic,
            matlab_ga and evosax), `iterations` (gradient), `simulations` of a round and `rounds` at most (simulations).

    Returns:
        The estimate. After an interrupt (Ctrl-C) it holds the best so far, and says so; the checkpoint can be resumed.

    Raises:
        InputError: what cannot give a right answer: see `free_parameters` and `Objective.of`; a parameter to which
            nothing that was measured reacts; all starts failing; a checkpoint of another problem; no such devices;
            measurements in other units, signs or axes, swapped, late, or unlike anything that the scene can do;
            trials that have not the same tendons, damping and friction, or of which nothing that is used was measured;
            what varies and is not free, or leaves no room within its bounds;
            errors of sensors as nuisance with another method than simulations.
    """
    if method not in (*METHODS, SIMULATIONS):
        known = ", ".join((*METHODS, SIMULATIONS))
        raise InputError(f"no method {method!r}", where="method", expected=f"one of: {known}")
    if not 0 <= seed <= MOST_SEED:
        raise InputError(f"found {seed!r}", where="seed", expected=f"a whole number from 0 to {MOST_SEED}")
    if resume and checkpoint is None:
        raise InputError("nothing to resume from", where="resume", expected="a checkpoint file")
    if checkpoint is not None:
        check_place(checkpoint)
    allowed = limits_of(limits)
    nominal, given = trials_of(scene, measured)
    if objective == "paper" and (priors or varies or nuisance is not None):
        where = "priors" if priors else "nuisance" if nuisance is not None else "varies"
        raise InputError("the paper's objective has no noise to weigh priors against", where=where)
    besides = Nuisance.of(nuisance)
    if method != SIMULATIONS:
        besides.refuse_sensors(f"method {method!r}")
    else:
        besides = besides.at_work(nominal)
    scenes, parameters = free_in_trials(nominal, free, bounds, priors, besides, varies)
    target = objective_of(scenes, given, objective, use, noise, loss, springs)
    knee = scenes[0]
    problem = Problem.of(scenes, parameters, target, _computed(knee, target, computed), devices)
    began, tell = time.perf_counter(), progress or (lambda _: None)
    if method == SIMULATIONS:
        count, rounds = _check_simulations(objective, loss, checkpoint, options)
        check_size(problem.parameters, count, target.present.size)
        problem.evaluator.prepare(TOGETHER)
        compiled = compiled_aside(knee.unnamed())
        doubts = plain_look(problem, allowed)

        def report(e: dict[str, float], most: int) -> None:
            tell(Progress(method, int(e["iteration"]), most, e["best"], e["spread"]))

        found = infer(problem, besides, seed, count, rounds, report)
        if not found.interrupted:
            besides, draws = at_own_lengths(problem, besides, found.answer.draws)
            scenes, parameters = free_in_trials(nominal, free, bounds, priors, besides, varies)
            problem = Problem.of(scenes, parameters, target, problem.evaluator.computed, devices)
            problem.evaluator.prepare(TOGETHER)
            found = found._replace(answer=found.answer._replace(draws=draws))
        outcome = Outcome.of_simulations(problem, found, seed, allowed)
    else:
        search = _method(method, problem, seed, options)
        problem.evaluator.prepare(search.widest)
        compiled = compiled_aside(knee.unnamed())  # for the fitted motion, which is simulated last
        identity = problem.fingerprint(method, seed, search.settings())
        path = None if checkpoint is None else Path(checkpoint)
        state = load_checkpoint(path, identity) if resume and path is not None else None
        doubts = first_look(problem, search.ask(search.begin()) if state is None else None, allowed)
        search, state = _searched(search, state, identity, tell, path)
        problem, outcome = search.problem, Outcome.of_search(search, state)
    estimate = estimate_of(problem, outcome, method, given, springs, besides, doubts, allowed, began)
    if not outcome.interrupted:
        compiled()
        judge(estimate)
    return estimate


def _searched(
    search: Method, state: State | None, identity: str, tell: Tell, checkpoint: Path | None
) -> tuple[Method, State]:
    """The search where it ended, and its state there. Raises InputError: all starts failed."""
    state = _run(search, state, identity, tell, checkpoint)
    if state["best_theta"] is None:
        raise InputError(
            f"all {state['starts']} starts failed: no equilibrium, or no finite motion",
            where=search.problem.scene.name,
            expected="at least one start from which the motion can be simulated",
            remedy="narrower bounds, or a scene that `pftwin simulate` can run",
        )
    if state["interrupted"]:
        return search, state
    return finished(search, state, lambda again: _run(again, None, "", tell, None))


def _check_simulations(
    objective: str, loss: str, checkpoint: str | Path | None, options: Mapping[str, Any]
) -> tuple[int, int]:
    """How many simulations a round has, and how many rounds at most; refuses what simulations do not know."""
    for name, given, expected in (("objective", objective, "likelihood"), ("loss", loss, "linear")):
        if given != expected:
            raise InputError(f"simulations have no {name} {given!r}", where=name, expected=expected)
    if checkpoint is not None:
        remedy = "leave it out: the whole takes some minutes"
        raise InputError("simulations keep no checkpoint", where="checkpoint", remedy=remedy)
    known = {"simulations": PER_ROUND, "rounds": ROUNDS}
    _check_options(SIMULATIONS, tuple(known), options)
    found = known | dict(options)
    return found["simulations"], found["rounds"]


def likelihood_of(estimate: Estimate, measured: Recordings) -> Problem:
    """The problem that an estimate solved, with the noise that it found; measured of every trial, by default as the
    estimate or its scenes have it. Raises InputError: an estimate without a scene, or of the paper's objective; what
    `Objective.of` has against the measurements."""
    e, scenes = estimate, [trial.nominal for trial in estimate.trials]
    if not scenes:
        remedy = "Estimate.load(path, scene)"
        raise InputError("an estimate from a file holds no scene", where="estimate", remedy=remedy)
    if e.objective == "paper":
        raise InputError("the paper's objective is no likelihood", where="estimate", remedy="objective='likelihood'")
    if e.trial_rmse and len(scenes) != len(e.trial_rmse):
        found = f"fitted to {len(e.trial_rmse)} trials, and {len(scenes)} of their scenes given"
        raise InputError(found, where="estimate", expected="the scene of each: Estimate.load(path, [scene, ...])")
    shared = e.names[: e.shared]
    limits = {n: (lower, upper) for n, lower, upper in zip(shared, e.lower, e.upper, strict=False)}
    priors = {name: prior for name, prior in e.priors.items() if name in shared}
    _, given = trials_of(scenes, [trial.measured for trial in e.trials] if measured is None else measured)
    noise = {**e.noise, **e.covariances}
    target = objective_of(scenes, given, "likelihood", e.channels, noise, "linear", e.springs or SPRINGS)
    target = replace(target, share=e.share)
    problem = Problem.of(scenes, free_in_trials(scenes, shared, limits, priors, EXACT, e.varies)[1], target)
    problem.evaluator.prepare(None)
    if e.substeps:
        problem.evaluator.fine = e.substeps
    return problem


def _computed(scene: Scene, target: Objective, wanted: Sequence[str] | None) -> tuple[str, ...] | None:
    """Channels in the scene's order, so that equal sets share one program; None for those compared alone."""
    if wanted is None:
        return None
    known = with_readings(scene)
    names = {wanted} if isinstance(wanted, str) else set(wanted)
    if strange := names - set(known):
        raise InputError(f"no channel {min(strange)!r}", where="computed", expected=f"some of: {', '.join(known)}")
    if missing := set(target.channels) - names:
        expected = "what is compared, and what else the program is to compute"
        found = f"without {', '.join(sorted(missing))}, which the fit compares"
        raise InputError(found, where="computed", expected=expected)
    return tuple(c for c in known if c in names)


_MOST = 1_000_000  # starts, generations, ...: beyond, the memory or the life of the machine ends


def _method(name: str, problem: Problem, seed: int, options: dict[str, Any]) -> Method:
    module, kind = METHODS[name]
    chosen = getattr(import_module(f"fitting.methods.{module}"), kind)
    _check_options(name, chosen.options, options)
    return chosen(problem, seed, **options)


def _check_options(name: str, known: tuple[str, ...], options: Mapping[str, Any]) -> None:
    for key, value in options.items():
        if key not in known:
            expected = f"one of: {', '.join(known)}"
            raise InputError(f"method {name!r} has no option {key!r}", where="options", expected=expected)
        if not (isinstance(value, int) and 1 <= value <= _MOST):
            raise InputError(f"found {value!r}", where=key, expected=f"a whole number, at least 1, at most {_MOST:,}")


def _run(search: Method, state: State | None, identity: str, tell: Tell, path: Path | None) -> State:
    """Iterates until the method stops or someone interrupts."""
    if state is None:
        state = {**search.begin(), "iteration": 0, "evaluations": 0, "history": [], "interrupted": False}
        state.setdefault("starts", search.starts)
    state["interrupted"] = False
    saved = time.perf_counter()
    try:
        while state["stopped"] is None:
            request = search.ask(state)
            answer = search.problem.answer(request)
            search.tell(state, request, answer)
            state["iteration"] += 1
            state["evaluations"] += len(request.theta)
            found = {"best": state["best_value"], "spread": search.spread(state)}
            entry = {"iteration": state["iteration"], "evaluations": state["evaluations"], **found}
            state["history"].append(entry)
            now = time.perf_counter()
            if path is not None and (now - saved > _BETWEEN_CHECKPOINTS or state["stopped"]):
                save_checkpoint(path, identity, state)
                saved = now
            tell(Progress(search.name, state["iteration"], search.most_iterations, **found))
    except KeyboardInterrupt:
        state["interrupted"] = True
        if path is not None:
            save_checkpoint(path, identity, state)
        if state["best_theta"] is None:
            raise
    return state
