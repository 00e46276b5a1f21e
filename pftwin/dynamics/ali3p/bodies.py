"""The knee's bodies in natural coordinates (patella, tibia, femur where it moves): masses, forces and their slopes.

Guided bodies have the patella's mass and moments of inertia, about their frames' origins: a scene knows none of theirs,
and their motion does not depend on them, while masses of one size keep the step's matrices well conditioned.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Quaternion, Scalar, Twist, Vec3, Wrench
from pftwin.dynamics.ali3p.natural_coordinates import (
    LENGTH,
    Driven,
    axes_of,
    coordinates,
    rates,
    twist_of,
    wrench_map,
)
from pftwin.dynamics.solve import six
from pftwin.dynamics.state import Guide, GuideAt, State, System
from pftwin.model.effects.base import Instant, Load, Patella, StiffTerm
from pftwin.model.motion import Frame


def masses(system: System) -> Array:
    """(12,) the constant mass matrix of each body, which is diagonal [kg].

    Along the vectors: integrals of rho x^2 = (I_y + I_z - I_x) / 2 and so on, over L^2.
    """
    i = system.inertia
    half = 0.5 * (i.x + i.y + i.z)
    each = jnp.stack([system.mass, *((half - a) / LENGTH**2 for a in (i.x, i.y, i.z))])
    return jnp.repeat(each, 3)


def guided_coordinates(guide: Guide) -> tuple[Array, Array]:
    """Coordinates of the bodies that recorded motions drive, and their rates (n, 12): zeros for the first body."""
    frames = [guide.tibia] if guide.femur is None else [guide.tibia, guide.femur]
    place = [coordinates(f.origin, f.rotation) for f in frames]
    rate = [rates(f.velocity, f.angular_velocity, f.rotation) for f in frames]
    nothing = jnp.zeros_like(place[0])
    return jnp.stack([nothing, *place]), jnp.stack([nothing, *rate])


def driven_targets(guide_at: GuideAt, step: Scalar) -> Driven:
    """What the bodies are to follow at the step's end."""

    end = jnp.ones_like(step)
    (place, rate), (_, change) = jax.jvp(lambda part: guided_coordinates(guide_at(part)), (end,), (end,))
    return Driven(place, rate, change / step)


class Bodies(eqx.Module):
    """What acts on them at an instant."""

    system: System
    memories: tuple[Any, ...]
    time: Scalar
    step: Scalar  # until the next look [s]

    def instant(self, q: Array, twists: list[Twist]) -> Instant:
        """What effects see, made of nothing but the coordinates (n, 12) and what `twist_of` says of their rates."""
        own, *others = ((Vec3.from_array(a[:3]), axes_of(a), twist) for a, twist in zip(q, twists, strict=True))
        tibia, *femur = (Frame(at, axes, by.linear, axes.apply(by.angular)) for at, axes, by in others)
        patella = Patella(own[0], own[1], own[2].linear, own[2].angular)
        return Guide(femur[0] if femur else None, tibia, self.time).instant(patella, self.step)

    def state(self, q: Array, dq: Array, last: State) -> State:
        """The patella's; its quaternion has the sign that goes on from the last one."""
        axes, twist = axes_of(q[0]), twist_of(q[0], dq[0])
        turn = Quaternion.from_rotation(axes).array()
        sign = jnp.where(turn @ last.orientation.array() < 0, -1.0, 1.0).astype(q.dtype)
        turn = Quaternion.from_array(sign * turn)
        return State(Vec3.from_array(q[0, :3]), turn, twist.linear, twist.angular, self.memories, last.carried)

    def forces(self, q: Array, dq: Array) -> tuple[Array, list[Load], tuple[Any, ...]]:
        """Generalised forces (n, 12) on all bodies, the loads that they come from, and the memories that these leave.

        A load says what acts on the patella. What it does to guided bodies is in the rates of its stiff terms, bed and
        drag, which are linear in those bodies' motion: by the principle of virtual power they feel minus the force
        times the rate's derivative. A load that is a wrench alone acts from nowhere: gravity, and known tensions.
        """
        own, *others = (twist_of(a, b) for a, b in zip(q, dq, strict=True))

        def looked(others: list[Twist]) -> tuple[list[Array], tuple[list[Load], tuple[Any, ...]]]:
            loads, memories = self.system.loads(self.instant(q, [own, *others]), self.memories)
            return [flow for load in loads for flow in _rates_of_parts(load)], (loads, memories)

        flows, react, (loads, memories) = jax.vjp(looked, others, has_aux=True)
        efforts = [effort for load in loads for effort in _forces_of_parts(load)]
        (pulled,) = react([-jnp.broadcast_to(e, f.shape) for e, f in zip(efforts, flows, strict=True)])
        total = sum((load.total() for load in loads), start=Wrench.zero())
        wrenches = [total, *(Wrench(p.linear, p.angular) for p in pulled)]
        rows = [jnp.stack(six(w.force, w.moment)) for w in wrenches]
        return jnp.stack([wrench_map(a) @ row for a, row in zip(q, rows, strict=True)]), loads, memories

    def metric(self, q: Array, loads: list[Load], by_velocity: Scalar, by_place: Scalar) -> Array:
        """M + by_velocity C + by_place K (n, 12, 12): K and C are the loads' own slopes, on the patella.

        Slopes against the guided bodies' coordinates are left out: their constraints determine these wholly.
        """
        slope, terms = jnp.zeros((6, 6), q.dtype), [term for load in loads for term in load.stiff]
        if terms:
            each = [jnp.atleast_1d(by_place * t.stiffness + by_velocity * t.damping) for t in terms]
            along = [_columns(t) for t in terms]
            weights, along = jnp.maximum(jnp.concatenate(each), 0.0), jnp.concatenate(along, axis=1)
            slope = (along * weights[None, :]) @ along.T
        for load in loads:
            if load.bed is not None:
                slope = slope + by_velocity * load.bed.slope(by_place / by_velocity)
            if load.drag is not None:
                each = [load.drag.translational] * 3 + [load.drag.rotational] * 3
                slope = slope + jnp.diag(by_velocity * jnp.stack([jnp.asarray(c, q.dtype) for c in each]))
        to_natural = wrench_map(q[0])
        own = jnp.broadcast_to(jnp.diag(masses(self.system)), (q.shape[0], 12, 12))
        return own.at[0].add(to_natural @ slope @ to_natural.T)


def _columns(term: StiffTerm) -> Array:
    """(6, k) wrench directions of a group of k terms."""
    return jnp.stack([jnp.atleast_1d(x) for x in six(term.direction, term.moment)])


def _rates_of_parts(load: Load) -> list[Array]:
    """The rates at which a load's parts give way."""
    parts = [part for part in (load.bed, load.drag) if part is not None]
    twists = [jnp.concatenate([part.velocity.array(), part.spin.array()]) for part in parts]
    return [term.rate for term in load.stiff] + twists


def _forces_of_parts(load: Load) -> list[Array]:
    """The forces against them, in the same order."""
    wrenches = [part.wrench() for part in (load.bed, load.drag) if part is not None]
    pushes = [-jnp.concatenate([w.force.array(), w.moment.array()]) for w in wrenches]
    return [term.force for term in load.stiff] + pushes
