"""The recording of a scene file: reads it once, repairs and filters it, and computes each segment's poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.mocap import (
    MarkerTrajectories,
    PoseSeries,
    butterworth_lowpass,
    fill_gaps,
    mean_cluster,
    mended_bones,
    mended_cluster,
    read_markers,
    read_poses,
    segment_poses,
    three_point_frames,
)
from pftwin.files.mocap.bones import in_words, jumps, knee_jumps
from pftwin.files.mocap.filters import samples_needed
from pftwin.files.mocap.poses import check_same_times
from pftwin.files.scene_file.clusters import ClusterFits
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.segments import JointCenterSection, MotionSection, SegmentSection
from pftwin.model.limits import Limits

Recorded = TypeVar("Recorded", PoseSeries, MarkerTrajectories)


class SegmentRecording:
    """Reads the recording once, and provides each segment's poses in the world."""

    def __init__(
        self,
        motion: MotionSection,
        segments: Mapping[str, SegmentSection],
        document: Document,
        notes: list[str],
        limits: Limits,
    ) -> None:
        self.motion, self.segments, self.document, self.notes = motion, segments, document, notes
        self.clusters, self.limits = ClusterFits(limits, notes), limits
        self._poses: dict[str, PoseSeries] = {}
        self._whole: dict[tuple[str, ...], PoseSeries] = {}
        self._centers: dict[str, Floats | None] = {}  # positions (n, 3) [m]; None while they are computed
        self._markers: MarkerTrajectories | None = None

    def whole(self, section: SegmentSection, *at: str) -> PoseSeries:
        """Poses of a segment over the whole recording; `at` is the location of its table in the scene file."""
        if at not in self._whole:
            self._whole[at] = self._read(section, *at)
        return self._whole[at]

    def _read(self, section: SegmentSection, *at: str) -> PoseSeries:
        if section.body is not None:
            with self.document.naming(*at, "body"):
                return self._body(section.body)
        if section.cluster_m is not None:
            with self.document.naming(*at, "cluster_m"):
                markers = self._filtered([*section.cluster_m], section.cluster_m)
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

    def skip_outliers(self, start: SegmentSection | None) -> None:
        """Starts the scene later, by up to `max_gap_s` and with a note, if its first frames are outliers: of femur and
        tibia in a file of poses, or of the patella, if it starts as recorded (`start`). More of them are refused later.
        """
        femur, tibia = self.segments["femur"], self.segments["tibia"]
        shin = self.poses(tibia, "tibia")
        thigh = None if femur.fixed is not None else self.poses(femur, "femur")

        def in_femur(poses: PoseSeries) -> PoseSeries:
            return poses if thigh is None else poses.relative_to(thigh)

        odd = {}
        if tibia.body is not None and (thigh is None or femur.body is not None):
            odd["femur and tibia jump against each other"] = knee_jumps(in_femur(shin), **self._fastest)
        if start is not None:
            patella = self.poses(start, "patella", "start")
            if patella.times.size == shin.times.size:  # if not, the start is refused
                odd["the patella jumps"] = jumps(in_femur(patella))
        first = int(np.argmin(np.any([*odd.values()], axis=0))) if odd else 0
        time = float(shin.times[first])
        if first == 0 or time - shin.times[0] > self.motion.max_gap_s * (1 + 1e-6):
            return
        self.motion = self.motion.model_copy(update={"start_time_s": time})
        before = np.arange(shin.times.size) < first
        why = "; ".join(f"{what} in {in_words(o & before)}" for what, o in odd.items() if (o & before).any())
        self.notes.append(f"the scene starts at {time:g} s: {why} of {shin.times.size}")

    @property
    def _fastest(self) -> dict[str, float]:
        """Speeds beyond which a tibia in the femur is an outlier: half of those at which a motion is an error."""
        limits = self.limits
        return {"speed": limits.most_knee_speed_m_per_s, "spin": limits.most_angular_speed_rad_per_s / 2}

    def bones(self) -> tuple[PoseSeries | None, PoseSeries]:
        """Poses of femur (None if it is fixed) and tibia in the time range of the scene.

        In a file of poses, runs of frames in which a bone jumps out and back are filled; raises InputError for too long
        runs.
        """
        femur, tibia = self.segments["femur"], self.segments["tibia"]
        shin = self.poses(tibia, "tibia")
        thigh = None if femur.fixed is not None else self.poses(femur, "femur")
        if tibia.body is None or (thigh is not None and femur.body is None):
            return thigh, shin
        with self.document.naming("motion"):
            thigh, shin, words = mended_bones(thigh, shin, max_gap_s=self.motion.max_gap_s, **self._fastest)
        self.notes.extend(words)
        return thigh, shin

    def poses(self, section: SegmentSection, *at: str) -> PoseSeries:
        """Poses of a segment in the time range of the scene."""
        return self._in_time(self.whole(section, *at))

    def points(self, names: list[str], *at: str) -> MarkerTrajectories:
        """Single markers in the time range of the scene; NaN in gaps that are too long to be filled."""
        with self.document.naming(*at):
            markers = self._filtered(names, keep_long=True)
        return self._in_time(markers.select(names))

    def _in_time(self, recorded: Recorded) -> Recorded:
        """Restricts a recording to the time range of the scene."""
        start, end = self.motion.start_time_s, self.motion.end_time_s
        if start is None and end is None:
            return recorded
        low = float(recorded.times[0]) if start is None else start
        high = float(recorded.times[-1]) if end is None else end
        slack = 1e-6 * max(1.0, abs(low), abs(high))
        for key, asked, inside in (("start_time_s", low, recorded.times[0]), ("end_time_s", high, recorded.times[-1])):
            if (asked < inside - slack) if key == "start_time_s" else (asked > inside + slack):
                raise InputError(
                    f"found {asked:g}",
                    where=self.document.where("motion", key),
                    expected=f"a time within the recording, {recorded.times[0]:g} s to {recorded.times[-1]:g} s",
                )
        with self.document.naming("motion"):
            return recorded.between(low, high)

    def _body(self, name: str) -> PoseSeries:
        file = self.motion.poses
        if file is None:
            raise InputError("a body needs a file of poses", remedy='poses = "FILE.csv" in [motion]')
        with self.document.naming("motion", "poses"):
            path = self.document.file(file)
            if not path.is_file():
                remedy = "check the path; relative ones start at the scene file"
                raise InputError("no such file", where=path, remedy=remedy)
        if name not in self._poses:
            self._poses.update(read_poses(str(path), [name], rate=self.motion.rate_Hz))
        return self._poses[name]

    def _filtered(
        self, names: list[str], cluster: Mapping[str, list[float]] | None = None, *, keep_long: bool = False
    ) -> MarkerTrajectories:
        """The named markers, repaired, with gaps filled, and filtered; fixed points and joint centres are not filtered.

        Markers of a cluster are repaired by its shape: the positions of its points in a segment's frame [m].
        """
        motion, recorded = self.motion, self._recorded()
        still = {name: np.array(motion.fixed_points_m[name]) for name in names if name in motion.fixed_points_m}
        more = {**still, **{name: self._center(name) for name in names if name in motion.joint_centers}}
        filtered = [name for name in names if name not in more]
        added = [np.broadcast_to(path, (recorded.times.size, 3))[:, None] for path in more.values()]
        positions = np.concatenate([recorded.select(filtered).positions, *added], axis=1)
        whole = MarkerTrajectories(recorded.times, (*filtered, *more), positions, recorded.source)
        if cluster is not None:
            whole, strays = mended_cluster(whole, cluster)
            self.notes.extend(w for s in strays if (w := s.in_words()) not in self.notes)  # the patella is read twice
        markers, gaps = fill_gaps(whole.select(filtered), max_gap_s=motion.max_gap_s, keep_long=keep_long)
        self.notes.extend(f"{g.marker}: {'filled' if g.filled else 'no'} {g.in_words()}" for g in gaps)
        if motion.cutoff_Hz is not None:
            markers = self._low_passed(markers, motion.cutoff_Hz)
        positions = np.concatenate([markers.positions, whole.select([*more]).positions], axis=1)
        return MarkerTrajectories(markers.times, (*filtered, *more), positions, markers.source)

    def _shaped(self, names: list[str]) -> MarkerTrajectories:
        """Markers of a segment without given positions, repaired by their mean shape if they have one."""
        recorded = self._recorded()
        whole = len(names) >= 3 and (~recorded.select(names).missing).all(axis=1).any()
        shape = {n: [*map(float, p)] for n, p in mean_cluster(recorded, names).items()} if whole else None
        return self._filtered(names, shape)

    def _recorded(self) -> MarkerTrajectories:
        """All markers of the file."""
        if self.motion.markers is None:
            raise InputError("markers are named, and no file of them", remedy='markers = "FILE.trc" in [motion]')
        if self._markers is None:
            with self.document.naming("motion", "markers"):
                self._markers = read_markers(str(self.document.file(self.motion.markers)), units=self.motion.units)
        return self._markers

    def _center(self, name: str) -> Floats:
        """Positions (n, 3) of a joint's centre in the world [m]."""
        path = self._centers.get(name)
        if path is not None:
            return path
        with self.document.naming("motion", "joint_centers", name):
            if name in self._centers:
                raise InputError(f"{name} is found by means of itself", expected="a segment that is seen without it")
            self._centers[name] = None
            section = self.motion.joint_centers[name]
            frame = self._frame(section)
            turning = None if section.of is None else self._shaped(section.of)
            self._centers[name] = path = section.path(name, frame, turning, self.limits, self.notes)
        return path

    def _frame(self, center: JointCenterSection) -> PoseSeries:
        """Poses, at the markers' times, of the segment in which a joint's centre is fixed."""
        times = self._recorded().times
        world = PoseSeries(times, np.zeros((times.size, 3)), np.tile([1.0, 0, 0, 0], (times.size, 1)), source="world")
        if center.about_markers is not None:
            markers = self._shaped(center.about_markers)
            return segment_poses(markers, mean_cluster(markers, center.about_markers))
        if center.about == "world":
            return world
        section = self.segments[center.about]
        if section.fixed is not None:
            return world.compose(section.fixed.pose().pose())
        poses = self.whole(section, center.about)
        check_same_times(poses, world)
        return poses

    def _low_passed(self, markers: MarkerTrajectories, cutoff: float) -> MarkerTrajectories:
        """Filters each marker in runs of frames that are long enough; NaN elsewhere."""
        motion, rate, filtered = self.motion, markers.rate, np.full_like(markers.positions, np.nan)
        shortest = samples_needed(rate, cutoff, motion.filter_order) if markers.missing.any() else 0
        with self.document.naming("motion", "cutoff_Hz"):
            for first, last, columns in _runs_without_gaps(markers.missing):
                if last - first < shortest:
                    name = markers.names[columns[0]]
                    self.notes.append(f"{name}: frames {first + 1} to {last} left out, too few for the filter")
                    continue
                run = markers.positions[first:last, columns]
                filtered[first:last, columns] = butterworth_lowpass(
                    run, rate, cutoff, motion.filter_order, correct_two_passes=motion.correct_two_passes
                )
        return markers.with_positions(filtered)


def _runs_without_gaps(missing: NDArray[np.bool_]) -> Iterator[tuple[int, int, NDArray[np.intp]]]:
    """First frame, frame after the last, and markers, of runs without gaps; markers without any gap together."""
    whole = ~missing.any(axis=0)
    if whole.any():
        yield 0, len(missing), np.flatnonzero(whole)
    for column in np.flatnonzero(~whole):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], ~missing[:, column], [False]]).astype(np.int8)))
        for first, last in edges.reshape(-1, 2):
            yield int(first), int(last), np.array([column])
