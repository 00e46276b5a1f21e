"""evosax's CMA-ES and differential evolution with the interface of `Method`. Needs the extra `evosax`.

They search the unit box; points outside it are mirrored back at the bounds.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from fitting.methods.populations import Generations, has_stalled
from fitting.methods.problem import Problem, ProblemAnswer, Request, State, standard_promotion
from pftwin.base.arrays import Floats
from pftwin.base.errors import MissingExtraError

_SPREAD = 0.3  # standard deviation of CMA-ES's first generation, as a share of the range


@lru_cache(maxsize=8)
def _algorithm(name: str, population: int, parameters: int) -> tuple[Any, Any, Any]:
    """The algorithm, its settings and its state's structure, cached so that each kind is compiled once."""
    try:
        from evosax import algorithms
    except ImportError as error:
        raise MissingExtraError("evosax", extra="evosax", feature=f"the method {name!r}") from error
    kind = algorithms.CMA_ES if name == "cma_es" else algorithms.DifferentialEvolution
    with standard_promotion():  # evosax mixes types and ranks
        found, key = kind(population_size=population, solution=jnp.zeros(parameters)), jax.random.key(0)
        settings = found.default_params
        if name == "cma_es":
            settings = settings.replace(std_init=jnp.asarray(_SPREAD))
            state = found.init(key, jnp.zeros(parameters), settings)
        else:
            state = found.init(key, jnp.zeros((population, parameters)), jnp.zeros(population), settings)
    return found, settings, jax.tree.structure(state)


class _Strategy(Generations):
    """An evosax algorithm; its state is stored as plain arrays."""

    def __init__(
        self, problem: Problem, seed: int, population: int | None = None, generations: int | None = None
    ) -> None:
        super().__init__(problem, seed, population, generations)
        self._algorithm, self._params, self._structure = _algorithm(self.name, self.population, len(problem.parameters))

    def begin(self) -> State:
        """A first population throughout the bounds; CMA-ES draws its own about the nominal point."""
        random = np.random.default_rng(self.seed)
        first = random.uniform(size=(self.population, len(self.problem.parameters)))
        state = {**self.blank(), "leaves": None, "trial": first, "bests": [], "scores": np.zeros(0), "generation": 0}
        if self.name == "cma_es":
            with standard_promotion():
                mean = jnp.asarray(self.problem.parameters.share(self.problem.parameters.nominal), dtype=float)
                self._store(state, self._algorithm.init(self._key(0, 0), mean, self._params))
            state["trial"] = None
        return state

    def ask(self, state: State) -> Request:
        """The next population."""
        if state["trial"] is None:
            with standard_promotion():
                trial, inner = self._algorithm.ask(self._key(state["generation"], 1), self._inner(state), self._params)
            self._store(state, inner)
            state["trial"] = np.asarray(trial, dtype=np.float64)
        p = self.problem.parameters
        return Request(p.lower + (p.upper - p.lower) * mirrored(state["trial"]), self.problem.evaluator.coarse)

    def tell(self, state: State, request: Request, answer: ProblemAnswer) -> None:
        """Passes the fitness on; members without a finite one rank last."""
        value = np.where(np.isfinite(answer.value), answer.value, np.inf)
        finite = np.isfinite(value)
        fitness = jnp.asarray(np.where(finite, value, 1e30), dtype=float)
        trial, key = jnp.asarray(state["trial"], dtype=float), self._key(state["generation"], 2)
        with standard_promotion():
            if state["leaves"] is None:
                inner = self._algorithm.init(key, trial, fitness, self._params)
            else:
                inner, _ = self._algorithm.tell(key, trial, fitness, self._inner(state), self._params)
        self._store(state, inner)
        if state["generation"] == 0:
            state["dropped"] = int((~finite).sum())
        state["generation"] += 1
        state["trial"], state["scores"] = None, value
        if finite.any() and value.min() < state["best_value"]:
            state["best_value"], state["best_theta"] = float(value.min()), request.theta[int(np.argmin(value))].copy()
        state["bests"].append(state["best_value"])
        found, over = bool(np.isfinite(state["best_value"])), has_stalled(np.array(state["bests"]))
        state["stopped"] = self.reason_to_stop(found=found, over=over, generations=state["generation"])

    def _key(self, generation: int, purpose: int) -> Any:
        return jax.random.fold_in(jax.random.fold_in(jax.random.key(self.seed), generation), purpose)

    @staticmethod
    def _store(state: State, inner: Any) -> None:
        state["leaves"] = [np.asarray(leaf) for leaf in jax.tree.leaves(inner)]

    def _inner(self, state: State) -> Any:
        return jax.tree.unflatten(self._structure, [jnp.asarray(leaf) for leaf in state["leaves"]])


class CmaEs(_Strategy):
    """Covariance matrix adaptation (Hansen 2016), from the nominal point."""

    name = "cma_es"


class DifferentialEvolution(_Strategy):
    """Differential evolution (Storn and Price 1997), with the best member as base."""

    name = "differential_evolution"


def mirrored(x: Floats) -> Floats:
    """Maps points into the unit box by mirroring them at its sides as often as needed."""
    folded = np.mod(x, 2.0)
    return np.where(folded > 1, 2 - folded, folded)
