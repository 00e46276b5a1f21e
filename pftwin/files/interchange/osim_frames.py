"""Frames of an OpenSim model: bodies, ground, and what is fixed in them at an offset."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import DEEPEST, Element

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
