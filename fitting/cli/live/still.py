"""What there is to draw of a scene, and what of it no knob changes: meshes and surfaces are made once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.spatial import Vec3
from pftwin.model.scene import Scene
from pftwin.results.scene_geometry import continuation, geometry, has_rectangle
from pftwin.results.viewer.shapes import MM, Shape

if TYPE_CHECKING:
    from xarray import Dataset

FAR = 0.045  # beyond the edges of a fitted surface that its continuation is made [m]
HEIGHT = 0.02  # over a chart of points that only tell how far along it is wanted [m]
MOST_ANGLE = 2.8  # of a cylinder's chart, which closes at pi [rad]
MARGIN = 4e-3  # how far past the outermost contact point it is drawn [m]


class Still:
    """Of a scene and of all that its knobs can make of it."""

    def __init__(self, scene: Scene) -> None:
        self._bodies = geometry(scene)
        self._beyond = _beyond(scene)

    def geometry(self, scene: Scene) -> Dataset:
        """The dataset of a treated scene: the still parts, and its own lines of force."""
        contact = scene.contact
        lines = geometry(scene if contact is None else scene.without(contact.name))
        return self._bodies.assign(lines.data_vars)

    def continued(self, points: NDArray[np.float64]) -> Shape | None:
        """The surface beyond its fitted rectangle, as far as contact points (k, 3) [m] need it; None where they do not.

        Points that are missing are NaN: arrays of one size need one program.
        """
        beyond = self._beyond
        if beyond is None or not len(points):
            return None
        at = _along(beyond.chart, points)
        ends = [(np.nanmin(c), np.nanmax(c)) if np.isfinite(c).any() else (0.0, 0.0) for c in at]
        if all(low >= edge[0] and high <= edge[1] for (low, high), edge in zip(ends, beyond.edges, strict=True)):
            return None
        near = np.ones(len(beyond.shape.triangles), dtype=bool)
        for (low, high), edge, c in zip(ends, beyond.edges, beyond.middles, strict=True):
            near &= (c > min(low - MARGIN, edge[0])) & (c < max(high + MARGIN, edge[1]))
        return Shape(beyond.shape.vertices, beyond.shape.triangles[near])


class _Beyond(NamedTuple):
    """The continuation of a fitted surface, as far as it is ever drawn."""

    chart: Any
    edges: list[tuple[float, float]]  # of the rectangle that was fitted [m]
    shape: Shape
    middles: tuple[NDArray[np.float64], NDArray[np.float64]]  # of its triangles, along the chart (m,) each [m]


def _along(chart: Any, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    at = chart.coordinates(Vec3(*(jnp.asarray(c, float) for c in points.T)))
    return np.asarray(at.x, dtype=np.float64), np.asarray(at.y, dtype=np.float64)


def _beyond(scene: Scene) -> _Beyond | None:
    surface: Any = scene.surface
    contact = scene.contact
    if surface is None or contact is None or contact.femur_triangles() is not None or not has_rectangle(surface):
        return None
    edges = [(float(c - h), float(c + h)) for c, h in zip(surface.center, surface.half_size, strict=True)]
    most = MOST_ANGLE * float(getattr(surface.chart, "radius", np.inf))  # as far as a cylinder's chart goes
    along = [max(edges[0][0] - FAR, -most), min(edges[0][1] + FAR, most)]
    corners = [surface.chart.point(u, v, HEIGHT) for u in along for v in (edges[1][0] - FAR, edges[1][1] + FAR)]
    made = continuation(surface, np.array([[float(c.x), float(c.y), float(c.z)] for c in corners]))
    if made is None:
        return None
    shape = Shape((MM * made[0]).astype(np.float32), made[1].astype(np.uint32))
    return _Beyond(surface.chart, edges, shape, _along(surface.chart, made[0][made[1]].mean(axis=1)))
