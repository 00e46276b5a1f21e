"""friction = { ... } in [contact] and [mesh_contact]."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from pftwin.base.leaves import number
from pftwin.files.scene_file.section import NotNegative, Positive, Section

if TYPE_CHECKING:
    from pftwin.model.effects.contact import Contact


class FrictionSection(Section):
    """Coulomb friction, smooth about rest."""

    coefficient: NotNegative = Field(description="coefficient of friction mu [-]")
    slip_speed_m_per_s: Positive = Field(
        default=1e-3, description="speed up to which contacts creep rather than slide [m/s]"
    )

    def added(self, contact: Contact) -> Contact:
        """The contact with it."""
        from pftwin.model.effects.friction import Friction

        return contact.with_friction(Friction(number(self.coefficient), number(self.slip_speed_m_per_s)))
