"""What there is to draw of a scene, and what of it no knob changes: meshes and surfaces are made once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pftwin.drawn_surface import continuation, has_rectangle, triangles_of
from pftwin.scene import Scene
from pftwin.scene_geometry import geometry
from pftwin.viewer.matrices import MM
from pftwin.viewer.shapes import Shape

if TYPE_CHECKING:
    from xarray import Dataset

FAR = 0.045  # beyond the edges of a fitted surface that its continuation is made [m]
HEIGHT = 0.02  # over a chart of points that only tell how far along it is wanted [m]
MOST_ANGLE = 2.8  # of a cylinder's chart, which closes at pi [rad]
AROUND = 7.0  # a continuation is drawn so far around the contact points [mm]


class Still:
    """Of a scene and of all that its knobs can make of it."""

    def __init__(self, scene: Scene) -> None:
        self._bodies = geometry(scene)
        self._beyond = _beyond(scene)

    def geometry(self, scene: Scene) -> Dataset:
        """The dataset of a treated scene: the still parts, and its own lines of force."""
        button = scene.button
        lines = geometry(scene if button is None else scene.without(button.name))
        return self._bodies.assign(lines.data_vars)

    def continued(self, points: NDArray[np.float64]) -> Shape | None:
        """The surface beyond its fitted rectangle, near contact points (k, 3) [m]; None where none is near."""
        from scipy.spatial import cKDTree

        points = points[np.isfinite(points).all(axis=1)]
        if self._beyond is None or not points.size:
            return None
        vertices, triangles = self._beyond
        middle = vertices[triangles].mean(axis=1)
        near = np.isfinite(cKDTree(MM * points).query(middle, distance_upper_bound=AROUND)[0])
        return Shape(vertices, triangles[near]) if near.any() else None


def _beyond(scene: Scene) -> Shape | None:
    """The continuation of a fitted surface, as far as it is ever drawn."""
    surface, contact = scene.surface, scene.button
    if surface is None or contact is None or triangles_of(contact)[0] is not None or not has_rectangle(surface):
        return None
    (u, v), (a, b) = ([float(x) for x in pair] for pair in (getattr(surface, n) for n in ("center", "half_size")))
    round_ = MOST_ANGLE * float(getattr(surface.chart, "radius", np.inf))  # as far as a cylinder's chart goes
    along = [max(u - a - FAR, -round_), min(u + a + FAR, round_)]
    corners = [surface.chart.point(x, y, HEIGHT) for x in along for y in (v - b - FAR, v + b + FAR)]  # type: ignore[arg-type]
    made = continuation(surface, np.array([[float(c.x), float(c.y), float(c.z)] for c in corners]))
    return None if made is None else Shape((MM * made[0]).astype(np.float32), made[1].astype(np.uint32))
