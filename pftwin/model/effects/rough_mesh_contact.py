"""The button's sphere on a triangle mesh, with friction."""

from __future__ import annotations

from typing import ClassVar

from pftwin.model.effects.base import Effect, Observable
from pftwin.model.effects.friction import WithFriction
from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact
from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact


class RoughMeshSphereContact(WithFriction, MeshSphereContact):
    """`MeshSphereContact` with the `friction` of `pftwin.model.effects.friction` on every facet."""

    frictionless: ClassVar[type[Effect]] = MeshSphereContact
    observables: ClassVar[dict[str, Observable]] = {**MeshSphereContact.observables, **WithFriction.tangential}


class RoughMeshVolumeContact(WithFriction, MeshVolumeContact):
    """`MeshVolumeContact` with the `friction` of `pftwin.model.effects.friction` on every facet."""

    frictionless: ClassVar[type[Effect]] = MeshVolumeContact
    observables: ClassVar[dict[str, Observable]] = {**MeshVolumeContact.observables, **WithFriction.tangential}
