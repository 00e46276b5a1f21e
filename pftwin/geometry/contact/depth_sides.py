"""The two sides of a contact by depths, as pytrees: the surface that is pressed into and the one that presses.

The femur's surface gives the point nearest to another and the outward normal there; the button's triangles
are queried, by their centroids. Both may be open.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.program_cache import cached
from pftwin.base.spatial import Vec3
from pftwin.geometry.bvh.features import features_of
from pftwin.geometry.bvh.tree import check_searchable
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.bvh.walk import Fans, fans_of, rows_of
from pftwin.geometry.mesh.mesh import SurfaceMesh

FEMUR_LANES = 8  # most triangles in a leaf
BUTTON_LANES = 16


class PressedSurface(eqx.Module):
    """The surface that is pressed into. Arrays are leaves: another mesh of the same size re-uses the program."""

    bounds: Array  # (nodes, 8, 16) float32 discs, see `Fans`
    rows: Array  # (16 nodes, 8) the same, child after child
    first: Array  # (nodes,) int32
    lanes: Array  # (leaves, 9, lanes) corners a, b, c [m], for searches
    corners: Array  # (leaves * lanes, 9) the same, one row for each place
    triangle: Array  # (leaves * lanes,) int32: which triangle of the mesh is in a place
    outward: Array  # (7 triangles, 3) unit, at each triangle's face, edges and corners
    rim: Array  # (7 triangles,) whether that is on the boundary of the open mesh
    label: Array | None  # (triangles,) int32, which facet

    def leaf(self, number: Array) -> Triangle:
        """The triangles of a leaf, one for each lane."""
        rows = jax.lax.dynamic_index_in_dim(self.lanes, number, keepdims=False)
        return Triangle(*(Vec3(rows[3 * k], rows[3 * k + 1], rows[3 * k + 2]) for k in range(3)))

    def rim_edges(self) -> Array:
        """(leaves * lanes,) int32: bits 1, 2, 4 for an edge ab, bc, ca of the triangle in a place on the rim."""
        edges = self.rim.reshape(-1, 7)[:, 1:4].astype(jnp.int32)
        return (edges @ jnp.array([1, 2, 4], jnp.int32))[self.triangle]

    @property
    def width(self) -> int:
        """Lanes of a leaf."""
        return self.lanes.shape[-1]


class PressingSurface(eqx.Module):
    """The surface whose triangles' depths are asked for."""

    rows: Array  # (16 nodes, 4) float32 balls about centroids, child after child of each node
    first: Array  # (nodes,) int32
    corners: Array  # (leaves * lanes, 9) a, b, c [m]
    index: Array  # (leaves, lanes) int32: which triangle; negative in an empty lane, which holds a copy

    @property
    def lanes(self) -> int:
        """Triangles in a leaf."""
        return self.index.shape[-1]

    @property
    def leaves(self) -> int:
        """How many."""
        return self.index.shape[-2]


def pressed_surface(mesh: SurfaceMesh, labels: ArrayLike | None = None) -> PressedSurface:
    """From a mesh, open or closed, whose normals point outward [m].

    Args:
        mesh: in the frame in which it is fixed.
        labels: (triangles,) integers, which facet a triangle belongs to: 0 medial, 1 lateral.

    Raises:
        InputError: no triangles, too many, or coordinates that are not finite; labels that do not fit.
    """
    check_searchable(mesh)
    facets = None
    if labels is not None:
        facets = np.asarray(labels)
        if facets.shape != (len(mesh.faces),) or not np.isin(facets, (0, 1)).all():
            raise InputError(
                f"labels of shape {facets.shape}",
                where=mesh.source,
                expected=f"({len(mesh.faces)},): 0 (medial) or 1 (lateral) for each triangle",
            )
        facets = jax.device_put(facets.astype(np.int32))
    fans, outward, rim = cached(_fans_and_features, mesh.vertices, mesh.faces, files=())
    corners, index = _packed_corners(mesh, fans)
    own = canonicalize_dtype(float)
    return PressedSurface(
        bounds=jax.device_put(fans.bounds),
        rows=jax.device_put(rows_of(fans)),
        first=jax.device_put(fans.first),
        lanes=jax.device_put(np.ascontiguousarray(corners.swapaxes(1, 2)).astype(own)),
        corners=jax.device_put(corners.reshape(-1, 9).astype(own)),
        triangle=jax.device_put(np.where(index < 0, -1 - index, index).ravel().astype(np.int32)),
        outward=jax.device_put(outward.astype(own)),
        rim=jax.device_put(rim),
        label=facets,
    )


def pressing_surface(mesh: SurfaceMesh) -> PressingSurface:
    """From a mesh [m] in the frame in which it is fixed.

    Raises:
        InputError: no triangles, too many, or coordinates that are not finite.
    """
    check_searchable(mesh)
    fans = cached(fans_of, mesh.vertices[mesh.faces], BUTTON_LANES, True, files=())
    corners, index = _packed_corners(mesh, fans)
    own = canonicalize_dtype(float)
    parts = (rows_of(fans), fans.first, corners.reshape(-1, 9).astype(own), index.astype(np.int32))
    return PressingSurface(*(jax.device_put(a) for a in parts))


def _fans_and_features(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[Fans, NDArray[np.float64], NDArray[np.bool_]]:
    mesh = SurfaceMesh(vertices, faces)
    features = features_of(mesh, np.zeros(len(faces), dtype=np.int64))
    return fans_of(vertices[faces], FEMUR_LANES, False), features.outward.reshape(-1, 3), features.rim.ravel()


def _packed_corners(mesh: SurfaceMesh, fans: Fans) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Corners (leaves, lanes, 9), and the index of each place."""
    source = np.where(fans.places < 0, -1 - fans.places, fans.places)
    return mesh.vertices[mesh.faces][source].reshape(*source.shape, 9), fans.places
