"""Contact between the patella's button and the femur: its interface, and what its kinds share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.base import Effect, Instant, Load, Observable, StiffTerm, applied_at
from pftwin.model.effects.contact_law import ContactLaw, Speeds

if TYPE_CHECKING:
    from pftwin.geometry.contact.mesh_facets import FacetPoint
    from pftwin.geometry.patch.closest import ClosestPoint, Surface
    from pftwin.model.effects.friction import Friction

FACETS = ("medial", "lateral")
FORCE = {  # what every contact reports of its force
    "force": Observable("N", "total normal contact force, sum over the facets"),
    "force_medial": Observable("N", "normal force on the medial contact"),
    "force_lateral": Observable("N", "normal force on the lateral contact"),
    "force_x": Observable("N", "contact force on the patella, femur x"),
    "force_y": Observable("N", "contact force on the patella, femur y"),
    "force_z": Observable("N", "contact force on the patella, femur z"),
    "point_medial": Observable("m", "medial contact point, femur frame"),
    "point_lateral": Observable("m", "lateral contact point, femur frame"),
}
BY_FACET = FORCE | {f"indentation_{f}": Observable("m", f"indentation at the {f} contact") for f in FACETS}


class Contact(Effect):
    """A contact that results follow. It reports what `FORCE` lists, for the medial and the lateral facet.

    Points are NaN where nothing touches. An indentation is reported as `indentation_medial` and `indentation_lateral`
    where there is one for each facet.
    """

    name: str = eqx.field(static=True, kw_only=True, default="contact")
    method: ClassVar[str] = ""  # how contact is found, in a word; empty where the surface's name implies it

    def contact_role(self) -> Contact:
        """Itself."""
        return self

    def observe(self, now: Instant, memory: Any) -> dict[str, Any]:
        """What `report` shows."""
        return self.report(now, memory)[0]

    @abstractmethod
    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Any], Scalar | None]:
        """See `Effect`: what is shown of a contact and its energy come from one search."""

    def standing_load(self, now: Instant, memory: Any) -> Load:
        """The load at an observed instant, by the contacts that `report` shows."""
        return self.load(now, memory)[0]

    @abstractmethod
    def tracked_point(self) -> Vec3:
        """The point of the patella whose path results show: the middle of the button's sphere, patella frame [m]."""

    @abstractmethod
    def with_button_moved(self, by: Vec3) -> Self:
        """The contact with its button moved on the patella, along the patella's axes [m]."""

    @abstractmethod
    def button_radius(self) -> Scalar:
        """Of the button's sphere; of a mesh, half its largest extent [m]. A step may not leap over a part of it."""

    def groove_surface(self) -> Surface | None:
        """A smooth surface that tells where the groove is: the contact's own, or a stand-in; None without any."""
        return None

    def normal_law(self) -> ContactLaw | None:
        """The law from indentation and its rate to a force; None where there is none of a single force."""
        return None

    def fitted_surface(self) -> Surface | None:
        """The smooth surface that the button touches; None where it touches a mesh."""
        return None

    def with_fitted_surface(self, surface: Surface) -> Self:
        """The contact with another surface in place of `fitted_surface`."""
        raise NotImplementedError(f"{type(self).__name__} has no fitted surface")

    def femur_triangles(self) -> Array | None:
        """Corners (n, 9) of the femur's triangles, femur frame [m]; None where it is no mesh. Some may be copies."""
        return None

    def pressure(self, depth: Scalar) -> Scalar | None:
        """Pressure [Pa] where surfaces at rest overlap by a depth [m] of any shape; None of a law of whole contacts."""
        return None

    def button_triangles(self) -> Array | None:
        """Corners (n, 9) of the button's triangles from `tracked_point`, patella axes [m]; None of a sphere."""
        return None

    def with_friction(self, friction: Friction) -> Contact:
        """The same contact with friction; one that has friction already gets this one.

        Raises:
            InputError: a contact that has no single normal and point for each force.
        """
        raise InputError(
            f"friction for {self.name!r} ({type(self).__name__})",
            where="friction",
            expected="the contact of a sphere, with a patch or with a mesh: by volume or by nearest points",
        )


P = TypeVar("P", bound="ClosestPoint | FacetPoint")


class ContactPush(NamedTuple):
    """A contact's force, and what it remembers."""

    term: StiffTerm
    energy: Scalar  # stored [J]
    approach_speed: Scalar | None  # at the moment the contact began, 0 while apart [m/s]; None: the law forgets


def force_along(
    law: ContactLaw,
    now: Instant,
    indentation: Scalar,
    rate: Scalar,
    direction: Vec3,
    moment: Vec3,
    approach_speed: Scalar | None,
    share: Scalar | float,
    stored: Scalar | float | None = None,
) -> ContactPush:
    """A law's force along a direction.

    Args:
        law, now: the normal contact law, and the instant.
        indentation, rate: [m], [m/s].
        direction, moment: of a unit force on the patella: world axes, and patella axes about the centre of mass [m].
        approach_speed: `ContactPush.approach_speed` of the last load.
        share: of the law's force that this contact bears.
        stored: of the law's energy that this contact stores; by default as much.
    """
    if approach_speed is not None:
        begun = jnp.where(approach_speed > 0, approach_speed, jnp.maximum(rate, 1e-12))
        approach_speed = jnp.where(indentation > 0, begun, 0.0)
    # Sliding along a curve, a tangent leads off the surface: linearised about the deeper of where the step starts
    # and where it leads, contact does not open and close from step to step.
    # The viscous part is left to the step as well, which sees that the force does not pull.
    if not now.ends_a_step:
        force = law.force(indentation, rate, approach_speed)
    else:
        deeper = jnp.where(rate < 0, -now.lookahead * rate, 0.0)
        force = law.force(indentation + deeper, jnp.zeros_like(rate), approach_speed)
        back = force.elastic - deeper * force.stiffness
        force = force._replace(total=back + force.damping * rate, elastic=back)
    total, elastic, stiffness, damping = (share * a for a in force[:4])
    term = StiffTerm(direction, moment, total, elastic, stiffness, damping, rate, unilateral=True)
    return ContactPush(term, (share if stored is None else stored) * force.energy, approach_speed)


def load_of(pushes: Sequence[ContactPush]) -> tuple[Load, Speeds]:
    """A stiff term for each contact, and the approach speeds to remember."""
    energy = sum((p.energy for p in pushes[1:]), start=pushes[0].energy)
    speeds = tuple(p.approach_speed for p in pushes if p.approach_speed is not None)
    return Load(stiff=tuple(p.term for p in pushes), energy=energy), speeds or None


def vector_sum(vectors: Sequence[Vec3]) -> Vec3:
    """The sum, of the vectors' own float type."""
    return sum(vectors[1:], start=vectors[0])


def facet_report(
    total: Vec3, forces: Sequence[Scalar], indentations: Sequence[Scalar], points: Sequence[Array]
) -> dict[str, Any]:
    """What `BY_FACET` lists. A mesh of one facet calls it medial; the other one reports no force and NaN.

    Args:
        total: contact force on the patella, femur axes [N].
        forces, indentations, points: of each facet [N], [m] and (3,) in the femur's frame [m].
    """
    report: dict[str, Any] = {"force": sum(forces[1:], start=forces[0])}
    report |= {"force_x": total.x, "force_y": total.y, "force_z": total.z}
    zero = jnp.zeros_like(forces[0])
    absent = zero, jnp.nan * zero, jnp.full((3,), jnp.nan, zero.dtype)
    each = [*zip(forces, indentations, points, strict=True), absent]
    for facet, (force, indentation, point) in zip(FACETS, each, strict=False):
        report |= {f"force_{facet}": force, f"indentation_{facet}": indentation, f"point_{facet}": point}
    return report


class Touch(NamedTuple, Generic[P]):
    """A sphere at one nearest point of the femur."""

    at: P
    indentation: Scalar  # [m]
    share: Scalar  # share of the law's force: 1, less where two contacts overlap, 0 for no contact
    push: ContactPush


class FixedButton(Contact):
    """A contact whose button is fixed in the patella, at the field that `tracked_point` returns.

    Subclasses declare a `surface`, that of the femur or a smooth stand-in that tells where the groove is.
    """

    if TYPE_CHECKING:  # fields of the subclasses, in their own order

        @property
        def surface(self) -> Surface | None: ...  # noqa: D102

    def groove_surface(self) -> Surface | None:
        """The surface, or its stand-in."""
        return self.surface

    def with_button_moved(self, by: Vec3) -> Self:
        """See `Contact`."""
        return eqx.tree_at(lambda e: e.tracked_point(), self, self.tracked_point() + by)

    def recentred(self, center_of_mass: Vec3) -> Self:
        """The button's place counted from the centre of mass."""
        return self.with_button_moved(-center_of_mass)


class ButtonSphere(FixedButton):
    """A contact whose button is a sphere fixed in the patella: `center` in its frame and `radius` [m].

    Subclasses declare these and a `law`.
    """

    if TYPE_CHECKING:  # fields of the subclasses, in their own order

        @property
        def law(self) -> ContactLaw: ...  # noqa: D102
        @property
        def center(self) -> Vec3: ...  # noqa: D102
        @property
        def radius(self) -> Scalar: ...  # noqa: D102

    def centre_in_femur(self, now: Instant) -> tuple[Vec3, Vec3]:
        """The sphere's centre in the femur's frame and its velocity relative to it, femur axes [m], [m/s]."""
        patella, femur = now.patella, now.femur
        arm = patella.arm(self.center)
        centre = patella.position + arm
        velocity = femur.relative_velocity(patella.velocity_at(arm), centre)
        return femur.to_local(centre), femur.local_direction(velocity)

    def push(
        self,
        now: Instant,
        normal: Vec3,
        indentation: Scalar,
        rate: Scalar,
        approach_speed: Scalar | None,
        share: Scalar | float,
        stored: Scalar | float | None = None,
    ) -> ContactPush:
        """The law's force along a normal of the femur (femur axes): see `force_along`."""
        world = now.femur.direction(normal)
        moment = applied_at(self.center, now.patella, world)
        return force_along(self.law, now, indentation, rate, world, moment, approach_speed, share, stored)

    def touch(
        self,
        now: Instant,
        at: P,
        normal: Vec3,
        rate: Scalar,
        approach_speed: Scalar | None,
        share: Scalar,
        stored: Scalar | None = None,
    ) -> Touch[P]:
        """The law's force at a nearest point; the normal is in the femur's axes, `rate` that of the indentation."""
        indentation = self.radius - at.distance
        push = self.push(now, normal, indentation, rate, approach_speed, share, stored)
        return Touch(at, indentation, share, push)

    def normal_law(self) -> ContactLaw:
        """See `Contact`."""
        return self.law

    def tracked_point(self) -> Vec3:
        """The sphere's centre."""
        return self.center

    def button_radius(self) -> Scalar:
        """The sphere's."""
        return self.radius


class ButtonMesh(FixedButton):
    """A contact whose button is a mesh fixed in the patella: its `origin` there [m], axes parallel to the patella's."""

    in_turns: ClassVar[bool] = True

    if TYPE_CHECKING:  # fields of the subclasses, in their own order

        @property
        def origin(self) -> Vec3: ...  # noqa: D102

    def tracked_point(self) -> Vec3:
        """The origin of the button's mesh: the middle of a sphere."""
        return self.origin
