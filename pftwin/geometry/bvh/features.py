"""Pseudo-normals at triangles' faces, edges and corners, and which of these lie on the rim or on the facets' seam.

The seven features of a triangle are numbered as in `pftwin.geometry.bvh.triangle`. An edge's normal is the mean of its
two triangles' normals, a corner's the angle-weighted mean of its triangles' normals: with these the sign of the
distance at the nearest point is always right (Baerentzen and Aanaes 2005).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.mesh.mesh import SurfaceMesh, summed_at
from pftwin.geometry.mesh.topology import Edges, edges_of


class Features(NamedTuple):
    """Properties of each triangle's face, three edges and three corners, in this order."""

    outward: NDArray[np.float64]  # (m, 7, 3) unit outward pseudo-normals
    rim: NDArray[np.bool_]  # (m, 7) on the boundary of an open mesh
    seam: NDArray[np.bool_]  # (m, 7) shared with a triangle of another label


def features_of(mesh: SurfaceMesh, label: NDArray[np.int64]) -> Features:
    """Computes the features of a mesh; `label` (m,) holds the facet of each triangle."""
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
    """Features (m, 7) on marked edges (e,): the edges and their ends, never faces."""
    ends = np.zeros(edges.corners.max() + 1, dtype=bool)
    ends[edges.corners[marked]] = True
    return np.concatenate([np.zeros((len(faces), 1), bool), marked[edges.of_face], ends[faces]], axis=1)


def _label_borders(edges: Edges, label: NDArray) -> NDArray[np.bool_]:
    """Which edges, (e,), have triangles of different labels (m,)."""
    lowest, highest = np.full(len(edges.corners), label.max()), np.full(len(edges.corners), label.min())
    np.minimum.at(lowest, edges.of_face.ravel(), np.repeat(label, 3))
    np.maximum.at(highest, edges.of_face.ravel(), np.repeat(label, 3))
    return lowest < highest


def border_edges(mesh: SurfaceMesh, label: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """End points (k, 6) of the edges between triangles of different labels (m,), and of an open mesh's boundary."""
    edges = edges_of(mesh.faces)
    marked = _label_borders(edges, label), edges.count == 1
    seam, rim = (mesh.vertices[edges.corners[m]].reshape(-1, 6) for m in marked)
    return seam, rim
