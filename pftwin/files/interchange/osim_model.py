"""Reads the parts of an OpenSim model that pftwin can use: bodies, joints, two-point ligaments, contact meshes.

Missing values have OpenSim's defaults. Unsupported ligaments are listed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element, Frames, OsimFrame, placed
from pftwin.files.interchange.osim_joints import Tree, read_tree

LIGAMENT = "Blankevoort1991Ligament"
SURFACE = "Smith2018ContactMesh"
CONTACT = "Smith2018ArticularContactForce"


class LeftOut(NamedTuple):
    """A part of the model that was not imported, and why."""

    kind: str
    name: str
    why: str


class OsimLigament(NamedTuple):
    """A strand between two points."""

    name: str
    ends: tuple[tuple[OsimFrame, Floats], tuple[OsimFrame, Floats]]
    stiffness: float  # [N per strain]
    slack_length: float  # [m]
    toe_strain: float
    damping_time: float  # [s]
    wraps: tuple[str, ...]  # names of the objects that its path wraps over


def _ligaments(
    model: Element, defaults: dict[str, Element], frames: Frames, left: list[LeftOut]
) -> Iterator[OsimLigament]:
    """Ligaments with two points; the others are added to `left`."""
    for element in model.all(LIGAMENT):
        if element.words("appliesForce") == "false":
            left.append(LeftOut(LIGAMENT, element.name, "it is switched off in the model"))
            continue
        points = list(element.all("PathPoint", "ConditionalPathPoint", "MovingPathPoint"))
        if len(points) != 2 or any(p.tag != "PathPoint" for p in points):
            why = f"its path has {len(points)} points, some of them may move: only straight lines between two are taken"
            left.append(LeftOut(LIGAMENT, element.name, why))
            continue
        start, end = ((frames.of(p), p.needed("location").numbers(3)) for p in points)
        wraps = tuple(w.name for w in path_wraps(element) if w.covers(0, 1))
        own = {"linear_stiffness": 1.0, "slack_length": 0.0, "transition_strain": 0.06, "damping_coefficient": 0.003}
        k, slack, toe, damping = (element.number_of(t, v, defaults.get(LIGAMENT)) for t, v in own.items())
        if not (k > 0 and slack > 0 and toe > 0 and damping >= 0):
            found = f"stiffness {k:g} N, slack length {slack:g} m, transition strain {toe:g}, damping {damping:g} s"
            raise InputError(found, where=element.where, expected="positive numbers")
        yield OsimLigament(element.name, (start, end), k, slack, toe, damping, wraps)


class PathWrap(NamedTuple):
    """An object over which a path may wrap, and the range of the path's points, counted from 0."""

    name: str
    first: int
    last: float  # infinite: to the path's end

    def covers(self, start: int, end: int) -> bool:
        """Whether the path may wrap over the object between two of its points."""
        return self.first <= start and end <= self.last


def path_wraps(force: Element) -> Iterator[PathWrap]:
    """Wrap objects of a force's path; raises InputError if a range is not two numbers."""
    for wrap in force.all("PathWrap"):
        start, end = wrap.numbers_of("range", (-1.0, -1.0))  # counted from 1; below 1: the path's end
        yield PathWrap(wrap.words("wrap_object"), max(int(start), 1) - 1, int(end) - 1 if end >= 1 else math.inf)


class Mesh(NamedTuple):
    """A mesh's file, with its frame and scale."""

    name: str
    file: str
    frame: OsimFrame
    scale: Floats  # (3,)
    where: str


class Body(NamedTuple):
    """A body's mass properties and meshes."""

    name: str
    mass: float  # [kg]
    center: Floats  # (3,) [m]
    inertia: Floats  # (6,) xx, yy, zz, xy, xz, yz about the centre of mass [kg m^2]
    meshes: tuple[Mesh, ...]
    where: str


class ContactSurface(NamedTuple):
    """An elastic layer on a mesh."""

    mesh: Mesh
    modulus: float  # [Pa]
    poisson: float
    thickness: float  # [m]
    variable: bool  # whether the thickness varies, as the distance to a second mesh


class OsimContact(NamedTuple):
    """A contact between two surfaces."""

    name: str
    surfaces: tuple[str, str]
    law: str  # "linear" or "logarithmic"
    lumped: bool


@dataclass(frozen=True)
class OsimModel:
    """The usable parts of a model, and a list of parts that are left out."""

    root: Element
    frames: Frames
    gravity: Floats  # (3,) in ground [m/s^2]
    bodies: dict[str, Body]
    tree: Tree
    ligaments: list[OsimLigament]
    surfaces: dict[str, ContactSurface]
    contacts: list[OsimContact]
    left_out: list[LeftOut]


def class_defaults(root: Element) -> dict[str, Element]:
    """Elements of a model's <defaults>, by class."""
    return {d.tag: d for holder in root.children if holder.tag == "defaults" for d in holder.children}


def read_model(root: Element) -> OsimModel:
    """Reads the usable parts of a <Model>; raises InputError for missing or invalid values."""
    frames, left = Frames(root), []
    defaults = class_defaults(root)
    used = Element(root.tag, root.name, root.file, root.line, "", [c for c in root.children if c.tag != "defaults"])
    return OsimModel(
        root,
        frames,
        root.numbers_of("gravity", (0.0, -9.80665, 0.0)),
        {b.name: _body(b, frames) for b in used.all("Body")},
        read_tree(used, frames),
        list(_ligaments(used, defaults, frames, left)),
        {s.name: _surface(s, defaults.get(SURFACE), frames) for s in used.all(SURFACE)},
        [_contact(c) for c in used.all(CONTACT) if c.words("appliesForce") != "false"],
        left,
    )


def _body(element: Element, frames: Frames) -> Body:
    meshes = tuple(
        _mesh(m, m.name or element.name, frames.find(m.words("socket_frame") or "..", m)) for m in element.all("Mesh")
    )
    mass, center = element.number_of("mass", 0.0), element.numbers_of("mass_center", (0.0,) * 3)
    return Body(element.name, mass, center, element.numbers_of("inertia", (0.0,) * 6), meshes, element.where)


def _mesh(element: Element, name: str, frame: OsimFrame) -> Mesh:
    """The mesh that an element refers to, in a frame."""
    scale = element.numbers_of("scale_factors", (1.0, 1.0, 1.0))
    return Mesh(name, element.words("mesh_file"), frame, scale, element.where)


def _surface(element: Element, otherwise: Element | None, frames: Frames) -> ContactSurface:
    base = frames.of(element, "socket_frame")
    mesh = _mesh(element, element.name, OsimFrame(base.body, base.pose @ placed(element, "location")))
    own = {"elastic_modulus": 1e6, "poissons_ratio": 0.5, "thickness": 0.005}
    modulus, poisson, thickness = (element.number_of(tag, value, otherwise) for tag, value in own.items())
    return ContactSurface(mesh, modulus, poisson, thickness, element.words("use_variable_thickness") == "true")


def _contact(element: Element) -> OsimContact:
    target, casting = (
        element.needed(f"socket_{k}_mesh").text.strip().rpartition("/")[2] for k in ("target", "casting")
    )
    law = "logarithmic" if element.words("elastic_foundation_formulation") == "nonlinear" else "linear"
    return OsimContact(element.name, (target, casting), law, element.words("use_lumped_contact_model") != "false")


def valid_name(name: str) -> str:
    """Converts a name to one that is valid in a scene file, in lower case."""
    words = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_").lower()
    return words if words[:1].isalpha() else f"part_{words}"


def loose_name(name: str) -> str:
    """A name without dots, underscores, blanks, hyphens and case, in which files of one subject often differ."""
    return re.sub(r"[._\s-]", "", name).casefold()
