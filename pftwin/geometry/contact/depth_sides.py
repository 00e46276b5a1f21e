"""The two surfaces of a contact by depths, as pytrees: the pressed surface (femur) and the pressing one (button).

The femur's surface is searched for the point nearest to each centroid of the button's triangles, and gives the outward
normal there. Both surfaces may be open.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from jax.lax import optimization_barrier, stop_gradient
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.program_cache import cached
from pftwin.base.spatial import Rotation, Scalar, Vec3, safe_sqrt
from pftwin.geometry.bvh.loops import member_by_member
from pftwin.geometry.bvh.tree import check_searchable
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.bvh.walk import Fans, SearchTree, fans_of, rows_of
from pftwin.geometry.contact.contact_mesh import distances_from_border, features_of
from pftwin.geometry.contact.depth_search import TouchingLeaves, touching_leaves
from pftwin.geometry.mesh.mesh import SurfaceMesh

T = TypeVar("T")
FEMUR_LANES = 8  # largest number of triangles in a leaf of the femur
BUTTON_LANES = 16  # and of the button
ON_SURFACE = 1e-10  # [m] at smaller distances the normal is the surface's pseudo-normal


class Below(NamedTuple):
    """A surface as seen from points (k,) near it; vectors in its frame."""

    depth: Scalar  # [m], positive inside
    normal: Vec3  # unit, outward: minus the depth's gradient
    bend: Vec3  # gradient by the point of the normal's component along a given vector; within a table only
    rim: Array  # bool: whether the nearest point is on the rim of an open surface
    lateral: Scalar | None  # distance from the facets' border, positive laterally [m]; None if there are no facets


class PressedSurface(eqx.Module):
    """The surface that is pressed into. Arrays are leaves: another mesh of the same size reuses compiled programs."""

    tree: SearchTree  # of discs
    lanes: Array  # (leaves, 9, lanes) corners a, b, c [m], for searches
    corners: Array  # (leaves * lanes, 9) the same, one row per place
    triangle: Array  # (leaves * lanes,) int32: index of the mesh's triangle in each place
    outward: Array  # (7 triangles, 3) unit outward pseudo-normals at each triangle's face, edges and corners
    rim: Array  # (7 triangles,) whether the feature is on the boundary of an open mesh
    border: Array | None  # (leaves * lanes, 3) of the corners in each place: see `Below.lateral`

    def leaf(self, number: Array) -> Triangle:
        """The triangles of a leaf, one per lane."""
        rows = jax.lax.dynamic_index_in_dim(self.lanes, number, keepdims=False)
        return Triangle(*(Vec3(rows[3 * k], rows[3 * k + 1], rows[3 * k + 2]) for k in range(3)))

    def rim_edges(self) -> Array:
        """Edges on the rim of the triangle in each place, (leaves * lanes,) int32: bits 1, 2, 4 for ab, bc, ca."""
        edges = self.rim.reshape(-1, 7)[:, 1:4].astype(jnp.int32)
        return (edges @ jnp.array([1, 2, 4], jnp.int32))[self.triangle]

    @property
    def width(self) -> int:
        """Lanes per leaf."""
        return self.lanes.shape[-1]

    @property
    def exact(self) -> PressedSurface:
        """The surface itself; a `DistanceGrid` has an attribute of this name."""
        return self

    def touching(
        self, button: PressingSurface, position: Vec3, rotation: Rotation, *, width: int, band: float, limit: float
    ) -> TouchingLeaves:
        """Leaves of a button that have a centroid with a depth from -band to limit.

        Args:
            button, position, rotation: the other surface, and the pose of its frame in this one's.
            width: capacity for leaves.
            band: largest distance outside the surface [m].
            limit: largest depth [m].
        """
        search = member_by_member(partial(touching_leaves, width, band, limit))
        return search(button, self, position, rotation)

    def below(self, place: Array, point: Vec3, vector: Vec3) -> Below:
        """The surface at points (k,) whose nearest triangles are in places (k,). It does not bend: facets are flat."""
        triangle = Triangle.of_rows(gathered(self.corners[place]))
        on = closest_on_triangle(triangle, point)
        feature = stop_gradient(7 * self.triangle[place] + on.feature)
        outward = Vec3.from_array(gathered(self.outward[feature]))
        away = point - on.point
        size = safe_sqrt(away.squared_norm())
        off_surface = stop_gradient(size) > ON_SURFACE
        sign = jnp.where(stop_gradient(away.dot(outward)) < 0, -1.0, 1.0)
        scale = sign / jnp.where(off_surface, size, 1.0)
        normal = jax.tree.map(lambda a, n: jnp.where(off_surface, scale * a, n), away, outward)
        flat = jax.tree.map(jnp.zeros_like, vector)
        return Below(-normal.dot(away), normal, flat, self.rim[feature], self.lateral(place, triangle, on.point))

    def lateral(self, place: Array, triangle: Triangle, point: Vec3) -> Scalar | None:
        """Distance from the facets' border of points on the triangles in some places: see `Below`."""
        if self.border is None:
            return None
        at = gathered(self.border[place])
        a, b, c = triangle.weights(point)
        return a * at[..., 0] + b * at[..., 1] + c * at[..., 2]


class PressingSurface(eqx.Module):
    """The surface whose triangles' depths are computed."""

    rows: Array  # (16 nodes, 4) float32 balls about centroids, the children of each node in turn
    first: Array  # (nodes,) int32: each node's first child
    corners: Array  # (leaves, 9, lanes) a, b, c [m]
    index: Array  # (leaves, lanes) int32: triangle; negative in an empty lane, which holds a copy
    discs: Array  # (leaves, 8) about the centroids in a leaf: middle, normal, radius, half thickness [m]
    mesh: Array  # (n, 9) corners of the mesh's own triangles [m]

    @property
    def lanes(self) -> int:
        """Lanes per leaf."""
        return self.index.shape[-1]

    @property
    def leaves(self) -> int:
        """Number of leaves."""
        return self.index.shape[-2]


def gathered(rows: T) -> T:
    """Prevents XLA from fusing a gather into each of its uses, where it would be repeated."""
    return optimization_barrier(rows)


def pressed_surface(mesh: SurfaceMesh, labels: ArrayLike | None = None) -> PressedSurface:
    """Makes the pressed surface from a mesh.

    Args:
        mesh: open or closed, normals outward, in the frame of its body [m].
        labels: (triangles,) integers, the facet of each triangle: 0 medial, 1 lateral.

    Raises:
        InputError: no triangles, too many, or coordinates that are not finite; labels that do not match the mesh.
    """
    check_searchable(mesh)
    border = None
    if labels is not None:
        facets = np.asarray(labels)
        if facets.shape != (len(mesh.faces),) or not np.isin(facets, (0, 1)).all():
            raise InputError(
                f"labels of shape {facets.shape}",
                where=mesh.source,
                expected=f"({len(mesh.faces)},): 0 (medial) or 1 (lateral) for each triangle",
            )
        border = distances_from_border(mesh, facets == 1)
    fans, outward, rim = cached(_fans_and_features, mesh.vertices, mesh.faces, files=())
    source = _originals(fans.places)
    corners = mesh.vertices[mesh.faces][source].reshape(*source.shape, 9)
    own = canonicalize_dtype(float)
    parts = {
        "tree": (fans.bounds, rows_of(fans), fans.first),
        "lanes": np.ascontiguousarray(corners.swapaxes(1, 2)).astype(own),
        "corners": corners.reshape(-1, 9).astype(own),
        "triangle": source.ravel(),
        "outward": outward.astype(own),
        "rim": rim,
        "border": None if border is None else border[source.ravel()].astype(own),
    }
    return PressedSurface(**jax.device_put(parts))


def pressing_surface(mesh: SurfaceMesh, together: int = 1) -> PressingSurface:
    """Makes the pressing surface from a mesh in its body's frame [m]; up to `together` neighbours become one triangle.

    Raises:
        InputError: no triangles, too many, or coordinates that are not finite.
    """
    check_searchable(mesh)
    whole = mesh.vertices[mesh.faces]
    triangles = whole if together == 1 else cached(_taken_together, whole, together, files=())
    fans = cached(fans_of, triangles, BUTTON_LANES, True, files=())
    corners = triangles[_originals(fans.places)]
    own = canonicalize_dtype(float)
    parts = (
        rows_of(fans),
        fans.first,
        np.ascontiguousarray(corners.reshape(*corners.shape[:2], 9).swapaxes(1, 2)).astype(own),
        fans.places,
        _discs(corners).astype(own),
        whole.reshape(-1, 9).astype(own),
    )
    return PressingSurface(*jax.device_put(parts))


def _fans_and_features(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[Fans, NDArray[np.float64], NDArray[np.bool_]]:
    mesh = SurfaceMesh(vertices, faces)
    features = features_of(mesh, np.zeros(len(faces), dtype=np.int64))
    return fans_of(vertices[faces], FEMUR_LANES, False), features.outward.reshape(-1, 3), features.rim.ravel()


def _taken_together(corners: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """Merges groups of up to `most` neighbours of triangles (n, 3, 3) into triangles (k, 3, 3) of equal area vector and
    centroid. On a plane the force and moment of a linear pressure do not change, on a curved surface hardly.
    """
    vectors = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    places = fans_of(corners, most, True).places
    vector = np.where(places[..., None] < 0, 0.0, vectors[_originals(places)])  # copies do not count
    weight = np.linalg.norm(vector, axis=2, keepdims=True)
    vector, total = vector.sum(axis=1), weight.sum(axis=1)
    middles = corners.mean(axis=1)[_originals(places)]
    weighted = (weight * middles).sum(axis=1) / np.maximum(total, 1e-300)
    middle = np.where(total > 0, weighted, middles.mean(axis=1))
    area = np.linalg.norm(vector, axis=1, keepdims=True)
    normal = vector / np.maximum(area, 1e-300)
    aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-300)
    size = np.sqrt(area * 4 / np.sqrt(27))  # circumradius of an equilateral triangle
    turns = 2 * np.pi / 3 * np.arange(3)
    arms = (
        np.cos(turns)[None, :, None] * aside[:, None] + np.sin(turns)[None, :, None] * np.cross(normal, aside)[:, None]
    )
    return middle[:, None] + size[:, None] * arms


def _discs(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Discs (leaves, 8) around the centroids of triangles (leaves, lanes, 3, 3): see `PressingSurface`."""
    middles = corners.mean(axis=2)
    middle = 0.5 * (middles.min(axis=1) + middles.max(axis=1))
    normal = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]).sum(axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    arms = middles - middle[:, None]
    radius, thick = np.linalg.norm(arms, axis=2), np.abs(np.einsum("lki,li->lk", arms, normal))
    return np.concatenate([middle, normal, radius.max(axis=1)[:, None], thick.max(axis=1)[:, None]], axis=1)


def _originals(places: NDArray[np.int32]) -> NDArray[np.int32]:
    """Triangle in each place, also if the place holds a copy."""
    return np.where(places < 0, -1 - places, places)
