"""How deep the border between two facets is inside a ball: whether two contacts have become one.

On a chain of edges the depth is the power of a point, as in `pftwin.geometry.contact.ball_cut`. Of a parabola of height
d over a chord, which it is where one contact lies across the border, the integral of the square over that of the depth
is 4/5 d: this ratio says how deep, whatever the chord's length, and is smooth where the chord appears.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.spatial import Scalar, Vec3, safe_sqrt
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.mesh.parts import edges_of

# Gauss-Legendre on three points: exact for the polynomials here, which are of degree four at most.
_NODES = ((-math.sqrt(0.6), 5 / 18), (0.0, 8 / 18), (math.sqrt(0.6), 5 / 18))


class SeamDepth(NamedTuple):
    """Integrals along the part of a chain of edges inside a ball, and their slopes with respect to its centre."""

    length: Scalar  # [m]
    depth: Scalar  # of the depth [m^2]
    square: Scalar  # of its square [m^3]
    depth_slope: Vec3  # [m]
    square_slope: Vec3  # [m^2]


def seam_depth(edges: Array, center: Vec3, radius: Scalar) -> SeamDepth:
    """Of edges (n, 6), each its start and its end, and a ball, all in one frame [m]."""
    q = Vec3(*(edges[:, i] - c for i, c in enumerate((center.x, center.y, center.z))))
    way = Vec3(*(edges[:, 3 + i] - edges[:, i] for i in range(3)))
    length, half, excess = way.squared_norm(), q.dot(way), q.squared_norm() - radius * radius
    over = 1 / jnp.where(length > 0, length, 1.0)
    root = half * half - length * excess
    spread = safe_sqrt(jnp.where(root > 0, root, 0.0))
    enter, leave = (jnp.clip((sign * spread - half) * over, 0.0, 1.0) for sign in (-1.0, 1.0))
    size = (leave - enter) * safe_sqrt(length)
    depth, square = jnp.zeros_like(size), jnp.zeros_like(size)
    depth_slope = square_slope = Vec3(*[jnp.zeros_like(size)] * 3)
    for node, share in _NODES:
        p = q + (0.5 * (enter + leave + node * (leave - enter))) * way
        d, weight = (radius * radius - p.squared_norm()) * (0.5 / radius), share * size
        depth, square = depth + weight * d, square + weight * d * d
        depth_slope = depth_slope + (weight / radius) * p
        square_slope = square_slope + (2 * weight * d / radius) * p
    return SeamDepth(size.sum(), depth.sum(), square.sum(), depth_slope.sum(), square_slope.sum())


def edges_between(mesh: SurfaceMesh, label: NDArray) -> NDArray[np.float64]:
    """The edges (k, 6) where triangles of different labels (m,) meet."""
    edges = edges_of(mesh.faces)
    lowest, highest = np.full(len(edges.corners), label.max()), np.full(len(edges.corners), label.min())
    np.minimum.at(lowest, edges.of_face.ravel(), np.repeat(label, 3))
    np.maximum.at(highest, edges.of_face.ravel(), np.repeat(label, 3))
    return mesh.vertices[edges.corners[lowest < highest]].reshape(-1, 6)


def rim_edges(mesh: SurfaceMesh) -> NDArray[np.float64]:
    """The edges (k, 6) of an open mesh's boundary; none of a closed one's."""
    edges = edges_of(mesh.faces)
    return mesh.vertices[edges.corners[edges.count == 1]].reshape(-1, 6)
