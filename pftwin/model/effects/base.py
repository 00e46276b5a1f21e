"""What an effect is: a value with parameters and one method, from the state of the knee to a load on the patella.

A load is a wrench plus the effect's *stiff terms*: scalar forces along wrench directions with their slopes, which is
all an implicit step needs to know. Integrators know loads, never effects.
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


@dataclass(frozen=True)  # all instances are equal, so that programs are not compiled again for another
class Ground:
    """The frame of a fixed femur: the world itself, so every transformation is the identity and leaves no equation."""

    def point(self, p: Vec3) -> Vec3:
        """World coordinates of a point of this frame."""
        return p

    to_local = direction = local_direction = point

    def relative_velocity(self, velocity: Vec3, at: Vec3) -> Vec3:
        """A velocity less that of the frame's own point at world position `at`."""
        return velocity

    def relative_spin(self, spin: Vec3, axes: Rotation) -> Vec3:
        """An angular velocity, given in some axes, less that of the frame."""
        return spin


class Patella(eqx.Module):
    """The patella at an instant. Points of its frame are given from its centre of mass."""

    position: Vec3  # of the centre of mass, world [m]
    rotation: Rotation  # patella frame to world
    velocity: Vec3  # of the centre of mass, world [m/s]
    spin: Vec3  # angular velocity, patella axes [rad/s]

    @staticmethod
    def at_rest(position: Vec3, orientation: Quaternion) -> Patella:
        """A patella that does not move."""
        return Patella(position, orientation.rotation(), Vec3.zero(), Vec3.zero())

    def arm(self, p: Vec3) -> Vec3:
        """From the centre of mass to the patella's point p (patella frame), world axes [m]."""
        return self.rotation.apply(p)

    def velocity_at(self, arm: Vec3) -> Vec3:
        """World velocity of the patella's point at `arm` from the centre of mass (world axes)."""
        return self.velocity + self.rotation.apply(self.spin).cross(arm)


class Instant(eqx.Module):
    """The state of the knee as an effect sees it."""

    patella: Patella
    femur: Frame | Ground
    tibia: Frame
    time: Scalar | float  # [s]
    step: Scalar | float  # time until the next load [s], over which memories advance; 0 where nothing advances
    lookahead: Scalar | float = 0.0  # time from the state that an implicit step starts from to this instant [s]
    displacement_gain: Scalar | None = None  # displacement here per change of velocity, if not `lookahead` [s]
    twist: Twist | None = None  # of the patella at the start of the step, if not that of `patella`

    @property
    def ends_a_step(self) -> bool:
        """Whether this is the end of an implicit step, predicted from its start, rather than an observed instant."""
        return not isinstance(self.lookahead, float)

    def turn_in_femur(self) -> Rotation:
        """Patella frame to the femur's."""
        axes = self.patella.rotation
        return Rotation(*(self.femur.local_direction(a) for a in (axes.ex, axes.ey, axes.ez)))

    def segment(self, name: str) -> Frame | Ground:
        """The frame of "femur", "tibia" or "ground"."""
        segments = {"femur": self.femur, "tibia": self.tibia, "ground": Ground()}
        if name not in segments:
            raise KeyError(f"no segment {name!r}: expected femur, tibia or ground")
        return segments[name]


class StiffTerm(eqx.Module):
    """A scalar force f(s, ds/dt) on the patella along one wrench direction g = (direction, moment).

    s grows as the patella moves against g: ds/dt = -g . twist + the guided bodies' share. Leaves may have a leading
    axis: a group of like terms.
    """

    direction: Vec3  # unit vector of the force, world
    moment: Vec3  # its moment about the centre of mass, patella axes [m]
    force: Scalar  # f [N]
    elastic: Scalar  # the part of f that comes from stored energy [N]
    stiffness: Scalar  # df/ds [N/m]
    damping: Scalar  # df/d(ds/dt) [N s/m]
    rate: Scalar  # ds/dt [m/s]
    unilateral: bool = eqx.field(static=True, default=False)  # whether an implicit step has to see that f >= 0

    def wrench(self) -> Wrench:
        """Force in world axes, moment in patella axes; summed over a group."""
        return Wrench((self.force * self.direction).sum(), (self.force * self.moment).sum())


class Drag(eqx.Module):
    """An isotropic viscous drag on the whole body: force -c_t v, moment -c_r w."""

    translational: Scalar  # c_t [N s/m]
    rotational: Scalar  # c_r [N m s/rad]
    velocity: Vec3  # v, of the centre of mass relative to what drags, world [m/s]
    spin: Vec3  # w, relative, patella axes [rad/s]

    def wrench(self) -> Wrench:
        """Force in world axes, moment in patella axes."""
        return Wrench(-self.translational * self.velocity, -self.rotational * self.spin)

    def dissipation(self) -> Scalar:
        """Dissipated power [W]."""
        return self.translational * self.velocity.squared_norm() + self.rotational * self.spin.squared_norm()


class AggregateStiffness(eqx.Module):
    """The sums over very many stiff terms on one body that a step and the energy budget need.

    With g_i = (direction, moment) of each, forces f_i >= 0 and slopes k_i, and c_i = c k_i.
    """

    force: Array  # (6,) sum f_i g_i: force in world axes, moment about the centre of mass in patella axes [N, N m]
    elastic: Array  # (6,) the elastic part of it
    stiffness: Array  # (6, 6) sum k_i g_i g_i^T
    damping_time: Scalar | float  # c [s]
    size: Scalar  # sum f_i [N]
    velocity: Vec3  # of the centre of mass relative to the other body, world [m/s]
    spin: Vec3  # relative, patella axes [rad/s]

    def wrench(self) -> Wrench:
        """Force in world axes, moment in patella axes."""
        return Wrench(Vec3.from_array(self.force[:3]), Vec3.from_array(self.force[3:]))

    def slope(self, step: Scalar) -> Array:
        """(6, 6): what the wrench loses per unit of twist over a step."""
        return (step + self.damping_time) * self.stiffness

    def dissipation(self) -> Scalar:
        """Dissipated power [W]."""
        lost = self.elastic - self.force
        return lost[:3] @ self.velocity.array() + lost[3:] @ self.spin.array()


class Load(NamedTuple):
    """What an effect does to the patella at an instant."""

    stiff: tuple[StiffTerm, ...] = ()
    bed: AggregateStiffness | None = None
    drag: Drag | None = None
    wrench: Wrench | None = None  # everything that is not stiff; axes as in `total`
    energy: Scalar | None = None  # stored [J]
    heat: Scalar | None = None  # dissipated inside the effect, beside what stiff terms and drag dissipate [W]

    def total(self) -> Wrench:
        """The whole wrench, stiff terms and drag included: force in world axes, moment in patella axes."""
        parts = [part.wrench() for part in (self.drag, self.bed, *self.stiff) if part is not None]
        return sum(parts, start=Wrench.zero() if self.wrench is None else self.wrench)

    def power(self, patella: Patella) -> Scalar:
        """Rate of work done on the patella [W]."""
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
    """What one effect reports: a number a frame that may be measured too."""

    effect: str
    key: str
    unit: str
    long_name: str

    @staticmethod
    def of(name: str, known: Mapping[str, Mapping[str, Observable]], where: str) -> Reported:
        """By "EFFECT.OBSERVABLE", among all observables of a scene's effects.

        Raises:
            InputError: no such effect, or one that does not report this.
        """
        owner, _, key = name.rpartition(".")
        if key in known.get(owner, {}):
            return Reported(owner, key, *known[owner][key])
        those = {owner: known[owner]} if owner in known else known
        listed = ", ".join(f"{effect}.{each}" for effect, all_ in those.items() for each in all_)
        raise InputError(f"no observable {name!r}", where=where, expected=f"one of: {listed or 'none there'}")


class Change(NamedTuple):
    """An effect with one of its features changed, for studies of what that feature is worth."""

    label: str  # the feature: changes with one label are made in all effects at once
    effect: Effect  # with the change
    how: str  # in words
    memory: Callable[[Any], Any] | None = None  # converts the unchanged effect's memory, where the two differ


class Effect(eqx.Module):
    """Base of all effects. `name` tells effects of one kind apart in results and scene files."""

    name: str = eqx.field(static=True, kw_only=True)
    observables: ClassVar[dict[str, Observable]] = {}
    jumps: ClassVar[bool] = False  # whether the force jumps as the pose changes: then there need be no equilibrium
    is_weight: ClassVar[bool] = False  # whether it is the patella's weight
    in_turns: ClassVar[bool] = False  # whether the members of a batch search for it one after another on a CPU

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "observe" in vars(cls) and "report" not in vars(cls):
            cls.report = Effect.report  # an inherited `report` would ignore this class's `observe`

    @abstractmethod
    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """The load at an instant, and the memory that goes on to the next step (None for most)."""

    def remember(self, now: Instant) -> Any:
        """The memory to start with; None for an effect that remembers nothing."""
        return None

    def guess(self, now: Instant) -> Any:
        """A rough first memory that a few loads at rest correct: cheaper to compile than `remember`."""
        return self.remember(now)

    def refined(self, memory: Any, trial: Any) -> Any:
        """A memory with the places that a load at a trial pose has improved, but without its history."""
        return memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """What a result shows of this effect, by the names in `observables`."""
        return {}

    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Scalar], Scalar | None]:
        """What `observe` shows, and the energy stored. Override it where both are computed at once."""
        return self.observe(now, memory), self.load(now, memory)[0].energy

    def line_element(self) -> LineElement | None:
        """The effect as a line of force that pulls at the patella; None for all others."""
        return None

    def contact_role(self) -> Contact | None:
        """The effect as the contact between button and femur that results follow; None for all others."""
        return None

    def quantities(self) -> dict[str, Quantity]:
        """What is declared of its numbers: unit, bounds and short name, by the names of fields, dotted below them."""
        return {".".join(d.path): d.quantity for d in declarations(self) if d.quantity is not None}

    def simplifications(self) -> Iterable[Change]:
        """The effect without one of its features: its damping, its friction, its toe region."""
        return ()

    def elaborations(self) -> Iterable[Change]:
        """The effect with a feature that it lacks, with values from the literature."""
        return ()

    def in_still_femur(self, femur: SegmentMotion) -> Effect | None:
        """The effect where a moving femur's frame is treated as inertial; None if it has no meaning there."""
        return self

    def recentred(self, center_of_mass: Vec3) -> Effect:
        """The same effect with patella points given from the centre of mass, ready for the time loop."""
        return self


def applied_at(p: Vec3, patella: Patella, direction: Vec3) -> Vec3:
    """Moment (patella axes) of a unit force in a world direction at the patella's point p."""
    return p.cross(patella.rotation.unapply(direction))
