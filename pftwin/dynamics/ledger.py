"""Running sums of the energy budget: external work, heat of damping, and work of all forces on the patella.

Forces and powers at the ends of the steps are integrated by the trapezoidal rule. The work of forces with a potential
is computed along the step's displacement, not from velocities, so that it matches the stored energy that they lose.
With T the kinetic and V the stored energy,

    numerical dissipation = work done on the patella - (T - T at the start),
    remainder = (T + V) - (T + V at the start) - work + heat + numerical dissipation.

The first is the dissipation by the integration formula, the second the error of the trapezoidal rule: see
docs/physics.md. Heat is the power of dashpots alone. Their damped and elastic force are taken at the same instant, as
otherwise heat would contain the energy that springs store in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Twist, Vec3, Wrench
from pftwin.dynamics.state import State
from pftwin.model.effects.base import Load


class Powers(NamedTuple):
    """Powers of all loads at an instant."""

    work: Scalar  # of guided bodies and prescribed tensions [W]
    heat: Scalar  # of damping between bodies [W]
    lossy: Scalar  # on the patella, of loads without a potential: prescribed tensions and damping [W]
    potential: Wrench  # load with a potential: force in world axes [N], moment in patella axes [N m]
    inner: Scalar  # heat inside effects, as its mean over the step [W]

    @staticmethod
    def of(loads: Sequence[Load], trial: Twist, velocity: Twist) -> Powers:
        """Powers of loads at the twist `velocity` of the patella; `trial` is the twist at which they were computed."""
        zero = jnp.zeros_like(velocity.linear.x)
        work, heat, lossy, inner, potential = zero, zero, zero, zero, _no_load(zero)
        for load in loads:
            if load.wrench is not None and load.energy is not None:
                potential = potential + load.wrench
            elif load.wrench is not None:
                power = load.wrench.power(velocity)
                work, lossy = work + power, lossy + power
            if load.drag is not None:
                drag = load.drag
                medium = trial.plus(-1.0, Twist(drag.velocity, drag.spin))
                through = velocity.plus(-1.0, medium)
                pull = eqx.tree_at(lambda d: (d.velocity, d.spin), drag, (through.linear, through.angular)).wrench()
                work, lossy = work + pull.power(medium), lossy + pull.power(velocity)
                heat = heat - pull.power(through)
            if load.bed is not None:
                bed = load.bed
                under = trial.plus(-1.0, Twist(bed.velocity, bed.spin))
                elastic, damped = (_wrench(w) for w in (bed.elastic, bed.force - bed.elastic))
                work, lossy = work + bed.wrench().power(under), lossy + damped.power(velocity)
                heat, potential = heat - damped.power(velocity.plus(-1.0, under)), potential + elastic
            if load.heat is not None:
                inner = inner + load.heat
            for term in load.stiff:
                driven = term.rate + term.direction.dot(trial.linear) + term.moment.dot(trial.angular)
                along = term.direction.dot(velocity.linear) + term.moment.dot(velocity.angular)
                damped = term.force - term.elastic
                work, lossy = work + jnp.sum(term.force * driven), lossy + jnp.sum(damped * along)
                heat = heat + jnp.sum(damped * (driven - along))
                potential = potential + eqx.tree_at(lambda t: t.force, term, term.elastic).wrench()
        return Powers(work, heat, lossy, potential, inner)


class Ledger(eqx.Module):
    """Running sums since the start [J], and the powers at the end of the last step."""

    work: Scalar  # of guided bodies and prescribed tensions
    heat: Scalar  # of damping
    done: Scalar  # work of all forces on the patella
    last: Powers
    begun: Scalar  # 0 before the first step, when `last` is unknown, then 1
    approach: Scalar  # largest approach speed so far of a unilateral force (contact) that pushes [m/s]

    @staticmethod
    def opened(like: Scalar) -> Ledger:
        """An empty ledger, in the float type of `like`."""
        zero = jnp.zeros_like(like)
        return Ledger(zero, zero, zero, Powers(zero, zero, zero, _no_load(zero), zero), zero, zero)

    def after_step(
        self, before: State, after: State, loads: Sequence[Load], step: Scalar, trial: Twist | None = None
    ) -> Ledger:
        """The ledger after one more step of length `step` [s], from the loads at its end.

        `trial` is the twist of the patella at which the loads were computed, by default that of `after`.
        """
        end = Twist(after.velocity, after.spin)
        trial = end if trial is None else trial
        now = Powers.of(loads, trial, end)
        turn = (before.orientation.conjugate() * after.orientation).rotation_vector()
        moved = Twist(after.position - before.position, turn)

        known = 0.5 * self.begun
        mean = jax.tree.map(lambda last, now: now + known * (last - now), self.last, now)
        done = step * mean.lossy + mean.potential.power(moved)
        heat = step * (mean.heat + now.inner)
        sums = (self.work + step * mean.work, self.heat + heat, self.done + done)
        return Ledger(*sums, now, jnp.ones_like(known), self.approach_until(before, loads, trial))

    def approach_until(self, before: State, loads: Sequence[Load], trial: Twist) -> Scalar:
        """`approach` after one more step, from the velocities at its start. Arguments as in `after_step`."""
        lost = trial.plus(-1.0, Twist(before.velocity, before.spin))
        fastest = jnp.zeros_like(lost.linear.x)
        for term in (term for load in loads for term in load.stiff if term.unilateral):
            rate = term.rate + term.direction.dot(lost.linear) + term.moment.dot(lost.angular)
            fastest = jnp.maximum(fastest, jnp.max(jnp.where(term.force > 0, rate, 0.0)))
        return jnp.maximum(self.approach, fastest)

    def numerical_dissipation(self, kinetic: Scalar) -> Scalar:
        """Numerical dissipation at the frames, from the patella's kinetic energy there, (n,) each [J]."""
        return self.done - (kinetic - kinetic[0])


def _no_load(zero: Scalar) -> Wrench:
    nothing = Vec3(zero, zero, zero)
    return Wrench(nothing, nothing)


def _wrench(six: Array) -> Wrench:
    return Wrench(Vec3.from_array(six[:3]), Vec3.from_array(six[3:]))
