"""[measured]: measurements that the simulation is compared with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pftwin.base.errors import InputError
from pftwin.files.mocap import Table, frame_means, read_readings, singular_spectrum_filter
from pftwin.files.mocap.bones import in_words, jumps
from pftwin.files.mocap.units import SI_UNITS, split_unit
from pftwin.files.scene_file.bones import BonePoses
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.section import FileName, Section, problem
from pftwin.files.scene_file.segments import SegmentSection
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from pftwin.model.measured import Measured

_FORCES = ("contact_force", "tibial_spring_force", "femoral_spring_force")
_AXES = "xyz"  # what [[marker]] reports


class MeasuredSection(Section):
    """Measurements of the same motion: the patella's poses or skin markers, and optionally forces."""

    patella: SegmentSection | None = Field(
        default=None, description="table: recording of the patella (body, cluster_m, three_points)"
    )
    markers: dict[str, str] = Field(
        default_factory=dict,
        description="table: for each [[marker]] the recording's marker on the skin over the patella, such as "
        '"m1" = "R.Patella"; only changes over time are compared, since skin slides over the bone',
    )
    forces: FileName | None = Field(
        default=None,
        description="file of forces and other readings: CSV with units in its header, or C3D (its analog channels); "
        "readings at a higher rate than the motion are averaged over a frame",
    )
    contact_force: str | None = Field(default=None, description="column of the forces file: normal contact force")
    tibial_spring_force: str | None = Field(
        default=None, description="column of the forces file: patellar tendon's force"
    )
    femoral_spring_force: str | None = Field(default=None, description="column of the forces file: quadriceps' force")
    readings: dict[str, str] = Field(
        default_factory=dict,
        description='table: columns of the forces file for other results of effects, such as "contact.force_medial" = '
        '"medial_N"; not smoothed',
    )
    weights: str | None = Field(
        default=None, description="column of the forces file: each frame's weight in a fit, 0 to skip it"
    )
    smoothing_window: Annotated[int, Field(ge=2)] | None = Field(
        default=None,
        description="window of the singular spectrum analysis that smooths the forces [samples]; none by default",
    )
    synthetic: bool = Field(default=False, description="whether the measurements are simulated")

    def _check(self) -> None:
        if self.patella is None and not self.markers:
            raise problem("neither patella nor markers", expected="how the patella was recorded")

    def build(self, scene: Scene, bones: BonePoses) -> Measured:
        """Reads the measurements, in the femur's frame, at the scene's frames.

        Raises InputError for files that cannot be used, missing columns, and forces that do not cover the motion.
        """
        from pftwin.model.measured import Measured

        document, times = bones.recording.document, scene.motion.times
        center, quaternions, source = np.full((times.size, 3), np.nan), None, bones.recording.motion.markers
        if self.patella is not None:
            times, center, quaternions, source = self._pose(self.patella, scene, bones)
        columns = self._columns(document, scene)
        markers = self._markers(scene, bones)
        if both := [name for name in markers if name in columns.get("readings", {})]:
            where = document.where("measured", "readings")
            raise InputError(f"{both[0]} is measured by a marker and in a column", where=where, expected="one of them")
        return Measured(
            times,
            center,
            quaternions,
            **{**columns, "readings": {**columns.get("readings", {}), **markers}},
            synthetic=self.synthetic,
            source=self.forces or str(source),
            skin_markers=tuple(self.markers),
        )

    def _pose(
        self, patella: SegmentSection, scene: Scene, bones: BonePoses
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], str]:
        """Times, positions of the tracked point and quaternions, in the femur's frame, and their source."""
        document = bones.recording.document
        if patella.fixed is not None:
            where = document.where("measured", "patella", "fixed")
            raise InputError("a fixed pose is no measurement", where=where, expected="a recording")
        poses = bones.patella(patella, "measured", "patella")
        with document.naming("measured", "patella"):
            poses = bones.poses_in_femur(poses)
        point = np.array([float(v) for v in scene.tracked_point().array()])
        center, quaternions = poses.positions + poses.matrices() @ point, poses.quaternions.copy()
        if (odd := jumps(poses)).any():
            center[odd], quaternions[odd] = np.nan, np.nan
            bones.recording.notes.append(
                f"{poses.source}: the patella's {in_words(odd)} of {odd.size} (from {poses.times[0]:g} s on) left out: "
                "it jumps there from where the frames around have it"
            )
        return poses.times, center, quaternions, poses.source

    def _markers(self, scene: Scene, bones: BonePoses) -> dict[str, NDArray[np.float64]]:
        """Positions of the skin markers in the femur's frame, by the names of results of [[marker]]."""
        if not self.markers:
            return {}
        document = bones.recording.document
        recorded = bones.recording.points([*self.markers.values()], "measured", "markers")
        with document.naming("measured", "markers"):
            for name in self.markers:
                for axis in _AXES:
                    scene.reported(f"{name}.{axis}")
            times = scene.motion.times
            if recorded.times.size != times.size or np.abs(recorded.times - times).max() > 1e-6 * np.ptp(times):
                raise InputError(
                    f"{recorded.times.size} frames from {recorded.times[0]:g} s on",
                    where=recorded.source,
                    expected=f"those of the motion, {times.size} from {times[0]:g} s on",
                )
        places = bones.points_in_femur(bones.side.points("world", recorded.positions))
        return {
            f"{name}.{axis}": places[:, i, k] for i, name in enumerate(self.markers) for k, axis in enumerate(_AXES)
        }

    def _columns(self, document: Document, scene: Scene) -> dict[str, Any]:
        """Forces and readings at the frames of the motion."""
        wanted = {name: column for name in _FORCES if (column := getattr(self, name)) is not None}
        if self.forces is None:
            if named := [*wanted, *(name for name in ("weights", "readings") if getattr(self, name))]:
                where = document.where("measured", named[0])
                raise InputError("a column of no file", where=where, remedy='forces = "FILE.csv"')
            return {}
        motion = scene.motion
        with document.naming("measured", "forces"):
            table = read_readings(document.file(self.forces))
            slack = 0.1 * motion.frame_interval
            if table.times[0] > motion.start_time + slack or table.times[-1] < motion.end_time - slack:
                raise InputError(
                    f"forces from {table.times[0]:g} s to {table.times[-1]:g} s",
                    where=table.source,
                    expected=f"forces for the whole motion, {motion.start_time:g} s to {motion.end_time:g} s",
                )
        out: dict[str, Any] = {}
        for name, column in wanted.items():
            with document.naming("measured", name):
                values = _column(table, column, "N")
                if self.smoothing_window is not None:
                    # Cables only pull and contacts only push, but smoothing overshoots where they become slack or
                    # open. A column of the opposite sign is not changed: `fit` reports it.
                    smooth = singular_spectrum_filter(values, self.smoothing_window)
                    values = np.maximum(smooth, 0.0) if values.mean() >= 0 else smooth
                out[name] = frame_means(motion.times, table.times, values)
        with document.naming("measured", "readings"):
            units = {name: scene.reported(name).unit for name in self.readings}
            read = {name: _column(table, column, units[name]) for name, column in self.readings.items()}
        out["readings"] = {name: frame_means(motion.times, table.times, each) for name, each in read.items()}
        if self.weights is not None:
            with document.naming("measured", "weights"):
                weights = _column(table, self.weights, "1")
                whole = frame_means(motion.times, table.times, (weights > 0).astype(float)) > 1 - 1e-9
                out["weights"] = np.where(whole, frame_means(motion.times, table.times, weights), 0.0)
        return out


def _column(table: Table, column: str, unit: str) -> NDArray[np.float64]:
    """A column by its name, with or without its unit. Raises InputError for an unknown column or another unit."""
    label = column if column in table.names else split_unit(column)[0]
    values = table.column(label if label in table.names else column)
    if unit not in SI_UNITS:
        found, expected = f"a reading in {unit}", f"one of: {', '.join(sorted(SI_UNITS))}"
        raise InputError(found, where=f"{table.source}, column {label!r}", expected=expected)
    if table.units[label] != unit:
        found = "no unit" if table.units[label] == "1" else f"its unit is {table.units[label]}"
        raise InputError(found, where=f"{table.source}, column {label!r}", expected=f"a unit of {unit}, such as {unit}")
    return values
