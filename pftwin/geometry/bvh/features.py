"""Outward normals at a triangle's face, edges and corners, and which of them lie on the rim or the facets' seam.

The seven features of a triangle are numbered as in `pftwin.geometry.bvh.triangle`. Out at an edge is the mean of its
two triangles' normals, at a corner that of all its triangles' by their angles: the only choice for which the side of
the nearest point is always the side of the surface (Baerentzen and Aanaes 2005).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.mesh.mesh import SurfaceMesh, summed_at
from pftwin.geometry.mesh.topology import Edges, edges_of


class Features(NamedTuple):
    """Of every triangle's face, three edges and three corners, in this order."""

    outward: NDArray[np.float64]  # (m, 7, 3) unit
    rim: NDArray[np.bool_]  # (m, 7) on the boundary of an open mesh
    seam: NDArray[np.bool_]  # (m, 7) shared with a triangle of another label


def features_of(mesh: SurfaceMesh, label: NDArray[np.int64]) -> Features:
    """The features of a mesh whose triangles bear labels (m,), one for each facet."""
    faces, n = mesh.faces, len(mesh.vertices)
    normals = mesh.area_vectors / np.maximum(mesh.face_areas, 1e-300)[:, None]
    edges = edges_of(faces)
    at_edges = summed_at(edges.of_face, np.repeat(normals, 3, axis=0), len(edges.corners))
    arms = np.roll(mesh.vertices[faces], -1, axis=1) - mesh.vertices[faces]
    arms /= np.maximum(np.linalg.norm(arms, axis=2, keepdims=True), 1e-300)
    angles = np.arccos(np.clip(-np.einsum("nij,nij->ni", arms, np.roll(arms, 1, axis=1)), -1, 1))
    at_corners = summed_at(faces, (angles[:, :, None] * normals[:, None]).reshape(-1, 3), n)
    outward = np.concatenate([normals[:, None], at_edges[edges.of_face], at_corners[faces]], axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=2, keepdims=True), 1e-300)
    between = _label_borders(edges, label)
    return Features(outward, *(_marked_features(faces, edges, marked) for marked in (edges.count == 1, between)))


def _marked_features(faces: NDArray, edges: Edges, marked: NDArray) -> NDArray[np.bool_]:
    """(m, 7) from marks on edges: their ends are marked too, faces never."""
    ends = np.zeros(edges.corners.max() + 1, dtype=bool)
    ends[edges.corners[marked]] = True
    return np.concatenate([np.zeros((len(faces), 1), bool), marked[edges.of_face], ends[faces]], axis=1)


def _label_borders(edges: Edges, label: NDArray) -> NDArray[np.bool_]:
    """Which edges have triangles of different labels (m,)."""
    lowest, highest = np.full(len(edges.corners), label.max()), np.full(len(edges.corners), label.min())
    np.minimum.at(lowest, edges.of_face.ravel(), np.repeat(label, 3))
    np.maximum.at(highest, edges.of_face.ravel(), np.repeat(label, 3))
    return lowest < highest


def border_edges(mesh: SurfaceMesh, label: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The edges (k, 6) where triangles of different labels (m,) meet, and those of an open mesh's boundary."""
    edges = edges_of(mesh.faces)
    marked = _label_borders(edges, label), edges.count == 1
    seam, rim = (mesh.vertices[edges.corners[m]].reshape(-1, 6) for m in marked)
    return seam, rim
