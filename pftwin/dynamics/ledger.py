"""The energy budget's two running sums: work that guided bodies and known pulls put in, heat that damping takes out.

What is left over, (T + V) - (T + V at the start) - work + heat, is the integrator's own: what the
step itself dissipated where it is negative. It tends to zero with the step.
"""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp

from pftwin.dynamics.state import State
from pftwin.effects.base import Bed, Drag, Load
from pftwin.spatial import Scalar, Vec3


class Ledger(eqx.Module):
    """Running sums since the start [J]."""

    work: Scalar
    heat: Scalar

    def entered(
        self,
        before: State,
        after: State,
        loads: Sequence[Load],
        applied: Sequence[Scalar] | None,
        at: float,
        step: Scalar,
    ) -> Ledger:
        """With one step's entries.

        Args:
            before: state at the step's start.
            after: at its end.
            loads: of the step.
            applied: the forces that the stiff terms really had, in the loads' order; None: as they are halfway.
            at: where in the step the loads' elastic forces stand: 0 at its start, 1 at its end.
            step: its length [s].
        """
        velocity, spin = _middle(before.velocity, after.velocity), _middle(before.spin, after.spin)
        work, heat, forces = self.work, self.heat, None if applied is None else iter(applied)
        for load in loads:
            if load.wrench is not None and load.energy is None:
                w = load.wrench
                work = work + step * (w.force.dot(velocity) + w.moment.dot(spin))
            if load.drag is not None:
                put_in, lost = _dragged(load.drag, before, after, velocity, spin, at)
                work, heat = work + step * put_in, heat + step * lost
            if load.bed is not None:
                put_in, lost = _bedded(load.bed, before, velocity, spin, at, step)
                work, heat = work + step * put_in, heat + step * lost
            if load.heat is not None:
                heat = heat + step * load.heat
            for term in load.stiff:
                guided = term.rate + term.direction.dot(before.velocity) + term.moment.dot(before.spin)
                rate = guided - term.direction.dot(velocity) - term.moment.dot(spin)
                elastic = term.elastic + (0.5 - at) * step * term.stiffness * rate
                force = term.force + (elastic - term.elastic) if forces is None else next(forces)
                work = work + step * jnp.sum(force * guided)
                heat = heat + step * jnp.sum((force - elastic) * rate)
        return Ledger(work, heat)


def _dragged(drag: Drag, before: State, after: State, velocity: Vec3, spin: Vec3, at: float) -> tuple[Scalar, Scalar]:
    """Power put in by what drags and power lost, with the drag's force as it is at the place `at` within the step."""
    moving, turning = before.velocity - drag.velocity, before.spin - drag.spin
    ahead = drag.velocity + at * (after.velocity - before.velocity), drag.spin + at * (after.spin - before.spin)
    w = Drag(drag.translational, drag.rotational, *ahead).wrench()
    put_in = w.force.dot(moving) + w.moment.dot(turning)
    return put_in, -w.force.dot(velocity - moving) - w.moment.dot(spin - turning)


def _bedded(bed: Bed, before: State, velocity: Vec3, spin: Vec3, at: float, step: Scalar) -> tuple[Scalar, Scalar]:
    """Power put in by the body that the bed stands on and power lost, with the bed's force as it is."""
    guided = jnp.concatenate([(before.velocity - bed.velocity).array(), (before.spin - bed.spin).array()])
    twist = jnp.concatenate([velocity.array(), spin.array()]) - guided
    elastic = bed.elastic - (0.5 - at) * step * bed.stiffness @ twist
    return bed.force @ guided, (elastic - bed.force) @ twist


def _middle(a: Vec3, b: Vec3) -> Vec3:
    return 0.5 * (a + b)
