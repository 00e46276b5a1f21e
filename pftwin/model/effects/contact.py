"""The contact between the patella's button and the femur: what results, statuses, fits and treatments ask of it."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.base import Effect, Observable

if TYPE_CHECKING:
    from pftwin.geometry.patch.closest import Surface
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


class Contact(Effect):
    """A contact that results follow. It reports what `FORCE` lists, for the medial and the lateral facet.

    Points are NaN where nothing touches. An indentation is reported as `indentation_medial` and `indentation_lateral`
    where there is one for each facet.
    """

    name: str = eqx.field(static=True, kw_only=True, default="contact")
    method: ClassVar[str] = ""  # how contact is found, in a word; empty where the surface's name says it

    def contact_role(self) -> Contact:
        """Itself."""
        return self

    @abstractmethod
    def tracked_point(self) -> Vec3:
        """The point of the patella whose path results show: the middle of the button's sphere, patella frame [m]."""

    @abstractmethod
    def with_button_moved(self, by: Vec3) -> Self:
        """With the button elsewhere on the patella, along the patella's axes [m]."""

    @abstractmethod
    def button_radius(self) -> Scalar:
        """Of the button's sphere; of a mesh, half its largest extent [m]. A step may not leap over a part of it."""

    def groove_surface(self) -> Surface | None:
        """A smooth surface that tells where the groove is: the contact's own, or a stand-in; None without any."""
        return None

    def fitted_surface(self) -> Surface | None:
        """The smooth surface that the button touches; None where it touches a mesh."""
        return None

    def with_fitted_surface(self, surface: Surface) -> Self:
        """With another surface in the place of `fitted_surface`."""
        raise NotImplementedError(f"{type(self).__name__} has no fitted surface")

    def femur_triangles(self) -> Array | None:
        """Corners (n, 9) of the femur's triangles, femur frame [m]; None where it is no mesh. Some may be copies."""
        return None

    def button_triangles(self) -> Array | None:
        """Corners (n, 9) of the button's triangles from `tracked_point`, patella axes [m]; None where it is a
        sphere.
        """
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
