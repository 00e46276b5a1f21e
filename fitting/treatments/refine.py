"""Refines a treatment: simulations with forward-mode derivatives, and sequential quadratic programming (SLSQP).

A single amount is bracketed instead (Brent): derivatives would take longer to compile than the whole search. The
requirement that a share of draws meets all limits is itself a constraint: on a quantile of the draws' least margin.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.prediction.members import MemberPrograms, Recipe, run
from fitting.prediction.outcomes import MEASURES, Groove, measure
from fitting.prediction.predicting import STEP, Fitted
from fitting.prediction.untreated import untrusted_starts
from fitting.treatments import Treatment
from fitting.treatments.limits import Limit
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.dynamics.batch.batched import batched
from pftwin.dynamics.frame_states import substeps_for
from pftwin.dynamics.status import status_facts_of_counts
from pftwin.model.scene import Scene

_ITERATIONS = 30
_ROOM = 1e-6  # safety margin of the search, as a share of a limit's scale, so that its answer meets the limit
_HALVINGS = 12
_NONE = -1e3  # margin if a value is missing
_CLOSE = 1e-4  # relative change of the effort at which bisection ends
_FINE = 1e-4  # tolerance of a single amount, as a share of the grid's step
CHUNK = 64  # variants per batch: one program for the grid and for draws, whose numbers vary


@eqx.filter_jit
def _outcomes_and_derivatives(
    recipe: Recipe, places: tuple[int, ...], fixed: Array, thetas: Array, amounts: Array
) -> Any:
    """Outcomes at given amounts (draws,), and their derivatives with respect to the amounts (amounts, draws)."""

    def found(x: Array) -> Any:
        def one(theta: Array) -> Any:
            scene = recipe.made(fixed.at[jnp.asarray(places)].set(x), theta)
            return measure(recipe.course(scene), recipe.threshold)

        return batched(one)(thetas)

    # All columns in one pass of the time loop.
    pushforward = jax.vmap(lambda t: jax.jvp(found, (amounts,), (t,)), out_axes=(None, 0))
    return pushforward(jnp.eye(len(places), dtype=amounts.dtype))


def places_of(treatment: Treatment, names: Collection[str]) -> tuple[int, ...]:
    """Indices of amounts in a treatment, by names with or without the kind's. Raises InputError for unknown ones."""
    own = treatment.names
    places = {n.rpartition(".")[2]: i for i, n in enumerate(own)} | {n: i for i, n in enumerate(own)}
    if stray := [n for n in names if n not in places]:
        raise InputError(f"no amount {stray[0]!r}", where="ranges", expected=f"one of: {', '.join(own)}")
    return tuple(places[n] for n in names)


class Search:
    """Simulations with derivatives, cached by their amounts."""

    def __init__(
        self,
        scene: Scene,  # untreated
        treatment: Treatment,  # with the values of the amounts that are not searched
        names: tuple[str, ...],  # of the amounts that are searched
        estimate: Fitted | None,  # parameters that replace the scene's own
        limits: tuple[Limit, ...],
        thetas: Floats,  # parameters (1 + draws, p): the estimate's, then draws from its uncertainty
        confidence: float,  # share of the draws that must meet all limits
        dt: float | None,  # longest time step [s]; None: as in `predict`
        threshold: float,  # beyond which the button counts as dislocated [m]
    ) -> None:
        self._places = places_of(treatment, names)
        self._fixed = jnp.stack([jnp.asarray(v, dtype=float) for v in treatment.values])
        self._treatment = treatment
        self._care = dt is None
        substeps = jnp.asarray(substeps_for(scene.motion.frame_interval, STEP if dt is None else dt))
        fitted = None if estimate is None else estimate.apply
        prepared = treatment.prepared(scene)
        self._recipe = Recipe(scene.unnamed(), prepared, fitted, Groove.of(scene), substeps, threshold, False)
        self._programs = MemberPrograms(self._recipe, CHUNK, CHUNK)  # with the programs that simulated the grid
        self._scene = scene
        self._thetas = jnp.asarray(thetas, dtype=float)
        self._limits, self._draws = limits, len(thetas) - 1
        self._needed = math.ceil(confidence * self._draws - 1e-9)
        self._known: dict[bytes, Any] = {}
        self.alone = len(names) == 1

    @property
    def count(self) -> int:
        """The number of simulations so far."""
        return len(self._known) * (1 + self._draws)

    def met(self, lower: Floats, upper: Floats) -> list[Floats]:
        """The simulated amounts within a range that meet the limits, and do so in the required share of draws."""
        tried = (np.frombuffer(key) for key in self._known)
        return [a for a in tried if _within(a, lower, upper) and (self.room(a) >= 0).all()]

    def _at(self, amounts: Floats) -> Any:
        """Outcomes for the estimate and the draws (1 + draws,), and their derivatives (None for a single amount).

        For a single amount also the number of frames with each flag (1 + draws, flags); the run with derivatives does
        not estimate the error of its steps.
        """
        key = np.asarray(amounts, dtype=np.float64).tobytes()
        if key not in self._known:
            if self.alone:
                every, thetas = np.array(self._fixed), np.asarray(self._thetas)
                every[list(self._places)] = amounts
                members = run(self._programs, np.tile(every, (len(thetas), 1)), thetas, care=self._care)
                self._known[key] = members.outcomes, None, members.flags
            else:
                numbers = (self._fixed, self._thetas, jnp.asarray(amounts, dtype=float))
                found = _outcomes_and_derivatives(self._recipe, self._places, *numbers)
                self._known[key] = *jax.tree.map(np.asarray, found), None
        return self._known[key]

    def outcomes(self, amounts: Floats) -> dict[str, float]:
        """Outcomes for the estimate by name, SI units."""
        return {name: float(self._at(amounts)[0][name][0]) for name in MEASURES}

    def status(self, amounts: Floats) -> dict[str, Any]:
        """`status_facts` of the estimate's motion; empty for several amounts, whose error is not known."""
        counts = self._at(amounts)[2]
        return {} if counts is None else status_facts_of_counts(counts[0])

    def _rooms(self, amounts: Floats) -> Floats:
        """Scaled margins of each limit, for the estimate and the draws (limits, 1 + draws)."""
        found = self._at(amounts)[0]
        rooms = np.stack([lim.room(found[lim.outcome]) / lim.size for lim in self._limits])
        return np.where(np.isfinite(rooms) & ~self._lost, rooms, _NONE)

    @cached_property
    def _lost(self) -> NDArray[np.bool_]:
        """Which rows of parameters (1 + draws,) start INVALID untreated; they meet no limit."""
        return np.array([bool(why) for why in untrusted_starts(self._programs, self._scene, np.asarray(self._thetas))])

    def share(self, amounts: Floats) -> float:
        """Share of the draws that meet all limits."""
        return float((self._rooms(amounts)[:, 1:] >= 0).all(axis=0).mean())

    def room(self, amounts: Floats) -> Floats:
        """Scaled margin of each limit for the estimate; with draws also that of the required share."""
        rooms = self._rooms(amounts)
        if not self._draws:
            return rooms[:, 0]
        return np.append(rooms[:, 0], np.sort(rooms[:, 1:].min(axis=0))[-self._needed])

    def slope(self, amounts: Floats) -> Floats:
        """Derivatives (limits, amounts); with draws an additional row, for the draw that decides the share."""
        slopes = self._at(amounts)[1]
        all_ = np.stack([(-1 if x.at_most is not None else 1) * slopes[x.outcome] / x.size for x in self._limits])
        rows = all_[:, :, 0]
        if self._draws:
            rooms = self._rooms(amounts)[:, 1:]
            draw = int(np.argsort(rooms.min(axis=0))[-self._needed])
            rows = np.concatenate([rows, all_[None, int(np.argmin(rooms[:, draw])), :, 1 + draw]])
        return np.nan_to_num(rows)

    def treated(self, amounts: Any) -> Treatment:
        """The treatment with these amounts: (k,), or a list of variants (n, k)."""
        columns = np.moveaxis(np.asarray(amounts, dtype=np.float64), -1, 0)
        values: list[Any] = [jnp.broadcast_to(v, columns.shape[1:]) for v in self._fixed]
        for place, column in zip(self._places, columns, strict=True):
            values[place] = jnp.asarray(column, dtype=float)
        return self._treatment.with_values(values)


def refine(search: Search, start: Floats, below: Floats, lower: Floats, upper: Floats, scale: Floats) -> Floats:
    """The smallest amounts near a start that meet the limits; the start if nothing smaller does.

    `below`: for a single amount, the nearest smaller one that was tried and does not meet them.
    """
    if search.alone:
        return _just_met(search, start, below)
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
    for amounts in tried:  # every simulated point counts, wherever the search ended
        if (
            _within(amounts, lower, upper)
            and (search.room(amounts) >= 0).all()
            and effort(amounts, scale) < effort(best, scale)
        ):
            best = amounts
    return _bisect_toward(search, best, np.clip(0.0 * best, lower, upper), scale)


def _within(amounts: Floats, lower: Floats, upper: Floats) -> bool:
    return bool((amounts >= lower - 1e-12).all() and (amounts <= upper + 1e-12).all())


def _just_met(search: Search, best: Floats, below: Floats) -> Floats:
    """Smallest single amount that meets the limits, by bracketing from one that does not (Brent)."""
    from scipy.optimize import brentq

    met = {1.0: best}

    def room(share: float) -> float:
        amounts = below + share * (best - below)
        least = float(search.room(amounts).min())
        if least >= 0:
            met[share] = amounts
        return least - _ROOM

    if room(0.0) < 0 < room(1.0):
        brentq(room, 0.0, 1.0, xtol=_FINE)
    return met[min(met)]


def _bisect_toward(search: Search, best: Floats, least: Floats, scale: Floats) -> Floats:
    """Bisects on the line from the least amounts to the best, for outcomes that jump."""
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
    """Size of the amounts: the root of the sum of squares of their shares of the range."""
    return float(np.linalg.norm(amounts / scale))
