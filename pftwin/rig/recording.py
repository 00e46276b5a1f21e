"""Segment motion and measurements from the virtual laboratory's files, read in the same way as user files."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np

from pftwin.files.mocap import (
    MarkerTrajectories,
    PoseSeries,
    butterworth_lowpass,
    fill_gaps,
    read_csv,
    read_trc,
    segment_poses,
    singular_spectrum_filter,
)
from pftwin.model.measured import Measured
from pftwin.rig import geometry as rig

CUTOFF = 12.0  # of the second-order Butterworth low-pass filter of the markers [Hz], as in the paper
WINDOW = 30  # of the singular spectrum analysis of the forces [frames], as in the paper
LABEL = "virtual rig (synthetic measurements)"
IMPLANT_FILE = "femoral_component.stl"
FORCES = ("contact", "tibial_spring", "femoral_spring")


@dataclass(frozen=True)
class Recording:
    """The recording of one case: poses of femur, tibia and patella in the world, and the measurements."""

    femur: PoseSeries
    tibia: PoseSeries
    patella: PoseSeries
    measured: Measured


def data_folder() -> Path:
    """Returns the folder of the rig's files."""
    return Path(str(resources.files("pftwin.rig") / "data"))


def recording_files(case: int, folder: Path | None = None) -> tuple[Path, Path]:
    """Returns the paths of a case's marker and force files, in the package or in `folder`."""
    where = folder or data_folder()
    return where / f"case{case}_markers.trc", where / f"case{case}_forces.csv"


def source_of(case: int) -> str:
    """Returns the label of a case's measurements."""
    return f"{LABEL}, case {case}"


def read_recording(case: int, folder: Path | None = None) -> Recording:
    """Reads a case's files from the package or `folder`, fills gaps, filters, and fits segment poses."""
    markers_file, forces_file = recording_files(case, folder)
    raw, _ = fill_gaps(read_trc(markers_file))
    markers = raw.with_positions(butterworth_lowpass(raw.positions, raw.rate, CUTOFF))
    femur = segment_poses(_with_hip(markers), {**rig.FEMUR_MARKERS, "HIP": rig.HIP})
    tibia = segment_poses(markers, rig.TIBIA_MARKERS)
    patella = segment_poses(markers, rig.PATELLA_MARKERS)
    forces = read_csv(forces_file)
    contact, tibial, femoral = (
        np.maximum(singular_spectrum_filter(forces.column(name), WINDOW), 0.0) for name in FORCES
    )
    relative = patella.relative_to(femur)
    measured = Measured(
        relative.times,
        relative.positions,
        relative.quaternions,
        contact_force=contact,
        tibial_spring_force=tibial,
        femoral_spring_force=femoral,
        synthetic=True,
        source=source_of(case),
    )
    return Recording(femur, tibia, patella, measured)


def _with_hip(markers: MarkerTrajectories) -> MarkerTrajectories:
    """Adds the hip's centre as a marker: a known joint location, as Vaughan's method allows."""
    hip = np.broadcast_to(np.array(rig.HIP), (markers.times.size, 1, 3))
    return MarkerTrajectories(
        markers.times, (*markers.names, "HIP"), np.concatenate([markers.positions, hip], axis=1), markers.source
    )
