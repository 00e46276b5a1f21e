"""A cut across a trochlea, as on an axial scan: its deepest point, its ridges, its lateral facet."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array
from pftwin.geometry.patch.closest import Surface
from pftwin.results.tracking import groove_line

_SAMPLES = 401
_LIFT = (0.02, 0.021)  # two heights whose difference gives the direction out of the bone [m]
_HALF_WIDTH = 0.020  # for a surface of unknown width [m]


@dataclass(frozen=True)
class TrochlearSection:
    """Points of the femur's frame, (3,) each [m]. A ridge is None where the surface still rises at its edge."""

    bottom: Floats
    medial_ridge: Floats | None
    lateral_ridge: Floats | None
    lateral_facet: Floats  # (n, 3) from the bottom to the lateral ridge
    normal: Floats  # unit vector across the section
    outward: Floats  # unit vector in the section, out of the bone
    note: str

    def no_ridge(self) -> str:
        """Which ridge is not there."""
        sides = [s for s, r in (("medial", self.medial_ridge), ("lateral", self.lateral_ridge)) if r is None]
        return f"no {' and no '.join(sides)} ridge: the fitted surface still rises at its edge"


def section(surface: Surface, level: float) -> TrochlearSection:
    """The cut at one place along the groove, from 0, its proximal end, to 1, its distal one; at constant chart u.

    InputError for a surface without a groove.
    """
    line = groove_line(surface)
    if line is None:
        raise InputError("the trochlea has no groove", where="section", expected="a surface with a groove")
    ends = _points(surface, line.u[[0, -1]], line.v[[0, -1]])
    proximal, distal = (line.u[-1], line.u[0]) if ends[1, 0] > ends[0, 0] else (line.u[0], line.u[-1])
    u = float(proximal + level * (distal - proximal))
    bottom_v = float(line.at(u))
    v0 = float(getattr(surface, "center", (0.0, 0.0))[1])
    half = float(getattr(surface, "half_size", (_HALF_WIDTH, _HALF_WIDTH))[1])
    medial, lateral = (np.linspace(bottom_v, v0 + side * half, _SAMPLES) for side in (-1, 1))
    ridges, facets = [], []
    for v in (medial, lateral):
        heights = np.asarray(surface.jet(jnp.full(v.shape, u), jnp.asarray(v)).f)
        top = int(np.argmax(heights))
        points = _points(surface, np.full(v.shape, u), v)
        ridges.append(points[top] if 0 < top < _SAMPLES - 1 else None)
        facets.append(points[: top + 1])
    chart = surface.chart
    low, high = (np.asarray(chart.point(jnp.asarray(u), jnp.asarray(bottom_v), jnp.asarray(h)).array()) for h in _LIFT)
    outward = (high - low) / np.linalg.norm(high - low)
    across = host_array(chart.axes.ey)
    bottom = _points(surface, np.array([u]), np.array([bottom_v]))[0]
    note = f"section at {level:.0%} of the groove from its proximal end"
    return TrochlearSection(bottom, *ridges, facets[1], np.cross(across, outward), outward, note)


def _points(surface: Surface, u: Floats, v: Floats) -> Floats:
    """(n, 3) on the surface, femur frame."""
    a, b = jnp.asarray(u, dtype=float), jnp.asarray(v, dtype=float)
    return np.asarray(surface.chart.point(a, b, surface.jet(a, b).f).array(), dtype=np.float64)
