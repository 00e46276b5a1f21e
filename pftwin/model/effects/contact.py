"""Base classes and shared functions for contact between the patella's button and the femur."""

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
    from pftwin.geometry.contact.patch_mesh import FacetPoint
    from pftwin.geometry.patch.closest import ClosestPoint, Surface
    from pftwin.model.effects.friction import Friction

FACETS = ("medial", "lateral")
FORCE = {  # observables of the force, reported by every contact
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
    """Base class of contacts between button and femur. It reports the observables in `FORCE` for both facets.

    Points are NaN where there is no contact. Contacts with one indentation per facet also report
    `indentation_medial` and `indentation_lateral`.
    """

    name: str = eqx.field(static=True, kw_only=True, default="contact")
    method: ClassVar[str] = ""  # name of the contact search; empty where the surface's type implies it

    def contact_role(self) -> Contact:
        """This contact."""
        return self

    def observe(self, now: Instant, memory: Any) -> dict[str, Any]:
        """The observables of `report`."""
        return self.report(now, memory)[0]

    @abstractmethod
    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Any], Scalar | None]:
        """See `Effect`. Observables and energy come from one contact search."""

    def standing_load(self, now: Instant, memory: Any) -> Load:
        """The load at an observed instant, from the contacts that `report` lists."""
        return self.load(now, memory)[0]

    @abstractmethod
    def tracked_point(self) -> Vec3:
        """Point of the patella whose path results show: the centre of the button's sphere, patella frame [m]."""

    @abstractmethod
    def with_button_moved(self, by: Vec3) -> Self:
        """The contact with its button translated on the patella by a vector in patella axes [m]."""

    @abstractmethod
    def button_radius(self) -> Scalar:
        """Radius of the button's sphere, or half the largest extent of its mesh [m]; longest steps scale with it."""

    def groove_surface(self) -> Surface | None:
        """Smooth surface that defines the groove: the contact surface or a substitute for it; None if there is none."""
        return None

    def normal_law(self) -> ContactLaw | None:
        """Law of the force as a function of indentation and its rate; None if contact is not a single force."""
        return None

    def fitted_surface(self) -> Surface | None:
        """Smooth surface of the femur in this contact; None if the femur is a mesh."""
        return None

    def with_fitted_surface(self, surface: Surface) -> Self:
        """The contact with `surface` in place of `fitted_surface`."""
        raise NotImplementedError(f"{type(self).__name__} has no fitted surface")

    def femur_triangles(self) -> Array | None:
        """Corners (n, 9) of the femur's triangles, femur frame [m], possibly with duplicates; None if it is no mesh."""
        return None

    def pressure(self, depth: Scalar) -> Scalar | None:
        """Static pressure [Pa] at overlap depths [m] (any shape); None if the law gives a force per contact instead."""
        return None

    def button_triangles(self) -> Array | None:
        """Corners (n, 9) of the button's triangles from `tracked_point`, patella axes [m]; None for a sphere."""
        return None

    def with_friction(self, friction: Friction) -> Contact:
        """The contact with friction, which replaces any friction that it has.

        Raises:
            InputError: the contact's forces have no single normal and point each.
        """
        raise InputError(
            f"friction for {self.name!r} ({type(self).__name__})",
            where="friction",
            expected="the contact of a sphere, with a patch or with a mesh: by volume or by nearest points",
        )


P = TypeVar("P", bound="ClosestPoint | FacetPoint")


class NormalForce(NamedTuple):
    """Normal force of a contact, and its memory."""

    term: StiffTerm
    energy: Scalar  # stored [J]
    approach_speed: Scalar | None  # when the contact began, 0 without contact [m/s]; None: not used by the law


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
) -> NormalForce:
    """Normal force of a contact law, along a direction.

    Args:
        law, now: the normal contact law, and the instant.
        indentation, rate: indentation [m] and its rate [m/s].
        direction, moment: unit force on the patella, world axes; its moment about the centre of mass, patella axes [m].
        approach_speed: `NormalForce.approach_speed` of the last load [m/s].
        share: fraction of the law's force that this contact bears.
        stored: fraction of the law's energy that this contact stores; `share` by default.
    """
    if approach_speed is not None:
        begun = jnp.where(approach_speed > 0, approach_speed, jnp.maximum(rate, 1e-12))
        approach_speed = jnp.where(indentation > 0, begun, 0.0)
    # When the button slides along a curved surface, extrapolation along the tangent leaves the surface. Linearising
    # about the deeper of the step's start and its predicted end keeps contact from opening and closing at every step.
    # The implicit step also adds the viscous part, and keeps the force from pulling.
    if not now.ends_a_step:
        force = law.force(indentation, rate, approach_speed)
    else:
        deeper = jnp.where(rate < 0, -now.lookahead * rate, 0.0)
        force = law.force(indentation + deeper, jnp.zeros_like(rate), approach_speed)
        back = force.elastic - deeper * force.stiffness
        force = force._replace(total=back + force.damping * rate, elastic=back)
    total, elastic, stiffness, damping = (share * a for a in force[:4])
    term = StiffTerm(direction, moment, total, elastic, stiffness, damping, rate, unilateral=True)
    return NormalForce(term, (share if stored is None else stored) * force.energy, approach_speed)


def load_of(forces: Sequence[NormalForce]) -> tuple[Load, Speeds]:
    """Returns the load, with one stiff term per contact, and the approach speeds for the memory [m/s]."""
    energy = sum((f.energy for f in forces[1:]), start=forces[0].energy)
    speeds = tuple(f.approach_speed for f in forces if f.approach_speed is not None)
    return Load(stiff=tuple(f.term for f in forces), energy=energy), speeds or None


def vector_sum(vectors: Sequence[Vec3]) -> Vec3:
    """Sum of one or more vectors, in their float type."""
    return sum(vectors[1:], start=vectors[0])


def facet_report(
    total: Vec3, forces: Sequence[Scalar], indentations: Sequence[Scalar], points: Sequence[Array]
) -> dict[str, Any]:
    """The observables in `BY_FACET`. A single facet counts as medial; lateral then reports zero force and NaN.

    Args:
        total: contact force on the patella, femur axes [N].
        forces, indentations, points: per facet: [N], [m], and (3,) in the femur frame [m].
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
    """Contact of a sphere at one nearest point of the femur."""

    at: P
    indentation: Scalar  # [m]
    share: Scalar  # fraction of the law's force: 1, less where two contacts overlap, 0 for no contact
    normal_force: NormalForce


class FixedButton(Contact):
    """A contact whose button is fixed in the patella, at the field that `tracked_point` returns.

    Subclasses declare a `surface`: that of the femur, or a smooth substitute that defines the groove.
    """

    if TYPE_CHECKING:  # fields of the subclasses, whose order differs between them

        @property
        def surface(self) -> Surface | None: ...  # noqa: D102

    def groove_surface(self) -> Surface | None:
        """The field `surface`."""
        return self.surface

    def with_button_moved(self, by: Vec3) -> Self:
        """See `Contact`."""
        return eqx.tree_at(lambda e: e.tracked_point(), self, self.tracked_point() + by)

    def recentred(self, center_of_mass: Vec3) -> Self:
        """The contact with the button's position relative to the centre of mass."""
        return self.with_button_moved(-center_of_mass)


class ButtonSphere(FixedButton):
    """A contact whose button is a sphere fixed in the patella: `center` in its frame and `radius` [m].

    Subclasses declare these fields and a `law`.
    """

    if TYPE_CHECKING:  # fields of the subclasses, whose order differs between them

        @property
        def law(self) -> ContactLaw: ...  # noqa: D102
        @property
        def center(self) -> Vec3: ...  # noqa: D102
        @property
        def radius(self) -> Scalar: ...  # noqa: D102

    def centre_in_femur(self, now: Instant) -> tuple[Vec3, Vec3]:
        """The sphere's centre in the femur frame [m], and its velocity relative to the femur, femur axes [m/s]."""
        patella, femur = now.patella, now.femur
        arm = patella.arm(self.center)
        centre = patella.position + arm
        velocity = femur.relative_velocity(patella.velocity_at(arm), centre)
        return femur.to_local(centre), femur.local_direction(velocity)

    def normal_force(
        self,
        now: Instant,
        normal: Vec3,
        indentation: Scalar,
        rate: Scalar,
        approach_speed: Scalar | None,
        share: Scalar | float,
        stored: Scalar | float | None = None,
    ) -> NormalForce:
        """Normal force along `normal` (femur axes): see `force_along`."""
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
        """Contact at a nearest point `at`; `normal` in femur axes, `rate` of the indentation [m/s]."""
        indentation = self.radius - at.distance
        force = self.normal_force(now, normal, indentation, rate, approach_speed, share, stored)
        return Touch(at, indentation, share, force)

    def normal_law(self) -> ContactLaw:
        """See `Contact`."""
        return self.law

    def tracked_point(self) -> Vec3:
        """The sphere's centre."""
        return self.center

    def button_radius(self) -> Scalar:
        """Radius of the sphere [m]."""
        return self.radius


class ButtonMesh(FixedButton):
    """A contact whose button is a mesh fixed in the patella at `origin` [m], by default with axes parallel to its."""

    in_turns: ClassVar[bool] = True

    if TYPE_CHECKING:  # fields of the subclasses, whose order differs between them

        @property
        def origin(self) -> Vec3: ...  # noqa: D102

    def tracked_point(self) -> Vec3:
        """Origin of the button's mesh, patella frame [m]; for a spherical button, its centre."""
        return self.origin
