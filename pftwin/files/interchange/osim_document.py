"""Parses OpenSim's XML files: elements with their line numbers, and the frames that they refer to.

Files are untrusted: a document with a DOCTYPE is rejected, so that no entities can be declared, expanded or fetched,
and so is one that is nested deeper than any model. Frames are bodies, ground, and frames fixed in them at an offset.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import MODEL_BYTES, read_bytes

DEEPEST = 64  # largest nesting depth; models have about a dozen levels
MOST_ELEMENTS = 200_000  # a whole-body model has some 25,000, 8,000 per megabyte
OLDEST = 40000  # oldest supported file version: OpenSim 4


@dataclass(slots=True)
class Element:
    """An XML element with its text and children."""

    tag: str
    name: str
    file: str
    line: int
    text: str = ""
    children: list[Element] = field(default_factory=list)
    # The nearest enclosing element with a name (wrappers such as <components> have none): ".." in OpenSim's paths.
    owner: Element | None = field(default=None, repr=False, compare=False)

    @property
    def where(self) -> str:
        """File and line, for messages."""
        return f"{self.file}, line {self.line}"

    def child(self, *tags: str) -> Element | None:
        """The first child of one of these tags."""
        return next((c for c in self.children if c.tag in tags), None)

    def needed(self, tag: str) -> Element:
        """The child with a tag; raises InputError if there is none."""
        found = self.child(tag)
        if found is None:
            raise InputError(f"<{self.tag}> {self.name!r} has no <{tag}>", where=self.where)
        return found

    def all(self, *tags: str) -> Iterator[Element]:
        """All descendants with one of these tags, in the file's order."""
        for c in self.children:
            if c.tag in tags:
                yield c
            yield from c.all(*tags)

    def words(self, tag: str) -> str:
        """Stripped text of a child; empty if there is no such child."""
        found = self.child(tag)
        return "" if found is None else found.text.strip()

    def numbers(self, count: int | None = None) -> NDArray[np.float64]:
        """The text as finite numbers; raises InputError if it is not, or if their count is not `count`."""
        try:
            values = np.array([float(w) for w in self.text.split()])
        except ValueError:
            values = np.array([np.nan])
        if not np.isfinite(values).all() or (count is not None and values.size != count):
            wanted = "finite numbers" if count is None else f"{count} finite number{'s' if count > 1 else ''}"
            raise InputError(f"<{self.tag}> is {self.text.strip()[:60]!r}", where=self.where, expected=wanted)
        return values

    def numbers_of(self, tag: str, default: Sequence[float], otherwise: Element | None = None) -> Floats:
        """Numbers of a child, as many as in the default, which is returned if there is no such child.

        If this element lacks the child, that of `otherwise` is used: the element with the class's defaults.
        """
        found = self.child(tag) or (otherwise and otherwise.child(tag))
        return np.array(default) if found is None else found.numbers(len(default))

    def number_of(self, tag: str, default: float, otherwise: Element | None = None) -> float:
        """Like `numbers_of`, for one number."""
        return float(self.numbers_of(tag, [default], otherwise)[0])

    def objects(self) -> list[Element]:
        """Children of its <objects>, in which OpenSim's sets store their parts; empty if it has none."""
        held = self.child("objects")
        return [] if held is None else held.children


def read_osim(path: str | os.PathLike[str]) -> Element:
    """Reads the <Model> of an OpenSim 4 file.

    Raises InputError as `read_xml`, for no model, and for an older version.
    """
    root = read_xml(path)
    if root.tag != "OpenSimDocument":
        raise InputError(f"the document is a <{root.tag}>", where=root.where, expected="an <OpenSimDocument>")
    version = root.name
    if not (version.isdecimal() and len(version) < 10 and int(version) >= OLDEST):
        found = f"version {version[:20] or 'unknown'}"
        expected = f"{OLDEST} or later, as OpenSim 4 writes"
        raise InputError(found, where=root.where, expected=expected, remedy="open the model in OpenSim 4 and save it")
    return root.needed("Model")


def read_xml(path: str | os.PathLike[str]) -> Element:
    """Reads an XML file and returns its root element.

    Raises InputError for no such file, invalid XML (naming the line), a DOCTYPE, and too many or too deeply nested
    elements.
    """
    content, file = read_bytes(path, max_bytes=MODEL_BYTES), str(path)
    parser = expat.ParserCreate()
    top = Element("", "", file, 1)
    open_ones = [top]
    texts: list[list[str]] = [[]]  # of the open elements; the parser may deliver text in pieces
    count = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(open_ones) > DEEPEST or count > MOST_ELEMENTS:
            found = f"more than {MOST_ELEMENTS:,}" if count > MOST_ELEMENTS else f"nested deeper than {DEEPEST}"
            raise InputError(f"{found} elements", where=f"{file}, line {parser.CurrentLineNumber}")
        name = attributes.get("Version" if tag == "OpenSimDocument" else "name", "")
        around = open_ones[-1]
        made = Element(tag, name, file, parser.CurrentLineNumber, owner=around if around.name else around.owner)
        open_ones[-1].children.append(made)
        open_ones.append(made)
        texts.append([])

    def end(_: str) -> None:
        open_ones.pop().text = "".join(texts.pop())

    def said(text: str) -> None:
        texts[-1].append(text)

    def refuse(*_: Any) -> None:
        raise InputError(
            "it declares a DOCTYPE", where=f"{file}, line {parser.CurrentLineNumber}", expected="a model without one"
        )

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = begin, end, said
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.buffer_text = True
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        words = expat.ErrorString(error.code)
        raise InputError(f"no valid XML: {words}", where=f"{file}, line {error.lineno}") from None
    except InputError:
        raise
    except (LookupError, ValueError) as error:  # from the encoding declared in the first line
        raise InputError(f"no readable XML: {error}", where=file, expected="UTF-8") from None
    return top.children[0]


GROUND = "ground"


class OsimFrame(NamedTuple):
    """A frame fixed in a body."""

    body: str
    pose: Floats  # (4, 4) in the body's frame


def placed(element: Element, translation: str, rotation: str = "orientation") -> Floats:
    """Pose (4, 4) from an element's translation [m] and body-fixed angles [rad], which have these tags."""
    pose = np.eye(4)
    pose[:3, 3] = element.numbers_of(translation, (0.0, 0.0, 0.0))
    pose[:3, :3] = Rotation.from_euler("XYZ", element.numbers_of(rotation, (0.0, 0.0, 0.0))).as_matrix()
    return pose


class Frames:
    """Resolves the frames that sockets refer to."""

    def __init__(self, model: Element) -> None:
        self.bodies = {b.name for b in model.all("Body")}
        self.offsets = list(model.all("PhysicalOffsetFrame"))

    def knows(self, name: str) -> bool:
        """Whether there is a body, ground or a frame of this name."""
        return name == GROUND or name in self.bodies or any(f.name == name for f in self.offsets)

    def of(self, element: Element, socket: str = "socket_parent_frame") -> OsimFrame:
        """The frame that an element's socket refers to, see `find`; raises InputError if there is no such socket."""
        return self.find(element.needed(socket).text, element)

    def find(self, path: str, near: Element, depth: int = 0) -> OsimFrame:
        """The frame named by the last part of a socket's path: in this element, a body, ground, or a frame elsewhere.

        A path may start with ".." for the owner of `near`, the element with the socket, as for meshes and frames in a
        body's components. `depth` is the number of frames followed so far, each fixed in the next. Raises InputError
        for an unknown name.
        """
        where, steps = near.where, path.strip().split("/")
        while steps[:1] == [".."] and near.owner is not None:
            near, steps = near.owner, steps[1:]
        if not steps:
            return self._of(near, depth)
        name = steps[-1]
        own = [f for f in near.all("PhysicalOffsetFrame") if f.name == name]
        if not own and (name == GROUND or name in self.bodies):
            return OsimFrame(name, np.eye(4))
        found = own or [f for f in self.offsets if f.name == name]
        if not found:
            raise InputError(f"no body and no frame is called {path.strip()!r}", where=where)
        return self._of(found[0], depth)

    def _of(self, element: Element, depth: int) -> OsimFrame:
        """The frame that an element defines."""
        if element.tag in ("Body", "Ground"):
            return OsimFrame(GROUND if element.tag == "Ground" else element.name, np.eye(4))
        if element.tag != "PhysicalOffsetFrame":
            raise InputError(f"<{element.tag}> {element.name!r} is no frame", where=element.where)
        place = placed(element, "translation")
        if depth > DEEPEST:
            raise InputError(f"the frame {element.name!r} is attached to itself", where=element.where)
        parent = element.needed("socket_parent").text
        # A plain name never refers to a frame inside this one, which would be circular.
        near = element if parent.strip().startswith("..") else Element("", "", element.file, element.line)
        base = self.find(parent, near, depth + 1)
        return OsimFrame(base.body, base.pose @ place)
