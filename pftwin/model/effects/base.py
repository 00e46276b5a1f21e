"""Base class of effects: each holds parameters and computes the load on the patella from the state of the knee.

A load is a wrench plus *stiff terms*: scalar forces along wrench directions, with their derivatives, which is all that
an implicit step needs. Integrators depend on loads alone, never on the kinds of effects.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.quantities import Quantity, declarations
from pftwin.base.spatial import Quaternion, Rotation, Scalar, Twist, Vec3, Wrench
from pftwin.model.motion import Frame, SegmentMotion

if TYPE_CHECKING:
    from pftwin.model.effects.contact import Contact
    from pftwin.model.effects.line_elements import LineElement


@dataclass(frozen=True)  # all instances are equal, so that a new instance does not trigger recompilation
class Ground:
    """The frame of a fixed femur: the world frame. Every transformation is the identity and adds no operation."""

    def point(self, p: Vec3) -> Vec3:
        """World coordinates of a point of this frame."""
        return p

    to_local = direction = local_direction = point

    def relative_velocity(self, velocity: Vec3, at: Vec3) -> Vec3:
        """A world velocity minus that of the frame's material point at world position `at` [m/s]."""
        return velocity

    def relative_spin(self, spin: Vec3, axes: Rotation) -> Vec3:
        """An angular velocity, expressed in `axes`, minus that of the frame [rad/s]."""
        return spin


class Patella(eqx.Module):
    """Pose and velocity of the patella at an instant. Points of its frame are relative to its centre of mass."""

    position: Vec3  # of the centre of mass, world [m]
    rotation: Rotation  # patella frame to world
    velocity: Vec3  # of the centre of mass, world [m/s]
    spin: Vec3  # angular velocity, patella axes [rad/s]

    @staticmethod
    def at_rest(position: Vec3, orientation: Quaternion) -> Patella:
        """A patella with zero velocity and angular velocity."""
        return Patella(position, orientation.rotation(), Vec3.zero(), Vec3.zero())

    def arm(self, p: Vec3) -> Vec3:
        """Vector from the centre of mass to the point p (patella frame), in world axes [m]."""
        return self.rotation.apply(p)

    def velocity_at(self, arm: Vec3) -> Vec3:
        """World velocity [m/s] of the patella's point at the offset `arm` [m, world axes] from the centre of mass."""
        return self.velocity + self.rotation.apply(self.spin).cross(arm)


class Instant(eqx.Module):
    """State of the knee from which an effect computes its load."""

    patella: Patella
    femur: Frame | Ground
    tibia: Frame
    time: Scalar | float  # [s]
    step: Scalar | float  # time until the next load [s], by which memories advance; 0: they do not advance
    lookahead: Scalar | float = 0.0  # time from the start of an implicit step to this instant [s]
    displacement_gain: Scalar | None = None  # displacement here per change of velocity, if not `lookahead` [s]
    twist: Twist | None = None  # twist of the patella at the start of the step, if not that of `patella`

    @property
    def ends_a_step(self) -> bool:
        """Whether this is the predicted end of an implicit step rather than an observed instant."""
        return not isinstance(self.lookahead, float)

    def turn_in_femur(self) -> Rotation:
        """Rotation from the patella frame to the femur frame."""
        axes = self.patella.rotation
        return Rotation(*(self.femur.local_direction(a) for a in (axes.ex, axes.ey, axes.ez)))

    def knee_flexion(self) -> Scalar:
        """Flexion of the tibia in the femur [rad], as `pftwin.base.rotations` defines it."""
        long_axis = self.femur.local_direction(self.tibia.rotation.ex)
        return jnp.arctan2(long_axis.z, long_axis.x)

    def segment(self, name: str) -> Frame | Ground:
        """The frame of "femur", "tibia" or "ground"."""
        segments = {"femur": self.femur, "tibia": self.tibia, "ground": Ground()}
        if name not in segments:
            raise KeyError(f"no segment {name!r}: expected femur, tibia or ground")
        return segments[name]


class StiffTerm(eqx.Module):
    """A scalar force f(s, ds/dt) on the patella along one wrench direction g = (direction, moment).

    s grows as the patella moves against g: ds/dt = -g . twist + the contribution of the guided bodies' motion. With a
    leading axis on its leaves, this is a group of terms of one kind.
    """

    direction: Vec3  # unit vector of the force, world
    moment: Vec3  # its moment about the centre of mass, patella axes [m]
    force: Scalar  # f [N]
    elastic: Scalar  # the part of f that comes from stored energy [N]
    stiffness: Scalar  # df/ds [N/m]
    damping: Scalar  # df/d(ds/dt) [N s/m]
    rate: Scalar  # ds/dt [m/s]
    unilateral: bool = eqx.field(static=True, default=False)  # whether an implicit step must enforce f >= 0

    def wrench(self) -> Wrench:
        """Force in world axes, moment in patella axes; summed over a group."""
        return Wrench((self.force * self.direction).sum(), (self.force * self.moment).sum())


class Drag(eqx.Module):
    """Isotropic viscous drag on the patella: force -c_t v, moment -c_r w."""

    translational: Scalar  # c_t [N s/m]
    rotational: Scalar  # c_r [N m s/rad]
    velocity: Vec3  # v, of the centre of mass relative to the segment that exerts the drag, world [m/s]
    spin: Vec3  # w, relative, patella axes [rad/s]

    def wrench(self) -> Wrench:
        """Force in world axes, moment in patella axes."""
        return Wrench(-self.translational * self.velocity, -self.rotational * self.spin)

    def dissipation(self) -> Scalar:
        """Dissipated power [W]."""
        return self.translational * self.velocity.squared_norm() + self.rotational * self.spin.squared_norm()


class AggregateStiffness(eqx.Module):
    """Sums over many stiff terms, as an implicit step and the energy budget need them.

    Term i has the wrench direction g_i = (direction, moment), force f_i >= 0, stiffness k_i and damping c_i = c k_i.
    """

    force: Array  # (6,) sum f_i g_i: force in world axes, moment about the centre of mass in patella axes [N, N m]
    elastic: Array  # (6,) elastic part of `force`
    stiffness: Array  # (6, 6) sum k_i g_i g_i^T
    damping_time: Scalar | float  # c [s]
    size: Scalar  # sum f_i [N]
    velocity: Vec3  # of the centre of mass relative to the other body, world [m/s]
    spin: Vec3  # relative, patella axes [rad/s]

    def wrench(self) -> Wrench:
        """Force in world axes, moment in patella axes."""
        return Wrench(Vec3.from_array(self.force[:3]), Vec3.from_array(self.force[3:]))

    def slope(self, step: Scalar) -> Array:
        """(6, 6): decrease of the wrench per unit of twist over a step [s]."""
        return (step + self.damping_time) * self.stiffness

    def dissipation(self) -> Scalar:
        """Dissipated power [W]."""
        lost = self.elastic - self.force
        return lost[:3] @ self.velocity.array() + lost[3:] @ self.spin.array()


class Load(NamedTuple):
    """Load of an effect on the patella at an instant."""

    stiff: tuple[StiffTerm, ...] = ()
    bed: AggregateStiffness | None = None
    drag: Drag | None = None
    wrench: Wrench | None = None  # sum of the non-stiff parts; axes as in `total`
    energy: Scalar | None = None  # stored [J]
    heat: Scalar | None = None  # power dissipated inside the effect, in addition to stiff terms and drag [W]

    def total(self) -> Wrench:
        """Total wrench, including stiff terms and drag: force in world axes, moment in patella axes."""
        parts = [part.wrench() for part in (self.drag, self.bed, *self.stiff) if part is not None]
        return sum(parts, start=Wrench.zero() if self.wrench is None else self.wrench)

    def power(self, patella: Patella) -> Scalar:
        """Power of the load on the patella [W]."""
        w = self.total()
        return w.force.dot(patella.velocity) + w.moment.dot(patella.spin)

    def dissipation(self) -> Scalar:
        """Rate at which the effect dissipates energy [W]."""
        lost = [jnp.sum((t.force - t.elastic) * t.rate) for t in self.stiff]
        lost += [part.dissipation() for part in (self.bed, self.drag) if part is not None]
        return sum(lost if self.heat is None else [*lost, self.heat], start=jnp.zeros(()))


class Observable(NamedTuple):
    """Unit and long name of a quantity that an effect reports."""

    unit: str
    long_name: str


class Reported(NamedTuple):
    """An observable of a named effect: a quantity with one value per frame, which may also be measured."""

    effect: str
    key: str
    unit: str
    long_name: str

    @staticmethod
    def of(name: str, known: Mapping[str, Mapping[str, Observable]], where: str) -> Reported:
        """Looks up "EFFECT.OBSERVABLE" in `known`, the observables of a scene's effects by effect name.

        Raises:
            InputError: there is no such effect, or it does not report this observable.
        """
        owner, _, key = name.rpartition(".")
        if key in known.get(owner, {}):
            return Reported(owner, key, *known[owner][key])
        those = {owner: known[owner]} if owner in known else known
        listed = ", ".join(f"{effect}.{each}" for effect, all_ in those.items() for each in all_)
        raise InputError(f"no observable {name!r}", where=where, expected=f"one of: {listed or 'none there'}")


class Change(NamedTuple):
    """An effect with one feature changed, for studies of the effect of that feature on the result."""

    label: str  # the feature: changes with the same label are applied to all effects together
    effect: Effect  # the changed effect
    how: str  # description of the change
    memory: Callable[[Any], Any] | None = None  # converts the unchanged effect's memory; None: both are the same


class Effect(eqx.Module):
    """Base class of all effects. `name` identifies the effect in results and scene files."""

    name: str = eqx.field(static=True, kw_only=True)
    observables: ClassVar[dict[str, Observable]] = {}
    jumps: ClassVar[bool] = False  # whether the force is discontinuous in the pose, so that equilibrium may not exist
    is_weight: ClassVar[bool] = False  # whether the effect is the patella's weight
    in_turns: ClassVar[bool] = False  # whether its search runs for the variants of a batch one at a time on a CPU

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "observe" in vars(cls) and "report" not in vars(cls):
            cls.report = Effect.report  # an inherited `report` would ignore this class's `observe`

    @abstractmethod
    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """Returns the load at an instant, and the memory for the next step (None for most effects)."""

    def remember(self, now: Instant) -> Any:
        """Initial memory; None for an effect without memory."""
        return None

    def guess(self, now: Instant) -> Any:
        """Rough initial memory, which a few loads at rest then correct; cheaper to compile than `remember`."""
        return self.remember(now)

    def refined(self, memory: Any, trial: Any) -> Any:
        """`memory` with the contact points of `trial`, the memory after a load at a trial pose, but not its history."""
        return memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Values of the observables, keyed by the names in `observables`."""
        return {}

    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Scalar], Scalar | None]:
        """Returns the values of `observe` and the stored energy [J]. Override it where one computation gives both."""
        return self.observe(now, memory), self.load(now, memory)[0].energy

    def line_element(self) -> LineElement | None:
        """This effect if it is a line of force that pulls at the patella, else None."""
        return None

    def contact_role(self) -> Contact | None:
        """This effect if it is the contact between button and femur that results report, else None."""
        return None

    def quantities(self) -> dict[str, Quantity]:
        """Unit, bounds and short name of each parameter, keyed by field name, with dots for nested fields."""
        return {".".join(d.path): d.quantity for d in declarations(self) if d.quantity is not None}

    def simplifications(self) -> Iterable[Change]:
        """Variants of the effect, each without one feature, e.g. its damping, friction or toe region."""
        return ()

    def elaborations(self) -> Iterable[Change]:
        """Variants of the effect, each with one additional feature, whose parameters are from the literature."""
        return ()

    def in_still_femur(self, femur: SegmentMotion) -> Effect | None:
        """The equivalent effect where a moving femur's frame is treated as inertial; None if there is none."""
        return self

    def recentred(self, center_of_mass: Vec3) -> Effect:
        """The effect with patella points relative to the centre of mass, prepared for the time loop."""
        return self


def applied_at(p: Vec3, patella: Patella, direction: Vec3) -> Vec3:
    """Moment (patella axes) of a unit force in a world direction at the patella's point p."""
    return p.cross(patella.rotation.unapply(direction))
