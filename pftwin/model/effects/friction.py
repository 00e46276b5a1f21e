r"""Regularised Coulomb friction at the contacts of a sphere.

At each contact, with N its normal force and v the sliding velocity of the sphere's surface on the femur,

    F = -mu N v / sqrt(|v|^2 + v_s^2),

which is Coulomb's mu N for |v| well above the slip speed v_s, and a stiff damper mu N / v_s below it: instead of
sticking, a contact creeps, at v_s tan / sqrt(mu^2 - tan^2) on a slope with tan < mu. Vigué et al. 2017, J Sound Vib
389:350 compare regularised laws with Coulomb's. Contacts are points, so spin about the normal meets no friction.

An implicit step uses the secant c = mu N / sqrt(|v|^2 + v_s^2) as damping in both tangential directions, not the
tangent, which vanishes in fast sliding: F = -c v at the end of the step opposes the sliding that remains there, never
reverses it, and dissipates energy for any step length. N is the normal force at the end of the previous step, so
friction lags by one step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Twist, Vec3, safe_sqrt
from pftwin.model.effects.base import Change, Instant, Load, Observable, StiffTerm, applied_at
from pftwin.model.effects.contact import FACETS, ButtonSphere, Contact


class Friction(eqx.Module):
    """Parameters of friction between a pair of surfaces."""

    coefficient: Scalar = eqx.field(metadata=quantity("", at_least=0))  # mu
    slip_speed: Scalar = eqx.field(metadata=quantity("m/s", positive=True))  # v_s: contacts creep below it


class LastNormalForce(NamedTuple):
    """Linearised normal force of a step: a change dv of the twist makes it f - (h k + c) g . dv."""

    direction: Vec3  # direction of the force: with `moment`, g
    moment: Vec3  # moment of a unit force [m]
    unchanged: Scalar  # f + (h k + c) g . v, with the twist v at the linearisation [N]
    weight: Scalar  # h k + c [N s/m]

    @staticmethod
    def of(term: StiffTerm, now: Instant) -> LastNormalForce:
        """Linearises the normal force `term` at the end of the step."""
        gain = now.lookahead if now.displacement_gain is None else now.displacement_gain
        weight = gain * term.stiffness + term.damping
        here = Twist(now.patella.velocity, now.patella.spin)
        unchanged = term.force + weight * _speed_along(term.direction, term.moment, here)
        return LastNormalForce(term.direction, term.moment, unchanged, weight)


class FrictionMemory(NamedTuple):
    """Memory of a contact with friction."""

    contact: Any  # memory of the contact without friction
    last: tuple[LastNormalForce, ...]  # linearised normal forces of the last step


class Sliding(NamedTuple):
    """Friction at one contact."""

    terms: tuple[StiffTerm, StiffTerm]  # in two directions of the tangent plane
    speed: Scalar  # sliding speed [m/s]
    grip: Scalar  # ratio of friction to normal force [-]


class WithFriction(ButtonSphere):
    """Mixin that adds a friction force to each normal force of a sphere's contact.

    A subclass also derives from the contact class that it names in `frictionless`, whose normal forces are unilateral
    stiff terms, that of the medial facet first.
    """

    friction: Friction = eqx.field(kw_only=True)
    frictionless: ClassVar[type[Contact]]
    tangential: ClassVar[dict[str, Observable]] = {
        "friction_medial": Observable("N", "friction at the medial contact"),
        "friction_lateral": Observable("N", "friction at the lateral contact"),
        "slip_speed_medial": Observable("m/s", "sliding speed at the medial contact"),
        "slip_speed_lateral": Observable("m/s", "sliding speed at the lateral contact"),
    }

    @classmethod
    def of(cls, contact: Contact, friction: Friction) -> Self:
        """Adds friction to a contact of the class `frictionless`."""
        fields = {f.name: getattr(contact, f.name) for f in dataclasses.fields(contact)}
        return cls(**fields, friction=friction)

    def with_friction(self, friction: Friction) -> Self:
        """See `Contact`."""
        return eqx.tree_at(lambda c: c.friction, self, friction)

    def simplifications(self) -> Iterable[Change]:
        """See `Effect`: the contact without friction."""
        return (Change("friction", self.alone(), "smooth", memory=lambda memory: memory.contact),)

    def alone(self) -> Contact:
        """The contact without friction."""
        return self.frictionless(**{f.name: getattr(self, f.name) for f in dataclasses.fields(self.frictionless)})

    def remember(self, now: Instant) -> FrictionMemory:
        """See `Effect`: no previous normal force."""
        return self._first(now, self.alone().remember(now))

    def guess(self, now: Instant) -> FrictionMemory:
        """See `Effect`: no previous normal force."""
        return self._first(now, self.alone().guess(now))

    def refined(self, memory: FrictionMemory, trial: FrictionMemory) -> FrictionMemory:
        """See `Effect`: refines the contact's memory only."""
        return memory._replace(contact=self.alone().refined(memory.contact, trial.contact))

    def _first(self, now: Instant, memory: Any) -> FrictionMemory:
        zero = jnp.zeros_like(now.patella.position.x)
        nowhere = Vec3(zero, zero, zero)
        normal_terms = _normal_terms(jax.eval_shape(lambda: self.alone().load(now, memory)[0]))
        return FrictionMemory(memory, (LastNormalForce(nowhere, nowhere, zero, zero),) * len(normal_terms))

    def load(self, now: Instant, memory: FrictionMemory) -> tuple[Load, FrictionMemory]:
        """See `Effect`: the contact's load, and two more stiff terms per normal force."""
        load, contact = self.alone().load(now, memory.contact)
        normal_terms, last = _normal_terms(load), memory.last
        slidings = [self._sliding(now, term, before) for term, before in zip(normal_terms, last, strict=True)]
        if now.ends_a_step:
            last = tuple(LastNormalForce.of(term, now) for term in normal_terms)
        tangential = [term for sliding in slidings for term in sliding.terms]
        return load._replace(stiff=(*load.stiff, *tangential)), FrictionMemory(contact, last)

    def _sliding(self, now: Instant, term: StiffTerm, before: LastNormalForce) -> Sliding:
        """Friction at a contact with the normal force `term`."""
        patella, normal = now.patella, term.direction
        lever = self.center - self.radius * patella.rotation.unapply(normal)
        arm = patella.arm(lever)
        slip = now.femur.relative_velocity(patella.velocity_at(arm), patella.position + arm)
        along = [(t, -t.dot(slip)) for t in normal.perpendiculars()]
        square = along[0][1] * along[0][1] + along[1][1] * along[1][1]
        law, speed = self.friction, safe_sqrt(square)
        per_speed = law.coefficient / jnp.sqrt(square + law.slip_speed * law.slip_speed)
        secant = per_speed * friction_normal(term, before, now)
        zero = jnp.zeros_like(secant)
        terms = [StiffTerm(t, applied_at(lever, patella, t), secant * v, zero, zero, secant, v) for t, v in along]
        return Sliding((terms[0], terms[1]), speed, per_speed * speed)

    def report(self, now: Instant, memory: FrictionMemory) -> tuple[dict[str, Any], Scalar | None]:
        """See `Effect`: `force_x`, `force_y` and `force_z` include friction, the other contact forces do not."""
        contact = self.alone()
        report, energy = contact.report(now, memory.contact)
        normal_terms = _normal_terms(contact.standing_load(now, memory.contact))
        slidings = [self._sliding(now, term, before) for term, before in zip(normal_terms, memory.last, strict=True)]
        force = sum((t.force * t.direction for s in slidings for t in s.terms), start=Vec3.zero())
        local = now.femur.local_direction(force)
        for axis in "xyz":
            report[f"force_{axis}"] = report[f"force_{axis}"] + getattr(local, axis)
        absent = (0 * local.x, jnp.nan * local.x)
        for facet, (grip, speed) in zip(FACETS, [*((s.grip, s.speed) for s in slidings), absent], strict=False):
            normal = report[f"force_{facet}"]  # in the report a single contact belongs to one facet
            report |= {f"friction_{facet}": grip * normal, f"slip_speed_{facet}": jnp.where(normal > 0, speed, jnp.nan)}
        return report, energy


def _normal_terms(load: Load) -> list[StiffTerm]:
    """The normal forces among a contact's stiff terms."""
    return [term for term in load.stiff if term.unilateral]


def friction_normal(term: StiffTerm, last: LastNormalForce, now: Instant) -> Scalar:
    """Normal force that friction is proportional to [N], at least 0; at the end of a step, that of the last step.

    The force about which a step linearises is not the force at its end: where a stiff contact has just begun it is
    hundreds of times as large, and so would be the friction.
    """
    if not now.ends_a_step:
        return jnp.maximum(term.force, 0.0)
    twist = Twist(now.patella.velocity, now.patella.spin) if now.twist is None else now.twist
    came_to = jnp.maximum(last.unchanged - last.weight * _speed_along(last.direction, last.moment, twist), 0.0)
    return jnp.where(term.stiffness > 0, came_to, 0.0)


def _speed_along(direction: Vec3, moment: Vec3, twist: Twist) -> Scalar:
    """Component of a twist along a wrench direction [m/s]."""
    return direction.dot(twist.linear) + moment.dot(twist.angular)
