"""What of an OpenSim model does not go into a scene, and why."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pftwin.files.interchange.osim_document import Element, Frames
from pftwin.files.interchange.osim_knee import OsimKnee, placed
from pftwin.files.interchange.osim_model import CONTACT, LIGAMENT, SURFACE, LeftOut, OsimModel

_SETS = {
    "ControllerSet": "a scene has no controllers",
    "ProbeSet": "results report what effects do by themselves",
    "MarkerSet": "a scene's motion comes from coordinates; markers go into [motion] of a scene file of one's own",
    "ConstraintSet": "the bones' motion is prescribed",
}
_READ = (LIGAMENT, CONTACT, "CoordinateCouplerConstraint")


def rest(root: Element, model: OsimModel, knee: OsimKnee) -> Iterator[LeftOut]:
    """Everything that nobody has read, in the file's order."""
    frames = Frames(root)
    for group in root.children:
        held = group.child("objects")
        if held is None:
            continue
        if group.tag == "ForceSet":
            for force in held.children:
                if force.tag not in _READ:
                    yield LeftOut(force.tag, force.name, _why(force, model, knee, frames))
        elif group.tag == "ContactGeometrySet":
            for surface in held.children:
                if surface.tag != SURFACE:
                    yield LeftOut(surface.tag, surface.name, f"only <{SURFACE}> is read")
        elif group.tag in _SETS:
            for part in held.children:
                if part.tag not in _READ:
                    yield LeftOut(part.tag, part.name, _SETS[group.tag])


def _why(force: Element, model: OsimModel, knee: OsimKnee, frames: Frames) -> str:
    """For what pulls at the patella: where, so that the user can put it into the scene."""
    points = list(force.all("PathPoint"))
    if force.tag == "Ligament" or not points:
        return f"pftwin has no effect like <{force.tag}>"
    at = []
    for p in points:
        frame = frames.find(p.needed("socket_parent_frame").text, p, p.where)
        part, pose = placed(model, knee, frame)
        at.append((part, pose[:3, :3] @ p.needed("location").numbers(3) + pose[:3, 3]))
    parts = [part for part, _ in at]
    if "patella" not in parts:
        return "it does not pull at the patella; the bones' motion is prescribed"
    k = parts.index("patella")
    other = next((j for j in (k - 1, k + 1) if 0 <= j < len(at) and parts[j] != "patella"), None)
    if other is None:
        return "it leads along the patella alone"
    ends = f"insertion_m = {_point(at[k][1])}, origin_m = {_point(at[other][1])} on the {parts[other]}"
    return f"how strongly it pulls is a matter of its activation: give its tension in [[prescribed_tension]]; {ends}"


def _point(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{v:.6g}" for v in values) + "]"
