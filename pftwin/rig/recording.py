"""From the laboratory's files of the rig to segment motion and measurements, read as a user's files are."""

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

CUTOFF = 12.0  # second-order Butterworth low-pass of the markers [Hz], as in the paper
WINDOW = 30  # singular spectrum analysis of the forces, as in the paper
LABEL = "virtual rig (synthetic measurements)"
IMPLANT_FILE = "femoral_component.stl"
FORCES = ("contact", "tibial_spring", "femoral_spring")


@dataclass(frozen=True)
class Recording:
    """One case: guided bodies and patella in the world, and the measurements to compare with."""

    femur: PoseSeries
    tibia: PoseSeries
    patella: PoseSeries
    measured: Measured


def data_folder() -> Path:
    """Where the rig's files are."""
    return Path(str(resources.files("pftwin.rig") / "data"))


def recording_files(case: int, folder: Path | None = None) -> tuple[Path, Path]:
    """Markers and forces of one case, of the package or in a folder."""
    where = folder or data_folder()
    return where / f"case{case}_markers.trc", where / f"case{case}_forces.csv"


def source_of(case: int) -> str:
    """Where a case's measurements come from, in words."""
    return f"{LABEL}, case {case}"


def read_recording(case: int, folder: Path | None = None) -> Recording:
    """Reads, fills, filters and fits the files of one case, of the package or in a folder."""
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
    seen = patella.relative_to(femur)
    measured = Measured(
        seen.times,
        seen.positions,
        seen.quaternions,
        contact_force=contact,
        tibial_spring_force=tibial,
        femoral_spring_force=femoral,
        synthetic=True,
        source=source_of(case),
    )
    return Recording(femur, tibia, patella, measured)


def _with_hip(markers: MarkerTrajectories) -> MarkerTrajectories:
    """With the hip's centre as one more marker: a known joint location, as Vaughan's method allows."""
    hip = np.broadcast_to(np.array(rig.HIP), (markers.times.size, 1, 3))
    return MarkerTrajectories(
        markers.times, (*markers.names, "HIP"), np.concatenate([markers.positions, hip], axis=1), markers.source
    )
