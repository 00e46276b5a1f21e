"""Joints of an OpenSim model, and where they put its bodies in ground for given coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import GROUND, Element, Frames, OsimFrame
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


@dataclass(frozen=True)
class Tree:
    """All joints, by the name of the body that each carries; and coordinates that follow others."""

    joints: dict[str, Joint]
    coupled: dict[str, tuple[str, Function]] = field(default_factory=dict)  # by name: of which it is what function

    def coordinates(self) -> dict[str, Coordinate]:
        """By name."""
        return {c.name: c for j in self.joints.values() for c in j.coordinates}

    def values(self, given: dict[str, Floats], count: int) -> dict[str, Floats]:
        """Of every coordinate (n,): as given, else its default; then those that follow others."""
        out = {n: given.get(n, np.full(count, c.default)) for n, c in self.coordinates().items()}
        for name, (independent, function) in self.coupled.items():
            if name in out and independent in out:
                out[name] = function(out[independent])
        return out

    def pose(self, body: str, values: dict[str, Floats], count: int) -> Floats:
        """Of a body in ground, (n, 4, 4).

        Raises:
            InputError: a body that no chain of joints connects with ground.
        """
        out, seen = np.tile(np.eye(4), (count, 1, 1)), set()
        while body != GROUND:
            joint = self.joints.get(body)
            if joint is None or body in seen:
                raise InputError(f"no chain of joints connects the body {body!r} with ground", where=body)
            seen.add(body)
            out = joint.pose(values, count) @ out
            body = joint.parent.body
        return out

    def welded(self, body: str) -> tuple[str, Floats]:
        """The body that carries this one without a degree of freedom between, and the pose (4, 4) of this one in it."""
        out, seen = np.eye(4), set()
        while body in self.joints and self.joints[body].kind == "WeldJoint" and body not in seen:
            seen.add(body)
            out = self.joints[body].pose({}, 1)[0] @ out
            body = self.joints[body].parent.body
        return body, out


def read_tree(model: Element, frames: Frames) -> Tree:
    """The joints of a model, and its coupled coordinates.

    Raises:
        InputError: what a joint lacks; functions that are not known.
    """
    joints: dict[str, Joint] = {}
    for holder in model.all("JointSet"):
        for element in holder.needed("objects").children:
            joint = read_joint(element, frames)
            joints[joint.child.body] = joint
    coupled = {}
    for element in model.all("CoordinateCouplerConstraint"):
        function = function_in(element, "coupled_coordinates_function")
        names = element.words("independent_coordinate_names").split()
        if function is not None and len(names) == 1:
            coupled[element.words("dependent_coordinate_name")] = (names[0], function)
    return Tree(joints, coupled)
