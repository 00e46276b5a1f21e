"""The problem that fitting methods solve, the methods' base class, and checkpoints.

A method asks for evaluations and receives their results; the loop runs on the host.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fitting.evaluation import Evaluator, Prediction
from fitting.objective import Normal, Objective
from fitting.parameters import Parameters
from fitting.programs import POSITION
from fitting.trials_evaluator import TrialsEvaluator
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import read_json, write_text
from pftwin.dynamics.batch.devices import Devices
from pftwin.model.scene import Scene

_ROUNDS = 4  # most iterations of `bounded_steps`, per parameter: releases are few
_NOTHING = 1e-9  # gradient on a stopped parameter that counts as zero, as a share of the largest at the start


class Request(NamedTuple):
    """The evaluations that a method asks for."""

    theta: Floats  # (N, p)
    substeps: int
    want: Literal["value", "gradient", "normal"] = "value"  # value, also its gradient, or also the Hessian


class ProblemAnswer(NamedTuple):
    """Objective (infinite if the prediction is not usable), and gradient and Gauss-Newton Hessian if requested."""

    value: Floats  # (N,)
    gradient: Floats | None = None  # (N, p)
    hessian: Floats | None = None  # (N, p, p)


@dataclass(eq=False)
class Problem:
    """Scenes of one or several trials, their free parameters, and the objective that compares them with the data."""

    scene: Scene  # of the first trial
    parameters: Parameters
    objective: Objective
    evaluator: Evaluator | TrialsEvaluator

    @staticmethod
    def of(
        scenes: Sequence[Scene],
        parameters: Sequence[Parameters],
        objective: Objective,
        computed: tuple[str, ...] | None = None,
        devices: Devices = "all",
    ) -> Problem:
        """A problem for every trial's nominal scene and free parameters, as in `fitting.trials`, with an evaluator that
        computes these channels on these devices. Raises InputError if a free parameter moves the point of the patella
        whose path was measured."""
        if POSITION in objective.channels:
            refuse_moved_point(scenes[0], parameters[0])
        own = [
            Evaluator(scene, free.shared, objective.channels, computed=computed, devices=devices)
            for scene, free in zip(scenes, parameters, strict=True)
        ]
        evaluator = own[0] if len(own) == 1 else TrialsEvaluator(tuple(own), parameters[0].differences)
        return Problem(scenes[0], parameters[0], objective, evaluator)

    @property
    def weighs_priors(self) -> bool:
        """Whether the weight of the measurements beside priors matters."""
        return self.objective.kind != "paper" and any(p.prior for p in self.parameters.items)

    def answer(self, request: Request) -> ProblemAnswer:
        """Evaluates the objective, with priors, as requested."""
        theta = np.atleast_2d(request.theta)
        prior, pull, _ = self.parameters.prior_terms(theta)
        if request.want == "value":
            return ProblemAnswer(self.objective.value(self.evaluator.values(theta, request.substeps)) + prior)
        if request.want == "gradient":
            prediction = self.evaluator.values(theta, request.substeps)
            values = np.where(prediction.usable[:, None, None], prediction.values, 0.0)
            gradient = self.evaluator.gradients(theta, request.substeps, self.objective.pull(values))
            value = self.objective.value(prediction)
            known = np.isfinite(value) & np.isfinite(gradient).all(axis=1)
            return ProblemAnswer(np.where(known, value + prior, np.inf), np.where(known[:, None], gradient + pull, 0.0))
        return ProblemAnswer(*self.normal(theta, request.substeps))

    def normal(self, theta: Floats, substeps: int | None = None) -> Normal:
        """Objective with priors, its gradient and Hessian; by default with fine steps."""
        prior, pull, precision = self.parameters.prior_terms(theta)
        prediction = self.evaluator.with_slopes(theta, self.evaluator.fine if substeps is None else substeps)
        value, gradient, hessian = self.objective.normal(prediction)
        return Normal(value + prior, gradient + pull, hessian + np.diag(precision))

    def quadratic_step(self, theta: Floats, substeps: int) -> Floats:
        """Step from parameters (p,) to the minimum of the quadratic model there, within the bounds."""
        normal, p = self.normal(theta[None], substeps), self.parameters
        span, u = p.upper - p.lower, p.share(theta)
        hessian = normal.hessian[0] * np.outer(span, span)
        hessian = hessian + 1e-12 * np.trace(hessian) * np.eye(len(u))
        return bounded_steps(hessian, normal.gradient[0] * span, -u, 1 - u) * span

    def prediction(self, theta: Floats, substeps: int) -> Prediction:
        """Prediction with derivatives, at one point (p,)."""
        return self.evaluator.with_slopes(theta[None], substeps)

    def fingerprint(self, *settings: Any) -> str:
        """A hash of everything that determines a fit's iterates: scene, parameters, measurements and these settings."""
        total = hashlib.sha256()
        arrays, fixed = eqx.partition([scene.unnamed() for scene in self.evaluator.scenes], eqx.is_array)
        texts = [jax.tree.structure(arrays), jax.tree.leaves(fixed), jax.tree.structure(fixed)]
        o = self.objective
        texts += [self.parameters, o.kind, o.channels, o.stated_noise, o.loss, settings, self.evaluator.computed]
        total.update(repr(texts).encode())
        weights = () if o.metric is None else (o.metric.frames,)
        for array in (*jax.tree.leaves(arrays), o.measured, o.present, *weights):
            total.update(np.ascontiguousarray(array).tobytes())
        return total.hexdigest()


def refuse_moved_point(scene: Scene, parameters: Parameters) -> None:
    """Raises InputError if a free parameter moves the tracked point of the patella: it could then fit any measured
    path."""
    for p in parameters.items:
        if scene.contact is None or scene.contact.name not in {place.owner for place in (p.place, *p.place.tied)}:
            continue
        there = (p.place.written(scene, jnp.asarray(v, float)) for v in (p.lower, p.upper))
        low, high = (np.asarray(s.tracked_point().array()) for s in there)
        if np.abs(high - low).max() > 0:
            found = f"{p.name} moves the point of the patella whose path was measured"
            remedy = f"{scene.contact.name}.placement of an elastic foundation, which leaves the point where it is"
            raise InputError(found, where="free", expected="numbers that leave it where it is", remedy=remedy)


def bounded_steps(matrix: Floats, gradient: Floats, lowest: Floats, highest: Floats) -> Floats:
    """Steps to the minima of quadratics within bounds, by a primal active-set method, in a batch. Arguments: Hessians
    (..., p, p), positive definite; gradients (..., p) at the start; steps to the bounds (..., p), the lowest at most 0
    and the highest at least 0.

    Moves towards the minimum over the free parameters, stops the first that meets its bound, continues with the others,
    and releases stopped ones that are pulled inwards once the others have arrived; the objective decreases throughout.
    Source: Nocedal & Wright 2006, Numerical Optimization, section 16.5.
    """
    count, shape = matrix.shape[-1], matrix.shape[:-1]
    lowest, highest = np.minimum(lowest, 0.0), np.maximum(highest, 0.0)  # rounding may have passed a bound
    size = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    step = np.zeros(shape)
    pull = np.broadcast_to(-gradient, shape)
    nothing = _NOTHING * (np.abs(pull) / size).max(axis=-1, keepdims=True)
    stopped = ((pull > 0) & (highest == 0)) | ((pull < 0) & (lowest == 0))
    for _ in range(_ROUNDS * (count + 1)):
        free = ~stopped
        among = np.where(free[..., :, None] & free[..., None, :], matrix, np.eye(count))
        ahead = np.linalg.solve(among, np.where(free, pull, 0.0)[..., None])[..., 0]
        room = np.where(ahead > 0, highest - step, step - lowest)
        share = np.where(np.abs(ahead) > room, room / np.maximum(np.abs(ahead), 1e-300), np.inf)
        least = share.min(axis=-1, keepdims=True)
        met = np.isfinite(share) & (share <= least)
        bound = np.where(ahead > 0, highest, lowest)
        step = np.where(met, bound, np.clip(step + np.minimum(least, 1.0) * ahead, lowest, highest))
        stopped = stopped | met
        pull = -gradient - np.einsum("...ij,...j->...i", matrix, step)
        inward = np.where(((pull < 0) & (step >= highest)) | ((pull > 0) & (step <= lowest)), np.abs(pull) / size, 0.0)
        most = np.where(stopped & np.isinf(least), inward, 0.0)
        release = (most > nothing) & (most >= most.max(axis=-1, keepdims=True))
        stopped = stopped & ~release
        if np.isinf(least).all() and not release.any():
            break
    return step


State = dict[str, Any]  # arrays, numbers, strings and None: everything a method knows, so that a checkpoint can hold it


MOST_SEED = 2**63 - 1  # largest seed that both JAX's and NumPy's generators accept


class Method(ABC):
    """A search method. All its randomness comes from the seed, and its state holds everything it knows."""

    name: ClassVar[str]
    options: ClassVar[tuple[str, ...]]  # names of options that a user may set
    values: ClassVar[str] = "value"  # key of the objective's values in its state
    most_iterations: int
    starts: int  # number of points from which it starts
    rough: ClassVar[bool] = False  # whether its answer must be refined by another search from there
    widest: int | None = None  # largest batch without derivatives that it asks for; None: all have derivatives

    def __init__(self, problem: Problem, seed: int) -> None:
        self.problem, self.seed = problem, seed

    @abstractmethod
    def begin(self) -> State:
        """The state before the first evaluation."""

    @abstractmethod
    def ask(self, state: State) -> Request:
        """The evaluations that it needs next."""

    @abstractmethod
    def tell(self, state: State, request: Request, answer: ProblemAnswer) -> None:
        """Updates the state with the answer. Sets state["stopped"] to the reason when the search ends."""

    def settings(self) -> tuple[Any, ...]:
        """Settings that, with problem and seed, determine its iterates."""
        return (self.starts, self.most_iterations)

    def spread(self, state: State) -> float:
        """The range of the objective's finite values, a measure of progress; infinite if there are none."""
        values = state[self.values]
        finite = values[np.isfinite(values)]
        return float(np.ptp(finite)) if finite.size else np.inf

    def scattered_starts(self) -> Floats:
        """The nominal point and others throughout the bounds (starts, p)."""
        p = self.problem.parameters
        others = p.scattered(max(self.starts - 1, 1), np.random.default_rng(self.seed))[: self.starts - 1]
        return np.concatenate([p.nominal[None], others])

    @staticmethod
    def blank() -> State:
        """The entries that every state has."""
        return {"best_value": float("inf"), "best_theta": None, "dropped": 0, "stopped": None}


@contextmanager
def standard_promotion() -> Iterator[None]:
    """JAX's default promotion of types and ranks, which optimisation libraries need."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


FORMAT = "pftwin fit checkpoint 1"


def save_checkpoint(path: Path, problem: str, state: dict[str, Any]) -> None:
    """Writes a state. Raises OutputError if it cannot be written."""
    write_text(path, json.dumps({"format": FORMAT, "problem": problem, "state": state}, default=_as_json))


def load_checkpoint(path: Path, problem: str) -> dict[str, Any]:
    """Reads the saved state of this problem. Raises InputError if there is no such file, or it is no checkpoint of this
    problem."""
    content = read_json(path, expected=f"a file of {FORMAT!r}")
    try:
        if content["format"] != FORMAT:
            raise KeyError(content["format"])
        state = _restored(content["state"])
        saved_of = content["problem"]
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"no checkpoint of a fit: {error}", where=path, expected=f"a file of {FORMAT!r}") from None
    if saved_of != problem:
        raise InputError(
            "a checkpoint of another problem",
            where=path,
            expected="the same scene, measurements, parameters, bounds, objective, method and seed",
            remedy="the command that it came from, or a fit without it",
        )
    return state


def _as_json(value: np.ndarray | np.generic) -> Any:
    """Converts to plain JSON values; Python's decimal notation restores every float exactly."""
    if isinstance(value, np.generic):
        return value.item()
    return {"array": value.ravel().tolist(), "shape": list(value.shape), "dtype": value.dtype.str}


def _restored(value: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {"array", "shape", "dtype"}:
            return np.array(value["array"], dtype=value["dtype"]).reshape(value["shape"])
        return {k: _restored(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_restored(v) for v in value]
    return value
