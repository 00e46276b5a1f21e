"""Joints of an OpenSim model: poses of its bodies in ground for given coordinates (forward kinematics).

The displacement along a joint's axis, and a coordinate coupled to another, are functions of one coordinate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline, PPoly, make_interp_spline
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import GROUND, Element, Frames, OsimFrame

Function = Callable[[Floats], Floats]
KINDS = (
    "Constant",
    "LinearFunction",
    "PolynomialFunction",
    "PiecewiseLinearFunction",
    "SimmSpline",
    "MultiplierFunction",
)


def function_in(holder: Element, tag: str = "function") -> Function | None:
    """The function that an element contains, directly or within a child `tag`; None if there is none.

    Raises InputError for an unknown kind or invalid numbers.
    """
    kinds = (
        c for c in (holder.child(tag) or holder).children if c.tag in KINDS or c.tag.endswith(("Function", "Spline"))
    )
    found = next(kinds, None)
    return None if found is None else _function_of(found)


def _function_of(element: Element) -> Function:
    if element.tag == "Constant":
        value = float(element.needed("value").numbers(1)[0])
        return lambda x: np.full_like(x, value)
    if element.tag == "LinearFunction":
        slope, offset = element.needed("coefficients").numbers(2)
        return lambda x: slope * x + offset
    if element.tag == "PolynomialFunction":
        coefficients = element.needed("coefficients").numbers()
        return lambda x: np.asarray(np.polyval(coefficients, x), dtype=np.float64)
    if element.tag == "MultiplierFunction":
        factor = element.number_of("scale", 1.0)
        inner = function_in(element)
        if inner is None:
            raise InputError("a <MultiplierFunction> of nothing", where=element.where)
        return lambda x: factor * inner(x)
    if element.tag in ("PiecewiseLinearFunction", "SimmSpline"):
        return _through_points(element)
    raise InputError(
        f"no function <{element.tag}> is known", where=element.where, expected=f"one of: {', '.join(KINDS)}"
    )


def _through_points(element: Element) -> Function:
    x, y = (element.needed(k).numbers() for k in ("x", "y"))
    if x.size != y.size or x.size < 2 or not (np.diff(x) > 0).all():
        raise InputError(
            f"{x.size} abscissae and {y.size} values", where=element.where, expected="as many, two or more, ascending"
        )
    try:
        return spline(x, y) if element.tag == "SimmSpline" else continued(make_interp_spline(x, y, 1), x)
    except ValueError as error:  # slopes that overflow
        raise InputError(f"no curve goes through its points: {error}", where=element.where) from error


def spline(x: Floats, y: Floats) -> Function:
    """SIMM's cubic spline: its third derivative at an end is that of the cubic through the four outermost points.

    Beyond the ends it continues along its tangents. With three points the third derivatives at the ends are zero; two
    points are joined by a line. Source: Forsythe, Malcolm and Moler 1977, subroutine SPLINE.
    """
    if x.size == 2:
        return continued(make_interp_spline(x, y, 1), x)
    ends = [0.0, 0.0]
    if x.size > 3:
        second = np.diff(np.diff(y) / np.diff(x)) / (x[2:] - x[:-2])
        third = np.diff(second) / (x[3:] - x[:-3])
        ends = [6 * third[0], 6 * third[-1]]
    known: Any = [(3, ends[0])], [(3, ends[1])]  # order and value of a derivative at each end
    return continued(make_interp_spline(x, y, 3, bc_type=known), x)


def continued(inside: BSpline | PPoly, x: Floats) -> Function:
    """Extends a curve beyond the first and last abscissa x by its tangents there."""
    slope = inside.derivative()

    def value(at: Floats) -> Floats:
        within = np.clip(at, x[0], x[-1])
        return inside(within) + slope(within) * (at - within)

    return value


_X, _Y, _Z = np.eye(3)
# Rotation axes, then translation axes, of joints with a fixed transform.
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
    """A degree of freedom; values are in rad or m."""

    name: str
    default: float
    low: float
    high: float
    rotational: bool


class Axis(NamedTuple):
    """A rotation about a direction, or a translation along it."""

    direction: Floats  # (3,)
    coordinate: str | None
    function: Function | None  # of the coordinate; None: the coordinate itself


@dataclass(frozen=True)
class Joint:
    """A joint between two bodies."""

    kind: str
    name: str
    where: str
    parent: OsimFrame
    child: OsimFrame
    rotations: tuple[Axis, ...]  # in this order, body-fixed
    translations: tuple[Axis, ...]  # along the parent's frame
    coordinates: tuple[Coordinate, ...]

    def check(self) -> None:
        """Raises InputError for a joint of an unknown kind."""
        if self.kind not in JOINTS:
            raise InputError(f"<{self.kind}> {self.name!r}", where=self.where, expected=f"one of: {', '.join(JOINTS)}")

    def pose(self, values: dict[str, Floats], count: int) -> Floats:
        """Pose (n, 4, 4) of the child's body in the parent's; raises InputError for a joint of an unknown kind."""
        self.check()

        def amount(axis: Axis) -> Floats:
            at = np.zeros(count) if axis.coordinate is None else values[axis.coordinate]
            return (at if axis.function is None else axis.function(at))[:, None] * axis.direction

        out = np.tile(np.eye(4), (count, 1, 1))
        for axis in self.rotations:
            out[:, :3, :3] = out[:, :3, :3] @ Rotation.from_rotvec(amount(axis)).as_matrix()
        for axis in self.translations:
            out[:, :3, 3] += amount(axis)
        return self.parent.pose @ out @ np.linalg.inv(self.child.pose)


def read_joint(element: Element, frames: Frames) -> Joint:
    """Reads a joint; one of an unknown kind has no axes, and `Joint.check` raises."""
    parent, child = (frames.of(element, f"socket_{k}_frame") for k in ("parent", "child"))
    held = element.child("coordinates")
    listed = [] if held is None else held.children
    rotations, translations = _axes(element, [c.name for c in listed])
    turning = {a.coordinate for a in rotations}
    coordinates = []
    for c in listed:
        low, high = c.numbers_of("range", (-np.inf, np.inf))
        coordinates.append(Coordinate(c.name, c.number_of("default_value", 0.0), low, high, c.name in turning))
    return Joint(element.tag, element.name, element.where, parent, child, rotations, translations, tuple(coordinates))


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
        if used or function is not None:
            found[axis.name] = Axis(direction / length, used[0] if used else None, function)
    strange = [a.coordinate for a in found.values() if a.coordinate is not None and a.coordinate not in names]
    if strange:
        raise InputError(f"no coordinate {strange[0]!r} in the joint", where=element.where, expected=", ".join(names))

    def of(kind: str) -> tuple[Axis, ...]:
        return tuple(found[f"{kind}{k}"] for k in (1, 2, 3) if f"{kind}{k}" in found)

    return of("rotation"), of("translation")


@dataclass(frozen=True)
class Tree:
    """All joints, by the name of the body that each carries; and the coupled coordinates."""

    joints: dict[str, Joint]
    coupled: dict[str, tuple[str, Function]] = field(default_factory=dict)  # by name: independent coordinate, function

    def coordinates(self) -> dict[str, Coordinate]:
        """All coordinates, by name."""
        return {c.name: c for j in self.joints.values() for c in j.coordinates}

    def values(self, given: dict[str, Floats], count: int) -> dict[str, Floats]:
        """Values (n,) of every coordinate: as given, else its default; coupled ones are computed."""
        out = {n: given.get(n, np.full(count, c.default)) for n, c in self.coordinates().items()}
        for name, (independent, function) in self.coupled.items():
            if name in out and independent in out:
                out[name] = function(out[independent])
        return out

    def pose(self, body: str, values: dict[str, Floats], count: int) -> Floats:
        """Pose (n, 4, 4) of a body in ground; raises InputError if no chain of joints connects it with ground."""
        out, visited = np.tile(np.eye(4), (count, 1, 1)), set()
        while body != GROUND:
            joint = self.joints.get(body)
            if joint is None or body in visited:
                raise InputError(f"no chain of joints connects the body {body!r} with ground", where=body)
            visited.add(body)
            out = joint.pose(values, count) @ out
            body = joint.parent.body
        return out

    def welded(self, body: str) -> tuple[str, Floats]:
        """The body to which this one is rigidly attached, and the pose (4, 4) of this one in it."""
        out, visited = np.eye(4), set()
        while body in self.joints and self.joints[body].kind == "WeldJoint" and body not in visited:
            visited.add(body)
            out = self.joints[body].pose({}, 1)[0] @ out
            body = self.joints[body].parent.body
        return body, out


def read_tree(model: Element, frames: Frames) -> Tree:
    """Reads a model's joints and coupled coordinates. Raises InputError for an incomplete joint or unknown function."""
    elements = [e for holder in model.all("JointSet") for e in holder.needed("objects").children]
    joints = {joint.child.body: joint for joint in (read_joint(e, frames) for e in elements)}
    coupled = {}
    for element in model.all("CoordinateCouplerConstraint"):
        function = function_in(element, "coupled_coordinates_function")
        names = element.words("independent_coordinate_names").split()
        if function is not None and len(names) == 1:
            coupled[element.words("dependent_coordinate_name")] = (names[0], function)
    return Tree(joints, coupled)
