"""What the path of an OpenSim model's muscle wraps over, and how much longer that makes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element, Frames
from pftwin.files.interchange.osim_knee import OsimKnee, part_and_pose
from pftwin.files.interchange.osim_model import OsimModel

if TYPE_CHECKING:
    from pftwin.geometry.wrapping.obstacle import Obstacle

CYLINDER = "WrapCylinder"
_ANY_SIDE = ("all", "unassigned")


class Wrap(NamedTuple):
    """An obstacle, and the points of a path between which it counts."""

    part: str  # that carries it: of the knee, or another body's name
    obstacle: Obstacle  # in that part's frame
    first: int
    last: int

    def adds(self, start: Floats, end: Floats) -> Floats:
        """How much longer than straight the line between points (n, 3) of the part's frame is (n,) [m]."""
        from pftwin.base.leaves import vector

        around = np.asarray(self.obstacle.around(vector(start), vector(end)).length, dtype=np.float64)
        return np.maximum(around - np.linalg.norm(end - start, axis=-1), 0.0)


def wraps_of(muscle: Element, root: Element, model: OsimModel, knee: OsimKnee) -> tuple[list[Wrap], list[str]]:
    """What a path wraps over; and the names of those objects that are left out, for they are no cylinders.

    Raises:
        InputError: no object of that name; a cylinder or a range that cannot be.
    """
    sets = [(held, held.child("objects")) for held in root.all("WrapObjectSet")]  # some have none
    known = {o.name: (o, held) for held, objects in sets if objects is not None for o in objects.children}
    count = len(list(muscle.all("PathPoint", "ConditionalPathPoint", "MovingPathPoint")))
    frames, found, left = Frames(root), [], []
    for wrap in muscle.all("PathWrap"):
        name = wrap.words("wrap_object")
        if name not in known:
            raise InputError(f"no wrap object {name!r}", where=wrap.where, expected=f"one of: {', '.join(known)}")
        element, held = known[name]
        if element.words("active") == "false":
            continue
        if element.tag != CYLINDER:
            left.append(name)
            continue
        part, pose = part_and_pose(model, knee, frames.find("..", held, held.where))
        first, last = wrap.numbers_of("range", (-1.0, -1.0))
        found.append(Wrap(part, _cylinder(element, pose, part), max(int(first), 1) - 1, _last(int(last), count)))
    return found, left


def _last(number: int, count: int) -> int:
    return (count if number < 1 else number) - 1


def _cylinder(element: Element, pose: Floats, part: str) -> Obstacle:
    """Its axis is z; it is passed on the side of its own x or y, or of their opposites, where a quadrant says so."""
    from pftwin.base.leaves import number, vector
    from pftwin.geometry.wrapping.cylinder import Cylinder

    radius = element.needed("radius").numbers(1)[0]
    if radius <= 0:
        raise InputError(f"a radius of {radius:g} m", where=element.where, expected="a positive one")
    turn = Rotation.from_euler("XYZ", element.numbers_of("xyz_body_rotation", (0.0, 0.0, 0.0))).as_matrix()
    axes = pose[:3, :3] @ turn
    center = pose[:3, :3] @ element.numbers_of("translation", (0.0, 0.0, 0.0)) + pose[:3, 3]
    quadrant = (element.words("quadrant") or "all").lower()
    sides = {"x": axes[:, 0], "y": axes[:, 1]}
    side = None if quadrant in _ANY_SIDE else sides.get(quadrant.lstrip("+-"))
    if side is None and quadrant not in _ANY_SIDE:
        raise InputError(f"a quadrant {quadrant!r}", where=element.where, expected="all, or x, -x, y or -y")
    if side is not None and quadrant.startswith("-"):
        side = -side
    return Cylinder(vector(center), part, number(radius), vector(axes[:, 2]), None if side is None else vector(side))
