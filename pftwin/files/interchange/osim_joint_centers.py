"""The centres of hip and knee of an OpenSim model, told by the markers of pelvis and tibia, as markers of the femur."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import GROUND, OsimFrame
from pftwin.files.interchange.osim_joints import Joint
from pftwin.files.interchange.osim_knee import OsimKnee, part_and_pose
from pftwin.files.interchange.osim_model import OsimModel
from pftwin.files.interchange.osim_motion import tree_joint
from pftwin.files.mocap import MarkerTrajectories, segment_poses


class Center(NamedTuple):
    """The centre of a joint of the femur, which counts as a marker of it."""

    name: str
    carrier: str  # part whose markers tell where it is
    there: Floats  # (3,) in the carrier's frame [m]
    place: Floats  # (3,) in the femur's frame [m]


def find_centers(model: OsimModel, knee: OsimKnee) -> list[Center]:
    """The centres of hip and knee.

    Raises:
        InputError: a hip that slides, or a knee that is no joint of the femur: such centres are not fixed in it.
    """
    tree = model.tree
    joint, hip = tree.joints[tree_joint(tree, knee.tibia)], tree.joints.get(tree.welded(knee.femur)[0])
    if hip is None or hip.parent.body == GROUND or any(axis.coordinate is not None for axis in hip.translations):
        raise InputError(
            f"{knee.femur!r} hangs on no hip",
            where=f"{model.file}, --joint-centers",
            expected="a joint by which it turns about a point of another body",
        )
    pelvis, there = _joint_point(model, knee, hip)
    part, place = _joint_point(model, knee, joint)
    if part != "femur":
        raise InputError(f"{joint.name!r} hangs on {part!r}", where=joint.where, expected=f"on {knee.femur!r}")
    return [
        Center(f"{hip.name}_center", pelvis, there, _child_point(model, knee, hip)),
        Center(f"{joint.name}_center", "tibia", _child_point(model, knee, joint), place),
    ]


def _joint_point(model: OsimModel, knee: OsimKnee, joint: Joint) -> tuple[str, Floats]:
    """The part that carries a joint, and where the moving frame's origin is in it at the default coordinates [m]."""
    pose = joint.pose(model.tree.values({}, 1), 1)[0] @ joint.child.pose
    part, at = part_and_pose(model, knee, OsimFrame(joint.parent.body, pose))
    return part, at[:3, 3]


def _child_point(model: OsimModel, knee: OsimKnee, joint: Joint) -> Floats:
    return part_and_pose(model, knee, joint.child)[1][:3, 3]


def with_centers(
    markers: MarkerTrajectories, centers: Sequence[Center], clusters: Mapping[str, Mapping[str, Floats]]
) -> MarkerTrajectories:
    """The markers, and the centres among them.

    Raises:
        InputError: markers of a carrier on a line.
    """
    if not centers:
        return markers
    columns = [markers.positions]
    for center in centers:
        poses = segment_poses(markers, clusters[center.carrier], source=f"{markers.source}, {center.carrier}")
        columns.append((poses.positions + poses.matrices() @ center.there)[:, None])
    names = (*markers.names, *(c.name for c in centers))
    return replace(markers, names=names, positions=np.concatenate(columns, axis=1))
