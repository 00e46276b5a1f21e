"""Parts of a trochlear region whose vertices count more, or less, in a fit.

Michaud et al. 2024, section 2.4.2, refine the mesh where patellae dislocate, so that more vertices lie there and the
polynomial comes nearer to them. Weights do the same on any mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.geometry.patch.fit_vertices import chart_coordinates
from pftwin.geometry.patch.region import TrochlearRegion


@dataclass(frozen=True)
class WeightedPart:
    """A rectangle of a region and the weight of each vertex in it."""

    weight: float
    angles: tuple[float, float] = (-np.pi, np.pi)  # about the trochlear axis: 0 anteriorly, positive proximally [rad]
    across: tuple[float, float] = (-np.inf, np.inf)  # from the region's middle, positive laterally [m]


def emphasis(region: TrochlearRegion, parts: Sequence[WeightedPart]) -> Callable[[Floats], Floats]:
    """Weights (n,) of points (n, 3) of the mesh's frame [m], for `fit_patch(..., emphasis=)`.

    Of parts that overlap the last one counts; where there is none the weight is 1.
    """

    def weights(points: Floats) -> Floats:
        u, v, _ = chart_coordinates(region.cylinder, points)
        angle, found = u / float(region.cylinder.radius), np.ones(len(points))
        for part in parts:
            (low, high), (medial, lateral) = part.angles, part.across
            found[(angle >= low) & (angle <= high) & (v >= medial) & (v <= lateral)] = part.weight
        return found

    return weights
