"""How precisely an experiment can determine parameters (Cramer-Rao bound), what else to measure; profile likelihood."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.estimate import Estimate
from fitting.evaluation import Evaluator
from fitting.finish import NormalEstimate, shorten_steps
from fitting.fit import SPRING_PARAMETERS, likelihood_of
from fitting.methods.problem import Problem, refuse_moved_point
from fitting.nuisance import Nuisance
from fitting.parameters import Bounds, Parameters
from fitting.programs import ORIENTATION, POSITION, channels_of, reading_units, side_by_side, with_readings
from fitting.trials import check_channels, free_in_trials, trial_names
from fitting.uncertainty import in_words, inverse_information, percent, sizes
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene, check

NOISE = {POSITION: 2e-4, ORIENTATION: 5e-3}  # of motion capture [m], [rad]
FORCE_NOISE = 0.15  # of a load cell [N]
CHI_SQUARED_95 = 3.841458820694124  # quantile for one degree of freedom
_SETTLED = 5e-4  # divergence [nats] below which two bounds count as equal: four standard deviations all off by 1 %
_UNFELT = 1e-6  # least effect of a parameter's whole range on all frames, in units of the noise


@dataclass(frozen=True, eq=False)
class ExperimentPlan:
    """Best precision that a design allows for the parameters (p,), and further channels or trials that improve it."""

    names: tuple[str, ...]
    values: Floats
    channels: tuple[str, ...]  # channels to be measured
    noise: dict[str, float]
    covariance: Floats  # (p, p): no unbiased estimate has a smaller one
    condition: float
    unfelt: tuple[str, ...]  # parameters that affect no measured channel
    additions: dict[str, Floats]  # relative standard deviations (p,) with one more channel or trial, best first
    words: str  # the precision in words
    sizes: Floats  # what relative standard deviations are relative to (p,)
    trials: tuple[str, ...] = ()  # which additions are trials

    @property
    def relative(self) -> Floats:
        """Smallest relative standard deviations (p,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0)) / self.sizes

    def sentence(self) -> str:
        """The plan's precision and the best further measurement, in a sentence."""
        text = f"at best, {self.words}"
        if self.unfelt:
            text += f"; nothing reacts to {', '.join(self.unfelt)}"
        if self.additions:
            best = next(iter(self.additions))
            before, after = float(self.relative.max()), float(self.additions[best].max())
            if after < 0.8 * before:
                named = best in (POSITION, ORIENTATION, *self.trials) or "." in best
                what = best if named else f"the force of {best}"
                done = "recorded" if best in self.trials else "measured"
                falls = f"falls from {percent(before)} to {percent(after)}"
                text += f"; {what} {done} as well helps most: the worst standard deviation {falls}"
            else:
                text += "; no single further measurement helps much"
        return text

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        as_lists = ("names", "values", "channels", "covariance", "condition", "unfelt", "trials")
        return {
            **{name: np.asarray(getattr(self, name)).tolist() for name in as_lists},
            "noise": self.noise,
            "relative_standard_deviations": self.relative.tolist(),
            "additions": {k: v.tolist() for k, v in self.additions.items()},
            "sentence": self.sentence(),
        }


def plan_experiment(
    scene: Scene,
    *,
    free: Sequence[str] = SPRING_PARAMETERS,
    use: Sequence[str] = (POSITION,),
    noise: Mapping[str, float] | None = None,
    candidates: Sequence[str] | None = None,
    further: Sequence[Scene] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
    bounds: Bounds = 0.3,
    nuisance: str | Nuisance | None = None,
    varies: Mapping[str, float] | None = None,
    progress: Callable[[int, int, str], None] = lambda done, of, what: None,
) -> ExperimentPlan:
    """Computes the Cramer-Rao bound at the scene's parameters, before anything is measured or fitted.

    Args:
        scene: scene with the motion that is to be recorded.
        free: names of the parameters to be estimated.
        use: channels to be measured: "position", "orientation", an effect's name for its force, and any other
            observable of an effect ("contact.force_medial").
        noise: standard deviations by channel [m], [rad], [N]; by default 0.2 mm, 5 mrad and 0.15 N, white. For a
            reading that is not a force it is required.
        candidates: channels that could be measured too; by default all others of the scene.
        further: scenes of further trials of the same knee that could be recorded, with the same channels.
        priors: mean and standard deviation of a normal prior, by name.
        bounds: as in `fit_tendons`: the range over which a parameter must affect the measurements.
        nuisance: as in `fit_tendons`: what the scene omits or knows only roughly, estimated too.
        varies: as in `fit_tendons`: standard deviation by which a parameter differs between trials; its mean is
            estimated.
        progress: called with the number of trials done, of all, and what comes next, before each.

    Raises:
        InputError: unknown parameters or channels; a scene that cannot be simulated; a noise that is not positive;
            further trials that differ in tendons, damping or friction; a parameter in `varies` that is not free, or
            without a further trial.
    """
    for each in (scene, *further):
        check(each)
    extra = Nuisance.of(nuisance)
    extra.refuse_sensors("a plan of experiments")
    prepared, free_in_each = free_in_trials([scene, *further], free, bounds, priors, extra, varies)
    (scene, *others), (first, *theirs) = prepared, free_in_each
    parameters, asked, between = first.shared, first.asked, first.varies
    channels, more, units = _channels(scene, use, candidates)
    if stray := [name for name in noise or {} if name not in with_readings(scene)]:
        raise InputError(f"no channel {stray[0]!r}", where="noise", expected=f"one of: {', '.join(channels)}")
    sigma = _noise(channels, units, noise or {})
    measured = tuple(c for c in channels if c in use)
    check_channels(others, measured)
    every = trial_names([scene, *others])
    progress(0, len(every), f"linearising {every[0]}")
    information, unfelt = _information(scene, parameters, channels, sigma, measured)
    here = sum(information[c] for c in measured)
    prior = np.diag(parameters.prior_terms(parameters.nominal)[2])

    def known(*trials: Any) -> Floats:
        """Information on the requested parameters from trials that each have their own differences."""
        whole = sum((_information_on_mean(each, parameters, between) for each in trials), prior)
        return _marginal_information(whole, asked)

    bound = known(here)
    covariance = inverse_information(bound)
    names, span = parameters.names[:asked], (parameters.upper - parameters.lower)[:asked]
    nominal = parameters.nominal[:asked]
    scale = np.abs(sizes(names, span, nominal, parameters.coordinates))
    values = np.linalg.eigvalsh(bound * np.outer(scale, scale))
    with_more = {c: known(here + information[c]) for c in more}
    trials = tuple(f"trial {name}" for name in every[1:])
    for done, (name, other, own) in enumerate(zip(trials, others, theirs, strict=True), start=1):
        progress(done, len(every), f"linearising {every[done]}")
        with_more[name] = known(here, sum(_information(other, own, measured, sigma, measured)[0].values()))
    additions = {c: np.sqrt(np.diagonal(inverse_information(found))) / scale for c, found in with_more.items()}
    return ExperimentPlan(
        names,
        nominal,
        measured,
        {c: sigma[c] for c in channels},
        covariance,
        float(values[-1] / values[0]) if values[0] > 0 else np.inf,
        tuple(name for name in unfelt if name in names),
        dict(sorted(additions.items(), key=lambda item: float(item[1].max()))),
        in_words(names, span, nominal, covariance, measured, parameters.coordinates, units),
        scale,
        trials,
    )


def _channels(
    scene: Scene, use: Sequence[str], candidates: Sequence[str] | None
) -> tuple[tuple[str, ...], list[str], dict[str, str]]:
    """Channels measured or possible, in the scene's order; the possible ones; units of those that are neither poses
    nor forces. Raises InputError for an unknown channel, or if none is measured."""
    known = channels_of(scene)
    more = [c for c in known if c not in use] if candidates is None else list(candidates)
    for channel in (*use, *more):
        if channel not in with_readings(scene):
            expected = f"one of: {', '.join(known)}; or what an effect reports, EFFECT.OBSERVABLE"
            raise InputError(f"no channel {channel!r}", where="use", expected=expected)
    if not use:
        raise InputError("nothing is measured", where="use", expected=f"some of: {', '.join(known)}")
    units = reading_units(scene, (*use, *more))
    return tuple(c for c in (*known, *units) if c in use or c in more), more, units


def _noise(channels: Sequence[str], units: Mapping[str, str], stated: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations by channel. Raises InputError if one is invalid, or missing without a default."""
    sigma = {c: NOISE.get(c, FORCE_NOISE) for c in channels} | dict(stated)
    if unknown := [c for c in channels if units.get(c, "N") != "N" and c not in stated]:
        expected = f"its standard deviation [{units[unknown[0]]}]"
        raise InputError(f"no noise of {unknown[0]!r}", where="noise", expected=expected)
    if odd := [c for c in channels if np.ndim(sigma[c])]:
        raise InputError(f"{odd[0]}: a covariance", where="noise", expected="a standard deviation, in plans")
    if bad := [c for c in channels if not (np.isfinite(sigma[c]) and sigma[c] > 0)]:
        raise InputError(f"{bad[0]}: found {sigma[bad[0]]!r}", where="noise", expected="a positive number")
    return sigma


def _information_on_mean(information: Floats, parameters: Parameters, varies: Mapping[str, float]) -> Floats:
    """Information from one trial on the mean over trials (p, p), its own difference being estimated too."""
    at = [i for i, name in enumerate(parameters.names) if name in varies]
    if not at:
        return information
    own = information[np.ix_(at, at)] + np.diag([varies[parameters.names[i]] ** -2 for i in at])
    return information - information[:, at] @ np.linalg.solve(own, information[at])


def _marginal_information(information: Floats, asked: int) -> Floats:
    """Information on the first parameters (asked, asked), the others being estimated too: Schur's complement."""
    a, b, d = information[:asked, :asked], information[:asked, asked:], information[asked:, asked:]
    return a - b @ inverse_information(d) @ b.T if len(d) else a


def _information(
    scene: Scene, parameters: Parameters, channels: tuple[str, ...], noise: dict[str, float], use: tuple[str, ...]
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Fisher information of each channel (p, p), and the parameters that affect no used channel. Raises InputError if
    the scene cannot be simulated, or a parameter moves the point whose path is measured.

    Time steps are as short as those of a fit's answer: halving them changes nothing about the requested parameters.
    """
    if POSITION in use:
        refuse_moved_point(scene, parameters)
    evaluator = Evaluator(scene, parameters, channels)
    evaluator.prepare(None)
    span = parameters.upper - parameters.lower
    prior = np.diag(parameters.prior_terms(parameters.nominal)[2])

    def estimate(substeps: int) -> NormalEstimate | None:
        if not (found := _information_at(evaluator, parameters, noise, substeps)):
            return None
        scaled = (sum(found[c] for c in use) + prior) * np.outer(span, span)
        return NormalEstimate.of(np.zeros(parameters.asked), _marginal_information(scaled, parameters.asked))

    shorten_steps(evaluator, estimate, _SETTLED)
    if not (found := _information_at(evaluator, parameters, noise, evaluator.fine)):
        raise InputError("the scene's motion cannot be simulated", where=scene.name, remedy="pftwin simulate")
    felt = np.sqrt(sum(np.diagonal(found[c]) for c in use)) * span
    return found, tuple(n for n, size in zip(parameters.names, felt, strict=True) if size < _UNFELT)


def _information_at(
    evaluator: Evaluator, parameters: Parameters, noise: Mapping[str, float], substeps: int
) -> dict[str, Floats]:
    """Fisher information of each channel (p, p) with so many steps between frames; empty if the simulation fails."""
    prediction, out = evaluator.with_slopes(parameters.nominal[None], substeps), {}
    if not prediction.usable[0] or prediction.slopes is None:
        return {}
    for channel, columns in side_by_side(evaluator.channels):
        j = prediction.slopes[0, :, columns] / noise[channel]
        if channel == ORIENTATION:
            j = 2 * j  # a unit quaternion changes by half the rotation
        flat = j.reshape(-1, j.shape[-1])
        out[channel] = flat.T @ flat
    return out


@dataclass(frozen=True, eq=False)
class LikelihoodProfile:
    """Profile likelihood of one parameter: the others are refitted at each of its values."""

    name: str
    values: Floats  # (k,)
    deviance: Floats  # (k,) twice the decrease of the log-likelihood
    theta: Floats  # (k, p) all parameters, the others refitted
    interval: tuple[float, float]  # 95 %; infinite where the profile does not rise that far


def profile_likelihood(
    estimate: Estimate,
    name: str,
    *,
    measured: Measured | Sequence[Measured] | None = None,
    points: int = 15,
    reach: float = 3.0,
    iterations: int = 6,
) -> LikelihoodProfile:
    """Computes the profile likelihood of one parameter, fitting all its points in one batch.

    If residuals are correlated in time, it is scaled to the estimate's variance, which allows for that.

    Args:
        estimate: estimate by likelihood, with its scene.
        name: name of the parameter.
        measured: the measurements (of each trial); by default those of the estimate.
        points: number of points of the profile.
        reach: distance of the end points in standard deviations, limited by the bounds.
        iterations: Gauss-Newton iterations on the others.

    Raises:
        InputError: no such parameter; an estimate without a scene, or of the paper's objective, which is no likelihood.
    """
    if name not in estimate.names:
        raise InputError(f"no parameter {name!r}", where="name", expected=f"one of: {', '.join(estimate.names)}")
    problem = likelihood_of(estimate, measured)
    i = estimate.names.index(name)
    sd = estimate.standard_deviations[i]
    around = np.clip(estimate.values[i] + reach * sd * np.array([-1, 1]), estimate.lower[i], estimate.upper[i])
    held = np.linspace(around[0], around[1], points)
    theta = _conditional(problem, estimate, i, held, iterations)
    at, values = problem.normal(np.asarray(estimate.values)[None]), problem.normal(theta).value
    deviance = 2 * (values - min(float(at.value[0]), float(np.min(values))))
    deviance *= inverse_information(at.hessian[0])[i, i] / estimate.covariance[i, i]
    return LikelihoodProfile(name, held, deviance, theta, _crossings(held, deviance))


def _conditional(problem: Problem, estimate: Estimate, i: int, held: Floats, iterations: int) -> Floats:
    """Best values of the others with parameter i fixed (k, p), by damped Gauss-Newton from the linear prediction."""
    parameters = problem.parameters
    covariance = estimate.covariance
    theta = estimate.values + (held - estimate.values[i])[:, None] * covariance[i] / covariance[i, i]
    margin = 1e-6 * (parameters.upper - parameters.lower)
    others = np.arange(len(parameters)) != i

    def inside(t: Floats) -> Floats:
        t = np.clip(t, parameters.lower + margin, parameters.upper - margin)
        t[:, i] = held
        return t

    theta = inside(theta)
    best = problem.normal(theta)
    damping = np.full(len(held), 1e-3)
    for _ in range(iterations):
        h = best.hessian[:, others][:, :, others]
        diagonal = np.einsum("kii->ki", h)
        h = h + damping[:, None, None] * diagonal[:, :, None] * np.eye(h.shape[-1])
        trial = theta.copy()
        trial[:, others] -= np.linalg.solve(h, best.gradient[:, others, None])[..., 0]
        trial = inside(trial)
        new = problem.normal(trial)
        better = new.value < best.value
        theta = np.where(better[:, None], trial, theta)
        damping = np.where(better, damping / 5, damping * 10)
        for old, latest in zip(best, new, strict=True):
            old[better] = latest[better]
    return theta


def _crossings(held: Floats, deviance: Floats) -> tuple[float, float]:
    """Where the deviance crosses the 95 % quantile, on either side of its minimum."""
    least = int(np.argmin(deviance))

    def cross(order: NDArray[np.intp], none: float) -> float:
        for a, b in itertools.pairwise(order):
            if deviance[a] <= CHI_SQUARED_95 < deviance[b]:
                roots = np.sqrt(np.maximum(deviance[[a, b]], 0))  # about linear, as the deviance is about quadratic
                share = (np.sqrt(CHI_SQUARED_95) - roots[0]) / (roots[1] - roots[0])
                return float(held[a] + share * (held[b] - held[a]))
        return none

    return cross(np.arange(least, -1, -1), -np.inf), cross(np.arange(least, len(held)), np.inf)
