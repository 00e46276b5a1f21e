"""Multi-start Levenberg-Marquardt: all starts in one batch, with coarse time steps first and fine ones last.

Implemented here because optimistix's solver, mapped over starts, computes the Jacobian of each as often as the slowest
start needs, with a fixed number of time steps, and its progress cannot be reported, saved or interrupted.

Parameters are shares of their ranges, and steps end a ten-millionth of the range before the bounds (`bounded_steps`).
Mapping them to all real numbers would curve valleys, and a minimum at a bound would be approached forever.

A point with many derivatives costs the same alone as in a batch, as its derivatives fill the processor's vector units.
When few starts are left, each tries several dampings in one call: where the patella falls into the groove the objective
jumps, and one of many steps is likely to improve it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.methods.problem import Method, Problem, ProblemAnswer, Request, State, bounded_steps
from pftwin.base.arrays import Floats


class Phase(NamedTuple):
    """A phase of the search, with its own step length and limits."""

    keep: int  # number of best starts that continue
    fine: bool  # whether time steps are fine
    iterations: int  # at most
    least_gain: float  # least gain of a start that justifies another iteration, in tolerances of the objective
    damping: float = 1e-2  # largest initial damping, as a share of the diagonal


# Several starts continue to the end: where the patella falls into the groove the objective has many close minima.
PHASES = (Phase(10**9, False, 4, 1e3), Phase(8, False, 10, 1e3), Phase(8, True, 40, 1e3))
NEAR = (Phase(1, True, 40, 1.0, damping=1e-5),)  # from the end point of another search
_FEWEST, _MOST, _COLUMNS = 4, 16, 64  # least and most points per call if few starts are left; points times parameters
_LEAST, _FLAT = 1e-10, 1e-200  # least damping and diagonal: no matrix is singular
_STUCK = 1e7  # damping at which steps vanish
_LONGEST = 0.4  # largest step of a parameter, as a share of its range
_EDGE = 1e-7  # least distance from a bound, as a share of the range
_SAME = 1e-2  # distance within which two starts count as one


class LeastSquares(Method):
    """Levenberg-Marquardt from many starts, including the nominal point."""

    name = "least_squares"
    options = ("starts",)
    rough = True

    def __init__(self, problem: Problem, seed: int, starts: int = 32, *, near: bool = False) -> None:
        """With `near`, the nominal point is nearly the answer, and the only start."""
        super().__init__(problem, seed)
        self.starts, self.phases = (1, NEAR) if near else (starts, PHASES)
        self.most_iterations = sum(p.iterations for p in self.phases)

    def settings(self) -> tuple[Any, ...]:
        """Settings that, with problem and seed, determine its iterates."""
        return (self.starts, self.phases, _FEWEST, _MOST, _COLUMNS, _LONGEST, _EDGE)

    def begin(self) -> State:
        """All starts, not yet evaluated."""
        u = np.clip(self.problem.parameters.share(self.scattered_starts()), _EDGE, 1 - _EDGE)
        n, k = u.shape
        return {
            **self.blank(),
            "phase": 0,
            "in_phase": 0,
            "looking": True,  # whether the points themselves are evaluated, not steps from them
            "u": u,
            "value": np.full(n, np.inf),
            "gradient": np.zeros((n, k)),
            "hessian": np.zeros((n, k, k)),
            "damping": np.full(n, self.phases[0].damping),
            "done": np.zeros(n, bool),
        }

    def ask(self, state: State) -> Request:
        """The points themselves, or steps from them with several dampings."""
        fine = self.phases[state["phase"]].fine
        substeps = self.problem.evaluator.fine if fine else self.problem.evaluator.coarse
        u = state["u"] if state["looking"] else self._trials(state)[1]
        return Request(self.problem.parameters.at_share(u.reshape(-1, u.shape[-1])), substeps, "normal")

    def tell(self, state: State, request: Request, answer: ProblemAnswer) -> None:
        """Accepts steps that decrease the objective."""
        assert answer.gradient is not None
        assert answer.hessian is not None
        span = self.problem.parameters.upper - self.problem.parameters.lower
        gradient, hessian = answer.gradient * span, answer.hessian * span[:, None] * span
        if state["looking"]:
            state.update(value=answer.value.copy(), gradient=gradient, hessian=hessian, looking=False)
            alive = np.isfinite(answer.value)
            state["dropped"] += int((~alive).sum())
            self._keep(state, np.flatnonzero(alive))
        else:
            self._accept(state, answer.value, gradient, hessian)
            state["in_phase"] += 1
        self._note_best(state)
        if len(state["u"]) == 0:
            state["stopped"] = "all starts failed"
        elif state["done"].all() or state["in_phase"] >= self.phases[state["phase"]].iterations:
            self._next_phase(state)

    def _trials(self, state: State) -> tuple[NDArray[np.intp], Floats, Floats, Floats]:
        """Indices of the unfinished starts (P,); trial points (P, L, p), their dampings (P, L), and the decrease that
        the quadratic model predicts (P, L)."""
        which = np.flatnonzero(~state["done"])
        u, g, h = state["u"][which], state["gradient"][which], state["hessian"][which]
        points = max(_FEWEST, min(_MOST, _COLUMNS // u.shape[1]))
        if self.problem.evaluator.in_turns:  # batching saves nothing
            points = _FEWEST
        points = max(points, self.problem.evaluator.slope_chunk)  # an accelerator's call takes as long half empty
        count = max(1, points // len(u))
        ladder = 10.0 ** (np.arange(count) - count // 2)
        damping = np.maximum(state["damping"][which, None] * ladder, _LEAST)
        diagonal = np.diagonal(h, axis1=1, axis2=2)
        diagonal = diagonal + 1e-12 * diagonal.max(axis=1, keepdims=True) + _FLAT
        matrix = h[:, None] + damping[..., None, None] * (diagonal[:, None, :, None] * np.eye(u.shape[1]))
        step = bounded_steps(matrix, g[:, None], _EDGE - u[:, None], 1 - _EDGE - u[:, None])
        step *= np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=-1, keepdims=True), 1e-300))
        promised = -np.einsum("plk,pk->pl", step, g) - 0.5 * np.einsum("plk,pkj,plj->pl", step, h, step)
        return which, u[:, None] + step, damping, promised

    def _accept(self, state: State, value: Floats, gradient: Floats, hessian: Floats) -> None:
        which, at, damping, promised = self._trials(state)
        table = value.reshape(damping.shape)
        best = np.argmin(table, axis=1)
        rows = np.arange(len(which))
        new, old = table[rows, best], state["value"][which]
        better = new < old
        tolerance = self.problem.objective.tolerance(old) * self.phases[state["phase"]].least_gain
        chosen = rows * damping.shape[1] + best
        found = {"u": at[rows, best], "gradient": gradient[chosen], "hessian": hessian[chosen], "value": new}
        for key, values in found.items():
            state[key][which[better]] = values[better]
        further = np.where(better, damping[rows, best] / 5, damping[:, -1] * 10.0)
        state["damping"][which] = np.clip(further, 1e-9, 10 * _STUCK)
        gained = np.where(better, old - np.where(better, new, 0.0), np.inf)
        state["done"][which] = (gained < tolerance) | (promised.max(axis=1) < tolerance) | (further > _STUCK)

    def _keep(self, state: State, which: NDArray[np.intp]) -> None:
        for key in ("u", "value", "gradient", "hessian", "damping", "done"):
            state[key] = state[key][which]

    def _note_best(self, state: State) -> None:
        if len(state["value"]) and np.isfinite(state["value"].min()):
            i = int(np.argmin(state["value"]))
            state["best_value"] = float(state["value"][i])
            state["best_theta"] = self.problem.parameters.at_share(state["u"][i])

    def _next_phase(self, state: State) -> None:
        if state["phase"] == len(self.phases) - 1:
            converged = state["done"][int(np.argmin(state["value"]))]
            state["stopped"] = "converged" if converged else "iterations ran out before the best start converged"
            return
        before = self.phases[state["phase"]]
        state["phase"] += 1
        phase = self.phases[state["phase"]]
        u = state["u"]
        chosen: list[int] = []
        for i in np.argsort(state["value"], kind="stable"):
            if len(chosen) < phase.keep and all(np.abs(u[i] - u[j]).max() > _SAME for j in chosen):
                chosen.append(int(i))
        self._keep(state, np.array(chosen))
        state["in_phase"], state["looking"] = 0, phase.fine != before.fine
        state["done"] = np.zeros(len(chosen), bool)
        state["damping"] = np.minimum(state["damping"], phase.damping)
