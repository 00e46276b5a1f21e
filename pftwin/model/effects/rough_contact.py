"""The button's sphere on a trochlear surface, with friction."""

from __future__ import annotations

from typing import ClassVar

from pftwin.model.effects.base import Effect, Observable
from pftwin.model.effects.friction import WithFriction
from pftwin.model.effects.sphere_contact import SphereContact


class RoughSphereContact(WithFriction, SphereContact):
    """`SphereContact` with the `friction` of `pftwin.model.effects.friction` at the medial and at the lateral
    contact.
    """

    frictionless: ClassVar[type[Effect]] = SphereContact
    observables: ClassVar[dict[str, Observable]] = {**SphereContact.observables, **WithFriction.tangential}
