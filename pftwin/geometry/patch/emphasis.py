"""Weights for parts of a trochlear region in a fit.

Michaud et al. 2024, section 2.4.2, refine the mesh where patellae dislocate, so that it has more vertices there and the
polynomial fits better. Weights have the same effect on any mesh.
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
    """A rectangle of a region and the weight of the vertices in it."""

    weight: float
    angles: tuple[float, float] = (-np.pi, np.pi)  # about the trochlear axis: 0 anteriorly, positive proximally [rad]
    across: tuple[float, float] = (-np.inf, np.inf)  # medial-lateral, from the region's middle, positive laterally [m]


def emphasis(region: TrochlearRegion, parts: Sequence[WeightedPart]) -> Callable[[Floats], Floats]:
    """A function from points (n, 3) of the mesh's frame [m] to weights (n,), for `fit_patch(..., emphasis=)`.

    Where parts overlap the last one applies; outside all parts the weight is 1.
    """

    def weights(points: Floats) -> Floats:
        u, v, _ = chart_coordinates(region.cylinder, points)
        angle, found = u / float(region.cylinder.radius), np.ones(len(points))
        for part in parts:
            (low, high), (medial, lateral) = part.angles, part.across
            found[(angle >= low) & (angle <= high) & (v >= medial) & (v <= lateral)] = part.weight
        return found

    return weights
