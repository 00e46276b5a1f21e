"""The shortest line between two points around an ellipsoid: a taut string, found plane by plane.

An independent construction for tests, in plain numpy: in every plane through both ends the ellipsoid is an ellipse, and
the shortest way around it is half of the convex hull of ellipse and ends. The plane of the shortest way is looked for.
For the short wraps of a ligament that is the geodesic to well below its own uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import ConvexHull

from pftwin.base.arrays import Floats

ROUND = np.linspace(0, 2 * np.pi, 360, endpoint=False)


@dataclass(frozen=True)
class Ellipsoid:
    """A convex obstacle."""

    center: Floats  # (3,) [m]
    axes: Floats  # (3, 3) columns
    radii: Floats  # (3,) [m]

    def wrapped(self, start: Floats, end: Floats) -> tuple[float, Floats]:
        """Length of the taut line from start to end [m], and its unit direction at the start."""
        p, q = ((a - self.center) @ self.axes for a in (start, end))
        a, b = p / self.radii, (q - p) / self.radii
        nearest = a + np.clip(-(a @ b) / (b @ b), 0, 1) * b
        if nearest @ nearest >= 1:
            return float(np.linalg.norm(q - p)), (end - start) / np.linalg.norm(end - start)
        turns = np.linspace(0, np.pi, 36, endpoint=False)
        best = turns[np.argmin([self._in_plane(p, q, turn)[0] for turn in turns])]
        found = minimize_scalar(
            lambda turn: self._in_plane(p, q, turn)[0], bounds=(best - 0.1, best + 0.1), method="bounded"
        )
        length, way = self._in_plane(p, q, float(found.x))
        return length, self.axes @ (way / np.linalg.norm(way))

    def _in_plane(self, p: Floats, q: Floats, turn: float) -> tuple[float, Floats]:
        along = (q - p) / np.linalg.norm(q - p)
        side = np.linalg.svd(along[None])[2][1:]
        across = np.cos(turn) * side[0] + np.sin(turn) * side[1]
        one = along / self.radii
        one /= np.linalg.norm(one)
        two = across / self.radii
        two -= (two @ one) * one
        two /= np.linalg.norm(two)
        normal = np.cross(one, two)
        height = normal @ (p / self.radii)
        if abs(height) >= 1:
            return float(np.linalg.norm(q - p)), q - p
        circle = np.sqrt(1 - height**2) * (np.cos(ROUND)[:, None] * one + np.sin(ROUND)[:, None] * two)
        points = np.vstack([p, q, (height * normal + circle) * self.radii])
        hull = list(ConvexHull(np.stack([(points - p) @ along, (points - p) @ across], axis=1)).vertices)
        if not {0, 1} <= set(hull):
            return np.inf, q - p
        hull = hull[hull.index(0) :] + hull[: hull.index(0)]
        ends = hull.index(1)
        ways = (points[w] for w in (hull[: ends + 1], [*hull[ends:], 0][::-1]))
        lengths = [(float(np.linalg.norm(np.diff(w, axis=0), axis=1).sum()), w[1] - w[0]) for w in ways]
        return min(lengths, key=lambda pair: pair[0])
