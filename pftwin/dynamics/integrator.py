"""What an integrator is: a way to take one step from state to state, and what it tells of its steps."""

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

Books = Ledger | None  # None where no account is kept
Carry = tuple[State, Books]


class Diagnostics(NamedTuple):
    """What an integrator tells of its steps so far; None where it tells nothing."""

    residual: Scalar | None = None  # what is left of a step's equations where they are not solved, else 0
    drift: Scalar | None = None  # largest violation of a constraint so far [m]
    snaps: Scalar | None = None  # how often the patella has left its equilibrium for another


@dataclasses.dataclass(frozen=True)
class Integrator(ABC):
    """A way to take one step: a value with its options, which can be compared and hashed.

    Derive from it for one of your own: `advance` and `order`, a class attribute or a property, and `begin` where a step
    needs more of the last one than the state holds, which goes into `State.carried`. Fields in there that are called as
    in `Diagnostics` are told.
    """

    name: ClassVar[str]  # by which the command line and files call it
    inertia: ClassVar[bool] = True  # whether the motion has any: else nothing is in its velocities

    @property
    @abstractmethod
    def order(self) -> int:
        """Of the error in the step."""

    @abstractmethod
    def advance(
        self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Ledger | None
    ) -> tuple[State, Ledger | None]:
        """The state one step later, and the energy ledger where one is kept.

        Args:
            system: what moves, and the effects that act on it.
            state: at the step's start.
            guide_at: the guided bodies at a part of the step, 0 its start and 1 its end.
            step: its length [s].
            ledger: work and heat so far [J]; None where no account is kept.
        """

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """The state before the first step, with what this integrator carries."""
        return state

    def diagnostics(self, state: State) -> Diagnostics:
        """What it tells: the fields of these names in what a state carries."""
        return Diagnostics(*(getattr(state.carried, name, None) for name in Diagnostics._fields))

    @property
    def text(self) -> str:
        """As the command line and files write it: its name, and the options that are not the default ones."""
        given = (f for f in dataclasses.fields(self) if getattr(self, f.name) != f.default)
        options = ",".join(f"{f.name}={_written(getattr(self, f.name))}" for f in given)
        return f"{self.name}:{options}" if options else self.name

    def refuse_unfit(self, effects: tuple[Effect, ...]) -> None:
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

    def with_residual_cleared(self, state: State) -> State:
        """The state before the first step of a frame: earlier frames have told their own residuals."""
        left = self.diagnostics(state).residual
        return state if left is None else self._with_residual(state, jnp.zeros_like(left))

    def with_worst_residual(self, state: State, before: State) -> State:
        """The state after a step of a frame, with the larger residual of this step and those before it."""
        left, worst = self.diagnostics(state).residual, self.diagnostics(before).residual
        return state if left is None or worst is None else self._with_residual(state, jnp.maximum(left, worst))

    def _with_residual(self, state: State, left: Scalar) -> State:
        return eqx.tree_at(lambda s: self.diagnostics(s).residual, state, left)


def with_carried(state: State, carried: Any) -> State:
    """The state with what an integrator carries to the next step."""
    return eqx.tree_at(lambda s: s.carried, state, carried, is_leaf=lambda x: x is None)


def _written(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(int(value) if isinstance(value, bool) else value)
