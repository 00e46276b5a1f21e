"""Base class of integrators, which advance the state by one step and report diagnostics."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.state import Guide, GuideAt, State, System
from pftwin.model.effects.base import Effect

Books = Ledger | None  # None: no energy ledger
Carry = tuple[State, Books]


class Diagnostics(NamedTuple):
    """Diagnostics of an integrator's steps so far; None for those it does not report."""

    residual: Scalar | None = None  # residual of a step's equations if they are not solved, else 0
    drift: Scalar | None = None  # largest violation of a constraint so far [m]
    snaps: Scalar | None = None  # number of times the patella has snapped to another equilibrium


@dataclasses.dataclass(frozen=True)
class Integrator(ABC):
    """Base class of integrators. Instances hold options, and can be compared and hashed.

    A subclass implements `advance` and `order` (class attribute or property), and `begin` if a step needs more from the
    previous one than the state contains, which it stores in `State.solver_state`. Its fields with names from
    `Diagnostics` are reported.
    """

    name: ClassVar[str]  # name on the command line and in files
    inertia: ClassVar[bool] = True  # whether the motion has inertia; without it there is no kinetic energy

    @property
    @abstractmethod
    def order(self) -> int:
        """Order of convergence in the step."""

    @abstractmethod
    def advance(
        self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Ledger | None
    ) -> tuple[State, Ledger | None]:
        """Returns the state one step later, and the energy ledger if there is one.

        Args:
            system: the patella's mass and inertia, and the effects.
            state: state at the start of the step.
            guide_at: returns the guided bodies at a fraction of the step, 0 its start and 1 its end.
            step: length of the step [s].
            ledger: energy ledger so far; None if it is not needed.
        """

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """The state before the first step, with `State.solver_state` initialised."""
        return state

    def diagnostics(self, state: State) -> Diagnostics:
        """Diagnostics: the fields of these names in `State.solver_state`."""
        return Diagnostics(*(getattr(state.solver_state, name, None) for name in Diagnostics._fields))

    @property
    def text(self) -> str:
        """Its text on the command line and in files: the name, and options that differ from the defaults."""
        given = (f for f in dataclasses.fields(self) if getattr(self, f.name) != f.default)
        options = ",".join(f"{f.name}={_written(getattr(self, f.name))}" for f in given)
        return f"{self.name}:{options}" if options else self.name

    def refuse_unfit(self, effects: tuple[Effect, ...]) -> None:
        """Checks that the integrator supports the effects.

        Raises:
            InputError: without inertia, an effect's force is discontinuous, so that equilibrium may not exist.
        """
        jumping = [] if self.inertia else [e.name for e in effects if e.jumps]
        if jumping:
            raise InputError(
                f"found no inertia, and forces that jump from triangle to triangle in: {', '.join(jumping)}",
                where="integrator",
                expected="one with inertia, or a contact with equilibria: by volume, or of a patch",
            )

    def with_residual_cleared(self, state: State) -> State:
        """The state with the residual reset, before the first step of a frame, as each frame reports its own."""
        left = self.diagnostics(state).residual
        return state if left is None else self._with_residual(state, jnp.zeros_like(left))

    def with_worst_residual(self, state: State, before: State) -> State:
        """The state after a step, with the largest residual of the steps of this frame so far."""
        left, worst = self.diagnostics(state).residual, self.diagnostics(before).residual
        return state if left is None or worst is None else self._with_residual(state, jnp.maximum(left, worst))

    def _with_residual(self, state: State, left: Scalar) -> State:
        return eqx.tree_at(lambda s: self.diagnostics(s).residual, state, left)


def with_solver_state(state: State, solver_state: Any) -> State:
    """The state with `State.solver_state` replaced."""
    return eqx.tree_at(lambda s: s.solver_state, state, solver_state, is_leaf=lambda x: x is None)


def _written(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(int(value) if isinstance(value, bool) else value)
