"""Integrators by name. Each takes one step from state to state, and declares its order.

A name may have options: "newmark:gamma=0.6,beta=0.3025", "newmark:rho=0.8", "diffrax:Kvaerno5:rtol=1e-9".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from inspect import signature
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.dynamics import (
    ali3p,
    diffrax_solver,
    linear_implicit,
    linear_implicit_bdf2,
    newmark,
    quasi_static,
    symplectic_euler,
)
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.state import Guide, GuideAt, State, System
from pftwin.effects.base import Effect
from pftwin.errors import InputError
from pftwin.spatial import Scalar

Advance = Callable[[System, State, GuideAt, Scalar, Ledger | None], tuple[State, Ledger | None]]


def _as_it_is(system: System, state: State, guide: Guide, step: Scalar) -> State:
    return state


class Told(NamedTuple):
    """What an integrator tells of its steps in what its states carry: the field's name, None where it tells nothing."""

    unsettled: str | None = None  # what is left of a step's equations where they are not solved, else 0
    drift: str | None = None  # largest violation of a constraint so far [m]
    snaps: str | None = None  # how often the patella has left its equilibrium for another


class Integrator(NamedTuple):
    """A way to take one step."""

    advance: Advance
    order: int
    begin: Callable[[System, State, Guide, Scalar], State] = _as_it_is  # puts what the integrator carries into a state
    options: Callable[..., Integrator] | None = None  # the same with options, where it has any
    told: Told = Told()
    inertia: bool = True  # whether the motion has any: else nothing is in its velocities

    def fits(self, effects: tuple[Effect, ...]) -> None:
        """Refuses effects that it has no answer for.

        Raises:
            InputError: without inertia, an effect whose force jumps, which need not have an equilibrium anywhere.
        """
        jumping = [] if self.inertia else [e.name for e in effects if e.jumps]
        if jumping:
            raise InputError(
                f"found no inertia, and forces that jump from triangle to triangle in: {', '.join(jumping)}",
                where="integrator",
                expected="one with inertia, or a contact with equilibria: by volume, or of a patch",
            )

    def unsettled(self, state: State) -> Scalar | None:
        """What is left of the equations of a frame's worst step, where they are not solved."""
        return self._carried(state, self.told.unsettled)

    def drift(self, state: State) -> Scalar | None:
        """Largest violation of a constraint so far, where there are constraints [m]."""
        return self._carried(state, self.told.drift)

    def snaps(self, state: State) -> Scalar | None:
        """How often the patella has left its equilibrium for another, where it can."""
        return self._carried(state, self.told.snaps)

    def settled(self, state: State) -> State:
        """The state before the first step of a frame: what earlier ones left unsolved was told with their own frame."""
        left = self.unsettled(state)
        return state if left is None else self._with_unsettled(state, jnp.zeros_like(left))

    def at_worst(self, state: State, before: State) -> State:
        """The state after a step of a frame, which tells of the worst of its steps and not of the last."""
        left, worst = self.unsettled(state), self.unsettled(before)
        return state if left is None or worst is None else self._with_unsettled(state, jnp.maximum(left, worst))

    def _with_unsettled(self, state: State, left: Scalar) -> State:
        return eqx.tree_at(self.unsettled, state, left)

    @staticmethod
    def _carried(state: State, field: str | None) -> Scalar | None:
        return None if field is None else getattr(state.carried, field)


SOLVED = Told(unsettled="unsettled")
CONSTRAINED = Told(unsettled="unsettled", drift="drift")
SNAPPING = Told(unsettled="unsettled", snaps="snaps")


def _newmark(gamma: float | None = None, beta: float | None = None, rho: float | None = None) -> Integrator:
    """Newmark's method with its weights, or the generalised-alpha method with the damping of highest frequencies."""
    if rho is not None:
        if gamma is not None or beta is not None:
            raise InputError("found rho together with gamma or beta", where="newmark", expected="one or the other")
        if not 0 <= rho <= 1:
            raise InputError(f"found rho = {rho:g}", where="newmark", expected="from 0 (most damping) to 1 (none)")
        weights = newmark.Weights.damped(rho)
    else:
        gamma = 0.5 if gamma is None else gamma
        beta = 0.25 * (gamma + 0.5) ** 2 if beta is None else beta
        if not (gamma >= 0.5 and 2 * beta >= gamma):
            raise InputError(
                f"found gamma = {gamma:g}, beta = {beta:g}",
                where="newmark",
                expected="gamma of at least 1/2 and beta of at least gamma / 2, which is stable at any step",
            )
        weights = newmark.Weights(gamma, beta, 0.0, 0.0)
    order = newmark.ORDER if rho is not None or weights.gamma == 0.5 else 1
    return Integrator(partial(newmark.newmark, **weights._asdict()), order, newmark.begin, told=SOLVED)


def _ali3p(penalty: float = 0.0) -> Integrator:
    """The paper's formulation with its penalty, as a multiple of the patella's mass; 0: one that fits the precision."""
    if penalty and not penalty >= 10:
        raise InputError(f"found penalty = {penalty:g}", where="ali3p", expected="at least 10 times the patella's mass")
    advance = partial(ali3p.ali3p, penalty=penalty) if penalty else ali3p.ali3p
    return Integrator(advance, ali3p.ORDER, ali3p.begin, told=CONSTRAINED)


def _diffrax(
    solver: str, *, rtol: float = 1e-7, atol: float = 1e-9, adaptive: float = 1.0, adjoint: str = "forward"
) -> Integrator:
    """A solver of diffrax with its tolerances, or in steps of constant length; and which derivatives it has."""
    if min(rtol, atol) <= 0 or adaptive not in (0, 1) or adjoint not in diffrax_solver.ADJOINTS:
        raise InputError(
            f"found rtol={rtol:g}, atol={atol:g}, adaptive={adaptive:g}, adjoint={adjoint}",
            where=f"integrator diffrax:{solver}",
            expected=f"tolerances above 0, adaptive 1 or 0, adjoint one of: {', '.join(diffrax_solver.ADJOINTS)}",
        )
    order = diffrax_solver.solver_named(solver).order(None)  # pyright: ignore[reportArgumentType]
    options = {"solver": solver, "rtol": rtol, "atol": atol, "adaptive": bool(adaptive), "adjoint": adjoint}
    assert order is not None
    return Integrator(partial(diffrax_solver.diffrax_step, **options), order, diffrax_solver.begin, told=SOLVED)


INTEGRATORS = {
    "linear_implicit": Integrator(linear_implicit.linear_implicit, linear_implicit.ORDER),
    "linear_implicit_bdf2": Integrator(
        linear_implicit_bdf2.linear_implicit_bdf2, linear_implicit_bdf2.ORDER, linear_implicit_bdf2.begin
    ),
    "symplectic_euler": Integrator(
        symplectic_euler.symplectic_euler, symplectic_euler.ORDER, symplectic_euler.begin, told=SOLVED
    ),
    "newmark": Integrator(newmark.newmark, newmark.ORDER, newmark.begin, _newmark, SOLVED),
    "quasi_static": Integrator(
        quasi_static.quasi_static, quasi_static.ORDER, quasi_static.begin, told=SNAPPING, inertia=False
    ),
    "ali3p": Integrator(ali3p.ali3p, ali3p.ORDER, ali3p.begin, _ali3p, CONSTRAINED),
}


def integrator_named(name: str) -> Integrator:
    """The integrator of that name, with its options.

    Raises:
        InputError: no such integrator or option, or an option's value that cannot be.
    """
    base, _, rest = name.partition(":")
    if base == "diffrax":
        solver, _, rest = rest.partition(":")
        return _diffrax(solver, **(_options(name, rest, _diffrax) if rest else {}))
    if base not in INTEGRATORS:
        known = ", ".join((*INTEGRATORS, "diffrax:SOLVER"))
        raise InputError(f"no integrator {base!r}", where="integrator", expected=f"one of: {known}")
    found = INTEGRATORS[base]
    if not rest:
        return found
    if found.options is None:
        raise InputError(f"found options {rest!r}", where=f"integrator {base}", expected="none: it has no options")
    return found.options(**_options(base, rest, found.options))


def _options(base: str, text: str, of: Callable[..., Integrator]) -> dict[str, Any]:
    known = {p.name: p.default for p in signature(of).parameters.values() if p.default is not p.empty}
    values: dict[str, Any] = {}
    for part in text.split(","):
        key, _, value = (x.strip() for x in part.partition("="))
        values[key] = value if isinstance(known.get(key), str) else _number(value)
        if key not in known or values[key] is None:
            wanted = f"name=value, of: {', '.join(known)}"
            raise InputError(f"found {part.strip()!r}", where=f"integrator {base}", expected=wanted)
    return values


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
