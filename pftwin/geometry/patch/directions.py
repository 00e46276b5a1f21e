"""Directions in a mesh's frame under which a trochlear groove is found: what to try where stated ones find none."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

from pftwin.base.errors import InputError
from pftwin.base.signed_axes import AXES
from pftwin.geometry.patch.region import TrochlearRegion, trochlear_region

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh


class Candidate(NamedTuple):
    """Two axes of a mesh's frame, "-x" and the like, and the region that is found under them."""

    anterior: str
    proximal: str
    region: TrochlearRegion


def directions_with_groove(
    mesh: SurfaceMesh, *, half_width: float = 0.02, angles: tuple[float, float] = (-math.pi / 3, math.pi / 3)
) -> list[Candidate]:
    """All pairs of a mesh's axes as anterior and proximal directions under which `trochlear_region` finds a groove.

    Those whose groove goes on farthest distally come first, as a trochlea's does; then those with the longest groove.
    The notch of a bone is a groove too, and upside down a trochlea is one: which pair is right the shape alone does not
    tell.

    Args:
        mesh: as `trochlear_region` has it; `half_width` [m] and `angles` [rad] too.
    """
    found = []
    for (anterior, ahead), (proximal, up) in itertools.permutations(AXES.items(), 2):
        if anterior[1] == proximal[1]:
            continue  # one axis
        try:
            region = trochlear_region(mesh, anterior=ahead, proximal=up, half_width=half_width, angles=angles)
        except InputError:
            continue  # no groove there
        found.append(Candidate(anterior, proximal, region))
    return sorted(found, key=lambda c: (round(c.region.angles[0], 3), -len(c.region.groove)))
