"""The virtual laboratory: converts the plant's simulated motion to the files that a real laboratory records.

`python -m tests.verification.rig_plant.laboratory [FOLDER]` regenerates the files in `pftwin/rig/data/` (some
minutes). All data are synthetic.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pftwin.files.mocap.csv_files import write_csv
from pftwin.files.mocap.markers import MarkerTrajectories
from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.mocap.tables import Table
from pftwin.files.mocap.trc import write_trc
from pftwin.geometry.mesh.mesh import save_mesh
from pftwin.geometry.patch.implant import rig_implant
from pftwin.rig import geometry as rig
from pftwin.rig.recording import FORCES, IMPLANT_FILE, data_folder
from tests.verification.rig_plant.hand import hand_motion
from tests.verification.rig_plant.mechanics import run_plant

FINE = 6e-6  # chordal deviation of the implant's mesh, as in the paper's FM [m]
MARKER_NOISE = 0.2e-3  # standard deviation of white noise on each coordinate [m]
FORCE_NOISE = 0.15  # standard deviation of white noise on each load cell [N]
FORCE_BIAS = 0.05  # standard deviation of a load cell's offset [N]


def record(case: int, folder: Path) -> int:
    """Simulates a case's plant and writes its markers and forces; returns the number of force evaluations."""
    truth, evaluations = run_plant(case)
    write_recording(case, truth, np.random.default_rng(1000 + case), folder)
    return evaluations


def write_recording(case: int, truth: dict[str, NDArray], random: np.random.Generator, folder: Path) -> None:
    """Writes marker and force files of a plant's motion (`Plant.seen`), with the laboratory's noise."""
    femur, tibia = hand_motion(case)
    seen = PoseSeries(femur.times, truth["position"], truth["quaternion"], source=f"plant, case {case}")
    names, tracks = [], []
    for body, cluster in (
        (femur, rig.FEMUR_MARKERS),
        (tibia, rig.TIBIA_MARKERS),
        (_in_world(femur, seen), rig.PATELLA_MARKERS),
    ):
        for name, place in cluster.items():
            names.append(name)
            tracks.append(body.positions + np.einsum("nij,j->ni", body.matrices(), np.array(place)))
    positions = np.stack(tracks, axis=1)
    positions = np.round(positions + random.normal(0.0, MARKER_NOISE, positions.shape), 6)
    write_trc(folder / f"case{case}_markers.trc", MarkerTrajectories(femur.times, tuple(names), positions))
    write_csv(folder / f"case{case}_forces.csv", _load_cells(femur.times, truth, random))


def _in_world(femur: PoseSeries, seen: PoseSeries) -> PoseSeries:
    """Transforms poses from the femur frame to the world."""
    turn = femur.matrices()
    return PoseSeries.from_matrices(
        femur.times, femur.positions + np.einsum("nij,nj->ni", turn, seen.positions), turn @ seen.matrices()
    )


def _load_cells(times: NDArray, truth: dict[str, NDArray], random: np.random.Generator) -> Table:
    columns = [
        truth[name] + random.normal(0.0, FORCE_BIAS) + random.normal(0.0, FORCE_NOISE, times.size) for name in FORCES
    ]
    units: dict[str, str] = dict.fromkeys(FORCES, "N")
    return Table(times, FORCES, np.round(np.stack(columns, axis=1), 3), units, source="load cells")


def main() -> None:
    """Regenerates the rig's files."""
    from pftwin.base.runtime import configure

    configure()
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else data_folder()
    folder.mkdir(parents=True, exist_ok=True)
    save_mesh(rig_implant().mesh(deviation=FINE), folder / IMPLANT_FILE)
    for case in rig.CASES:
        began = time.perf_counter()
        evaluations = record(case, folder)
        print(f"case {case}: forces evaluated {evaluations} times, {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
