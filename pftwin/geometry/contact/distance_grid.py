r"""A surface's depth from a table: fast when thousands of triangles touch at once, as in contact between cartilages.

Space around the surface is divided into cubes, one around each node of a regular grid. In each cube the depth is a
polynomial of second degree in each coordinate; together they form a quadratic spline, accurate to second order. Its
slopes, and so the forces, are continuous away from the rim: with slopes that jump from cube to cube a patella may find
no equilibrium. On the femoral cartilage of a living knee (29,800 triangles) cubes of 1 mm have an rms error of 5 um.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from jax.lax import stop_gradient
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.program_cache import cached
from pftwin.base.spatial import Rotation, Scalar, Vec3
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.contact.depth_search import TouchingLeaves, nearest_triangle
from pftwin.geometry.contact.depth_sides import Below, PressedSurface, PressingSurface, gathered, pressed_surface
from pftwin.geometry.mesh.mesh import SurfaceMesh

_AROUND = 12e-3  # [m] margin of the table around the surface: more than the depths that are searched for
_BEYOND = 6e-3  # [m] distance beyond the rim up to which the depth is continued
_MOST_NODES = 5_000_000  # up to 113 bytes each
_ALLOWED = 5e-5  # [m] largest rms error of a table's depths on the surface
_SHARPEST = 100.0  # [1/m] largest curvature of a joint's surface
_FLAT = 1e-6  # smallest square of a slope by which it is divided
_OFF = 0.1  # largest error of a table's depth, as a share of a cube's edge
# The quadratic spline's polynomial (power, neighbour) from -1/2 to 1/2 around a node, from it and its neighbours.
_SPLINE = np.array([[1 / 8, 3 / 4, 1 / 8], [-1 / 2, 0, 1 / 2], [1 / 2, -1, 1 / 2]])


class DistanceGrid(eqx.Module):
    """A `PressedSurface` whose depths come from a table."""

    exact: PressedSurface  # the surface that the table approximates
    cells: Array  # (nodes, 27) float32: polynomial coefficients [m], for coordinates in the cube from -1/2 to 1/2
    rim: Array  # (nodes,) bool: whether the rim is nearest
    border: Array | None  # (nodes,) float32: `Below.lateral` at the nearest point
    low: Array  # (3,) position of the first node [m]
    spacing: Array  # () [m]
    shape: tuple[int, int, int] = eqx.field(static=True)  # nodes along each axis

    def touching(
        self, button: PressingSurface, position: Vec3, rotation: Rotation, *, width: int, band: float, limit: float
    ) -> TouchingLeaves:
        """Like `PressedSurface.touching`, but with bounds on the leaves' depths, from the depths of their middles."""
        position, rotation = stop_gradient((position, rotation))
        discs = button.discs
        middle, normal, radius, half = (Vec3.from_array(discs[:, :3]), Vec3.from_array(discs[:, 3:6]), *discs[:, 6:].T)
        near = self._near(position + rotation.apply(middle))
        depth, slope = stop_gradient((near.depth, near.slope))
        # How much deeper a disc reaches than its middle, because of its tilt and the surface's curvature.
        along = jnp.abs(slope.dot(rotation.apply(normal)))
        tilted = jnp.sqrt(jnp.maximum(slope.squared_norm() - along**2, 0.0))
        room = radius * tilted + half * along + 0.5 * _SHARPEST * radius**2 + _OFF * stop_gradient(self.spacing)
        wanted = (depth >= -(room + band)) & (depth <= room + limit)
        leaf = jnp.nonzero(wanted, size=width, fill_value=0)[0].astype(jnp.int32)
        return TouchingLeaves(leaf, jnp.zeros((width, button.lanes), jnp.int32), jnp.sum(wanted, dtype=jnp.int32))

    def below(self, place: Array, point: Vec3, vector: Vec3) -> Below:
        """The surface at points (k,); places are not used."""
        near = self._near(point)
        slope, steep = near.slope, near.slope.squared_norm()
        over = 1 / jnp.sqrt(jnp.maximum(steep, _FLAT))
        normal = -over * slope
        # d(n.v)/dp = -(H v - (n.v) H n) / |slope|, with H the depth's second derivative.
        along = jnp.where(steep > _FLAT, normal.dot(vector), 0.0)
        bend = -over * (near.bent(vector) - near.bent(normal) * along)
        lateral = None if self.border is None else self._between(self.border, point)
        return Below(near.depth, normal, bend, self.rim[near.node], lateral)

    def _between(self, values: Array, point: Vec3) -> Scalar:
        """Values of the nodes at points (k,), linear in each coordinate between the nodes."""
        number, found = jnp.int32(0), []
        for i, p in enumerate((point.x, point.y, point.z)):
            most = self.shape[i] - 1
            at = jnp.clip((p - self.low[i]) / self.spacing, 0.0, float(most))
            first = jnp.minimum(jnp.floor(stop_gradient(at)), float(most - 1))
            number = number * jnp.int32(self.shape[i]) + first.astype(jnp.int32)
            found.append(at - first)
        _, ny, nz = self.shape
        corners = [(i * ny + j) * nz + k for i in range(2) for j in range(2) for k in range(2)]
        mixed = [gathered(values[number + jnp.int32(n)]).astype(point.x.dtype) for n in corners]
        for u in found:
            half = len(mixed) // 2
            mixed = [a + u * (b - a) for a, b in zip(mixed[:half], mixed[half:], strict=True)]
        return mixed[0]

    def _near(self, point: Vec3) -> _Near:
        """The polynomials of points (k,), evaluated from the innermost coordinate outwards."""
        low, size, shape = self.low, self.spacing, self.shape
        at = [(p - low[i]) / size for i, p in enumerate((point.x, point.y, point.z))]
        inside = [jnp.clip(a, 0.0, n - 1.0) for a, n in zip(at, shape, strict=True)]
        out = [jnp.abs(stop_gradient(a - b)) for a, b in zip(at, inside, strict=True)]
        node = [jnp.round(stop_gradient(b)) for b in inside]
        (x, y, z), (i, j, k) = (b - n for b, n in zip(inside, node, strict=True)), (n.astype(jnp.int32) for n in node)
        number = (i * jnp.int32(shape[1]) + j) * jnp.int32(shape[2]) + k
        terms = gathered(self.cells[number]).astype(x.dtype)
        rows = [terms[:, n] for n in range(27)]
        # The letters after `f` are the coordinates by which the depth is differentiated.
        f, f_z, f_zz = (_along(g, rows, z) for g in (_value, _slope, _bend))
        f_y, f_yy, f_yz = (_along(g, p, y) for g, p in ((_slope, f), (_bend, f), (_slope, f_z)))
        f, f_z, f_zz = (_along(_value, p, y) for p in (f, f_z, f_zz))
        per = 1 / size
        slope = per * Vec3(_slope(f, x), _value(f_y, x), _value(f_z, x))
        second = (_bend(f, x), _value(f_yy, x), _value(f_zz, x), _slope(f_y, x), _slope(f_z, x), _value(f_yz, x))
        outside = size * jnp.maximum(jnp.maximum(out[0], out[1]), out[2])
        return _Near(number, _value(f, x) - outside, slope, tuple(per * per * s for s in second))


class _Near(NamedTuple):
    """The nearest nodes of points (k,), and their polynomials there."""

    node: Array  # int32
    depth: Scalar  # [m]
    slope: Vec3  # the depth's gradient
    second: tuple[Scalar, ...]  # the depth's second derivatives: xx, yy, zz, xy, xz, yz [1/m]

    def bent(self, v: Vec3) -> Vec3:
        """The matrix of second derivatives times a vector."""
        xx, yy, zz, xy, xz, yz = self.second
        return Vec3(xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z, xz * v.x + yz * v.y + zz * v.z)


def _along(part: Callable[[list[Scalar], Scalar], Scalar], terms: list[Scalar], u: Scalar) -> list[Scalar]:
    """The value, slope or second derivative at u of each polynomial in one coordinate; three terms make one."""
    return [part(terms[n : n + 3], u) for n in range(0, len(terms), 3)]


def _value(terms: list[Scalar], u: Scalar) -> Scalar:
    return terms[0] + u * (terms[1] + u * terms[2])


def _slope(terms: list[Scalar], u: Scalar) -> Scalar:
    return terms[1] + 2 * u * terms[2]


def _bend(terms: list[Scalar], u: Scalar) -> Scalar:
    return 2 * terms[2]


def distance_grid(mesh: SurfaceMesh, spacing: float, labels: ArrayLike | None = None) -> DistanceGrid:
    """Makes a table of a mesh's depths, in some seconds; it is kept if there is a cache folder.

    Args:
        mesh: as for `pressed_surface`.
        spacing: edge of the cubes [m].
        labels: as for `pressed_surface`.

    Raises:
        InputError: as for `pressed_surface`; a spacing that is not positive, so fine that the table would be too large,
            or so coarse that depths would have an rms error above 0.05 mm.
    """
    exact = pressed_surface(mesh, labels)
    if not 0 < spacing < np.inf:
        raise InputError(f"spacing {spacing!r}", where="distance_grid", expected="above 0 m")
    low = mesh.vertices.min(axis=0) - _AROUND
    cubes = np.ceil((mesh.vertices.max(axis=0) + _AROUND - low) / spacing)
    with np.errstate(over="ignore"):
        nodes = float(np.prod(cubes + 1))
    if not nodes <= _MOST_NODES:
        least = 1e3 * spacing * (nodes / _MOST_NODES) ** (1 / 3)
        found = f"{1e3 * spacing:.3g} mm: {nodes:,.0f} nodes about {mesh.source}"
        raise InputError(found, where="distance_grid", expected=f"at least {least:.2f} mm")
    shape = cubes.astype(int) + 1
    facets = np.zeros(len(mesh.faces), bool) if labels is None else np.asarray(labels).astype(bool)
    nx, ny, nz = shape.tolist()
    cells, rim, border, off = cached(_tables, mesh.vertices, mesh.faces, facets, low, spacing, (nx, ny, nz), files=())
    if off > _ALLOWED:
        found = f"{1e3 * spacing:.3g} mm: depths have an error of {1e3 * off:.2g} mm (rms) on {mesh.source}"
        most = f"at most {1e3 * _ALLOWED:.2g} mm"
        raise InputError(found, where="distance_grid", expected=most, remedy="a finer one")
    own = canonicalize_dtype(float)
    numbers = jnp.asarray(low, own), jnp.asarray(spacing, own)
    tables = jax.device_put(cells), jax.device_put(rim), None if labels is None else jax.device_put(border)
    return DistanceGrid(exact, *tables, *numbers, (nx, ny, nz))


def _tables(
    vertices: Floats, faces: NDArray[np.int64], facets: NDArray[np.bool_], low: Floats, spacing: float, shape: Any
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.float32], float]:
    """Polynomials (nodes, 27), `rim` and `border` of all nodes, and the rms error of depths [m]."""
    points = low + spacing * np.indices(shape).reshape(3, -1).T
    with jax.enable_x64(True), jax.default_device(jax.devices("cpu")[0]):  # the same table for every caller
        exact = pressed_surface(SurfaceMesh(vertices, faces), facets)
        depth, lateral, rim = (np.asarray(a) for a in _at_nodes(exact, jnp.asarray(points)))
    depth = depth.reshape(shape).astype(np.float64)
    for axis in range(3):  # second-order accurate coefficients from neighbours alone: no ringing
        bend = np.diff(np.moveaxis(depth, axis, 0), n=2, axis=0)
        np.moveaxis(depth, axis, 0)[1:-1] -= bend / 8
    terms = np.pad(depth, 1, mode="edge").astype(np.float32)
    for axis, n in enumerate(shape):
        near = np.stack([np.take(terms, range(a, a + n), axis=axis) for a in range(3)], axis=-1)
        terms = near @ _SPLINE.T.astype(np.float32)
    cells = terms.reshape(-1, 27)
    at = (vertices[faces].mean(axis=1) - low) / spacing  # on the surface, where the depth is zero
    node = np.round(at).astype(int)
    powers = (at - node)[:, :, None] ** np.arange(3)
    own = cells[np.ravel_multi_index(tuple(node.T), shape)].reshape(-1, 3, 3, 3)
    off = np.einsum("iabc,ia,ib,ic->i", own, powers[:, 0], powers[:, 1], powers[:, 2])
    return cells, rim, lateral.astype(np.float32), float(np.sqrt(np.mean(off**2)))


@jax.jit
def _at_nodes(exact: PressedSurface, points: Array) -> tuple[Array, Array | None, Array]:
    """Depths at points (n, 3), the nearest points' distances from the facets' border, and whether the rim is nearest.

    Just beyond the rim the depth is that below the tangent plane, so that cells across the rim are accurate up to it;
    farther away it is minus the distance.
    """

    def nearest(place: Array, row: Array) -> tuple[Array, Array]:
        place = nearest_triangle(exact, Vec3.from_array(row), place).place
        return place, place

    place, point = jax.lax.scan(nearest, jnp.int32(0), points)[1], Vec3.from_array(points)
    triangle = Triangle.of_rows(exact.corners[place])
    on = closest_on_triangle(triangle, point)
    feature = 7 * exact.triangle[place] + on.feature
    plane = (on.point - point).dot(Vec3.from_array(exact.outward[feature]))
    size, rim = jnp.sqrt(on.square), exact.rim[feature]
    beyond = jnp.where(size < _BEYOND, plane, -size)
    depth = jnp.where(rim, beyond, jnp.where(plane < 0, -size, size))
    return depth, exact.lateral(place, triangle, on.point), rim
