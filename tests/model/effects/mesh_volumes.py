"""Spheres that press on meshes by the volume of their overlap, for tests of that contact."""

from __future__ import annotations

from scenes import RADIUS, J, about, vec

from pftwin.geometry.contact.patch_mesh import patch_mesh
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact

K = 2e8  # N/m^1.5
LAW = Hertz(J(K))


def contact(mesh: SurfaceMesh, law=LAW, labels=None, effective: float = RADIUS) -> MeshVolumeContact:
    """The small knee's button, centred in the patella, on a mesh."""
    made = MeshVolumeContact(patch_mesh(mesh, RADIUS, labels), law, vec(0, 0, 0), J(RADIUS), J(effective))
    return about(made, vec(0, 0, 0))
