"""Markers of an OpenSim model: their positions on its bodies, and their names in a recording.

They are read from the model's <MarkerSet>, or from a separate file as OpenSim 3 and 4 write it. The hip and knee
centres, determined from the markers of pelvis and tibia, can be used as markers of the femur.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import refuse_repeated
from pftwin.files.interchange.osim_document import GROUND, Element, OsimFrame, read_xml
from pftwin.files.interchange.osim_joints import Joint
from pftwin.files.interchange.osim_knee import OsimKnee
from pftwin.files.interchange.osim_model import LeftOut, loose_name
from pftwin.files.interchange.osim_motion import tree_joint
from pftwin.files.mocap import MarkerTrajectories, segment_poses

_FRAMES = ("socket_parent_frame", "body")  # in OpenSim 4 and 3
SAMPLE = 8  # largest number of names in a message


class OsimMarker(NamedTuple):
    """A marker of a model."""

    name: str
    part: str  # of the knee: "femur", "tibia", "patella"; or the model's name of another body
    place: Floats  # (3,) in its frame [m]


def markers_of(knee: OsimKnee, path: str | os.PathLike[str] | None, left: list[LeftOut]) -> list[OsimMarker]:
    """Markers of a marker file or, without one, of the model; those on unknown bodies are added to `left`.

    Raises InputError for a file without a <MarkerSet>, a marker without a body or a location, and a repeated name.
    """
    root = knee.model.root
    holder = root.child("MarkerSet") if path is None else _marker_set(path)
    elements = [] if holder is None else list(holder.all("Marker"))
    refuse_repeated([e.name for e in elements], "markers", where=root.file if path is None else path)
    return list(_placed(elements, knee, left))


def _marker_set(path: str | os.PathLike[str]) -> Element:
    """The <MarkerSet> of a file."""
    document = read_xml(path)
    found = document if document.tag == "MarkerSet" else document.child("MarkerSet")
    if found is None:
        raise InputError(f"the document is a <{document.tag}>", where=document.where, expected="a <MarkerSet>")
    if next(found.all("Marker"), None) is None:
        raise InputError("a <MarkerSet> without a <Marker>", where=found.where, expected="markers")
    return found


def _placed(elements: Sequence[Element], knee: OsimKnee, left: list[LeftOut]) -> Iterator[OsimMarker]:
    frames = knee.model.frames
    for element in elements:
        held = element.child(*_FRAMES)
        if held is None:
            raise InputError(f"<Marker> {element.name!r} has no <{_FRAMES[0]}>", where=element.where)
        location = element.needed("location").numbers(3)
        if frames.knows(held.text.strip().rpartition("/")[2]):
            yield OsimMarker(element.name, *knee.point(frames.find(held.text, element), location))
        else:  # for instance in a marker file for another model
            left.append(LeftOut("Marker", element.name, f"no body and no frame is called {held.text.strip()!r}"))


def recorded_names(markers: Sequence[OsimMarker], recorded: Sequence[str], where: str) -> dict[str, str]:
    """Maps the model's marker names to those of a recording; markers that are not recorded are omitted.

    Names are matched exactly, else ignoring dots, underscores, blanks, hyphens and case. Raises InputError for
    ambiguous names, and if none matches.
    """
    alike: dict[str, list[str]] = {}
    for name in recorded:
        alike.setdefault(loose_name(name), []).append(name)
    found: dict[str, str] = {}
    meant: dict[str, str] = {}
    for marker in markers:
        names = [marker.name] if marker.name in recorded else alike.get(loose_name(marker.name), [])
        if len(names) > 1:
            several = f"{marker.name!r} of the model may be {' or '.join(map(repr, names))}"
            raise InputError(several, where=where, expected="one")
        for name in names:
            if meant.setdefault(name, marker.name) != marker.name:
                both = f"{meant[name]!r} and {marker.name!r} of the model may both be {name!r}"
                raise InputError(both, where=where, expected="names that differ by more than dots and blanks")
            found[marker.name] = name
    if not found:
        model, there = (", ".join(names[:SAMPLE]) for names in ([m.name for m in markers], list(recorded)))
        raise InputError(
            f"none of the model's markers ({model or 'it has none'})",
            where=where,
            expected=f"markers of the model's names; the recording has {there}",
            remedy="--markers FILE.xml with the marker set of this recording",
        )
    return found


class Center(NamedTuple):
    """The centre of a joint of the femur, used as a marker of the femur."""

    name: str
    carrier: str  # part whose markers determine the position
    there: Floats  # (3,) in the carrier's frame [m]
    place: Floats  # (3,) in the femur's frame [m]


def find_centers(knee: OsimKnee) -> list[Center]:
    """Finds the centres of hip and knee.

    Raises InputError for a centre that is not fixed in the femur: a hip with translations, or a knee of another body.
    """
    tree = knee.model.tree
    joint, hip = tree.joints[tree_joint(tree, knee.tibia)], tree.joints.get(tree.welded(knee.femur)[0])
    if hip is None or hip.parent.body == GROUND or any(axis.coordinate is not None for axis in hip.translations):
        raise InputError(
            f"{knee.femur!r} is attached to no hip joint",
            where=f"{knee.model.root.file}, --joint-centers",
            expected="a joint by which it turns about a point of another body",
        )

    def carrier_and_origin(joint: Joint) -> tuple[str, Floats]:
        """The part that carries a joint, and the moving frame's origin in it at the default coordinates."""
        pose = joint.pose(tree.values({}, 1), 1)[0] @ joint.child.pose
        return knee.point(OsimFrame(joint.parent.body, pose), np.zeros(3))

    pelvis, there = carrier_and_origin(hip)
    part, place = carrier_and_origin(joint)
    if part != "femur":
        raise InputError(f"{joint.name!r} is attached to {part!r}", where=joint.where, expected=f"on {knee.femur!r}")
    in_femur, in_tibia = (knee.point(j.child, np.zeros(3))[1] for j in (hip, joint))
    return [
        Center(f"{hip.name}_center", pelvis, there, in_femur),
        Center(f"{joint.name}_center", "tibia", in_tibia, place),
    ]


def with_centers(
    markers: MarkerTrajectories, centers: Sequence[Center], clusters: Mapping[str, Mapping[str, Floats]]
) -> MarkerTrajectories:
    """Adds the centres to the markers; raises InputError if a carrier's markers are collinear."""
    if not centers:
        return markers
    columns = [markers.positions]
    for center in centers:
        poses = segment_poses(markers, clusters[center.carrier], source=f"{markers.source}, {center.carrier}")
        columns.append((poses.positions + poses.matrices() @ center.there)[:, None])
    names = (*markers.names, *(c.name for c in centers))
    return replace(markers, names=names, positions=np.concatenate(columns, axis=1))
