"""All joints of an OpenSim model: where its bodies are in ground, for given coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_frames import GROUND, Frames
from pftwin.files.interchange.osim_functions import Function, function_in
from pftwin.files.interchange.osim_joints import Coordinate, Joint, read_joint

Floats = NDArray[np.float64]


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
