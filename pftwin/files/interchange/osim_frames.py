"""Frames of an OpenSim model: bodies, ground, offset frames, and where joints put them for given coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import DEEPEST, Element
from pftwin.files.interchange.osim_functions import Function, function_in
from pftwin.files.interchange.osim_joints import Coordinate, Joint, read_joint

Floats = NDArray[np.float64]
GROUND = "ground"


class OsimFrame(NamedTuple):
    """A place fixed in a body."""

    body: str
    pose: Floats  # (4, 4) in the body's frame


class Frames:
    """Finds the frame that a socket names."""

    def __init__(self, model: Element) -> None:
        self.bodies = {b.name for b in model.all("Body")}
        self.offsets = list(model.all("PhysicalOffsetFrame"))

    def find(self, path: str, near: Element, where: str, depth: int = 0) -> OsimFrame:
        """By the last part of a path: a frame of this very element, a body, ground, or a frame elsewhere.

        A path may begin with ".." for what the element is part of, as meshes and frames in a body's components do.

        Args:
            path: as the socket has it.
            near: the element that has the socket.
            where: of the socket, for messages.
            depth: of frames that hang on frames so far.

        Raises:
            InputError: nothing is called so.
        """
        steps = path.strip().split("/")
        while steps[:1] == [".."] and near.owner is not None:
            near, steps = near.owner, steps[1:]
        if not steps:
            return self._of(near, depth)
        name = steps[-1]
        own = [f for f in near.all("PhysicalOffsetFrame") if f.name == name]
        if own:
            return self._offset(own[0], depth)
        if name == GROUND or name in self.bodies:
            return OsimFrame(name, np.eye(4))
        others = [f for f in self.offsets if f.name == name]
        if not others:
            raise InputError(f"no body and no frame is called {path.strip()!r}", where=where)
        return self._offset(others[0], depth)

    def _of(self, element: Element, depth: int) -> OsimFrame:
        """Of an element that is a frame itself."""
        if element.tag == "PhysicalOffsetFrame":
            return self._offset(element, depth)
        if element.tag in ("Body", "Ground"):
            return OsimFrame(GROUND if element.tag == "Ground" else element.name, np.eye(4))
        raise InputError(f"<{element.tag}> {element.name!r} is no frame", where=element.where)

    def _offset(self, element: Element, depth: int) -> OsimFrame:
        place = np.eye(4)
        for tag, part in (("translation", 0), ("orientation", 1)):
            found = element.child(tag)
            if found is not None and part == 0:
                place[:3, 3] = found.numbers(3)
            elif found is not None:
                place[:3, :3] = Rotation.from_euler("XYZ", found.numbers(3)).as_matrix()
        if depth > DEEPEST:
            raise InputError(f"the frame {element.name!r} hangs on itself", where=element.where)
        parent = element.needed("socket_parent").text
        # A name alone is never that of a frame within this one: it would hang on what hangs on it.
        near = element if parent.strip().startswith("..") else Element("", "", element.file, element.line)
        base = self.find(parent, near, element.where, depth + 1)
        return OsimFrame(base.body, base.pose @ place)


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
