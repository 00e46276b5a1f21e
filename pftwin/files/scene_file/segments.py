"""Where femur, tibia and patella are: fixed, in a table of poses, or seen through markers."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from pftwin.base.errors import InputError
from pftwin.files.mocap import (
    MarkerTrajectories,
    PoseSeries,
    butterworth_lowpass,
    fill_gaps,
    read_markers,
    read_poses,
    segment_poses,
    three_point_frames,
)
from pftwin.files.scene_file.clusters import ClusterFits
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.section import FileName, NotNegative, Point, Positive, Section, UnitQuaternion, problem
from pftwin.files.scene_file.side import HostPose
from pftwin.model.limits import Limits


class PoseSection(Section):
    """A frame in its parent."""

    position_m: Point = Field(default=[0.0, 0.0, 0.0], description="origin of the frame in its parent [m]")
    quaternion_wxyz: UnitQuaternion = Field(default=[1.0, 0.0, 0.0, 0.0], description="unit quaternion (w, x, y, z)")

    def pose(self) -> HostPose:
        """The pose as arrays."""
        return HostPose.of(self.position_m, self.quaternion_wxyz)


class ThreePointsSection(Section):
    """Vaughan's frame from three markers: origin at the first, first axis towards the second."""

    markers: Annotated[list[str], Field(min_length=3, max_length=3)] = Field(description="names of three markers")
    axes: Literal["xy", "yx", "xz", "zx", "yz", "zy"] = Field(
        default="xy", description="axis along markers 1-2, then the one towards marker 3"
    )
    segment: PoseSection = Field(
        default_factory=PoseSection, description="the segment's own frame in the three-point frame"
    )


class SegmentSection(Section):
    """One of: a fixed pose, a body of a table of poses, a cluster of markers, three markers."""

    fixed: PoseSection | None = Field(default=None, description="pose in the world, which does not change")
    body: str | None = Field(default=None, description="name of the body in the file of poses")
    cluster_m: dict[str, Point] | None = Field(
        default=None, description="marker names and their places in the segment's frame [m]; least-squares fit"
    )
    three_points: ThreePointsSection | None = Field(default=None, description="frame from three markers")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = self.sources()
        if len(given) != 1:
            raise problem(
                f"found {' and '.join(given)}" if given else "nothing says where it is",
                expected="one of fixed, body, cluster_m and three_points",
            )
        return self

    def sources(self) -> list[str]:
        """Which fields say where the segment is."""
        return [n for n in ("fixed", "body", "cluster_m", "three_points") if getattr(self, n) is not None]

    def marker_names(self) -> list[str]:
        """The markers it needs."""
        return list(self.cluster_m or ()) + (self.three_points.markers if self.three_points else [])


class MotionSection(Section):
    """The recording that the segments' tables refer to."""

    poses: FileName | None = Field(
        default=None,
        description="file of poses: CSV with time_s, BODY_px_m ... BODY_qz; STO with time, BODY_T11 ... BODY_T44 [m]",
    )
    rate_Hz: Positive | None = Field(default=None, description="frames per second, where time in an STO counts frames")
    markers: FileName | None = Field(default=None, description="TRC, C3D or CSV file of markers")
    units: Literal["m", "cm", "mm"] | None = Field(
        default=None, description="unit of the markers where their file has none"
    )
    fixed_points_m: dict[str, Point] = Field(
        default_factory=dict,
        description="points fixed in the world that count as markers, as a hip centre [m]",
    )
    max_gap_s: NotNegative = Field(default=0.1, description="longest gap in a marker that is filled by a spline [s]")
    cutoff_Hz: Positive | None = Field(default=None, description="cut-off of the zero-phase Butterworth filter [Hz]")
    filter_order: Literal[1, 2, 3, 4] = Field(default=2, description="order of one pass of the filter")
    correct_two_passes: bool = Field(
        default=False, description="design the filter so that both passes together have -3 dB at the cut-off"
    )
    start_time_s: float | None = Field(default=None, description="first time used [s]; the recording's by default")
    end_time_s: float | None = Field(default=None, description="last time used [s]; the recording's by default")
    synthetic: bool = Field(default=False, description="whether this motion was simulated; results and figures say so")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.start_time_s is not None and self.end_time_s is not None and self.start_time_s >= self.end_time_s:
            raise problem(f"start_time_s is {self.start_time_s}, end_time_s {self.end_time_s}", expected="start < end")
        if self.rate_Hz is not None and self.poses is None:
            raise problem("rate_Hz without poses", expected="a file of poses whose times count frames")
        return self


def _check_there(file: Path) -> None:
    if not file.is_file():
        raise InputError("no such file", where=file, remedy="check the path; relative ones start at the scene file")


class SegmentRecording:
    """Reads the recording once, and gives each segment's poses in the world."""

    def __init__(self, motion: MotionSection, document: Document, notes: list[str], limits: Limits) -> None:
        self.motion, self.document, self.notes = motion, document, notes
        self.clusters = ClusterFits(limits, notes)
        self._poses: dict[str, PoseSeries] = {}
        self._markers: MarkerTrajectories | None = None

    def whole(self, section: SegmentSection, *at: str) -> PoseSeries:
        """The poses of a segment over the whole recording; `at` is its place in the scene file."""
        if section.body is not None:
            with self.document.naming(*at, "body"):
                return self._body(section.body)
        if section.cluster_m is not None:
            with self.document.naming(*at, "cluster_m"):
                markers = self._filtered(section.marker_names())
                poses = segment_poses(markers, section.cluster_m, source=f"{markers.source}, {at[0]}")
                self.clusters.take(".".join(at), section.cluster_m, markers, poses)
                return poses
        assert section.three_points is not None
        three = section.three_points
        with self.document.naming(*at, "three_points"):
            markers = self._filtered(three.markers)
            a, b, c = (markers.marker(name) for name in three.markers)
            source = f"{markers.source}, {at[0]}"
            poses = three_point_frames(a, b, c, markers.times, axes=three.axes, source=source)
            return poses.compose(three.segment.pose().pose())

    def poses(self, section: SegmentSection, *at: str) -> PoseSeries:
        """The poses of a segment in the time range of the scene."""
        poses = self.whole(section, *at)
        start, end = self.motion.start_time_s, self.motion.end_time_s
        if start is None and end is None:
            return poses
        low = float(poses.times[0]) if start is None else start
        high = float(poses.times[-1]) if end is None else end
        slack = 1e-6 * max(1.0, abs(low), abs(high))
        for key, asked, inside in (("start_time_s", low, poses.times[0]), ("end_time_s", high, poses.times[-1])):
            if (asked < inside - slack) if key == "start_time_s" else (asked > inside + slack):
                raise InputError(
                    f"found {asked:g}",
                    where=self.document.where("motion", key),
                    expected=f"a time within the recording, {poses.times[0]:g} s to {poses.times[-1]:g} s",
                )
        with self.document.naming("motion"):
            return poses.between(low, high)

    def _body(self, name: str) -> PoseSeries:
        file = self.motion.poses
        if file is None:
            raise InputError("a body needs a file of poses", remedy='poses = "FILE.csv" in [motion]')
        with self.document.naming("motion", "poses"):
            path = self.document.file(file)
            _check_there(path)
        if name not in self._poses:
            self._poses.update(read_poses(str(path), [name], rate=self.motion.rate_Hz))
        return self._poses[name]

    def _filtered(self, names: list[str]) -> MarkerTrajectories:
        """The named markers with gaps filled, filtered; fixed points among them as they are."""
        motion = self.motion
        if motion.markers is None:
            raise InputError("a cluster needs a file of markers", remedy='markers = "FILE.trc" in [motion]')
        if self._markers is None:
            with self.document.naming("motion", "markers"):
                self._markers = read_markers(str(self.document.file(motion.markers)), units=motion.units)
        seen = [name for name in names if name not in motion.fixed_points_m]
        markers, gaps = fill_gaps(self._markers.select(seen), max_gap_s=motion.max_gap_s)
        self.notes.extend(f"{g.marker}: filled frames {g.first_frame} to {g.last_frame}" for g in gaps)
        if motion.cutoff_Hz is not None:
            markers = self._low_passed(markers, motion.cutoff_Hz)
        still = {name: motion.fixed_points_m[name] for name in names if name in motion.fixed_points_m}
        constant = np.tile(np.array([*still.values()]).reshape(1, len(still), 3), (markers.times.size, 1, 1))
        positions = np.concatenate([markers.positions, constant], axis=1)
        return MarkerTrajectories(markers.times, (*seen, *still), positions, markers.source)

    def _low_passed(self, markers: MarkerTrajectories, cutoff: float) -> MarkerTrajectories:
        motion = self.motion
        with self.document.naming("motion", "cutoff_Hz"):
            return markers.with_positions(
                butterworth_lowpass(
                    markers.positions,
                    markers.rate,
                    cutoff,
                    motion.filter_order,
                    correct_two_passes=motion.correct_two_passes,
                )
            )
