r"""Linearly implicit Euler: one force evaluation per step, with every stiff term of every effect implicit.

Forces are evaluated where the step would end at the present velocity, and every stiff term is linearised there in the
change of velocity (`pftwin.dynamics.integrators.implicit_solve`): one Newton iteration of backward Euler. See
docs/physics.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax

from pftwin.base.spatial import Scalar, Twist, Vec3, Wrench
from pftwin.dynamics.integrator import Books, Carry, Integrator
from pftwin.dynamics.integrators.implicit_solve import Span, change_of_velocity, load_at_end
from pftwin.dynamics.state import GuideAt, State, System, advance, gyroscopic


@dataclass(frozen=True)
class LinearImplicit(Integrator):
    """Linearly implicit Euler, of first order: see the module `pftwin.dynamics.integrators.linear_implicit`."""

    name: ClassVar[str] = "linear_implicit"
    order: ClassVar[int] = 1

    def advance(self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Books = None) -> Carry:
        """See `Integrator`."""
        with jax.named_scope("loads"):
            ahead = advance(state, state.velocity, state.spin, step, state.memories).patella()
            loads, memories = system.loads(guide_at(1.0).instant(ahead, step, step), state.memories)
        with jax.named_scope("implicit_solve"):
            inertial = Wrench(Vec3.zero(), gyroscopic(system.inertia, state.spin))
            dv = change_of_velocity(system, inertial, loads, Span(step, step))
        after = advance(state, state.velocity + Vec3(*dv[:3]), state.spin + Vec3(*dv[3:]), step, memories)
        if ledger is not None:
            ends = [load_at_end(load, dv, step) for load in loads]
            ledger = ledger.after_step(state, after, ends, step, Twist(state.velocity, state.spin))
        return after, ledger
