"""Tables of segments' poses (fixed, from a file of poses, or from markers), joint centres and the recording."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pftwin.base.arrays import Floats
from pftwin.base.leaves import number, vector
from pftwin.files.mocap import MarkerTrajectories, PoseSeries, sphere_center
from pftwin.files.scene_file.section import FileName, NotNegative, Point, Positive, Section, UnitQuaternion, problem
from pftwin.files.scene_file.side import HostPose, Side
from pftwin.model.limits import Limits, beyond
from pftwin.model.scene import PatellaBody


class PoseSection(Section):
    """Pose of a frame in its parent."""

    position_m: Point = Field(default=[0.0, 0.0, 0.0], description="origin of the frame in its parent [m]")
    quaternion_wxyz: UnitQuaternion = Field(default=[1.0, 0.0, 0.0, 0.0], description="unit quaternion (w, x, y, z)")

    def pose(self) -> HostPose:
        """The pose as arrays."""
        return HostPose.of(self.position_m, self.quaternion_wxyz)


class ThreePointsSection(Section):
    """Vaughan's frame from three markers: origin at the first marker, first axis towards the second."""

    markers: Annotated[list[str], Field(min_length=3, max_length=3)] = Field(description="names of three markers")
    axes: Literal["xy", "yx", "xz", "zx", "yz", "zy"] = Field(
        default="xy", description="axis from marker 1 to marker 2, then the axis towards marker 3"
    )
    segment: PoseSection = Field(
        default_factory=PoseSection, description="pose of the segment's frame in the three-point frame"
    )


class SegmentSection(Section):
    """One of: a fixed pose, a body in the file of poses, a cluster of markers, three markers."""

    fixed: PoseSection | None = Field(default=None, description="constant pose in the world")
    body: str | None = Field(default=None, description="name of the body in the file of poses")
    cluster_m: dict[str, Point] | None = Field(
        default=None, description="marker names and their positions in the segment's frame [m]; least-squares fit"
    )
    three_points: ThreePointsSection | None = Field(default=None, description="frame from three markers")

    def _check(self) -> None:
        given = [n for n in ("fixed", "body", "cluster_m", "three_points") if getattr(self, n) is not None]
        if len(given) != 1:
            raise problem(
                f"found {' and '.join(given)}" if given else "nothing says where it is",
                expected="one of fixed, body, cluster_m and three_points",
            )


class StartSection(SegmentSection):
    """The patella's pose at the first frame, from which the search for equilibrium starts."""

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
        """The patella of a scene."""
        center = vector(side.points("patella", self.center_of_mass_m))
        return PatellaBody(number(self.mass_kg), vector(side.moments(self.inertia_kg_m2)), center)


class FemurSection(SegmentSection):
    """The femur; fixed at the world's origin by default."""

    fixed: PoseSection | None = Field(default=None, description="pose in the world of a fixed femur")


class TibiaSection(SegmentSection):
    """The tibia, whose motion is that of the recording."""


class JointCenterSection(Section):
    """A joint centre that is used as a marker, for instance for segments with only two markers.

    It is fixed in a segment of this file or in a cluster of other markers, for instance of the pelvis. Its position
    there is given, or is the point about which markers of the adjacent segment rotate, by least squares.
    """

    about: Literal["world", "femur", "tibia"] = Field(default="world", description="segment in which it is fixed")
    about_markers: Annotated[list[str], Field(min_length=3)] | None = Field(
        default=None, description="instead of `about`: three or more markers of the segment in which it is fixed"
    )
    point_m: Point | None = Field(default=None, description="its position in that segment's frame [m]")
    of: Annotated[list[str], Field(min_length=1)] | None = Field(
        default=None, description="instead of `point_m`: markers of the other segment, which rotate about it"
    )

    def _check(self) -> None:
        if (self.point_m is None) == (self.of is None):
            found = "neither point_m nor of" if self.of is None else "both point_m and of"
            raise problem(found, expected="its place, point_m, or the markers that turn about it, of")
        if self.about_markers is not None and (self.point_m is not None or self.about != "world"):
            found = "about_markers beside " + ("about" if self.point_m is None else "point_m")
            raise problem(found, expected="about_markers with of alone, or about")

    def path(
        self, name: str, frame: PoseSeries, turning: MarkerTrajectories | None, limits: Limits, notes: list[str]
    ) -> Floats:
        """Positions (n, 3) in the world [m].

        Args:
            name: of the joint centre, for messages.
            frame: poses of the segment in which it is fixed.
            turning: the markers `of`; None for a given point.
            limits: required accuracy.
            notes: a note on the result is added.

        Raises:
            InputError: a motion that does not determine it accurately enough.
        """
        rotations = frame.matrices()
        if turning is None:
            return frame.positions + rotations @ np.array(self.point_m)
        local = np.einsum("nji,nmj->nmi", rotations, turning.positions - frame.positions[:, None])
        found = sphere_center(local, source=turning.source)
        markers, angle = ", ".join(turning.names), np.degrees(found.reach)
        if 1e3 * found.deviation > (most := limits.most_center_deviation_mm):
            known = np.isfinite(found.deviation)
            accuracy = (
                f"determines it to {1e3 * found.deviation:.3g} mm only" if known else "does not determine all of it"
            )
            words = f"{markers} turn about it by up to {angle:.2g} deg from their mean, which {accuracy}"
            raise beyond("most_center_deviation_mm", most, words, 1e3 * found.deviation)
        notes.append(
            f"{name}: {markers} turn about it by up to {angle:.0f} deg from their mean and keep their distance "
            f"within {1e3 * found.residual_rms:.2f} mm rms; its standard deviation is {1e3 * found.deviation:.2f} mm"
        )
        return frame.positions + rotations @ found.point


class MotionSection(Section):
    """The recording that the segments' tables refer to."""

    poses: FileName | None = Field(
        default=None,
        description="file of poses: CSV with time_s, BODY_px_m ... BODY_qz; STO with time, BODY_T11 ... BODY_T44 [m]",
    )
    rate_Hz: Positive | None = Field(default=None, description="frames per second, if time in an STO is a frame number")
    markers: FileName | None = Field(default=None, description="TRC, C3D or CSV file of markers")
    units: Literal["m", "cm", "mm"] | None = Field(
        default=None, description="unit of the markers' coordinates if their file has none"
    )
    fixed_points_m: dict[str, Point] = Field(
        default_factory=dict,
        description="points fixed in the world that are used as markers, such as a hip centre [m]",
    )
    joint_centers: dict[str, JointCenterSection] = Field(
        default_factory=dict,
        description="points fixed in a segment that are used as markers: given, or determined from the motion",
    )
    max_gap_s: NotNegative = Field(
        default=0.1,
        description="longest gap of a marker, or run of frames in which a bone jumps, that is filled by a spline, or "
        "left out at the start [s]",
    )
    cutoff_Hz: Positive | None = Field(default=None, description="cut-off of the zero-phase Butterworth filter [Hz]")
    filter_order: Literal[1, 2, 3, 4] = Field(default=2, description="order of one pass of the filter")
    correct_two_passes: bool = Field(
        default=False, description="design the filter so that both passes together have -3 dB at the cut-off"
    )
    start_time_s: float | None = Field(default=None, description="first time used [s]; by default the recording's")
    end_time_s: float | None = Field(default=None, description="last time used [s]; by default the recording's")
    synthetic: bool = Field(default=False, description="whether the motion is simulated; stated in results and figures")

    def _check(self) -> None:
        if self.start_time_s is not None and self.end_time_s is not None and self.start_time_s >= self.end_time_s:
            raise problem(f"start_time_s is {self.start_time_s}, end_time_s {self.end_time_s}", expected="start < end")
        if self.rate_Hz is not None and self.poses is None:
            raise problem("rate_Hz without poses", expected="a file of poses whose times count frames")
        if twice := sorted(self.fixed_points_m.keys() & self.joint_centers):
            raise problem(f"{twice[0]} is a fixed point and a joint centre", expected="different names")
