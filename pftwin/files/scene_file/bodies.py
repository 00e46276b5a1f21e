"""The patella as a body, where it starts, and the guided motion of femur and tibia."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.files.mocap import PoseSeries
from pftwin.files.mocap.jumps import in_words, jumps
from pftwin.files.scene_file.recording import SegmentRecording
from pftwin.files.scene_file.section import Point, Positive, Section
from pftwin.files.scene_file.segments import PoseSection, SegmentSection
from pftwin.files.scene_file.side import HostPose, Side
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody


class StartSection(SegmentSection):
    """The patella's pose at the first frame, near which the equilibrium is looked for."""

    relative_to: Literal["world", "femur"] = Field(default="world", description="frame in which a fixed start is given")


class PatellaSection(Section):
    """The patella as a rigid body."""

    mass_kg: Positive = Field(description="mass of the patella [kg]")
    inertia_kg_m2: list[Positive] = Field(
        min_length=3, max_length=3, description="principal moments about the centre of mass, patella axes [kg m^2]"
    )
    center_of_mass_m: Point = Field(default=[0.0, 0.0, 0.0], description="centre of mass, patella frame [m]")
    start: StartSection = Field(description="table: the patella's pose at the first frame")

    def body(self, side: Side) -> PatellaBody:
        """The patella as a scene holds it."""
        center = vector(side.points("patella", self.center_of_mass_m))
        return PatellaBody(number(self.mass_kg), vector(side.moments(self.inertia_kg_m2)), center)


class FemurSection(SegmentSection):
    """The femur; fixed at the world's origin by default."""

    fixed: PoseSection | None = Field(default=None, description="pose in the world of a femur that does not move")


class TibiaSection(SegmentSection):
    """The tibia, guided by the recording."""


def guided_motion(
    femur: SegmentSection, tibia: TibiaSection, recording: SegmentRecording, side: Side
) -> tuple[KneeMotion, HostPose | None, PoseSeries | None]:
    """The motion; the fixed femur's pose in the world or None; the moving femur's poses or None (mirrored)."""
    document = recording.document
    if tibia.fixed is not None:
        raise InputError(
            "the tibia is fixed",
            where=document.where("tibia", "fixed"),
            expected="a recording: the run goes through its frames",
            remedy="a file of poses with one pose in every frame",
        )
    thigh, shin = recording.bones()
    shin = side.poses("world", "tibia", shin)
    if thigh is None:
        assert femur.fixed is not None
        fixed = side.pose("world", "femur", femur.fixed.pose())
        with document.naming("tibia"):
            return KneeMotion.from_poses(fixed.pose(), shin), fixed, None
    thigh = side.poses("world", "femur", thigh)
    with document.naming("motion"):
        return KneeMotion.from_poses(thigh, shin), None, thigh


def start_pose(
    start: StartSection,
    recording: SegmentRecording,
    side: Side,
    motion: KneeMotion,
    fixed_femur: HostPose | None,
    femur: PoseSeries | None,
) -> HostPose:
    """The patella's start in the scene's world (the femur's frame where the femur is fixed)."""
    if start.fixed is not None and start.relative_to == "femur":
        relative = side.pose("femur", "patella", start.fixed.pose())
        return relative if femur is None else HostPose.of(femur.positions[0], femur.quaternions[0]) @ relative
    if start.fixed is not None:
        world = side.pose("world", "patella", start.fixed.pose())
    else:
        world = _first_pose(side.poses("world", "patella", recording.poses(start, "patella", "start")), motion, femur)
    return world if fixed_femur is None else fixed_femur.inverse() @ world


def _first_pose(poses: PoseSeries, motion: KneeMotion, femur: PoseSeries | None) -> HostPose:
    if abs(poses.times[0] - motion.start_time) > 0.1 * motion.frame_interval:
        raise InputError(
            f"the patella's first pose is at {poses.times[0]:g} s, the motion starts at {motion.start_time:g} s",
            where=poses.source,
            expected="the same first frame",
        )
    if (odd := jumps(poses if femur is None else poses.relative_to(femur)))[0]:
        raise InputError(
            f"the patella jumps from its first pose to where most others are ({in_words(odd)} out of line)",
            where=poses.source,
            expected="a start where the patella was",
            remedy=f"start_time_s = {poses.times[np.argmin(odd)]:g} in [motion]; or start = {{ fixed = ... }}",
        )
    return HostPose.of(np.asarray(poses.positions[0]), np.asarray(poses.quaternions[0]))
