"""The button's sphere on a trochlear surface, with friction; and friction for whatever contact there is."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import equinox as eqx

from pftwin.effects.base import Effect, Observable
from pftwin.effects.friction import Friction, WithFriction
from pftwin.effects.sphere_contact import SphereContact
from pftwin.errors import InputError


class RoughSphereContact(WithFriction, SphereContact):
    """`SphereContact` with the `friction` of `pftwin.effects.friction` at the medial and at the lateral contact."""

    frictionless: ClassVar[type[Effect]] = SphereContact
    observables: ClassVar[dict[str, Observable]] = {**SphereContact.observables, **WithFriction.tangential}


def with_friction(contact: Effect, friction: Friction) -> Effect:
    """The same contact with friction; one that has friction already gets this one.

    Raises:
        InputError: a contact that has no single normal and point for each force: of two meshes by contours, or of an
            elastic foundation; or no contact.
    """
    if isinstance(contact, WithFriction):
        return eqx.tree_at(lambda c: c.friction, contact, friction)
    kinds: dict[type[Effect], Any] = {SphereContact: RoughSphereContact}
    if type(contact) not in kinds:
        from pftwin.effects import rough_mesh_contact as rough

        kinds = {kind.frictionless: kind for kind in (rough.RoughMeshSphereContact, rough.RoughMeshVolumeContact)}
    if type(contact) not in kinds:
        raise InputError(
            f"friction for {contact.name!r} ({type(contact).__name__})",
            where="friction",
            expected="the contact of a sphere, with a patch or with a mesh: by volume or by nearest points",
        )
    fields = {f.name: getattr(contact, f.name) for f in dataclasses.fields(contact)}
    return kinds[type(contact)](**fields, friction=friction)
