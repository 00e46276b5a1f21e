"""Markers of an OpenSim model: where they sit on its bodies, and what a recording calls them.

They stand in the model's own <MarkerSet>, or in a file of one as OpenSim 3 and 4 write it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import refuse_repeated
from pftwin.files.interchange.osim_document import Element, Frames, OsimFrame, read_xml
from pftwin.files.interchange.osim_knee import OsimKnee, part_and_pose
from pftwin.files.interchange.osim_model import LeftOut, OsimModel

_FRAMES = ("socket_parent_frame", "body")  # of OpenSim 4 and 3
SAMPLE = 8  # names in a message


class OsimMarker(NamedTuple):
    """A marker of a model."""

    name: str
    part: str  # of the knee: "femur", "tibia", "patella"; or the model's name for another body
    place: Floats  # (3,) in its frame [m]


def markers_of(
    root: Element, model: OsimModel, knee: OsimKnee, path: str | os.PathLike[str] | None, left: list[LeftOut]
) -> list[OsimMarker]:
    """The markers of a marker file, else of the model; those on bodies that the model lacks are left out.

    Args:
        root: the model's document.
        model: what was read of it.
        knee: its bodies. What is welded to one of them counts as part of it.
        path: of a marker file; None: the model's own markers.
        left: gets what is left out.

    Raises:
        InputError: a file that is no <MarkerSet>; a marker without a body or a location; two of one name.
    """
    holder = root.child("MarkerSet") if path is None else marker_set(path)
    elements = [] if holder is None else list(holder.all("Marker"))
    refuse_repeated([e.name for e in elements], "markers", where=root.file if path is None else path)
    return list(_placed(elements, Frames(root), model, knee, left))


def marker_set(path: str | os.PathLike[str]) -> Element:
    """The <MarkerSet> of a file.

    Raises:
        InputError: as `read_xml`; a document of something else, or without markers.
    """
    document = read_xml(path)
    found = document if document.tag == "MarkerSet" else document.child("MarkerSet")
    if found is None:
        raise InputError(f"the document is a <{document.tag}>", where=document.where, expected="a <MarkerSet>")
    if next(found.all("Marker"), None) is None:
        raise InputError("a <MarkerSet> without a <Marker>", where=found.where, expected="markers")
    return found


def _placed(
    elements: Sequence[Element], frames: Frames, model: OsimModel, knee: OsimKnee, left: list[LeftOut]
) -> Iterator[OsimMarker]:
    for element in elements:
        held = element.child(*_FRAMES)
        if held is None:
            raise InputError(f"<Marker> {element.name!r} has no <{_FRAMES[0]}>", where=element.where)
        location = element.needed("location").numbers(3)
        frame = _frame(held, element, frames)
        if frame is None:
            left.append(LeftOut("Marker", element.name, f"no body and no frame is called {held.text.strip()!r}"))
            continue
        part, pose = part_and_pose(model, knee, frame)
        yield OsimMarker(element.name, part, pose[:3, :3] @ location + pose[:3, 3])


def _frame(held: Element, marker: Element, frames: Frames) -> OsimFrame | None:
    """None where the model has nothing of that name, as in a marker file that was written for another model."""
    name = held.text.strip().rpartition("/")[2]
    if not frames.knows(name):
        return None
    return frames.find(held.text, marker, marker.where)


def recorded_names(markers: Sequence[OsimMarker], recorded: Sequence[str], where: str) -> dict[str, str]:
    """What a recording calls the markers, by the model's names; those that it does not have are left out.

    A name is looked for as it stands, then without regard to dots, underscores, blanks, hyphens and capital letters.

    Raises:
        InputError: several of the recording may be meant, or one by several of the model's; none at all.
    """
    alike: dict[str, list[str]] = {}
    for name in recorded:
        alike.setdefault(_plain(name), []).append(name)
    found: dict[str, str] = {}
    for marker in markers:
        names = [marker.name] if marker.name in recorded else alike.get(_plain(marker.name), [])
        if len(names) > 1:
            raise InputError(
                f"{marker.name!r} of the model may be {' or '.join(map(repr, names))}", where=where, expected="one"
            )
        found |= dict.fromkeys([marker.name], names[0]) if names else {}
    meant: dict[str, str] = {}
    for own, theirs in found.items():
        if theirs in meant:
            both = f"{meant[theirs]!r} and {own!r} of the model may both be {theirs!r}"
            raise InputError(both, where=where, expected="names that differ by more than dots and blanks")
        meant[theirs] = own
    if not found:
        model, there = (", ".join(names[:SAMPLE]) for names in ([m.name for m in markers], list(recorded)))
        raise InputError(
            f"none of the model's markers ({model or 'it has none'})",
            where=where,
            expected=f"markers of the model's names; the recording has {there}",
            remedy="--markers FILE.xml with the marker set of this recording",
        )
    return found


def _plain(name: str) -> str:
    return re.sub(r"[._\s-]", "", name).casefold()
