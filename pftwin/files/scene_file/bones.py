"""Recorded motion of femur, tibia and patella, in the axes of a right knee."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.mocap import PoseSeries
from pftwin.files.mocap.bones import in_words, jumps
from pftwin.files.scene_file.recording import SegmentRecording
from pftwin.files.scene_file.segments import SegmentSection, StartSection
from pftwin.files.scene_file.side import HostPose, Side
from pftwin.model.motion import KneeMotion


@dataclass(frozen=True, eq=False)
class BonePoses:
    """Poses of femur and tibia at the frames of a scene."""

    recording: SegmentRecording
    side: Side
    motion: KneeMotion
    fixed_femur: HostPose | None  # pose of a fixed femur in the world; the scene's world is then the femur's frame
    femur: PoseSeries | None  # poses of a moving femur in the world

    @staticmethod
    def read(recording: SegmentRecording, side: Side, start: StartSection) -> BonePoses:
        """Makes the bones' motion from a recording, from the first frame on in which they are in line.

        Raises InputError for a fixed tibia, and poses implausible for a knee.
        """
        document, femur = recording.document, recording.segments["femur"]
        if recording.segments["tibia"].fixed is not None:
            raise InputError(
                "the tibia is fixed",
                where=document.where("tibia", "fixed"),
                expected="a recording: the run goes through its frames",
                remedy="a file of poses with one pose in every frame",
            )
        recording.skip_outliers(None if start.fixed is not None else start)
        thigh, shin = recording.bones()
        shin = side.poses("world", "tibia", shin)
        if thigh is None:
            assert femur.fixed is not None
            fixed = side.pose("world", "femur", femur.fixed.pose())
            with document.naming("tibia"):
                return BonePoses(recording, side, KneeMotion.from_poses(fixed.pose(), shin), fixed, None)
        thigh = side.poses("world", "femur", thigh)
        with document.naming("motion"):
            return BonePoses(recording, side, KneeMotion.from_poses(thigh, shin), None, thigh)

    def patella(self, section: SegmentSection, *at: str) -> PoseSeries:
        """Recorded poses of the patella in the world; `at` is the location of its table in the file."""
        return self.side.poses("world", "patella", self.recording.poses(section, *at))

    def poses_in_femur(self, poses: PoseSeries) -> PoseSeries:
        """Transforms poses from the world to the femur's frame."""
        if self.fixed_femur is not None:
            return poses.seen_from(self.fixed_femur.pose())
        assert self.femur is not None
        return poses.relative_to(self.femur)

    def points_in_femur(self, points: Floats) -> Floats:
        """Transforms points (n, m, 3) [m] at each frame from the world to the femur's frame."""
        if self.fixed_femur is not None:
            return self.fixed_femur.inverse().apply(points)
        assert self.femur is not None
        return np.einsum("nji,nmj->nmi", self.femur.matrices(), points - self.femur.positions[:, None])

    def start_pose(self, start: StartSection) -> tuple[HostPose, HostPose]:
        """The patella's start in the scene's world (the femur's frame if the femur is fixed), and in the femur."""
        first = None if self.femur is None else HostPose.of(self.femur.positions[0], self.femur.quaternions[0])
        if start.fixed is not None and start.relative_to == "femur":
            relative = self.side.pose("femur", "patella", start.fixed.pose())
            return (relative if first is None else first @ relative), relative
        if start.fixed is not None:
            world = self.side.pose("world", "patella", start.fixed.pose())
        else:
            world = self._first_pose(self.patella(start, "patella", "start"))
        if self.fixed_femur is not None:
            world = self.fixed_femur.inverse() @ world
        return world, (world if first is None else first.inverse() @ world)

    def _first_pose(self, poses: PoseSeries) -> HostPose:
        if abs(poses.times[0] - self.motion.start_time) > 0.1 * self.motion.frame_interval:
            raise InputError(
                f"the patella's first pose is at {poses.times[0]:g} s, the motion starts at "
                f"{self.motion.start_time:g} s",
                where=poses.source,
                expected="the same first frame",
            )
        if (odd := jumps(poses if self.femur is None else poses.relative_to(self.femur)))[0]:
            raise InputError(
                f"the patella jumps from its first pose to where most others are ({in_words(odd)} out of line)",
                where=poses.source,
                expected="a start where the patella was",
                remedy=f"start_time_s = {poses.times[np.argmin(odd)]:g} in [motion]; or start = {{ fixed = ... }}",
            )
        return HostPose.of(np.asarray(poses.positions[0]), np.asarray(poses.quaternions[0]))
