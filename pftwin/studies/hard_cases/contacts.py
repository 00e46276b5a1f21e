"""Contact kinds of the hard cases; all contacts of one kind have arrays of equal shape, so that they can be stacked."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import numpy as np
from jax.dtypes import canonicalize_dtype
from numpy.typing import NDArray

from pftwin.base.leaves import number, vector
from pftwin.geometry.bvh.corners import corner_tree
from pftwin.geometry.contact.contact_mesh import ContactMesh, contact_mesh
from pftwin.geometry.contact.patch_mesh import patch_mesh
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.base import Effect
from pftwin.model.effects.mesh_contact import MeshContact
from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact
from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.studies.hard_cases.ground import lateral_of, patch_on

if TYPE_CHECKING:
    from pftwin.studies.hard_cases.knee import KneeNumbers

PATCHES = ("P2", "P4", "P5", "P5 cylinder", "P8", "spline")
MESHES = ("contours", "volume")
CONTACTS = (*PATCHES, *MESHES)

BUTTON = 8  # frequency of the button's icosphere: 1,280 triangles
_CORNERS, _EDGES = 64, 64  # capacity of each femoral mesh
_NOWHERE = -1e3  # coordinate of padding edges, far away [m]


def contact_on(knee: KneeNumbers, kind: str) -> Effect:
    """Returns the contact of a kind for a knee; InputError for an invalid surface."""
    law, center, radius = knee.law.flores(), vector(knee.center), number(knee.radius)
    if kind in PATCHES:
        return SphereContact(patch_on(knee.ground, kind), law, center, radius)
    mesh = knee.mesh(knee.ground)
    label = lateral_of(mesh) if knee.facets == 2 else None
    if kind == "volume":
        made = patch_mesh(mesh, knee.radius, label)
        made = eqx.tree_at(lambda m: (m.seam, m.rim), made, (_padded_edges(made.seam), _padded_edges(made.rim)))
        return MeshVolumeContact(made, law, center, radius, number(knee.radius))
    femur = _padded_corners(contact_mesh(mesh, label), mesh)
    return MeshContact(femur, _button(knee.radius, canonicalize_dtype(float) == np.float64), law, center)


@lru_cache(maxsize=16)
def _button(radius: float, float64: bool) -> ContactMesh:
    """The button's sphere as a triangle mesh."""
    return contact_mesh(icosphere(radius, BUTTON))


def _padded_corners(made: ContactMesh, mesh: SurfaceMesh) -> ContactMesh:
    """Pads the mesh to the capacity of corners by repeating the last one."""
    tree = made.corners
    count = len(mesh.vertices)
    order = np.argsort(np.asarray(tree.index), kind="stable")
    first = order[np.searchsorted(np.asarray(tree.index)[order], np.arange(count))]
    points, normals = (np.asarray(a, dtype=np.float64)[first] for a in (tree.points, tree.normals))
    repeated = np.minimum(np.arange(_CORNERS), count - 1)
    return eqx.tree_at(lambda m: m.corners, made, corner_tree(points[repeated], normals[repeated]))


def _padded_edges(rows: jax.Array) -> jax.Array:
    """Pads border or rim edges to their capacity with points far away."""
    padded: NDArray = np.full((_EDGES, 6), _NOWHERE, np.asarray(rows).dtype)
    padded[: len(rows)] = np.asarray(rows)
    return jax.device_put(padded)
