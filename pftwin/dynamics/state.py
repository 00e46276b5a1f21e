"""State of the patella and of the effects' memories, the guided bodies, and the system of loads and inertia."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.spatial import Pose, Quaternion, Scalar, Twist, Vec3, Wrench
from pftwin.model.effects.base import Effect, Ground, Instant, Load, Patella
from pftwin.model.motion import Frame, KneeMotion, MotionPiece
from pftwin.model.scene import Scene


class State(eqx.Module):
    """Pose and twist of the patella's centre of mass, and the memory of each effect."""

    position: Vec3  # world [m]
    orientation: Quaternion  # patella to world
    velocity: Vec3  # world [m/s]
    spin: Vec3  # patella axes [rad/s]
    memories: tuple[Any, ...]
    solver_state: Any = None  # memory of the integrator, if any

    def patella(self) -> Patella:
        """The patella as effects use it."""
        return Patella(self.position, self.orientation.rotation(), self.velocity, self.spin)


class Guide(eqx.Module):
    """The guided bodies at an instant, or at several (leading axis)."""

    femur: Frame | None  # None: fixed, with the world as its frame
    tibia: Frame
    time: Scalar

    @staticmethod
    def sample(motion: KneeMotion | MotionPiece, times: Scalar) -> Guide:
        """The guided bodies at times [s]."""
        return Guide(*motion.frames(times), times)

    def slowed(self, factor: Scalar | float) -> Guide:
        """The same poses with velocities multiplied by a factor; 0 is at rest."""
        return Guide(None if self.femur is None else self.femur.slowed(factor), self.tibia.slowed(factor), self.time)

    def instant(
        self,
        patella: Patella,
        step: Scalar | float,
        lookahead: Scalar | float = 0.0,
        *,
        displacement_gain: Scalar | None = None,
        twist: Twist | None = None,
    ) -> Instant:
        """The instant for effects; see `Instant` for the arguments."""
        femur = Ground() if self.femur is None else self.femur
        return Instant(patella, femur, self.tibia, self.time, step, lookahead, displacement_gain, twist)


GuideAt = Callable[[float | Scalar], Guide]  # the guided bodies at a fraction of a step: 0 its start, 1 its end


class System(eqx.Module):
    """Mass, principal moments of inertia about the centre of mass (patella axes), and effects that act on it."""

    mass: Scalar  # [kg]
    inertia: Vec3  # [kg m^2]
    effects: tuple[Effect, ...]

    @staticmethod
    def of(scene: Scene) -> System:
        """The system of a scene, with points relative to the centre of mass."""
        effects = tuple(e.recentred(scene.patella.center_of_mass) for e in scene.effects)
        return System(scene.patella.mass, scene.patella.inertia, effects)

    def loads(self, now: Instant, memories: tuple[Any, ...]) -> tuple[list[Load], tuple[Any, ...]]:
        """Load of every effect, and the memories for the next step."""
        answers = [e.load(now, m) for e, m in zip(self.effects, memories, strict=True)]
        return [load for load, _ in answers], tuple(memory for _, memory in answers)

    def remember(self, now: Instant) -> tuple[Any, ...]:
        """Initial memories: see `Effect.remember`."""
        return tuple(e.remember(now) for e in self.effects)

    def refined(self, memories: tuple[Any, ...], trial: tuple[Any, ...]) -> tuple[Any, ...]:
        """Memories with contact points from an evaluation at a trial pose: see `Effect.refined`."""
        return tuple(e.refined(m, new) for e, m, new in zip(self.effects, memories, trial, strict=True))

    def guess(self, now: Instant) -> tuple[Any, ...]:
        """Rough initial memories: see `Effect.guess`."""
        return tuple(e.guess(now) for e in self.effects)

    def kinetic_energy(self, state: State) -> Scalar:
        """Kinetic energy of the patella [J]."""
        w = state.spin
        turning = self.inertia.x * w.x * w.x + self.inertia.y * w.y * w.y + self.inertia.z * w.z * w.z
        return 0.5 * (self.mass * state.velocity.squared_norm() + turning)

    def start(self, pose: Pose, guide: Guide) -> State:
        """A state at rest, with initial memories; `pose` is that of the centre of mass."""
        now = guide.instant(Patella.at_rest(pose.position, pose.orientation), 0.0)
        return self.at_rest(pose, self.remember(now))

    @staticmethod
    def at_rest(pose: Pose, memories: tuple[Any, ...]) -> State:
        """A state at rest, with given memories; `pose` is that of the centre of mass."""
        zero = Vec3(*(jnp.zeros_like(pose.position.x) for _ in range(3)))
        return State(pose.position, pose.orientation, zero, zero, memories)


def gyroscopic(inertia: Vec3, spin: Vec3) -> Vec3:
    """Gyroscopic moment -w x (I w), which conserves a free body's angular momentum, patella axes [N m]."""
    return Vec3(
        (inertia.y - inertia.z) * spin.y * spin.z,
        (inertia.z - inertia.x) * spin.z * spin.x,
        (inertia.x - inertia.y) * spin.x * spin.y,
    )


def acceleration(system: System, spin: Vec3, loads: list[Load]) -> Twist:
    """Linear (world axes) and angular (patella axes) acceleration under the loads and the gyroscopic moment."""
    total = sum((load.total() for load in loads), start=Wrench(Vec3.zero(), gyroscopic(system.inertia, spin)))
    m, i = total.moment, system.inertia
    return Twist((1 / system.mass) * total.force, Vec3(m.x / i.x, m.y / i.y, m.z / i.z))


def displaced_state(state: State, displacement: Twist, velocity: Twist) -> State:
    """The state displaced, with new velocities and unchanged memories."""
    position, orientation = state.position + displacement.linear, state.orientation.turned(displacement.angular)
    return State(position, orientation, velocity.linear, velocity.angular, state.memories, state.solver_state)


def advance(state: State, velocity: Vec3, spin: Vec3, step: Scalar, memories: tuple[Any, ...]) -> State:
    """The state after moving for a step [s] with the given velocities."""
    position, orientation = state.position + step * velocity, state.orientation.turned(step * spin)
    return State(position, orientation, velocity, spin, memories, state.solver_state)
