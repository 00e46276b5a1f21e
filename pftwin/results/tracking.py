"""Patellar tracking: the bottom line of the trochlear groove, the button's distance from it, and dislocations.

A patella is dislocated when the button has climbed over the groove's wall. Before it does, the button's centre moves
about as far sideways as the crest is from the bottom of the groove, so the measure is the medial-lateral distance of
the sphere's centre from the groove's bottom at the same position along the groove.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.geometry.patch.closest import Surface, rectangle_of

DISLOCATED = 0.020  # distance from the groove's bottom [m]: past the ridge of a facet, which is 15 to 20 mm wide
RE_ENGAGED = 0.6  # hysteresis: share of that distance below which the button has re-engaged
_SECTIONS, _SAMPLES = 81, 161
_LARGEST_JUMP = 0.003  # of the groove's bottom between neighbouring sections [m]


class GrooveLine(NamedTuple):
    """The groove's bottom line in chart coordinates [m]: v over u, and its depth below the lower of its two walls."""

    u: Floats
    v: Floats
    depth: Floats

    def at(self, u: ArrayLike) -> Floats:
        """Interpolates v of the bottom at positions u along the groove [m]; constant beyond the groove's ends."""
        return np.interp(np.asarray(u, dtype=np.float64), self.u, self.v)


def groove_line(surface: Surface) -> GrooveLine | None:
    """Finds the bottom of the groove over the surface's extent: a minimum of height across each section.

    The line starts in the deepest section and continues proximally and distally until it jumps. Returns None for a
    surface without a groove.
    """
    u, v = (np.linspace(*ends, n) for ends, n in zip(rectangle_of(surface), (_SECTIONS, _SAMPLES), strict=True))
    heights = np.asarray(_heights(surface, *np.meshgrid(u, v, indexing="ij")), dtype=np.float64)
    sections = [_minima(v, h) for h in heights]
    depths = [max((d for _, d in s), default=-np.inf) for s in sections]
    deepest = int(np.argmax(depths))
    if not np.isfinite(depths[deepest]):
        return None
    line = {deepest: max(sections[deepest], key=lambda m: m[1])}
    for way in (range(deepest + 1, _SECTIONS), range(deepest - 1, -1, -1)):
        before = line[deepest][0]
        for i in way:
            nearest = min(sections[i], key=lambda m: abs(m[0] - before), default=None)
            if nearest is None or abs(nearest[0] - before) > _LARGEST_JUMP:
                break
            line[i], before = nearest, nearest[0]
    rows = sorted(line)
    return GrooveLine(u[rows], np.array([line[i][0] for i in rows]), np.array([line[i][1] for i in rows]))


def groove_bottom(surface: Surface) -> tuple[Floats, Floats]:
    """u and v (k,) of the groove's bottom in chart coordinates [m]; on a surface without a groove, of its middle line.

    Between and beyond these points `numpy.interp` gives the bottom, as `GrooveLine.at` does.
    """
    line = groove_line(surface)
    if line is None:
        return np.array([-1.0, 1.0]), np.full(2, float(surface.center[1]))
    return line.u, line.v


def groove_offset(surface: Surface, centers: ArrayLike) -> tuple[Floats, Floats]:
    """Computes the position of sphere centres (n, 3) [m], in the femur frame, relative to the trochlear groove.

    Returns:
        Position along the groove (the chart's u) and distance from the groove's bottom, positive lateral; (n,) each
        [m]. On a surface without a groove, the distance is measured from the middle of the surface.
    """
    points = np.asarray(centers, dtype=np.float64)
    u, v = (np.asarray(a, dtype=np.float64) for a in _chart_coordinates(surface, Vec3(*points.T)))
    return u, v - np.interp(u, *groove_bottom(surface))


@eqx.filter_jit
def _heights(surface: Any, u: ArrayLike, v: ArrayLike) -> Array:
    return surface.jet(jnp.asarray(u, float), jnp.asarray(v, float)).f


@eqx.filter_jit
def _chart_coordinates(surface: Any, centers: Vec3) -> tuple[Array, Array]:
    c = Vec3(*(jnp.asarray(a, float) for a in (centers.x, centers.y, centers.z)))
    return surface.chart.foot(surface.chart.to_frame(c))


def _minima(v: Floats, h: Floats) -> list[tuple[float, float]]:
    """(position, depth) of the minima inside a section, with the position refined by a parabola."""
    inside = np.flatnonzero((h[1:-1] < h[:-2]) & (h[1:-1] <= h[2:])) + 1
    out = []
    for i in inside:
        curvature = h[i - 1] - 2 * h[i] + h[i + 1]
        shift = 0.5 * (h[i - 1] - h[i + 1]) / curvature
        depth = min(h[:i].max(), h[i + 1 :].max()) - h[i]
        out.append((float(v[i] + shift * (v[1] - v[0])), float(depth)))
    return out


@dataclass(frozen=True)
class Dislocation:
    """One event in which the button leaves the groove."""

    time: float  # at which the button leaves [s]
    knee_flexion: float | None  # at that time [rad]
    side: str  # "lateral" or "medial"
    farthest: float  # largest distance from the groove's bottom [m]
    re_engaged_at: float | None  # [s]; None: not within the recording

    def describe(self) -> str:
        """Describes the event in words."""
        flexion = "" if self.knee_flexion is None else f" at {np.degrees(self.knee_flexion):.1f} deg of knee flexion"
        back = "did not re-engage within the recording"
        if self.re_engaged_at is not None:
            back = f"re-engaged at {self.re_engaged_at:.2f} s"
        far = f"up to {1e3 * self.farthest:.1f} mm {self.side} of the groove"
        return f"{self.side} dislocation at {self.time:.2f} s{flexion}, {far}; {back}"


@dataclass(frozen=True, eq=False)
class Tracking:
    """The button's distance from the groove's bottom and its dislocations."""

    offset: Floats  # (n,) from the groove's bottom, positive lateral [m]
    dislocated: NDArray[np.bool_]  # (n,)
    events: tuple[Dislocation, ...]

    @property
    def re_engaged(self) -> bool | None:
        """Whether the button was back in the groove when the recording ended; None if it never left."""
        return self.events[-1].re_engaged_at is not None if self.events else None

    def describe(self) -> str:
        """Describes all events in words."""
        return "; ".join(e.describe() for e in self.events) or "normal tracking"


def find_dislocations(
    times: ArrayLike, offset: ArrayLike, knee_flexion: ArrayLike | None = None, *, threshold: float = DISLOCATED
) -> Tracking:
    """Finds dislocations in a recording (n,): times [s], offsets [m] (`groove_offset`) and, for reports, flexion [rad].

    The button leaves the groove when |offset| exceeds `threshold` [m] and re-engages when |offset| falls below
    `RE_ENGAGED * threshold`. A missing frame (NaN) keeps the previous state. Raises InputError for arrays of
    different lengths and for a threshold that is not positive.
    """
    t, y = np.asarray(times, dtype=np.float64), np.asarray(offset, dtype=np.float64)
    flexion = None if knee_flexion is None else np.asarray(knee_flexion, dtype=np.float64)
    if t.ndim != 1 or y.shape != t.shape or (flexion is not None and flexion.shape != t.shape):
        raise InputError(f"offsets of shape {y.shape}", where="tracking", expected=f"one per time, {t.shape}")
    if not threshold > 0:
        raise InputError(f"found {threshold!r}", where="threshold", expected="a positive distance in metres")
    out = np.zeros(t.size, dtype=bool)
    state = False
    for i, far in enumerate(np.abs(y)):
        state = bool(far > threshold) if not state else not far < RE_ENGAGED * threshold
        out[i] = state
    edges = np.diff(np.concatenate([[0], out.astype(int), [0]]))
    events = tuple(
        Dislocation(
            float(t[start]),
            None if flexion is None else float(flexion[start]),
            "lateral" if y[start] > 0 else "medial",
            float(np.nanmax(np.abs(y[start:stop]))),
            float(t[stop]) if stop < t.size else None,
        )
        for start, stop in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    )
    return Tracking(y, out, events)
