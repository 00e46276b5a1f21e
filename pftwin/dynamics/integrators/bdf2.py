r"""Linearly implicit BDF2: backward differences over two steps, of second order, with one force evaluation per step.

With d the displacement over a step and D the change of velocity,

    d_end = d / 3 + (2 h / 3) v_end,        D_end = D / 3 + (2 h / 3) M^-1 F(q_end, v_end, t_end)

(the first step, without a previous one, is d_end = h v_end, D_end = h M^-1 F_end) is the backward differentiation
formula BDF2, for rotations up to terms of third order. Forces are evaluated where the step would end if the velocity
changed as in the last step, and every stiff term is linearised there (`pftwin.dynamics.integrators.implicit_solve`).
The neglected rotation of forces and body is of third order in the step. So one Newton iteration is enough, and a step
costs as much as with `linear_implicit`. After an impact the last step is no guide: a third of its change of velocity
would continue into the next step and create energy. So if the change of velocity differs from the last one by more than
half of itself and by more than `ROUGH` allows, the next step is a first step. Source of the formula: Curtiss &
Hirschfelder 1952, PNAS 38:235; Hairer & Wanner, Solving Ordinary Differential Equations II, V.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.spatial import Scalar, Twist, Vec3, Wrench
from pftwin.dynamics.integrator import Books, Carry, Integrator, with_solver_state
from pftwin.dynamics.integrators.implicit_solve import Span, change_of_velocity, load_at_end
from pftwin.dynamics.state import Guide, GuideAt, State, System, displaced_state, gyroscopic
from pftwin.dynamics.static_load import LEVER

ROUGH = 20.0  # change of the acceleration between two steps above which it may be due to an impact [m/s^2]


class LastStep(NamedTuple):
    """What BDF2 carries from step to step: the last step."""

    displacement: Twist  # d: translation [m], rotation [rad]
    change: Twist  # D: change of the velocities
    share: Scalar  # weight of the last step in the next: 1/3; 0 for the first and after an impact


@dataclass(frozen=True)
class BDF2(Integrator):
    """Linearly implicit BDF2, of second order: see the module `pftwin.dynamics.integrators.bdf2`."""

    name: ClassVar[str] = "linear_implicit_bdf2"
    order: ClassVar[int] = 2

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """See `Integrator`: there is no previous step."""
        zero = jnp.zeros_like(state.position.x)
        nothing = Twist(Vec3(zero, zero, zero), Vec3(zero, zero, zero))
        return with_solver_state(state, LastStep(nothing, nothing, zero))

    def advance(self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Books = None) -> Carry:
        """See `Integrator`."""
        last = state.solver_state
        span = (1 - last.share) * step
        now = Twist(state.velocity, state.spin)
        expected = now.plus(3 * last.share, last.change)
        with jax.named_scope("loads"):
            ahead = displaced_state(state, last.displacement.times(last.share).plus(span, expected), expected)
            there = guide_at(1.0).instant(ahead.patella(), step, step, displacement_gain=span, twist=now)
            loads, memories = system.loads(there, state.memories)
        with jax.named_scope("implicit_solve"):
            # Subtracts the part of the expected velocity beyond the formula's weight of the last step.
            more, i = last.change.times(3 * last.share * (1 - last.share) / span), system.inertia
            turning = Vec3(i.x * more.angular.x, i.y * more.angular.y, i.z * more.angular.z)
            inertial = Wrench(-system.mass * more.linear, gyroscopic(i, expected.angular) - turning)
            dv = change_of_velocity(system, inertial, loads, Span(span, span))
        velocity = expected.plus(1.0, Twist(Vec3(*dv[:3]), Vec3(*dv[3:])))
        displacement = last.displacement.times(last.share).plus(span, velocity)
        after = displaced_state(state, displacement, velocity)
        change = velocity.plus(-1.0, now)
        solver_state = LastStep(
            displacement, change, jnp.where(_impact(change, last.change, step), 0.0, jnp.full_like(span, 1 / 3))
        )
        after = eqx.tree_at(lambda s: (s.memories, s.solver_state), after, (memories, solver_state))
        if ledger is not None:
            ends = [load_at_end(load, dv, span) for load in loads]
            ledger = ledger.after_step(state, after, ends, step, expected)
        return after, ledger


def _impact(change: Twist, last: Twist, step: Scalar) -> Scalar:
    """Whether the change of velocity differs so much from that of the last step that it may be due to an impact."""
    jump = _squared(change.plus(-1.0, last))
    return (jump > 0.25 * _squared(change)) & (jump > (ROUGH * step) ** 2)


def _squared(twist: Twist) -> Scalar:
    return twist.linear.squared_norm() + LEVER**2 * twist.angular.squared_norm()
