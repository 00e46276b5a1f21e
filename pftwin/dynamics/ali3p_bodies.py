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

from pftwin.dynamics.natural_coordinates import (
    LENGTH,
    Driven,
    axes_of,
    coordinates,
    frame_of,
    rates,
    second_rates,
    wrench_map,
)
from pftwin.dynamics.state import Guide, GuideAt, State, System
from pftwin.effects.base import Instant, Load, Patella
from pftwin.motion import Frame
from pftwin.spatial import Quaternion, Scalar, Twist, Vec3, Wrench


def masses(system: System) -> Array:
    """(12,) the constant mass matrix of each body, which is diagonal [kg].

    Along the vectors: integrals of rho x^2 = (I_y + I_z - I_x) / 2 and so on, over L^2.
    """
    i = system.inertia
    half = 0.5 * (i.x + i.y + i.z)
    each = jnp.stack([system.mass, *((half - a) / LENGTH**2 for a in (i.x, i.y, i.z))])
    return jnp.repeat(each, 3)


def patella_at(state: State, acceleration: Twist) -> tuple[Array, Array, Array]:
    """(12,) natural coordinates of a state's patella, their rates and second rates; spin and its rate are its own."""
    axes = state.orientation.rotation()
    omega, turning = axes.apply(state.spin), Twist(acceleration.linear, axes.apply(acceleration.angular))
    q = coordinates(state.position, axes)
    return q, rates(state.velocity, omega, axes), second_rates(turning, omega, axes)


def guided(guide: Guide) -> list[Frame]:
    """The bodies that recorded motions drive."""
    return [guide.tibia] if guide.femur is None else [guide.tibia, guide.femur]


def driven(guide_at: GuideAt, step: Scalar) -> Driven:
    """What the bodies are to follow at the step's end."""

    def rows(part: Scalar) -> tuple[Array, Array]:
        frames = guided(guide_at(part))
        place = [coordinates(f.origin, f.rotation) for f in frames]
        rate = [rates(f.velocity, f.angular_velocity, f.rotation) for f in frames]
        nothing = jnp.zeros_like(place[0])
        return jnp.stack([nothing, *place]), jnp.stack([nothing, *rate])

    end = jnp.ones_like(step)
    (place, rate), (_, change) = jax.jvp(rows, (end,), (end,))
    return Driven(place, rate, change / step)


class Bodies(eqx.Module):
    """What acts on them at an instant."""

    system: System
    memories: tuple[Any, ...]
    time: Scalar
    step: Scalar  # until the next look [s]

    def instant(self, q: Array, dq: Array) -> Instant:
        """What effects see, made of the coordinates (n, 12) and their rates alone."""
        axes, change = axes_of(q[0]), axes_of(dq[0])
        spin = Vec3(
            0.5 * (change.ey.dot(axes.ez) - change.ez.dot(axes.ey)),
            0.5 * (change.ez.dot(axes.ex) - change.ex.dot(axes.ez)),
            0.5 * (change.ex.dot(axes.ey) - change.ey.dot(axes.ex)),
        )
        patella = Patella(Vec3.from_array(q[0, :3]), axes, Vec3.from_array(dq[0, :3]), spin)
        tibia, *femur = (frame_of(a, b) for a, b in zip(q[1:], dq[1:], strict=True))
        return Guide(femur[0] if femur else None, tibia, self.time).instant(patella, self.step)

    def state(self, q: Array, dq: Array, last: State) -> State:
        """The patella's; its quaternion has the sign that goes on from the last one."""
        seen = self.instant(q, dq).patella
        turn = Quaternion.from_rotation(seen.rotation)
        sign = jnp.where(turn.array() @ last.orientation.array() < 0, -1.0, 1.0).astype(q.dtype)
        turn = Quaternion.from_array(sign * turn.array())
        return State(seen.position, turn, seen.velocity, seen.spin, self.memories, last.carried)

    def forces(self, q: Array, dq: Array) -> tuple[Array, list[Load], tuple[Any, ...]]:
        """Generalised forces (n, 12) on all bodies, the loads that they come from, and the memories that these leave.

        A load says what acts on the patella. What it does to guided bodies is in the rates of its stiff terms, bed and
        drag, which are linear in those bodies' motion: by the principle of virtual power they feel minus the force
        times the rate's derivative. A load that is a wrench alone acts from nowhere: gravity, and known tensions.
        """

        def looked(others: Array) -> tuple[list[Array], tuple[list[Load], tuple[Any, ...]]]:
            loads, memories = self.system.loads(self.instant(q, jnp.concatenate([dq[:1], others])), self.memories)
            return [flow for load in loads for flow in _flows(load)], (loads, memories)

        flows, react, (loads, memories) = jax.vjp(looked, dq[1:], has_aux=True)
        efforts = [effort for load in loads for effort in _efforts(load)]
        (reactions,) = react([jnp.broadcast_to(e, f.shape) for e, f in zip(efforts, flows, strict=True)])
        total = sum((load.total() for load in loads), start=Wrench.zero())
        own = wrench_map(q[0]) @ jnp.concatenate([total.force.array(), total.moment.array()])
        return jnp.concatenate([own[None], -reactions]), loads, memories

    def metric(self, q: Array, loads: list[Load], by_velocity: Scalar, by_place: Scalar) -> Array:
        """M + by_velocity C + by_place K (n, 12, 12): K and C are the loads' own slopes, on the patella.

        Slopes against the guided bodies' coordinates are left out: their constraints determine these wholly.
        """
        slope = jnp.zeros((6, 6), q.dtype)
        for load in loads:
            for term in load.stiff:
                g = jnp.stack([*_rows(term.direction), *_rows(term.moment)]).reshape(6, -1)
                weight = by_place * term.stiffness + by_velocity * term.damping
                slope = slope + (g * jnp.atleast_1d(jnp.maximum(weight, 0.0))[None, :]) @ g.T
            if load.bed is not None:
                slope = slope + by_velocity * load.bed.slope(by_place / by_velocity)
            if load.drag is not None:
                each = [load.drag.translational] * 3 + [load.drag.rotational] * 3
                slope = slope + jnp.diag(by_velocity * jnp.stack([jnp.asarray(c, q.dtype) for c in each]))
        to_natural = wrench_map(q[0])
        own = jnp.broadcast_to(jnp.diag(masses(self.system)), (q.shape[0], 12, 12))
        return own.at[0].add(to_natural @ slope @ to_natural.T)


def _rows(v: Vec3) -> tuple[Scalar, Scalar, Scalar]:
    return v.x, v.y, v.z


def _flows(load: Load) -> list[Array]:
    """The rates at which a load's parts give way."""
    parts = [part for part in (load.bed, load.drag) if part is not None]
    twists = [jnp.concatenate([part.velocity.array(), part.spin.array()]) for part in parts]
    return [term.rate for term in load.stiff] + twists


def _efforts(load: Load) -> list[Array]:
    """The forces against them, in the same order."""
    wrenches = [part.wrench() for part in (load.bed, load.drag) if part is not None]
    pushes = [-jnp.concatenate([w.force.array(), w.moment.array()]) for w in wrenches]
    return [term.force for term in load.stiff] + pushes
