"""The running sums of the energy budget: work put in, heat of damping, and what all forces do on the patella.

Forces and powers are those at the end of each step, summed by trapezoids. Forces that have a potential do their work
along the step's own displacement, whatever its velocities are, so what they do is what they store less. With T kinetic
and V stored energy,

    numerical dissipation = work done on the patella - (T - T at the start),
    remainder = (T + V) - (T + V at the start) - work + heat + numerical dissipation.

The first is what the step's own formula takes, the second the trapezoids' own error: see docs/physics.md. Heat is the
power of dashpots alone, both of whose forces, damped and elastic, are of one instant: of two, heat would contain what
springs store in between.
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
    """The powers of an instant."""

    work: Scalar  # of guided bodies and known pulls [W]
    heat: Scalar  # of damping between bodies [W]
    lossy: Scalar  # on the patella, of what has no potential: known pulls and damping [W]
    potential: Wrench  # what has one: force in world axes [N], moment in patella axes [N m]
    inner: Scalar  # heat inside of effects, which give its mean over the step [W]

    @staticmethod
    def of(loads: Sequence[Load], looked: Twist, velocity: Twist) -> Powers:
        """The powers of loads with their forces at the patella's velocity; `looked` is the one that they were told."""
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
                medium = looked.plus(-1.0, Twist(drag.velocity, drag.spin))
                through = velocity.plus(-1.0, medium)
                pull = eqx.tree_at(lambda d: (d.velocity, d.spin), drag, (through.linear, through.angular)).wrench()
                work, lossy = work + pull.power(medium), lossy + pull.power(velocity)
                heat = heat - pull.power(through)
            if load.bed is not None:
                bed = load.bed
                under = looked.plus(-1.0, Twist(bed.velocity, bed.spin))
                elastic, damped = (_wrench(w) for w in (bed.elastic, bed.force - bed.elastic))
                work, lossy = work + bed.wrench().power(under), lossy + damped.power(velocity)
                heat, potential = heat - damped.power(velocity.plus(-1.0, under)), potential + elastic
            if load.heat is not None:
                inner = inner + load.heat
            for term in load.stiff:
                driven = term.rate + term.direction.dot(looked.linear) + term.moment.dot(looked.angular)
                along = term.direction.dot(velocity.linear) + term.moment.dot(velocity.angular)
                damped = term.force - term.elastic
                work, lossy = work + jnp.sum(term.force * driven), lossy + jnp.sum(damped * along)
                heat = heat + jnp.sum(damped * (driven - along))
                potential = potential + eqx.tree_at(lambda t: t.force, term, term.elastic).wrench()
        return Powers(work, heat, lossy, potential, inner)


class Ledger(eqx.Module):
    """Running sums since the start [J], and the powers at the end of the last step."""

    work: Scalar  # of guided bodies and known pulls
    heat: Scalar  # of damping
    done: Scalar  # by all forces on the patella
    last: Powers
    begun: Scalar  # 0 before the first step, whose powers at the start are not known, then 1
    approach: Scalar  # the fastest so far at which something one-sided, a contact, came nearer and pushed [m/s]

    @staticmethod
    def opened(like: Scalar) -> Ledger:
        """Nothing yet, in the float type of `like`."""
        zero = jnp.zeros_like(like)
        return Ledger(zero, zero, zero, Powers(zero, zero, zero, _no_load(zero), zero), zero, zero)

    def entered(
        self, before: State, after: State, loads: Sequence[Load], step: Scalar, looked: Twist | None = None
    ) -> Ledger:
        """The ledger after one more step [s], from the loads at its end, with the forces that they have there.

        `looked` are the patella's velocities that the loads were told; by default those of `after`.
        """
        end = Twist(after.velocity, after.spin)
        looked = end if looked is None else looked
        now = Powers.of(loads, looked, end)
        turn = (before.orientation.conjugate() * after.orientation).rotation_vector()
        moved = Twist(after.position - before.position, turn)

        known = 0.5 * self.begun
        mean = jax.tree.map(lambda last, now: now + known * (last - now), self.last, now)
        done = step * mean.lossy + mean.potential.power(moved)
        heat = step * (mean.heat + now.inner)
        sums = (self.work + step * mean.work, self.heat + heat, self.done + done)
        return Ledger(*sums, now, jnp.ones_like(known), self.approach_until(before, loads, looked))

    def approach_until(self, before: State, loads: Sequence[Load], looked: Twist) -> Scalar:
        """`approach` after one more step; its arguments are those of `entered`.

        Of one-sided forces that push, with the velocities at the step's start.
        """
        lost = looked.plus(-1.0, Twist(before.velocity, before.spin))
        fastest = jnp.zeros_like(lost.linear.x)
        for term in (term for load in loads for term in load.stiff if term.unilateral):
            rate = term.rate + term.direction.dot(lost.linear) + term.moment.dot(lost.angular)
            fastest = jnp.maximum(fastest, jnp.max(jnp.where(term.force > 0, rate, 0.0)))
        return jnp.maximum(self.approach, fastest)

    def numerical_dissipation(self, kinetic: Scalar) -> Scalar:
        """Of a ledger over the frames, by the patella's kinetic energy there, (n,) each [J]."""
        return self.done - (kinetic - kinetic[0])


def _no_load(zero: Scalar) -> Wrench:
    nothing = Vec3(zero, zero, zero)
    return Wrench(nothing, nothing)


def _wrench(six: Array) -> Wrench:
    return Wrench(Vec3.from_array(six[:3]), Vec3.from_array(six[3:]))
