"""How much longer the path of an OpenSim model's muscle is for what it wraps over."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_model import PathWrap, path_wraps
from pftwin.files.interchange.osim_wraps import OsimWrap, Wraps

if TYPE_CHECKING:
    from pftwin.geometry.wrapping.obstacle import Obstacle


class Wrap(NamedTuple):
    """An obstacle, and the points of a path between which it counts."""

    part: str  # of the knee that carries it
    obstacle: Obstacle  # in that part's frame
    between: PathWrap

    def adds(self, start: Floats, end: Floats) -> Floats:
        """How much longer than straight the line between points (n, 3) of the part's frame is (n,) [m]."""
        from pftwin.base.leaves import vector

        around = np.asarray(self.obstacle.around(vector(start), vector(end)).length, dtype=np.float64)
        return np.maximum(around - np.linalg.norm(end - start, axis=-1), 0.0)


def wraps_of(muscle: Element, objects: Wraps) -> tuple[list[Wrap], list[str]]:
    """What a muscle's path wraps over; and the names of those objects that are left out, with the reasons.

    Raises:
        InputError: an object or a range that cannot be.
    """
    found, left = [], []
    for wrap in path_wraps(muscle):
        over, why = objects.over([wrap.name])
        left += why
        if over is not None:
            found.append(Wrap(over.body, _obstacle(over), wrap))
    return found, left


def _obstacle(over: OsimWrap) -> Obstacle:
    """In the model's axes."""
    from pftwin.base.leaves import number, vector
    from pftwin.base.spatial import Quaternion
    from pftwin.geometry.wrapping.cylinder import Cylinder
    from pftwin.geometry.wrapping.ellipsoid import Ellipsoid

    numbers = over.numbers
    center = vector(numbers["center_m"])
    if over.kind == "ellipsoid":
        turn = Quaternion(*(number(v) for v in numbers["quaternion_wxyz"]))
        return Ellipsoid(center, over.body, vector(numbers["radii_m"]), turn)
    side = vector(numbers["side"]) if "side" in numbers else None
    return Cylinder(center, over.body, number(numbers["radius_m"]), vector(numbers["axis"]), side)
