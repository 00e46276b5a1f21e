"""`fit_tendons`: fits a scene's parameters with any method; the iteration loop that the searches share."""

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
from fitting.first_look import check_by_derivatives, check_by_differences
from fitting.inference.infer import PER_ROUND, ROUNDS, TOGETHER, check_size, infer
from fitting.inference.nuisance_draws import at_own_lengths
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
    "matlab_ga": ("populations", "MatlabGa"),
    "cma_es": ("strategies", "CmaEs"),
    "differential_evolution": ("strategies", "DifferentialEvolution"),
}
SIMULATIONS = "simulations"  # a posterior instead of a search: see `fitting.inference`
SPRING_PARAMETERS = ("K1", "L1", "K2", "L2")
_BETWEEN_CHECKPOINTS = 1.0  # [s]


class Progress(NamedTuple):
    """Progress of a fit, reported after every iteration."""

    method: str
    iteration: int
    of: int  # most iterations
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
    """Estimates parameters of a scene, and their uncertainty, from measurements of its motion.

    Args:
        scene: the nominal scene, whose values are where the search starts; or the scenes of several trials of one knee,
            which share all parameters. Values are then those of the first trial, and a point's coordinates move by the
            same amount in every trial.
        measured: measurements at the scene's frames; by default those that the scene carries (of a case of the rig, or
            from a scene file's table [measured]). For several trials a sequence, one for each.
        method: "least_squares" (multi-start Levenberg-Marquardt), "gradient" (Adam, then L-BFGS, by reverse mode, for
            many parameters), "genetic", "matlab_ga" (after Matlab's `ga`), "cma_es", "differential_evolution" (the last
            two need the extra `evosax`); or "simulations": no search, but a posterior learned from some 30,000
            simulated recordings (`fitting.inference`), whose intervals are those to report.
        objective: "likelihood", or "paper": the sum over X, Y, Z of the root mean square error of the sphere's centre
            in the femur frame, without forces.
        free: names of the parameters to estimate; see `free_parameters`.
        bounds: half width as a share of the nominal value, for all or by name, or (lower, upper) by name; those of the
            first trial.
        priors: mean and standard deviation of a normal prior, by name; those of the first trial.
        nuisance: what the scene omits or knows only roughly, estimated too: "rig", "mocap", "mri" or a
            `fitting.Nuisance`. By default nothing, so that model errors bias the free parameters.
        varies: standard deviation by which a free or nuisance parameter differs between trials, by name. The value
            reported is the mean over all possible trials; each trial's difference is estimated too. By default nothing
            differs.
        seed: of all random choices. The same seed gives the same result; with simulations only if rounding is the same
            too, which the number of threads may change.
        use: channels to compare: "position", "orientation", an effect's name for its force, any other observable
            of an effect ("contact.force_medial"), or "all" that were measured; see `Objective.of`. Each of several
            trials contributes those that were measured in it.
        noise: standard deviation of each channel's noise, or covariance of positions or rotations; by default
            estimated from the residuals.
        loss: "linear", "huber" or "soft_l1".
        springs: names of the effects whose tensions were measured as "femoral" and "tibial" spring forces.
        progress: called after every iteration.
        checkpoint: file to which the state is saved during the fit.
        resume: whether to continue from that file.
        computed: channels that the compiled program computes, including those compared; by default these alone. Fits
            that compare different channels share one program if they compute the same; so does `plan_experiment`
            with fits that compute `fitting.channels_of(scene)`.
        devices: over which parameter vectors are distributed, as in `pftwin.simulate_batch`. The iterates are the same
            for any number of devices, to rounding.
        limits: for the checks of the measurements, by name: the value from which a fault is reported as a doubt, and
            that from which the fit is refused; see `fitting.channel_checks`.
        options: of the method: `starts` (least squares); `generations`, `population`, `populations` (genetic,
            matlab_ga and evosax); `iterations` (gradient); `simulations` per round and `rounds` at most (simulations).

    Returns:
        The estimate. After an interrupt (Ctrl-C) it holds the best so far, and says so; the checkpoint can be resumed.

    Raises:
        InputError: unusable input, as in `free_parameters` and `Objective.of`; a parameter that affects no channel
            compared; failure of all starts; a checkpoint of another problem; an unknown device; measurements in other
            units, signs or axes, swapped, late, or unlike any motion of the scene; trials that differ in tendons,
            damping or friction, or without any channel of `use`; a parameter in `varies` that is not free or has no
            room within its bounds; sensor errors as nuisance with a method other than simulations.
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
    extra = Nuisance.of(nuisance)
    if method != SIMULATIONS:
        extra.refuse_sensors(f"method {method!r}")
    else:
        extra = extra.at_work(nominal)
    scenes, parameters = free_in_trials(nominal, free, bounds, priors, extra, varies)
    target = objective_of(scenes, given, objective, use, noise, loss, springs)
    knee = scenes[0]
    problem = Problem.of(scenes, parameters, target, _computed(knee, target, computed), devices)
    began, tell = time.perf_counter(), progress or (lambda _: None)
    if method == SIMULATIONS:
        count, rounds = _check_simulations(objective, loss, checkpoint, options)
        check_size(problem.parameters, count, target.present.size)
        problem.evaluator.prepare(TOGETHER)
        compiled = compiled_aside(knee.unnamed())
        doubts = check_by_differences(problem, allowed)

        def report(e: dict[str, float], most: int) -> None:
            tell(Progress(method, int(e["iteration"]), most, e["best"], e["spread"]))

        found = infer(problem, extra, seed, count, rounds, report)
        if not found.interrupted:
            extra, draws = at_own_lengths(problem, extra, found.answer.draws)
            scenes, parameters = free_in_trials(nominal, free, bounds, priors, extra, varies)
            problem = Problem.of(scenes, parameters, target, problem.evaluator.computed, devices)
            problem.evaluator.prepare(TOGETHER)
            found = found._replace(answer=found.answer._replace(draws=draws))
        outcome = Outcome.of_simulations(problem, found, seed, allowed)
    else:
        search = _method(method, problem, seed, options)
        problem.evaluator.prepare(search.widest)
        # For the fitted motion, which is simulated last.
        compiled = compiled_aside(knee.unnamed(), before=problem.evaluator.begin)
        identity = problem.fingerprint(method, seed, search.settings())
        path = None if checkpoint is None else Path(checkpoint)
        state = load_checkpoint(path, identity) if resume and path is not None else None
        doubts = check_by_derivatives(problem, search.ask(search.begin()) if state is None else None, allowed)
        search, state = _searched(search, state, identity, tell, path)
        problem, outcome = search.problem, Outcome.of_search(search, state)
    estimate = estimate_of(problem, outcome, method, given, springs, extra, doubts, allowed, began)
    if not outcome.interrupted:
        compiled()
        judge(estimate)
    return estimate


def _searched(
    search: Method, state: State | None, identity: str, tell: Tell, checkpoint: Path | None
) -> tuple[Method, State]:
    """The search and its state after the last iteration. Raises InputError if all starts failed."""
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
    return finished(search, state, lambda started: _run(started, None, "", tell, None))


def _check_simulations(
    objective: str, loss: str, checkpoint: str | Path | None, options: Mapping[str, Any]
) -> tuple[int, int]:
    """Simulations per round and most rounds. Raises InputError for options that simulations do not have."""
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
    """The problem that an estimate solved, with the noise that it found. `measured` holds every trial's measurements,
    by default those of the estimate or its scenes. Raises InputError for an estimate without a scene or of the paper's
    objective, and as `Objective.of` does for the measurements."""
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
    """Computed channels in the scene's order, so that equal sets share one program; None: only those compared."""
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


_MOST = 1_000_000  # of starts, generations and the like: more would exhaust memory or take forever


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
    """Iterates until the method stops or the user interrupts."""
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
