"""optimistix's Levenberg-Marquardt mapped over starts: what `fitting.methods.least_squares` would be if it used the
library.

The residuals are the paper's objective's own: an axis' residuals over the square root of their number times their root
mean square, so that their sum of squares is the sum of the three root mean squares. The library differentiates them
through the whole simulation; the number of time steps is fixed in the program, and so is each start's first guess of
the equilibrium. A step evaluates every start with its derivatives, whether that start has come to an end or not.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fitting.methods.problem import Problem, standard_promotion
from fitting.parameters import applied
from pftwin.base.errors import MissingExtraError
from pftwin.base.spatial import Pose
from pftwin.dynamics.frame_states import starting_equilibrium
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.model.number_place import NumberPlace
from pftwin.model.scene import Scene
from tests.benchmarks.fitting.methods.meter import Meter
from tests.benchmarks.problem import tracked_path

STARTS = 32  # as many as `fitting.methods.least_squares` has
_MOST_STEPS = 256  # the library's default
_RTOL, _ATOL = 1e-5, 1e-6


class Residuals(eqx.Module):
    """Residuals of a start as a function of its unbounded parameters."""

    scene: Scene
    lower: Array
    upper: Array
    measured: Array  # (n, 3), 0 where missing
    present: Array  # (n, 1)
    places: tuple[NumberPlace, ...] = eqx.field(static=True)
    substeps: int = eqx.field(static=True)

    @staticmethod
    def of(problem: Problem) -> Residuals:
        """Of a problem with the paper's objective."""
        p, o = problem.parameters, problem.objective
        lower, upper, measured, present = (
            jnp.asarray(a, dtype=float) for a in (p.lower, p.upper, np.nan_to_num(o.measured[:, :3]), o.present[:, :1])
        )
        scene, substeps = problem.scene.unnamed(), problem.evaluator.coarse
        return Residuals(scene, lower, upper, measured, present, p.places, substeps)

    def theta(self, u: Array) -> Array:
        """Within the bounds."""
        return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(u)

    def __call__(self, u: Array, guess: Pose) -> Array:
        """(3 n,)."""
        scene = applied(self.places, self.scene, self.theta(u))
        start = starting_equilibrium(scene, guess)
        path = tracked_path(scene, integrator=LinearImplicit(), substeps=self.substeps, start=start).array()
        off = self.present * (path - self.measured)
        count = jnp.sum(self.present)
        size = jnp.sqrt(jnp.sum(off**2, axis=0, keepdims=True) / count + 1e-14)
        return (off / jnp.sqrt(count * size)).ravel()


def optimistix_levenberg_marquardt(meter: Meter, seed: int) -> str:
    """All starts side by side, one step of each after another, until all have converged."""
    solver = _solver()
    p, residuals = meter.problem.parameters, Residuals.of(meter.problem)
    others = p.latin_hypercube(STARTS - 1, np.random.default_rng(seed))
    first = np.concatenate([p.nominal[None], others])
    guesses, u = meter.problem.evaluator.guesses(first), jnp.asarray(p.to_unbounded(first))
    with standard_promotion():
        state = _begin(solver, residuals, u, guesses)
        for _ in range(_MOST_STEPS):
            meter.check()
            u, state, ended = _step(solver, residuals, u, guesses, state)
            value = np.sum(np.asarray(state.f_info.residual) ** 2, axis=1)  # at u: a step that was refused is no best
            meter.note(p.to_bounded(np.asarray(u)), value, len(first) * (1 + len(p)))
            if bool(np.all(ended)):
                return "all starts converged"
    return f"{_MOST_STEPS} steps, the most allowed"


def _solver() -> Any:
    try:
        import optimistix
    except ImportError as error:
        raise MissingExtraError("optimistix", extra="benchmarks", feature="the comparison with optimistix") from error
    return optimistix.LevenbergMarquardt(rtol=_RTOL, atol=_ATOL)


@eqx.filter_jit
def _begin(solver: Any, residuals: Residuals, u: Array, guesses: Pose) -> Any:
    def one(u: Array, guess: Pose) -> Any:
        shape = jax.eval_shape(residuals, u, guess)
        return solver.init(_with_no_more(residuals), u, guess, {}, shape, None, frozenset())

    return eqx.filter_vmap(one, out_axes=eqx.if_array(0))(u, guesses)


@eqx.filter_jit
def _step(solver: Any, residuals: Residuals, u: Array, guesses: Pose, state: Any) -> Any:
    """New points, their states, and who has come to an end."""

    def one(u: Array, guess: Pose, state: Any) -> Any:
        function = _with_no_more(residuals)
        ended, _ = solver.terminate(function, u, guess, {}, state, frozenset())
        new_u, new, _ = solver.step(function, u, guess, {}, state, frozenset())
        kept_u, kept = _chosen(ended, (u, state), (new_u, new))
        return kept_u, kept, kept.terminate

    axes = (eqx.if_array(0), eqx.if_array(0), eqx.if_array(0))
    return eqx.filter_vmap(one, in_axes=axes, out_axes=eqx.if_array(0))(u, guesses, state)


def _chosen(first: Array, one: Any, other: Any) -> Any:
    """The arrays of the one or of the other; what is no array is alike in both."""
    return jax.tree.map(lambda a, b: jnp.where(first, a, b) if eqx.is_array(a) else a, one, other)


def _with_no_more(residuals: Residuals) -> Any:
    return lambda u, guess: (residuals(u, guess), None)
