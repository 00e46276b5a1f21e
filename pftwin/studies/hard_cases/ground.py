"""Surfaces under the button: a height over a plane, as a fitted patch or as a coarse mesh with optional defects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Rotation
from pftwin.geometry.mesh.doctor import repaired
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import Chart, CylindricalChart, PlaneChart
from pftwin.geometry.patch.fit import parse_degree
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.geometry.patch.spline import SplinePatch

Height = Callable[[Floats, Floats], Floats]

CYLINDER = " cylinder"  # suffix of the name of a patch over a cylinder
CELLS = (8, 8)  # of the spline
SAMPLES = 41  # along each side of the rectangle, for fits
MESH = (3, 4)  # cells of the mesh along and across (an even number): 12 triangles on each facet


@dataclass(frozen=True)
class TiltedGround:
    """A surface over a plane that is tilted about the femur's y axis."""

    height: Height  # function of arrays u (proximal) and v (lateral) [m]
    half: tuple[float, float] = (0.024, 0.020)  # half size of the rectangle [m]
    tilt: float = 0.0  # of the plane's normal from z towards -x [rad]
    above: float = 0.0  # distance of the plane's origin from the femur's, along the normal [m]
    met: bool = False  # whether a polynomial must be exact at the middle, for cases that need nanometres there

    def axes(self) -> Floats:
        """Returns the plane's axes in the femur frame as the columns of a matrix (3, 3)."""
        ez = np.array([-np.sin(self.tilt), 0.0, np.cos(self.tilt)])
        ey = np.array([0.0, 1.0, 0.0])
        return np.stack([np.cross(ey, ez), ey, ez], axis=1)

    def grid(self, n_u: int, n_v: int) -> tuple[Floats, Floats, Floats]:
        """Returns u, v and height on a grid over the rectangle, (n_u, n_v) each [m]."""
        u, v = np.meshgrid(*(np.linspace(-h, h, n) for h, n in zip(self.half, (n_u, n_v), strict=True)), indexing="ij")
        return u, v, self.height(u, v) + 0.0 * u

    def points(self, u: Floats, v: Floats, height: Floats) -> Floats:
        """Returns points of the surface in the femur frame (n, 3) [m]."""
        local = np.stack([u, v, height + self.above], axis=-1).reshape(-1, 3)
        return local @ self.axes().T


def _trochlea(u: Floats, v: Floats) -> Floats:
    """A groove around the distal femur, about a trochlear radius of 26 mm."""
    return np.sqrt(0.026**2 - (0.85 * u) ** 2) - 0.026 + np.sqrt(v**2 + 0.006**2) * np.tan(np.radians(18))


TROCHLEA = TiltedGround(_trochlea, tilt=float(np.radians(40)), above=0.026)


def patch_on(ground: TiltedGround, kind: str) -> PolynomialPatch | SplinePatch:
    """Returns the patch of a kind ("P5", "P5 cylinder", "spline") fitted to a ground.

    All patches of one kind have the same structure, so that their scenes can be stacked.
    """
    name, round_ = kind.removesuffix(CYLINDER), kind.endswith(CYLINDER)
    coefficients, center, half = _fitted(ground, name, round_)
    middle, size = ((number(a), number(b)) for a, b in (center, half))
    given = _chart(ground, round_), number(coefficients), middle, size
    return SplinePatch(*given) if name == "spline" else PolynomialPatch(*given, parse_degree(name))


def axis_below(ground: TiltedGround, kind: str) -> float:
    """Returns the depth of the chart's origin below the plane [m]: that of the axis for a cylinder, otherwise 0."""
    return _depth(ground) if kind.endswith(CYLINDER) else 0.0


def _depth(ground: TiltedGround) -> float:
    """Depth of a cylinder's axis below the plane [m], large enough for small angles within the rectangle."""
    return max(0.026, 1.2 * ground.half[0])


def _chart(ground: TiltedGround, round_: bool) -> Chart:
    axes, depth = Rotation.from_array(number(ground.axes())), _depth(ground)
    if not round_:
        return PlaneChart(vector(ground.above * ground.axes()[:, 2]), axes)
    return CylindricalChart(vector((ground.above - depth) * ground.axes()[:, 2]), axes, number(depth))


@lru_cache(maxsize=512)
def _fitted(ground: TiltedGround, name: str, round_: bool) -> tuple[Floats, tuple[float, float], tuple[float, float]]:
    """Coefficients of the fitted patch, and centre and half size of its rectangle."""
    u, v, h = ground.grid(SAMPLES, SAMPLES)
    if round_:
        depth = _depth(ground)
        u, h = depth * np.arctan2(u, depth + h), np.hypot(u, depth + h)
    low, high = float(u[0].max()), float(u[-1].min())  # chosen so that every strip has samples
    half = 0.5 * (high - low), ground.half[1]
    center = 0.5 * (high + low), 0.0
    a, b = (x / size if size > 0 else 0 * x for x, size in ((u - center[0], half[0]), (v, half[1])))
    if name == "spline":
        return _spline(a, b, h), center, half
    return _polynomial(a, b, h, parse_degree(name), ground.met), center, half


def _polynomial(a: Floats, b: Floats, h: Floats, degree: int, met: bool) -> Floats:
    """Least-squares coefficients of a polynomial; if `met`, with the exact height at the middle."""
    basis = np.stack([a.ravel() ** i * b.ravel() ** j for i, j in exponents(degree)], axis=1)
    if not met:
        return np.asarray(np.linalg.lstsq(basis, h.ravel(), rcond=None)[0], np.float64)
    middle = h[SAMPLES // 2, SAMPLES // 2]
    others = np.linalg.lstsq(basis[:, 1:], h.ravel() - middle, rcond=None)[0]
    return np.concatenate([[middle], others])


def _spline(a: Floats, b: Floats, h: Floats) -> Floats:
    """Least-squares coefficients of a spline."""
    n_u, n_v = CELLS
    columns = [_basis(a.ravel(), n_u), _basis(b.ravel(), n_v)]
    basis = np.einsum("ki,kj->kij", *columns).reshape(a.size, -1)
    return np.linalg.lstsq(basis, h.ravel(), rcond=None)[0].reshape(n_u + 3, n_v + 3)


def _basis(a: Floats, n: int) -> Floats:
    """Values (k, n + 3) of the cubic B-splines of n cells from -1 to 1, at points a (k,)."""
    from scipy.interpolate import BSpline

    knots = (2 * np.arange(-3, n + 4) - n) / n
    return BSpline.design_matrix(a, knots, 3, extrapolate=True).toarray()


def mesh_on(ground: TiltedGround) -> SurfaceMesh:
    """Returns a grid mesh of the ground in the femur frame, with normals out of the bone."""
    n_u, n_v = (n + 1 for n in MESH)
    k = np.arange(n_u * n_v).reshape(n_u, n_v)
    a, b, c, d = (q.ravel() for q in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return SurfaceMesh(ground.points(*ground.grid(n_u, n_v)), faces, "a ground of few triangles")


def lateral_of(mesh: SurfaceMesh) -> NDArray[np.bool_]:
    """Returns which triangles lie lateral of the middle plane, (m,)."""
    return mesh.vertices[mesh.faces].mean(axis=1)[:, 1] > 0


def groove(angle: float, rounding: float = 0.005, half: tuple[float, float] = (0.024, 0.02)) -> TiltedGround:
    """Returns a straight groove along x, whose facets rise at an angle [deg], with a bottom rounding length [m]."""
    slope = np.tan(np.radians(angle))
    return TiltedGround(lambda u, v: np.sqrt(v**2 + rounding**2) * slope, half)


PLATE = TiltedGround(lambda u, v: 0.0 * u, (0.1, 0.1), met=True)
SHALLOW = groove(1)
GROUNDS = {
    "plate": PLATE,
    "floor": TiltedGround(lambda u, v: 0.0 * u, (0.03, 0.03)),
    "vee": groove(25),
    "ridge": TiltedGround(lambda u, v: -np.sqrt(v**2 + 0.01**2) * np.tan(np.radians(20)), (0.03, 0.03)),
    "shallow": SHALLOW,
    "steep": groove(70, 0.006),
    "narrow": groove(55, 0.002),
    "small_patch": groove(18, 0.006, (0.004, 0.004)),
    # A shallow groove between two shoulders, beyond which the surface falls off.
    "shoulders": TiltedGround(lambda u, v: 0.002 * (1 - np.cos(np.pi * v / 0.02)), (0.03, 0.03)),
    "edge": TiltedGround(TROCHLEA.height, (0.012, 0.012)),
    "no_width": TiltedGround(TROCHLEA.height, (0.024, 0.0)),
    # A longer rectangle: the trochlea's, if flat, ends 13 mm short of the equilibrium.
    "nearly_flat": replace(TROCHLEA, height=SHALLOW.height, half=(0.06, 0.03)),
    "nearly_vertical": groove(80, 0.004, (0.02, 0.012)),
}


_PLACE = (0.004, 0.006)  # point below the button, inside a triangle [m]
_OVER_HOLE = (-0.005, 0.011)  # point in the triangle that is removed to make a hole [m]

Vertices, Faces = NDArray[np.float64], NDArray[np.int64]
Change = Callable[[Vertices, Faces], tuple[Vertices, Faces]]


def _defective_mesh(change: Change) -> Callable[[TiltedGround], SurfaceMesh]:
    """A function that makes the ground's mesh with a defect and applies the repairs that keep the surface."""

    def made(ground: TiltedGround) -> SurfaceMesh:
        unbroken = mesh_on(ground)
        return repaired(*change(unbroken.vertices.copy(), unbroken.faces.copy()), source="a broken ground")[0]

    return made


def _with_faces(more: Callable[[Vertices, Faces], object]) -> Change:
    return lambda vertices, faces: (vertices, np.concatenate([faces, np.atleast_2d(np.asarray(more(vertices, faces)))]))


def _turned(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    faces[[2, 9, 14]] = faces[[2, 9, 14]][:, ::-1]
    return vertices, faces


def _needle(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """Splits a triangle into three, one of them a needle, with a vertex a micrometre from the middle of an edge."""
    k = int(np.argmin(np.abs(vertices[faces].mean(axis=1)[:, :2] - np.array(_PLACE)).sum(axis=1)))
    a, b, c = faces[k]
    p = 0.5 * (vertices[a] + vertices[b])
    inward = vertices[c] - p
    new = len(vertices)
    vertices = np.concatenate([vertices, [p + 1e-6 * inward / np.linalg.norm(inward)]])
    rest = np.delete(faces, k, axis=0)
    return vertices, np.concatenate([rest, [[a, b, new], [b, c, new], [c, a, new]]])


def _hole(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    middles = vertices[faces].mean(axis=1)[:, :2]
    return vertices, np.delete(faces, np.argmin(np.linalg.norm(middles - np.array(_OVER_HOLE), axis=1)), axis=0)


def _fork(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """Adds a third triangle to an edge of two triangles."""
    vertices = np.concatenate([vertices, [[0.0, 0.015, 0.01]]])
    return vertices, np.concatenate([faces, [[faces[0, 0], faces[0, 2], len(vertices) - 1]]])


def _crossing(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """Adds a separate sheet of two triangles that cuts through the plate below the button."""
    sheet = np.array([[-0.02, 0.003, -0.0004], [0.02, 0.003, -0.0004], [0.02, 0.02, 0.0004], [-0.02, 0.02, 0.0004]])
    n = len(vertices)
    return np.concatenate([vertices, sheet]), np.concatenate([faces, [[n, n + 1, n + 2], [n, n + 2, n + 3]]])


_TRIANGLE = np.array([[-0.03, -0.03, 0.0], [0.06, 0.0, 0.0], [-0.03, 0.03, 0.0]])  # [m]

MESH_MAKERS: dict[str, Callable[[TiltedGround], SurfaceMesh]] = {
    # Extended as a patch is extrapolated, so that a small button does not roll over the rim before it comes to rest.
    "wide": lambda ground: mesh_on(replace(ground, half=(0.03, 0.03))),
    "one_triangle": lambda ground: SurfaceMesh(_TRIANGLE, np.array([[0, 1, 2]]), "one triangle"),
    "zero_area": _defective_mesh(_with_faces(lambda v, f: [f[0, 0], f[0, 0], f[0, 1]])),
    "duplicate": _defective_mesh(_with_faces(lambda v, f: f[[7, 7]])),
    "two_faced": _defective_mesh(_with_faces(lambda v, f: f[5, ::-1])),
    "flipped": _defective_mesh(_turned),
    "needles": _defective_mesh(_needle),
    "hole": _defective_mesh(_hole),
    "fork": _defective_mesh(_fork),
    "crossing": _defective_mesh(_crossing),
}
