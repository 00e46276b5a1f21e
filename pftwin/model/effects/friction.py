r"""Regularised Coulomb friction at the contacts of a sphere.

At each contact, with N its normal force and v the sliding velocity of the sphere's skin on the surface,

    F = -mu N v / sqrt(|v|^2 + v_s^2),

which is Coulomb's mu N for |v| well above the slip speed v_s, and a stiff damper mu N / v_s below it: what would stick
creeps instead, at v_s tan / sqrt(mu^2 - tan^2) on a slope with tan < mu. Regularised laws against Coulomb's: Vigué et
al. 2017, J Sound Vib 389:350. No friction against spinning about the normal: the contact has no size.

An implicit step is given the secant c = mu N / sqrt(|v|^2 + v_s^2) as damping in both tangential directions, not the
tangent, which vanishes in fast sliding: F = -c v at the step's end opposes the sliding that is left then, never
overshoots zero and takes energy at any length of step. N is what the normal force came to in the step before, so
friction is a step late.
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
    """Friction constants of a pair of surfaces."""

    coefficient: Scalar = eqx.field(metadata=quantity("", at_least=0))  # mu
    slip_speed: Scalar = eqx.field(metadata=quantity("m/s", positive=True))  # v_s: below it contacts creep


class LastPush(NamedTuple):
    """A normal force as a step linearised it: with the change of velocity dv it became f - (h k + c) g . dv."""

    direction: Vec3  # g: the force's
    moment: Vec3  # and its moment's [m]
    unchanged: Scalar  # f + (h k + c) g . v, with the velocity v at the linearisation [N]
    weight: Scalar  # h k + c [N s/m]

    @staticmethod
    def of(push: StiffTerm, now: Instant) -> LastPush:
        """The force to remember."""
        gain = now.lookahead if now.displacement_gain is None else now.displacement_gain
        weight = gain * push.stiffness + push.damping
        here = Twist(now.patella.velocity, now.patella.spin)
        unchanged = push.force + weight * _speed_along(push.direction, push.moment, here)
        return LastPush(push.direction, push.moment, unchanged, weight)


class FrictionMemory(NamedTuple):
    """What a contact with friction carries from step to step."""

    contact: Any  # the contact's own memory
    last: tuple[LastPush, ...]  # its normal forces


class Sliding(NamedTuple):
    """Friction at one contact."""

    terms: tuple[StiffTerm, StiffTerm]  # in two directions of the tangent plane
    speed: Scalar  # of the sphere's skin on the surface [m/s]
    grip: Scalar  # friction over normal force [-]


class WithFriction(ButtonSphere):
    """Adds friction to a sphere's contact: each normal force is joined by a tangential one.

    For classes that derive from this and from a contact of a sphere, `frictionless`, whose normal forces are unilateral
    stiff terms, the medial facet's first.
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
        """A contact of the kind `frictionless` with friction."""
        fields = {f.name: getattr(contact, f.name) for f in dataclasses.fields(contact)}
        return cls(**fields, friction=friction)

    def with_friction(self, friction: Friction) -> Self:
        """See `Contact`."""
        return eqx.tree_at(lambda c: c.friction, self, friction)

    def simplifications(self) -> Iterable[Change]:
        """Without friction."""
        return (Change("friction", self.alone(), "smooth", memory=lambda memory: memory.contact),)

    def alone(self) -> Contact:
        """The contact without friction."""
        return self.frictionless(**{f.name: getattr(self, f.name) for f in dataclasses.fields(self.frictionless)})

    def remember(self, now: Instant) -> FrictionMemory:
        """The contact's memory, and no previous force."""
        return self._first(now, self.alone().remember(now))

    def guess(self, now: Instant) -> FrictionMemory:
        """The contact's guess, and no previous force."""
        return self._first(now, self.alone().guess(now))

    def refined(self, memory: FrictionMemory, trial: FrictionMemory) -> FrictionMemory:
        """The contact's refined memory."""
        return memory._replace(contact=self.alone().refined(memory.contact, trial.contact))

    def _first(self, now: Instant, memory: Any) -> FrictionMemory:
        zero = jnp.zeros_like(now.patella.position.x)
        nowhere = Vec3(zero, zero, zero)
        pushes = _pushes(jax.eval_shape(lambda: self.alone().load(now, memory)[0]))
        return FrictionMemory(memory, (LastPush(nowhere, nowhere, zero, zero),) * len(pushes))

    def load(self, now: Instant, memory: FrictionMemory) -> tuple[Load, FrictionMemory]:
        """The contact's load, and two stiff terms more for every normal force."""
        load, contact = self.alone().load(now, memory.contact)
        pushes, last = _pushes(load), memory.last
        slidings = [self._sliding(now, push, before) for push, before in zip(pushes, last, strict=True)]
        if now.ends_a_step:
            last = tuple(LastPush.of(push, now) for push in pushes)
        tangential = [term for sliding in slidings for term in sliding.terms]
        return load._replace(stiff=(*load.stiff, *tangential)), FrictionMemory(contact, last)

    def _sliding(self, now: Instant, push: StiffTerm, before: LastPush) -> Sliding:
        """Friction at a contact with the normal force `push`."""
        patella, normal = now.patella, push.direction
        lever = self.center - self.radius * patella.rotation.unapply(normal)
        arm = patella.arm(lever)
        slip = now.femur.relative_velocity(patella.velocity_at(arm), patella.position + arm)
        along = [(t, -t.dot(slip)) for t in tangents(normal)]
        square = along[0][1] * along[0][1] + along[1][1] * along[1][1]
        law, speed = self.friction, safe_sqrt(square)
        per_speed = law.coefficient / jnp.sqrt(square + law.slip_speed * law.slip_speed)
        secant = per_speed * normal_force(push, before, now)
        zero = jnp.zeros_like(secant)
        terms = [StiffTerm(t, applied_at(lever, patella, t), secant * v, zero, zero, secant, v) for t, v in along]
        return Sliding((terms[0], terms[1]), speed, per_speed * speed)

    def report(self, now: Instant, memory: FrictionMemory) -> tuple[dict[str, Any], Scalar | None]:
        """The contact's report; `force_x`, `_y` and `_z` with friction, the other forces without it."""
        contact = self.alone()
        report, energy = contact.report(now, memory.contact)
        pushes = _pushes(contact.standing_load(now, memory.contact))
        slidings = [self._sliding(now, push, before) for push, before in zip(pushes, memory.last, strict=True)]
        force = sum((t.force * t.direction for s in slidings for t in s.terms), start=Vec3.zero())
        local = now.femur.local_direction(force)
        for axis in "xyz":
            report[f"force_{axis}"] = report[f"force_{axis}"] + getattr(local, axis)
        absent = (0 * local.x, jnp.nan * local.x)
        for facet, (grip, speed) in zip(FACETS, [*((s.grip, s.speed) for s in slidings), absent], strict=False):
            normal = report[f"force_{facet}"]  # in the report a single contact belongs to one facet
            report |= {f"friction_{facet}": grip * normal, f"slip_speed_{facet}": jnp.where(normal > 0, speed, jnp.nan)}
        return report, energy


def _pushes(load: Load) -> list[StiffTerm]:
    """The normal forces among a contact's stiff terms."""
    return [term for term in load.stiff if term.unilateral]


def normal_force(push: StiffTerm, last: LastPush, now: Instant) -> Scalar:
    """The normal force that friction is proportional to [N], at least 0: at the end of a step, that of the last step.

    The linearised force is not what the step ends with: where a stiff contact is just being made it is hundreds of
    times as large, and friction would be too.
    """
    if not now.ends_a_step:
        return jnp.maximum(push.force, 0.0)
    twist = Twist(now.patella.velocity, now.patella.spin) if now.twist is None else now.twist
    came_to = jnp.maximum(last.unchanged - last.weight * _speed_along(last.direction, last.moment, twist), 0.0)
    return jnp.where(push.stiffness > 0, came_to, 0.0)


def _speed_along(direction: Vec3, moment: Vec3, twist: Twist) -> Scalar:
    """How fast the patella moves along a wrench direction."""
    return direction.dot(twist.linear) + moment.dot(twist.angular)


def tangents(normal: Vec3) -> tuple[Vec3, Vec3]:
    """Two unit vectors that complete a unit normal: Duff et al. 2017, J Comput Graph Tech 6(1):1.

    They jump where z changes its sign, which nothing isotropic in the plane can see.
    """
    sign = jnp.where(normal.z < 0, -1.0, 1.0)
    a = -1 / (sign + normal.z)
    b = normal.x * normal.y * a
    return (
        Vec3(1 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        Vec3(b, sign + normal.y * normal.y * a, -normal.y),
    )
