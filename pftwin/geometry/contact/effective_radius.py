"""The effective radius of a sphere on a mesh: that of the plane's contact with a sphere whose overlap is as large."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.geometry.contact.patch_mesh import PatchMesh
from pftwin.geometry.contact.sphere_patch import sphere_patch
from pftwin.geometry.mesh.mesh import SurfaceMesh

if TYPE_CHECKING:
    from pftwin.geometry.patch.region import TrochlearRegion

DEPTH = 0.008  # radii: the indentation at which it is measured
PLACES = 256  # on the mesh
LEAST = 16  # places where the sphere fits, below which there is nothing to take a median of


def effective_radius(mesh: SurfaceMesh, patch: PatchMesh, radius: float, near: ArrayLike | None = None) -> float:
    """The median of V / (pi d^2) over places where a sphere dips into the mesh by d, and nowhere deeper [m].

    Args:
        mesh: in the femur's frame [m].
        patch: the same, made ready for spheres.
        radius: of the sphere [m].
        near: which vertices count, (n,) bool, for instance `beside_groove`; None: all.

    Raises:
        InputError: a mask that does not suit the mesh; a surface on which the sphere touches hardly anywhere alone.
    """
    used = np.ones(len(mesh.vertices), bool) if near is None else np.asarray(near)
    if used.shape != (len(mesh.vertices),):
        raise InputError(f"a mask of shape {used.shape}", where="near", expected=f"({len(mesh.vertices)},)")
    faces = np.flatnonzero(used[mesh.faces].all(axis=1) & (mesh.face_areas > 0))
    if not len(faces):
        raise InputError("no triangle to measure on", where=mesh.source, expected="a mask with triangles in it")
    faces = faces[np.linspace(0, len(faces) - 1, PLACES).astype(int)]
    depth = DEPTH * radius
    normals = mesh.area_vectors[faces] / mesh.face_areas[faces, None]
    centers = mesh.vertices[mesh.faces[faces]].mean(axis=1) + (radius - depth) * normals
    dtype = patch.facets.triangles.dtype
    found = _volumes(patch.prepared(), jnp.asarray(centers, dtype), jnp.asarray(radius, dtype))
    doubled, distance = (np.asarray(a, dtype=np.float64) for a in found)
    alone = np.abs(distance - (radius - depth)) < 0.1 * depth
    if alone.sum() < LEAST:
        raise InputError(
            f"a sphere of radius {1e3 * radius:g} mm touches at {alone.sum()} of {PLACES} places without going deeper"
            " elsewhere",
            where=mesh.source,
            remedy="give the effective radius of the contact yourself",
        )
    power = depth - depth**2 / (2 * radius)
    return float(np.median(doubled[alone])) / (2 * radius * math.pi * power**2)


@jax.jit
def _volumes(patch: PatchMesh, centers: jax.Array, radius: jax.Array) -> tuple[jax.Array, jax.Array]:
    """At each centre twice R V, and the distance to the surface."""

    def one(c: jax.Array) -> tuple[jax.Array, jax.Array]:
        center = Vec3.from_array(c)
        medial, lateral = sphere_patch(patch, center, radius).sums.facets
        distances = jnp.stack([p.distance for p in patch.facets.points(center)])
        return medial.doubled + lateral.doubled, jnp.min(distances)

    return jax.lax.map(one, centers)


def beside_groove(mesh: SurfaceMesh, region: TrochlearRegion, reach: float) -> NDArray[np.bool_]:
    """A region's vertices within a distance from its groove line [m], (n,): where a button runs."""
    gap = np.linalg.norm(mesh.vertices[:, None] - region.groove[None], axis=2).min(axis=1)
    return region.mask & (gap <= reach)
