"""Gradient descent by reverse mode, for many parameters: optax's Adam from a few starts in a batch, then its L-BFGS.

One gradient costs as much for a hundred parameters as for one. Only first derivatives are available, and the objective
has kinks where contact begins and ends; so Adam goes first, which tolerates them.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fitting.methods.problem import Method, Problem, ProblemAnswer, Request, State, standard_promotion
from pftwin.base.arrays import Floats

RATE = 0.1  # of Adam, in the unbounded parameters
MEMORY = 10  # of L-BFGS
_LANES = 8  # step lengths tried in one call
_PATIENCE = 3  # consecutive steps of L-BFGS with too little gain before the search ends


class Gradient(Method):
    """Adam on all starts, then L-BFGS from the best."""

    name = "gradient"
    options = ("starts", "iterations")
    rough = True

    def __init__(self, problem: Problem, seed: int, starts: int = _LANES, iterations: int = 80) -> None:
        super().__init__(problem, seed)
        self.starts = starts
        self.widest = max(starts, _LANES)
        self.adam_iterations = iterations
        self.most_iterations = 2 * iterations
        problem.evaluator.pull_chunk = self.widest

    def begin(self) -> State:
        """The nominal point and others throughout the bounds."""
        u = self.problem.parameters.to_unbounded(self.scattered_starts())
        return {
            **self.blank(),
            "u": u,
            "value": np.full(len(u), np.inf),
            "gradient": np.zeros_like(u),
            "adam": _leaves(_adam(self.adam_iterations).init(jnp.asarray(u))),
            "lbfgs": None,
            "count": 0,
            "idle": 0,
            "direction": None,
        }

    def ask(self, state: State) -> Request:
        """Adam's points; then points along L-BFGS's direction, at distances that halve."""
        u = state["u"] if state["direction"] is None else self._along(state)
        return Request(self.problem.parameters.to_bounded(u), self.problem.evaluator.coarse, "gradient")

    def tell(self, state: State, request: Request, answer: ProblemAnswer) -> None:
        """Takes one step of Adam or of L-BFGS."""
        assert answer.gradient is not None
        gradient = answer.gradient * self.problem.parameters.slope(request.theta)
        i = int(np.argmin(answer.value))
        before = state["best_value"]
        if answer.value[i] < before:
            state["best_value"], state["best_theta"] = float(answer.value[i]), request.theta[i].copy()
        if state["direction"] is None:
            self._adam_step(state, answer.value, gradient)
        else:
            self._newton_step(state, answer.value, gradient)
            gained = before - state["best_value"]
            least_gain = 100 * self.problem.objective.tolerance(state["best_value"])
            state["idle"] = 0 if gained > least_gain else state["idle"] + 1
            if state["idle"] >= _PATIENCE:
                state["stopped"] = "the objective no longer decreases"
        state["count"] += 1
        if state["stopped"] is None and state["count"] >= self.most_iterations:
            state["stopped"] = f"{self.most_iterations} iterations, the most allowed"

    def _adam_step(self, state: State, value: Floats, gradient: Floats) -> None:
        alive = np.isfinite(value)
        if state["count"] == 0:
            state["dropped"] = int((~alive).sum())
        if not np.isfinite(state["best_value"]):
            state["stopped"] = "all starts failed"
            return
        state["value"] = value
        if state["count"] + 1 >= self.adam_iterations:
            best = self.problem.parameters.to_unbounded(state["best_theta"])
            state["u"], state["value"] = best[None], np.array([state["best_value"]])
            state["lbfgs"] = _leaves(_lbfgs().init(jnp.asarray(best)))
            state["direction"] = np.zeros_like(best)  # evaluating the point itself gives its gradient
            return
        # The starts' objectives differ by orders of magnitude; Adam uses the direction of their gradients alone.
        optimiser = _adam(self.adam_iterations)
        u, inner = jnp.asarray(state["u"]), _state_of(optimiser, state["u"], state["adam"])
        with standard_promotion():
            updates, inner = optimiser.update(jnp.asarray(np.where(alive[:, None], gradient, 0.0)), inner, u)
        state["adam"], state["u"] = _leaves(inner), np.asarray(u + updates)

    def _along(self, state: State) -> Floats:
        lengths = 2.0 ** -np.arange(_LANES)
        return state["u"][0] + lengths[:, None] * state["direction"]

    def _newton_step(self, state: State, value: Floats, gradient: Floats) -> None:
        at, i = self._along(state), int(np.argmin(value))
        first = not state["direction"].any()
        if not first and not value[i] < state["value"][0]:  # no gain along this direction: restart
            state["lbfgs"] = _leaves(_lbfgs().init(jnp.asarray(state["u"][0])))
            state["direction"] = -state["gradient"][0] / max(np.linalg.norm(state["gradient"][0]), 1e-300) * 0.05
            return
        state["u"], state["value"], state["gradient"] = at[i][None], value[i : i + 1], gradient[i][None]
        optimiser = _lbfgs()
        point = jnp.asarray(at[i])
        inner = _state_of(optimiser, at[i], state["lbfgs"])
        with standard_promotion():
            updates, inner = optimiser.update(jnp.asarray(gradient[i]), inner, point)
        direction = np.asarray(updates)
        longest = np.abs(direction).max()
        state["direction"] = direction * min(1.0, 1.0 / max(longest, 1e-300))
        state["lbfgs"] = _leaves(inner)


def _adam(iterations: int) -> Any:
    return optax.adam(optax.cosine_decay_schedule(RATE, max(iterations, 1), 0.05), b2=0.95)


def _lbfgs() -> Any:
    return optax.chain(optax.scale_by_lbfgs(memory_size=MEMORY), optax.scale(-1.0))


def _leaves(state: Any) -> list[Floats]:
    return [np.asarray(leaf) for leaf in jax.tree.leaves(state)]


def _state_of(optimiser: Any, like: Floats, leaves: list[Any]) -> Any:
    structure = jax.tree.structure(optimiser.init(jnp.asarray(like)))
    return jax.tree.unflatten(structure, [jnp.asarray(leaf) for leaf in leaves])
