"""Runge-Kutta solvers of diffrax, explicit or implicit, as integrators: a reference for high accuracy.

Between two updates of the effects' memories (the steps of `dt`) the equations of motion are an ordinary differential
equation. The solver integrates it to a tolerance with adaptive steps, or in one step of constant length. The state is
one array of 13 numbers, so that an implicit solver differentiates one function of one array, not of many scalars.
Source: Kidger 2021, On Neural Differential Equations, section 5; diffrax's documentation for each solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.spatial import Quaternion, Scalar, Twist, Vec3
from pftwin.dynamics.integrator import Books, Carry, Integrator, with_solver_state
from pftwin.dynamics.ledger import Powers
from pftwin.dynamics.state import Guide, GuideAt, State, System, acceleration

if TYPE_CHECKING:
    import diffrax

MOST_STEPS = 4096  # largest number of the solver's steps within one step of `dt`
ADJOINTS = {"forward": "ForwardMode", "recursive": "RecursiveCheckpointAdjoint", "direct": "DirectAdjoint"}
FIRST = 0.1  # the solver's first step, as a fraction of `dt`


class DiffraxStep(NamedTuple):
    """What `Diffrax` carries from step to step."""

    pace: Scalar  # mean step of the solver within the last step of `dt` [s]
    residual: Scalar  # 1 if the solver failed


def solver_named(name: str) -> diffrax.AbstractRungeKutta:
    """The solver of diffrax named `name`.

    Raises:
        InputError: there is no such solver, or it does not solve ordinary differential equations on its own.
    """
    import diffrax

    known = sorted(n for n in dir(diffrax) if _usable(getattr(diffrax, n)))
    if name not in known:
        raise InputError(f"no solver {name!r}", where="integrator diffrax", expected=f"one of: {', '.join(known)}")
    return getattr(diffrax, name)()


def _usable(found: Any) -> bool:
    import diffrax

    if not (isinstance(found, type) and issubclass(found, diffrax.AbstractRungeKutta)):
        return False
    return not found.__name__.startswith("Abstract") and found.term_structure is diffrax.AbstractTerm


@dataclass(frozen=True)
class Diffrax(Integrator):
    """A Runge-Kutta solver of diffrax, with adaptive or constant steps.

    Args:
        solver: its name in diffrax, such as "Tsit5".
        rtol, atol: tolerances of the error of each of the solver's steps, in metres, quaternions and their rates.
        adaptive: whether the solver adapts its steps; else it takes one per step of `dt`.
        adjoint: diffrax's method of differentiation: "forward"; for reverse mode "recursive" (checkpoints) or "direct".

    Raises:
        InputError: there is no such solver or method of differentiation, or a tolerance is not positive.
    """

    solver: str
    rtol: float = 1e-7
    atol: float = 1e-9
    adaptive: bool = True
    adjoint: str = "forward"
    name: ClassVar[str] = "diffrax"

    def __post_init__(self) -> None:
        solver_named(self.solver)
        if min(self.rtol, self.atol) <= 0 or self.adaptive not in (False, True) or self.adjoint not in ADJOINTS:
            raise InputError(
                f"found rtol={self.rtol:g}, atol={self.atol:g}, adaptive={self.adaptive:g}, adjoint={self.adjoint}",
                where=f"integrator diffrax:{self.solver}",
                expected=f"tolerances above 0, adaptive 1 or 0, adjoint one of: {', '.join(ADJOINTS)}",
            )

    @property
    def order(self) -> int:
        """Order of the solver."""
        order = solver_named(self.solver).order(None)  # pyright: ignore[reportArgumentType]
        assert order is not None
        return order

    @property
    def text(self) -> str:
        """Its text, such as "diffrax:Tsit5", with options that differ from the defaults."""
        options = super().text.removeprefix(f"{self.name}:").removeprefix(f"solver={self.solver}").removeprefix(",")
        return ":".join(part for part in (self.name, self.solver, options) if part)

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """See `Integrator`: an initial guess of the solver's step."""
        return with_solver_state(state, DiffraxStep(FIRST * step, jnp.zeros_like(step)))

    def advance(self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Books = None) -> Carry:
        """See `Integrator`."""
        import diffrax

        def slope(t: Scalar, y: Array, _: None) -> Array:
            now = _state(y, state)
            loads, _memories = system.loads(guide_at(t / step).instant(now.patella(), 0.0), state.memories)
            a = acceleration(system, now.spin, loads)
            half = Quaternion(jnp.zeros_like(now.spin.x), 0.5 * now.spin.x, 0.5 * now.spin.y, 0.5 * now.spin.z)
            turning = Quaternion.from_array(y[3:7]) * half
            rates = [now.velocity.array(), turning.array(), a.linear.array(), a.angular.array()]
            if ledger is not None:
                twist = Twist(now.velocity, now.spin)
                powers = Powers.of(loads, twist, twist)
                done = powers.lossy + powers.potential.power(twist)
                rates.append(jnp.stack([powers.work, powers.heat + powers.inner, done]))
            return jnp.concatenate(rates)

        books = [] if ledger is None else [jnp.stack([ledger.work, ledger.heat, ledger.done])]
        start = [state.position.array(), state.orientation.array(), state.velocity.array(), state.spin.array(), *books]
        chosen = solver_named(self.solver)
        if isinstance(chosen, diffrax.AbstractImplicitSolver):
            chosen = eqx.tree_at(lambda s: s.root_finder, chosen, diffrax.VeryChord(rtol=self.rtol, atol=self.atol))
        controller = diffrax.ConstantStepSize()
        if self.adaptive:
            controller = diffrax.PIDController(rtol=self.rtol, atol=self.atol)
        # After a failure there is no state to continue from: the rest of the motion is unknown, and is not computed.
        known = jnp.isfinite(state.position.x)
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(slope),  # pyright: ignore[reportArgumentType]
            chosen,
            t0=jnp.zeros_like(step),
            t1=jnp.where(known, step, 0.0),
            dt0=jnp.minimum(state.solver_state.pace, step) if self.adaptive else step,
            y0=jnp.concatenate(start),
            stepsize_controller=controller,
            adjoint=getattr(diffrax, ADJOINTS[self.adjoint])(),
            max_steps=MOST_STEPS,
            throw=False,
        )
        assert found.ys is not None
        given_up = found.result == diffrax.RESULTS.max_steps_reached
        y = jnp.where(given_up, jnp.nan, found.ys[-1])
        after = _state(y, state)
        ends, memories = system.loads(guide_at(1.0).instant(after.patella(), step), state.memories)
        failed = ((found.result != diffrax.RESULTS.successful) | ~known).astype(y.dtype)
        solver_state = DiffraxStep(step / jnp.maximum(found.stats["num_accepted_steps"], 1).astype(y.dtype), failed)
        after = eqx.tree_at(lambda s: (s.memories, s.solver_state), after, (memories, solver_state))
        if ledger is not None:
            approach = ledger.approach_until(state, ends, Twist(after.velocity, after.spin))
            sums = (y[13], y[14], y[15], approach)
            ledger = eqx.tree_at(lambda a: (a.work, a.heat, a.done, a.approach), ledger, sums)
        return after, ledger


def _state(y: Array, like: State) -> State:
    """The state from an array (13 or more,), with the memories of `like`."""
    turn = Quaternion.from_array(y[3:7]).normalised()
    velocity, spin = Vec3.from_array(y[7:10]), Vec3.from_array(y[10:13])
    return State(Vec3.from_array(y[:3]), turn, velocity, spin, like.memories, like.solver_state)
