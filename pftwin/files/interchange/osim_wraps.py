"""Converts wrap objects of an OpenSim model to a scene's obstacles: cylinders, spheres and ellipsoids on the bones.

Also computes by how much wrapping lengthens a muscle's path.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element, placed
from pftwin.files.interchange.osim_knee import PARTS, OsimKnee
from pftwin.files.interchange.osim_model import PathWrap, path_wraps

if TYPE_CHECKING:
    from pftwin.geometry.wrapping.obstacle import Obstacle

_HOLDERS = ("Body", "Ground", "PhysicalOffsetFrame")
_ALL = ("all", "unassigned", "")
_SIDES = {f"{sign}{axis}": k * unit for axis, unit in zip("xy", np.eye(3)[:2], strict=True)
          for sign, k in (("", 1.0), ("+", 1.0), ("-", -1.0))}  # fmt: skip


class OsimWrap(NamedTuple):
    """An obstacle on a bone."""

    name: str  # the model's
    kind: str  # "cylinder", "sphere" or "ellipsoid"
    body: str
    numbers: dict[str, Floats]  # other fields of a scene's table `wrap`

    @property
    def like(self) -> tuple[str, ...]:
        """Key that is equal for obstacles that lines of one group can have."""
        return self.kind, self.body, *self.numbers


def of_group(wraps: Sequence[OsimWrap]) -> OsimWrap:
    """Combines the obstacles of a group's lines: a single one if all are equal, else arrays with one for each line."""
    names = dict.fromkeys(w.name for w in wraps)
    if len(names) == 1:
        return wraps[0]
    numbers = {field: np.stack([w.numbers[field] for w in wraps]) for field in wraps[0].numbers}
    return wraps[0]._replace(name=", ".join(names), numbers=numbers)


class Wraps:
    """The wrap objects of a model."""

    def __init__(self, knee: OsimKnee) -> None:
        self.knee = knee
        self.objects: dict[str, Element] = {}
        for holder in knee.model.root.all("WrapObjectSet"):
            for element in holder.objects():
                self.objects.setdefault(element.name, element)

    def over(self, names: Sequence[str]) -> tuple[OsimWrap | None, list[str]]:
        """The obstacle of lines in a scene, and the objects that are left out, with the reasons.

        A line has one obstacle: the first object that is supported. Inactive objects are ignored.
        """
        taken: OsimWrap | None = None
        left = []
        for name in names:
            element = self.objects.get(name)
            if element is None:
                left.append(f"{name} (the model has no such object)")
            elif element.words("active") != "false":
                why = self._why_not(element)
                if not why and taken is not None:
                    why = f"a line runs over one obstacle, here {taken.name}"
                if why:
                    left.append(f"{name} ({why})")
                else:
                    taken = self._obstacle(element)
        return taken, left

    def _why_not(self, element: Element) -> str:
        """Why an object is not supported; empty if it is."""
        side, part = element.words("quadrant").lower(), self._place(element)[0]
        if element.tag not in ("WrapCylinder", "WrapSphere", "WrapEllipsoid"):
            return f"a <{element.tag}>"
        if part not in PARTS:
            return f"on the {part}"
        if side not in _ALL and (element.tag != "WrapCylinder" or side not in _SIDES):
            return f"of its sides only {side}"
        return ""

    def _obstacle(self, element: Element) -> OsimWrap:
        part, pose = self._place(element)
        place = pose @ placed(element, "translation", "xyz_body_rotation")
        at = {"center_m": place[:3, 3]}
        if element.tag == "WrapEllipsoid":
            turn = Rotation.from_matrix(place[:3, :3]).as_quat(scalar_first=True, canonical=True)
            radii = _sizes(element, "dimensions", 3)
            return OsimWrap(element.name, "ellipsoid", part, at | {"radii_m": radii, "quaternion_wxyz": turn})
        at["radius_m"] = _sizes(element, "radius", 1)[0]
        if element.tag == "WrapSphere":
            return OsimWrap(element.name, "sphere", part, at)
        numbers = at | {"axis": place[:3, 2]}
        side = element.words("quadrant").lower()
        if side not in _ALL:
            numbers["side"] = place[:3, :3] @ _SIDES[side]
        return OsimWrap(element.name, "cylinder", part, numbers)

    def _place(self, element: Element) -> tuple[str, Floats]:
        """The part of the knee (or name of another body) that carries the object, and its pose (4, 4) there."""
        holder = element
        while holder.owner is not None and holder.tag not in _HOLDERS:
            holder = holder.owner
        inside = Element("", "", element.file, element.line, owner=holder)
        return self.knee.placed(self.knee.model.frames.find("..", inside))


def _sizes(element: Element, tag: str, count: int) -> Floats:
    """Radii of an object [m]."""
    radii = element.needed(tag).numbers(count)
    if not (radii > 0).all():
        raise InputError(f"<{tag}> is {radii.tolist()}", where=element.where, expected="positive numbers")
    return radii


class Wrap(NamedTuple):
    """An obstacle, and the points of a path between which it is active."""

    part: str  # of the knee that carries it
    obstacle: Obstacle  # in that part's frame
    between: PathWrap

    def adds(self, start: Floats, end: Floats) -> Floats:
        """Additional length (n,) [m] by wrapping of a straight line between points (n, 3) of the part's frame [m]."""
        from pftwin.base.leaves import vector

        around = np.asarray(self.obstacle.around(vector(start), vector(end)).length, dtype=np.float64)
        return np.maximum(around - np.linalg.norm(end - start, axis=-1), 0.0)


def wraps_of(muscle: Element, objects: Wraps) -> tuple[list[Wrap], list[str]]:
    """Obstacles of a muscle's path, and the names of the objects that are left out, with the reasons."""
    found, left = [], []
    for wrap in path_wraps(muscle):
        over, why = objects.over([wrap.name])
        left += why
        if over is not None:
            found.append(Wrap(over.body, _obstacle(over), wrap))
    return found, left


def _obstacle(over: OsimWrap) -> Obstacle:
    """The obstacle in the model's axes."""
    from pftwin.base.leaves import number, vector
    from pftwin.base.spatial import Quaternion
    from pftwin.geometry.wrapping.cylinder import Cylinder
    from pftwin.geometry.wrapping.ellipsoid import Ellipsoid
    from pftwin.geometry.wrapping.sphere import Sphere

    numbers = over.numbers
    center = vector(numbers["center_m"])
    if over.kind == "ellipsoid":
        turn = Quaternion(*(number(v) for v in numbers["quaternion_wxyz"]))
        return Ellipsoid(center, over.body, vector(numbers["radii_m"]), turn)
    if over.kind == "sphere":
        return Sphere(center, over.body, number(numbers["radius_m"]))
    side = vector(numbers["side"]) if "side" in numbers else None
    return Cylinder(center, over.body, number(numbers["radius_m"]), vector(numbers["axis"]), side)
