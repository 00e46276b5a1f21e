"""Joints and coordinates of an OpenSim model: where a body is in the one that carries it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_frames import Frames, OsimFrame
from pftwin.files.interchange.osim_functions import Function, function_in

Floats = NDArray[np.float64]
_X, _Y, _Z = np.eye(3)
# Rotation axes, then translation axes, of joints whose transform needs no further description.
PLAIN: dict[str, tuple[tuple[Floats, ...], tuple[Floats, ...]]] = {
    "WeldJoint": ((), ()),
    "PinJoint": ((_Z,), ()),
    "SliderJoint": ((), (_X,)),
    "UniversalJoint": ((_X, _Y), ()),
    "GimbalJoint": ((_X, _Y, _Z), ()),
    "BallJoint": ((_X, _Y, _Z), ()),
    "FreeJoint": ((_X, _Y, _Z), (_X, _Y, _Z)),
}
JOINTS = (*PLAIN, "CustomJoint")


class Coordinate(NamedTuple):
    """A degree of freedom."""

    name: str
    default: float  # [rad] or [m]
    low: float
    high: float
    rotational: bool


class Axis(NamedTuple):
    """What turns about, or moves along, a direction."""

    direction: Floats  # (3,)
    coordinate: str | None
    function: Function | None  # None: the coordinate itself


@dataclass(frozen=True)
class Joint:
    """Between two bodies."""

    kind: str
    name: str
    where: str
    parent: OsimFrame
    child: OsimFrame
    rotations: tuple[Axis, ...]  # in this order, fixed to the moving body
    translations: tuple[Axis, ...]  # along the parent's frame
    coordinates: tuple[Coordinate, ...]

    def check(self) -> None:
        """Refuses a joint that cannot be followed.

        Raises:
            InputError: it is of a kind that is not known.
        """
        if self.kind not in JOINTS:
            raise InputError(f"<{self.kind}> {self.name!r}", where=self.where, expected=f"one of: {', '.join(JOINTS)}")

    def pose(self, values: dict[str, Floats], count: int) -> Floats:
        """The child's body in the parent's, (n, 4, 4).

        Raises:
            InputError: a joint of a kind that is not known.
        """
        self.check()
        out = np.tile(np.eye(4), (count, 1, 1))
        for axis in self.rotations:
            turn = Rotation.from_rotvec(_amount(axis, values, count)[:, None] * axis.direction).as_matrix()
            out[:, :3, :3] = out[:, :3, :3] @ turn
        for axis in self.translations:
            out[:, :3, 3] += _amount(axis, values, count)[:, None] * axis.direction
        return self.parent.pose @ out @ np.linalg.inv(self.child.pose)


def _amount(axis: Axis, values: dict[str, Floats], count: int) -> Floats:
    at = np.zeros(count) if axis.coordinate is None else values[axis.coordinate]
    return at if axis.function is None else axis.function(at)


def read_joint(element: Element, frames: Frames) -> Joint:
    """Of an element; one of an unknown kind has no axes, and cannot be followed.

    Raises:
        InputError: what it lacks; functions that are not known.
    """
    ends = [frames.find(element.needed(f"socket_{k}_frame").text, element, element.where) for k in ("parent", "child")]
    held = element.child("coordinates")
    listed = [] if held is None else held.children
    rotations, translations = _axes(element, [c.name for c in listed])
    turning = {a.coordinate for a in rotations}
    coordinates = tuple(_coordinate(c, c.name in turning) for c in listed)
    return Joint(element.tag, element.name, element.where, ends[0], ends[1], rotations, translations, coordinates)


def _coordinate(element: Element, rotational: bool) -> Coordinate:
    default, limits = element.child("default_value"), element.child("range")
    low, high = (-np.inf, np.inf) if limits is None else limits.numbers(2)
    return Coordinate(element.name, 0.0 if default is None else float(default.numbers(1)[0]), low, high, rotational)


def _axes(element: Element, names: list[str]) -> tuple[tuple[Axis, ...], tuple[Axis, ...]]:
    if element.tag in PLAIN:
        turns, ways = PLAIN[element.tag]
        if len(names) < len(turns) + len(ways):
            raise InputError(f"<{element.tag}> {element.name!r} has {len(names)} coordinates", where=element.where)
        made = [Axis(direction, name, None) for direction, name in zip((*turns, *ways), names, strict=False)]
        return tuple(made[: len(turns)]), tuple(made[len(turns) :])
    if element.tag != "CustomJoint":
        return (), ()
    found: dict[str, Axis] = {}
    for axis in element.needed("SpatialTransform").all("TransformAxis"):
        used = axis.words("coordinates").split()
        if len(used) > 1:
            raise InputError(f"{len(used)} coordinates of one axis", where=axis.where, expected="one")
        direction = axis.needed("axis").numbers(3)
        length = float(np.linalg.norm(direction))
        if length == 0:
            raise InputError("an axis without a direction", where=axis.where)
        function = function_in(axis)
        nothing = not used and function is None
        if not nothing:
            found[axis.name] = Axis(direction / length, used[0] if used else None, function)
    strange = [a.coordinate for a in found.values() if a.coordinate is not None and a.coordinate not in names]
    if strange:
        raise InputError(f"no coordinate {strange[0]!r} in the joint", where=element.where, expected=", ".join(names))

    def of(kind: str) -> tuple[Axis, ...]:
        return tuple(found[f"{kind}{k}"] for k in (1, 2, 3) if f"{kind}{k}" in found)

    return of("rotation"), of("translation")
