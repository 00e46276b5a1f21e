r"""The linearly implicit step of second order: backward differences over two steps, one force evaluation.

With d the displacement over a step and D the change of velocity,

    d_end = d / 3 + (2 h / 3) v_end,        D_end = D / 3 + (2 h / 3) M^-1 F(q_end, v_end, t_end)

(the first step, with no past, is d_end = h v_end, D_end = h M^-1 F_end) is the backward differentiation formula BDF2,
in rotations up to terms of third order. Forces are evaluated where the step would end if the velocity changed as it did
over the last one, and every stiff term is linearised from there (`pftwin.dynamics.integrators.implicit_solve`). What
that leaves out, the turning of forces and of the body, is of third order in the step, so one Newton iteration is
enough, and the step costs what `linear_implicit` costs. After an impact the past is no guide: a third of the change of
velocity would go on into the next step and make energy of nothing. Where the change of velocity has changed by more
than half of itself and by more than `ROUGH` allows, the next step starts afresh. Source of the formula: Curtiss &
Hirschfelder 1952, PNAS 38:235; Hairer & Wanner, Solving Ordinary Differential Equations II, V.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.spatial import Scalar, Twist, Vec3, Wrench
from pftwin.dynamics.integrator import Books, Carry, Integrator, with_carried
from pftwin.dynamics.integrators.implicit_solve import Span, change_of_velocity, load_at_end
from pftwin.dynamics.state import Guide, GuideAt, State, System, displaced_state, gyroscopic
from pftwin.dynamics.static_load import LEVER

ROUGH = 20.0  # change of the acceleration between two steps above which it may be that of an impact [m/s^2]


class LastStep(NamedTuple):
    """What BDF2 carries: the last step."""

    displacement: Twist  # d: displacement [m], turn [rad]
    change: Twist  # D: of the velocities
    share: Scalar  # of the last step in the next: 1/3; 0 at the first and after an impact


@dataclass(frozen=True)
class BDF2(Integrator):
    """The linearly implicit step of order two: see above."""

    name: ClassVar[str] = "linear_implicit_bdf2"
    order: ClassVar[int] = 2

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """The state without a past."""
        zero = jnp.zeros_like(state.position.x)
        nothing = Twist(Vec3(zero, zero, zero), Vec3(zero, zero, zero))
        return with_carried(state, LastStep(nothing, nothing, zero))

    def advance(self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Books = None) -> Carry:
        """See `Integrator`."""
        last = state.carried
        span = (1 - last.share) * step
        now = Twist(state.velocity, state.spin)
        expected = now.plus(3 * last.share, last.change)
        with jax.named_scope("loads"):
            ahead = displaced_state(state, last.displacement.times(last.share).plus(span, expected), expected)
            there = guide_at(1.0).instant(ahead.patella(), step, step, displacement_gain=span, twist=now)
            loads, memories = system.loads(there, state.memories)
        with jax.named_scope("implicit_solve"):
            # What the expected velocity is more than the formula's share of the past has to be taken back.
            more, i = last.change.times(3 * last.share * (1 - last.share) / span), system.inertia
            turning = Vec3(i.x * more.angular.x, i.y * more.angular.y, i.z * more.angular.z)
            inertial = Wrench(-system.mass * more.linear, gyroscopic(i, expected.angular) - turning)
            dv = change_of_velocity(system, inertial, loads, Span(span, span))
        velocity = expected.plus(1.0, Twist(Vec3(*dv[:3]), Vec3(*dv[3:])))
        displacement = last.displacement.times(last.share).plus(span, velocity)
        after = displaced_state(state, displacement, velocity)
        change = velocity.plus(-1.0, now)
        carried = LastStep(
            displacement, change, jnp.where(_impact(change, last.change, step), 0.0, jnp.full_like(span, 1 / 3))
        )
        after = eqx.tree_at(lambda s: (s.memories, s.carried), after, (memories, carried))
        if ledger is not None:
            ends = [load_at_end(load, dv, span) for load in loads]
            ledger = ledger.entered(state, after, ends, step, expected)
        return after, ledger


def _impact(change: Twist, last: Twist, step: Scalar) -> Scalar:
    """Whether the velocity has changed quite otherwise than in the step before."""
    jump = _squared(change.plus(-1.0, last))
    return (jump > 0.25 * _squared(change)) & (jump > (ROUGH * step) ** 2)


def _squared(twist: Twist) -> Scalar:
    return twist.linear.squared_norm() + LEVER**2 * twist.angular.squared_norm()
