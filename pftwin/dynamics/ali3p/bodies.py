"""Bodies of the knee in natural coordinates (patella, tibia, moving femur): masses, forces and their derivatives.

Guided bodies have the patella's mass and moments of inertia, about the origins of their frames. A scene does not give
their actual ones, which do not affect their motion, and equal masses keep the matrices of a step well conditioned.
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
from pftwin.model.effects.base import Instant, Load, Patella
from pftwin.model.motion import Frame


def masses(system: System) -> Array:
    """Diagonal (12,) of the constant mass matrix of each body [kg].

    For the three vectors these are the integrals of rho x^2 = (I_y + I_z - I_x) / 2 etc., divided by L^2.
    """
    i = system.inertia
    half = 0.5 * (i.x + i.y + i.z)
    each = jnp.stack([system.mass, *((half - a) / LENGTH**2 for a in (i.x, i.y, i.z))])
    return jnp.repeat(each, 3)


def guided_coordinates(guide: Guide) -> tuple[Array, Array]:
    """Natural coordinates and rates of the guided bodies, (n, 12) each; zeros for the first body, the patella."""
    frames = [guide.tibia] if guide.femur is None else [guide.tibia, guide.femur]
    place = [coordinates(f.origin, f.rotation) for f in frames]
    rate = [rates(f.velocity, f.angular_velocity, f.rotation) for f in frames]
    nothing = jnp.zeros_like(place[0])
    return jnp.stack([nothing, *place]), jnp.stack([nothing, *rate])


def driven_targets(guide_at: GuideAt, step: Scalar) -> Driven:
    """Prescribed motion of the guided bodies at the end of the step."""

    end = jnp.ones_like(step)
    (place, rate), (_, change) = jax.jvp(lambda part: guided_coordinates(guide_at(part)), (end,), (end,))
    return Driven(place, rate, change / step)


class Bodies(eqx.Module):
    """Forces on the bodies at an instant."""

    system: System
    memories: tuple[Any, ...]
    time: Scalar
    step: Scalar  # time until the next evaluation [s]

    def instant(self, q: Array, twists: list[Twist]) -> Instant:
        """The instant for effects, from coordinates (n, 12) and the bodies' twists (see `twist_of`)."""
        own, *others = ((Vec3.from_array(a[:3]), axes_of(a), twist) for a, twist in zip(q, twists, strict=True))
        tibia, *femur = (Frame(at, axes, by.linear, axes.apply(by.angular)) for at, axes, by in others)
        patella = Patella(own[0], own[1], own[2].linear, own[2].angular)
        return Guide(femur[0] if femur else None, tibia, self.time).instant(patella, self.step)

    def state(self, q: Array, dq: Array, last: State) -> State:
        """State of the patella; the quaternion has the sign that is closer to the last one."""
        axes, twist = axes_of(q[0]), twist_of(q[0], dq[0])
        turn = Quaternion.from_rotation(axes).array()
        sign = jnp.where(turn @ last.orientation.array() < 0, -1.0, 1.0).astype(q.dtype)
        turn = Quaternion.from_array(sign * turn)
        return State(Vec3.from_array(q[0, :3]), turn, twist.linear, twist.angular, self.memories, last.solver_state)

    def forces(self, q: Array, dq: Array) -> tuple[Array, list[Load], tuple[Any, ...]]:
        """Generalised forces (n, 12) on all bodies, the loads, and the memories after them.

        A load contains the force on the patella. Its reaction on guided bodies follows from the rates of its stiff
        terms, foundation and drag, which are linear in the motion of those bodies: by the principle of virtual power it
        is minus the force times the derivative of the rate. A wrench (gravity, prescribed tensions) has no reaction.
        """
        own, *others = (twist_of(a, b) for a, b in zip(q, dq, strict=True))

        def rates_and_loads(others: list[Twist]) -> tuple[list[Array], tuple[list[Load], tuple[Any, ...]]]:
            loads, memories = self.system.loads(self.instant(q, [own, *others]), self.memories)
            return [flow for load in loads for flow in _rates_of_parts(load)], (loads, memories)

        flows, react, (loads, memories) = jax.vjp(rates_and_loads, others, has_aux=True)
        efforts = [effort for load in loads for effort in _forces_of_parts(load)]
        (pulled,) = react([-jnp.broadcast_to(e, f.shape) for e, f in zip(efforts, flows, strict=True)])
        total = sum((load.total() for load in loads), start=Wrench.zero())
        wrenches = [total, *(Wrench(p.linear, p.angular) for p in pulled)]
        rows = [jnp.stack(six(w.force, w.moment)) for w in wrenches]
        return jnp.stack([wrench_map(a) @ row for a, row in zip(q, rows, strict=True)]), loads, memories

    def metric(self, q: Array, loads: list[Load], by_velocity: Scalar, by_place: Scalar) -> Array:
        """M + by_velocity C + by_place K, (n, 12, 12), with K and C the stiffness and damping of loads on the patella.

        Derivatives with respect to guided bodies' coordinates are omitted, as constraints determine these completely.
        """
        slope, terms = jnp.zeros((6, 6), q.dtype), [term for load in loads for term in load.stiff]
        if terms:
            each = [jnp.atleast_1d(by_place * t.stiffness + by_velocity * t.damping) for t in terms]
            along = [jnp.stack([jnp.atleast_1d(x) for x in six(t.direction, t.moment)]) for t in terms]  # (6, k) each
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


def _rates_of_parts(load: Load) -> list[Array]:
    """Rates of the parts of a load: of stiff terms, foundation and drag."""
    parts = [part for part in (load.bed, load.drag) if part is not None]
    twists = [jnp.concatenate([part.velocity.array(), part.spin.array()]) for part in parts]
    return [term.rate for term in load.stiff] + twists


def _forces_of_parts(load: Load) -> list[Array]:
    """Forces conjugate to `_rates_of_parts`, in the same order."""
    wrenches = [part.wrench() for part in (load.bed, load.drag) if part is not None]
    forces = [-jnp.concatenate([w.force.array(), w.moment.array()]) for w in wrenches]
    return [term.force for term in load.stiff] + forces
