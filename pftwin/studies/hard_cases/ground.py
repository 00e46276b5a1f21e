"""What the button lies on: a height over a plane, as a patch of any kind or as a mesh of few triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Rotation
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import Chart, CylindricalChart, PlaneChart
from pftwin.geometry.patch.fit import parse_degree
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.geometry.patch.spline import SplinePatch, cell_of, cubic_basis

Floats = NDArray[np.float64]
Height = Callable[[Floats, Floats], Floats]

CYLINDER = " cylinder"  # what a patch's name ends with where it lies over a cylinder
CELLS = (8, 8)  # of the spline
SAMPLES = 41  # along each side of the rectangle, for fits
MESH = (3, 4)  # cells of the mesh along and across: 12 triangles on each facet


@dataclass(frozen=True)
class TiltedGround:
    """A surface over a plane that is tilted about the femur's y axis."""

    height: Height  # of arrays u (proximal) and v (lateral) [m]
    half: tuple[float, float] = (0.024, 0.020)  # of the rectangle [m]
    tilt: float = 0.0  # of the plane's normal from z towards -x [rad]
    above: float = 0.0  # of the plane's origin along its normal from the femur's [m]
    met: bool = False  # whether cases count nanometres from its middle: a polynomial is then exact there

    def axes(self) -> Floats:
        """(3, 3): the plane's axes in the femur's frame, by columns."""
        ez = np.array([-np.sin(self.tilt), 0.0, np.cos(self.tilt)])
        ey = np.array([0.0, 1.0, 0.0])
        return np.stack([np.cross(ey, ez), ey, ez], axis=1)

    def grid(self, n_u: int, n_v: int) -> tuple[Floats, Floats, Floats]:
        """u, v and height over the rectangle, (n_u, n_v) each."""
        u, v = np.meshgrid(*(np.linspace(-h, h, n) for h, n in zip(self.half, (n_u, n_v), strict=True)), indexing="ij")
        return u, v, self.height(u, v) + 0.0 * u

    def points(self, u: Floats, v: Floats, height: Floats) -> Floats:
        """(n, 3) in the femur's frame."""
        local = np.stack([u, v, height + self.above], axis=-1).reshape(-1, 3)
        return local @ self.axes().T


def patch_on(ground: TiltedGround, kind: str) -> PolynomialPatch | SplinePatch:
    """The patch of that kind nearest to a ground: "P5", "P5 cylinder", "spline".

    All patches of one kind have one structure, so that scenes on them can be stacked.
    """
    name = kind.removesuffix(CYLINDER)
    round_ = kind.endswith(CYLINDER)
    coefficients, center, half = _fitted(ground, name, round_)
    chart = _chart(ground, round_)
    sizes = (number(center[0]), number(center[1])), (number(half[0]), number(half[1]))
    if name == "spline":
        return SplinePatch(chart, number(coefficients), *sizes)
    return PolynomialPatch(chart, number(coefficients), *sizes, parse_degree(name))


def axis_below(ground: TiltedGround, kind: str) -> float:
    """How far below the plane the patch's coordinates are counted from: over a cylinder from its axis [m]."""
    return _depth(ground) if kind.endswith(CYLINDER) else 0.0


def _depth(ground: TiltedGround) -> float:
    """Of a cylinder's axis below the plane [m]: no angle of the rectangle is then wide."""
    return max(0.026, 1.2 * ground.half[0])


def _chart(ground: TiltedGround, round_: bool) -> Chart:
    axes, depth = Rotation.from_array(number(ground.axes())), _depth(ground)
    if not round_:
        return PlaneChart(vector(ground.above * ground.axes()[:, 2]), axes)
    return CylindricalChart(vector((ground.above - depth) * ground.axes()[:, 2]), axes, number(depth))


@lru_cache(maxsize=512)
def _fitted(ground: TiltedGround, name: str, round_: bool) -> tuple[Floats, tuple[float, float], tuple[float, float]]:
    """Coefficients, middle and half size of the rectangle."""
    u, v, h = ground.grid(SAMPLES, SAMPLES)
    if round_:
        depth = _depth(ground)
        u, h = depth * np.arctan2(u, depth + h), np.hypot(u, depth + h)
    low, high = float(u[0].max()), float(u[-1].min())  # where every strip has samples
    half = 0.5 * (high - low), ground.half[1]
    center = 0.5 * (high + low), 0.0
    a, b = (x / size if size > 0 else 0 * x for x, size in ((u - center[0], half[0]), (v, half[1])))
    if name == "spline":
        return _spline(a, b, h), center, half
    return _polynomial(a, b, h, parse_degree(name), ground.met), center, half


def _polynomial(a: Floats, b: Floats, h: Floats, degree: int, met: bool) -> Floats:
    """Coefficients of the polynomial nearest to heights over the samples, or to those of all that meet the middle's."""
    basis = np.stack([a.ravel() ** i * b.ravel() ** j for i, j in exponents(degree)], axis=1)
    if not met:
        return np.asarray(np.linalg.lstsq(basis, h.ravel(), rcond=None)[0], np.float64)
    middle = h[SAMPLES // 2, SAMPLES // 2]
    others = np.linalg.lstsq(basis[:, 1:], h.ravel() - middle, rcond=None)[0]
    return np.concatenate([[middle], others])


def _spline(a: Floats, b: Floats, h: Floats) -> Floats:
    """Coefficients of the spline nearest to heights over the samples."""
    n_u, n_v = CELLS
    columns = [_hats(a.ravel(), n_u), _hats(b.ravel(), n_v)]
    basis = np.einsum("ki,kj->kij", *columns).reshape(a.size, -1)
    return np.linalg.lstsq(basis, h.ravel(), rcond=None)[0].reshape(n_u + 3, n_v + 3)


def _hats(a: Floats, n: int) -> Floats:
    """(k, n + 3): the spline's basis functions at places a."""
    cell, x = cell_of(a, n)
    out = np.zeros((a.size, n + 3))
    for j, values in enumerate(cubic_basis(x).values):
        np.add.at(out, (np.arange(a.size), cell + j), values)
    return out


def mesh_on(ground: TiltedGround, cells: tuple[int, int] = MESH) -> SurfaceMesh:
    """A grid's triangles, normals out of the bone, in the femur's frame.

    Raises:
        InputError: an odd number of cells across: none lies on the border of the facets.
    """
    n_u, n_v = (n + 1 for n in cells)
    if cells[1] % 2:
        raise InputError(f"{cells[1]} cells across", where="mesh_on", expected="an even number")
    k = np.arange(n_u * n_v).reshape(n_u, n_v)
    a, b, c, d = (q.ravel() for q in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return SurfaceMesh(ground.points(*ground.grid(n_u, n_v)), faces, "a ground of few triangles")


def lateral_of(mesh: SurfaceMesh) -> NDArray[np.bool_]:
    """Which triangles lie laterally of the middle plane, (m,)."""
    return mesh.vertices[mesh.faces].mean(axis=1)[:, 1] > 0
