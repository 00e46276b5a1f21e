"""Multi-start Levenberg-Marquardt: all starts at once, coarse steps first, the wanted accuracy last.

Written out rather than optimistix's solver: that runs one start inside one compiled program, its trial points, its
residuals and their Jacobian with it. Mapped over starts it takes the Jacobian of every start as often as the slowest
needs, in the slower order of loops, with the number of time steps fixed; and nothing of it can be seen, saved or
interrupted on the way. Here the host asks for a batch with derivatives and does the small algebra itself.

Parameters are shares of their ranges, and bounds are bounds: steps end there (`_within`). Mapped to all real numbers,
valleys bend, and a best point at a bound is approached for ever.

A point with many derivatives costs the same alone as in a batch: they fill the processor's vectors. Where few starts
are left, each tries several dampings at once: where the patella jumps into the groove, one in many is better.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.methods.problem import Method, Problem, ProblemAnswer, Request, State, range_of

Floats = NDArray[np.float64]


class Phase(NamedTuple):
    """A phase of the search, with its own step length and limits."""

    keep: int  # how many of the best go on
    fine: bool
    iterations: int  # at most
    worth: float  # a start's gain that is not worth another iteration, in tolerances of the objective


# Long steps cost a sixth of short ones, and valleys are as bent by them: short ones are for the end.
PHASES = (
    Phase(10**9, False, 4, 1e3),
    Phase(8, False, 6, 1e3),
    Phase(4, False, 30, 1.0),
    Phase(2, True, 40, 1.0),
)
_ROUGH = 1e3  # what the last phases count as worth it where another search follows
_POINTS, _COLUMNS = 4, 64  # points evaluated at once, at least, and times parameters: where fewer starts are left
_DAMPING = 1e-2  # to start with, of a diagonal's share
_STUCK = 1e7  # damping at which steps vanish
_LONGEST = 0.4  # step of a parameter
_EDGE = 1e-7  # how near to a bound steps lead
_SAME = 1e-2  # distance within which two starts count as one


class LeastSquares(Method):
    """Levenberg-Marquardt from many starts, with the nominal point among them."""

    name = "least_squares"
    options = ("starts",)

    def __init__(self, problem: Problem, seed: int, starts: int = 32, *, last: bool = False) -> None:
        """`last`: no search with the measurements counted anew follows (`fitting.correlated`)."""
        super().__init__(problem, seed)
        self.starts = starts
        self.least_worth = 0.0 if last or not problem.weighs_priors else _ROUGH
        self.most_iterations = sum(p.iterations for p in PHASES)

    def settings(self) -> tuple[Any, ...]:
        """What decides its course."""
        return (self.starts, PHASES, self.least_worth)

    def begin(self) -> State:
        """All starts, not yet evaluated."""
        u = np.clip(self.problem.parameters.share(self.scattered_starts()), _EDGE, 1 - _EDGE)
        n, k = u.shape
        return {
            **self.blank(),
            "phase": 0,
            "in_phase": 0,
            "looking": True,  # at the points themselves, rather than at steps from them
            "u": u,
            "value": np.full(n, np.inf),
            "gradient": np.zeros((n, k)),
            "hessian": np.zeros((n, k, k)),
            "damping": np.full(n, _DAMPING),
            "done": np.zeros(n, bool),
        }

    def ask(self, state: State) -> Request:
        """The points themselves, or steps from them with several dampings."""
        fine = PHASES[state["phase"]].fine
        substeps = self.problem.evaluator.fine if fine else self.problem.evaluator.coarse
        u = state["u"][:, None] if state["looking"] else self._trials(state)[0]
        return Request(self.problem.parameters.at_share(u.reshape(-1, u.shape[-1])), substeps, "normal")

    def tell(self, state: State, request: Request, answer: ProblemAnswer) -> None:
        """Accepts what is better."""
        assert answer.gradient is not None
        assert answer.hessian is not None
        span = self.problem.parameters.upper - self.problem.parameters.lower
        gradient, hessian = answer.gradient * span, answer.hessian * span[:, None] * span
        if state["looking"]:
            state.update(value=answer.value.copy(), gradient=gradient, hessian=hessian, looking=False)
            if state["phase"] == 0:
                alive = np.isfinite(answer.value)
                state["dropped"] += int((~alive).sum())
                self._keep(state, np.flatnonzero(alive))
        else:
            self._accept(state, answer.value, gradient, hessian)
            state["in_phase"] += 1
        self._note_best(state)
        if len(state["u"]) == 0:
            state["stopped"] = "all starts failed"
        elif self._phase_done(state) or state["in_phase"] >= PHASES[state["phase"]].iterations:
            self._next_phase(state)

    def spread(self, state: State) -> float:
        """Of the objective over the starts."""
        return range_of(state["value"])

    def _trials(self, state: State) -> tuple[Floats, Floats, Floats]:
        """Points (P, L, p), their dampings (P, L), and the decrease that the quadratic model promises (P, L)."""
        u, g, h = state["u"], state["gradient"], state["hessian"]
        points = max(_POINTS, _COLUMNS // u.shape[1])
        lanes = max(1, points // len(u))
        ladder = 10.0 ** (np.arange(lanes) - lanes // 2)
        damping = state["damping"][:, None] * ladder
        diagonal = np.diagonal(h, axis1=1, axis2=2)
        diagonal = diagonal + 1e-12 * diagonal.max(axis=1, keepdims=True) + 1e-300
        matrix = h[:, None] + damping[..., None, None] * (diagonal[:, None, :, None] * np.eye(u.shape[1]))
        step = _within(matrix, g[:, None], _EDGE - u[:, None], 1 - _EDGE - u[:, None])
        step *= np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=-1, keepdims=True), 1e-300))
        step = np.where(state["done"][:, None, None], 0.0, step)
        at = u[:, None] + step
        promised = -np.einsum("plk,pk->pl", step, g) - 0.5 * np.einsum("plk,pkj,plj->pl", step, h, step)
        return at, damping, promised

    def _accept(self, state: State, value: Floats, gradient: Floats, hessian: Floats) -> None:
        at, damping, promised = self._trials(state)
        parents, lanes = damping.shape
        table = value.reshape(parents, lanes)
        lane = np.argmin(table, axis=1)
        rows = np.arange(parents)
        which, new = rows * lanes + lane, table[rows, lane]
        better = (new < state["value"]) & ~state["done"]
        worth = max(PHASES[state["phase"]].worth, self.least_worth)
        tolerance = self.problem.objective.tolerance(state["value"]) * worth
        gained = np.where(better, state["value"] - np.where(better, new, 0.0), 0.0)
        state["u"] = np.where(better[:, None], at[rows, lane], state["u"])
        state["gradient"] = np.where(better[:, None], gradient[which], state["gradient"])
        state["hessian"] = np.where(better[:, None, None], hessian[which], state["hessian"])
        state["value"] = np.where(better, new, state["value"])
        used = damping[rows, lane]
        raised = damping[:, -1] * 10.0
        state["damping"] = np.clip(np.where(better, used / 5, raised), 1e-9, 10 * _STUCK)
        small = np.max(promised, axis=1) < tolerance
        state["done"] |= (better & (gained < tolerance)) | small | (state["damping"] > _STUCK)

    def _keep(self, state: State, which: NDArray[np.intp]) -> None:
        for key in ("u", "value", "gradient", "hessian", "damping", "done"):
            state[key] = state[key][which]

    @staticmethod
    def _best_done(state: State) -> bool:
        return bool(state["done"][int(np.argmin(state["value"]))])

    def _phase_done(self, state: State) -> bool:
        """Of the last phase with its best start; of others with all, for the one that comes first may end too high."""
        return self._best_done(state) if state["phase"] == len(PHASES) - 1 else bool(state["done"].all())

    def _note_best(self, state: State) -> None:
        if len(state["value"]) and np.isfinite(state["value"].min()):
            i = int(np.argmin(state["value"]))
            state["best_value"] = float(state["value"][i])
            state["best_theta"] = self.problem.parameters.at_share(state["u"][i])

    def _next_phase(self, state: State) -> None:
        if state["phase"] == len(PHASES) - 1:
            converged = self._best_done(state)
            state["stopped"] = "converged" if converged else "iterations ran out before the best start converged"
            return
        before = PHASES[state["phase"]]
        state["phase"] += 1
        phase = PHASES[state["phase"]]
        u = state["u"]
        chosen: list[int] = []
        for i in np.argsort(state["value"], kind="stable"):
            if len(chosen) < phase.keep and all(np.abs(u[i] - u[j]).max() > _SAME for j in chosen):
                chosen.append(int(i))
        self._keep(state, np.array(chosen))
        state["in_phase"], state["looking"] = 0, phase.fine != before.fine
        state["done"] = np.zeros(len(chosen), bool)
        state["damping"] = np.minimum(state["damping"], _DAMPING)


def _within(matrix: Floats, gradient: Floats, lowest: Floats, highest: Floats) -> Floats:
    """The steps that lead to the minima of quadratics within bounds, or near them.

    Goes towards the minimum over what is free, stops at its bound what meets one first, and goes on with the others,
    lower all the way. What was stopped is not let go again, so that steps may fall short where several are.

    Args:
        matrix: Hessians (..., p, p), positive definite.
        gradient: at the beginning (..., p).
        lowest: the steps to the bounds (..., p), and `highest`.
    """
    count = matrix.shape[-1]
    step, stopped = np.zeros(matrix.shape[:-1]), np.zeros(matrix.shape[:-1], bool)
    for _ in range(count + 1):
        free = ~stopped
        pull = np.where(free, -gradient - np.einsum("...ij,...j->...i", matrix, step), 0.0)
        among = np.where(free[..., :, None] & free[..., None, :], matrix, np.eye(count))
        ahead = np.linalg.solve(among, pull[..., None])[..., 0]
        room = np.where(ahead > 0, highest - step, step - lowest)
        share = np.where(np.abs(ahead) > room, room / np.maximum(np.abs(ahead), 1e-300), np.inf)
        least = share.min(axis=-1, keepdims=True)
        step = np.clip(step + np.minimum(least, 1.0) * ahead, lowest, highest)
        stopped |= np.isfinite(share) & (share <= least)
        if not np.isfinite(least).any():
            break
    return step
