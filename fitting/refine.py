"""Refining a treatment: single simulations with forward-mode derivatives, and sequential quadratic programming."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.course import Groove, course
from fitting.limits import Limit
from fitting.members import Recipe
from fitting.outcomes import MEASURES, measure
from fitting.predict import Fitted
from fitting.treatments import Treatment
from pftwin.dynamics.observe import observe
from pftwin.dynamics.trajectory import substeps_for, trajectory
from pftwin.scene import Scene

_ITERATIONS = 30
_ROOM = 1e-6  # of a limit's size: what the search keeps clear of it, so that its answer keeps the limit
_HALVINGS = 12
_CLOSE = 1e-4  # of the effort: where halving ends
Floats = NDArray[np.float64]


@eqx.filter_jit
def _looked(recipe: Recipe, places: tuple[int, ...], fixed: Array, theta: Array, amounts: Array) -> Any:
    """Outcomes at some amounts, and their derivatives by them."""

    def found(x: Array) -> Any:
        scene = recipe.made(fixed.at[jnp.asarray(places)].set(x), theta)
        seen = observe(scene, trajectory(scene, substeps=recipe.substeps))
        return measure(course(scene, seen, recipe.groove), recipe.threshold)

    # Columns side by side: one pass of the loop serves them all.
    push = jax.vmap(lambda t: jax.jvp(found, (amounts,), (t,)), out_axes=(None, 0))
    return push(jnp.eye(len(places), dtype=amounts.dtype))


class Search:
    """Single simulations with derivatives, each amounts' kept."""

    def __init__(
        self,
        scene: Scene,
        treatment: Treatment,
        names: tuple[str, ...],
        estimate: Fitted | None,
        limits: tuple[Limit, ...],
        dt: float,
        threshold: float,
    ) -> None:
        own = treatment.names
        self._places = tuple(next(i for i, n in enumerate(own) if name in (n, n.rpartition(".")[2])) for name in names)
        self._fixed = jnp.stack([jnp.asarray(v, dtype=float) for v in treatment.values])
        self._treatment = treatment
        substeps = substeps_for(scene.motion.frame_interval, dt)
        fitted = None if estimate is None else estimate.apply
        prepared = treatment.prepared(scene)
        self._recipe = Recipe(scene.unnamed(), prepared, fitted, Groove.of(scene), substeps, threshold, False)
        self._theta = jnp.asarray(np.zeros(0) if estimate is None else estimate.values, dtype=float)
        self._limits = limits
        self._known: dict[bytes, Any] = {}

    @property
    def count(self) -> int:
        """Simulations so far."""
        return len(self._known)

    def _at(self, amounts: Floats) -> Any:
        key = np.asarray(amounts, dtype=np.float64).tobytes()
        if key not in self._known:
            numbers = (self._fixed, self._theta, jnp.asarray(amounts, dtype=float))
            self._known[key] = jax.tree.map(np.asarray, _looked(self._recipe, self._places, *numbers))
        return self._known[key]

    def outcomes(self, amounts: Floats) -> dict[str, float]:
        """By name, SI."""
        return {name: float(self._at(amounts)[0][name]) for name in MEASURES}

    def room(self, amounts: Floats) -> Floats:
        """Of each limit, in its size."""
        found = self._at(amounts)[0]
        room = np.array([float(lim.room(found[lim.outcome])) / lim.size for lim in self._limits])
        return np.where(np.isfinite(room), room, -1e3)

    def slope(self, amounts: Floats) -> Floats:
        """(limits, amounts)."""
        slopes = self._at(amounts)[1]
        rows = [(-1 if lim.at_most is not None else 1) * slopes[lim.outcome] / lim.size for lim in self._limits]
        return np.nan_to_num(np.stack(rows))

    def treated(self, amounts: Floats) -> Treatment:
        """The treatment with these amounts."""
        values = self._fixed.at[jnp.asarray(self._places)].set(jnp.asarray(amounts, dtype=float))
        return self._treatment.with_values(list(values))


def refined(search: Search, start: Floats, lower: Floats, upper: Floats, scale: Floats) -> Floats:
    """The smallest amounts near the start that meet the limits; the start where nothing smaller does."""
    from scipy.optimize import minimize

    best = start
    tried: list[Floats] = []

    def room(x: Floats) -> Floats:
        tried.append(x * scale)
        return search.room(x * scale) - _ROOM

    constraint: Any = {"type": "ineq", "fun": room, "jac": lambda x: search.slope(x * scale) * scale}
    minimize(
        lambda x: 0.5 * float(x @ x),
        start / scale,
        jac=lambda x: x,
        method="SLSQP",
        bounds=list(zip(lower / scale, upper / scale, strict=True)),
        constraints=[constraint],
        options={"maxiter": _ITERATIONS, "ftol": 1e-10},
    )
    for amounts in tried:  # what was simulated on the way counts, wherever the search ended
        within = (amounts >= lower - 1e-12).all() and (amounts <= upper + 1e-12).all()
        if within and (search.room(amounts) >= 0).all() and effort(amounts, scale) < effort(best, scale):
            best = amounts
    return _nearer(search, best, np.clip(0.0 * best, lower, upper), scale)


def _nearer(search: Search, best: Floats, least: Floats, scale: Floats) -> Floats:
    """On the line from the least amounts to the best, where the limits are just met: for outcomes that jump."""
    if (search.room(least) >= 0).all():
        return least
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        if (high - low) * effort(best - least, scale) < _CLOSE:
            break
        middle = 0.5 * (low + high)
        if (search.room(least + middle * (best - least)) >= 0).all():
            high = middle
        else:
            low = middle
    return least + high * (best - least)


def effort(amounts: Floats, scale: Floats) -> float:
    """How large amounts are: the root of the sum of squares of their shares of the range."""
    return float(np.linalg.norm(amounts / scale))
