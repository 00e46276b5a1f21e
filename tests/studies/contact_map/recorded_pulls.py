"""What pulls on the patella in the DM recording: forces in the femur's axes, frame by frame.

The recorded tensions are elastic ones at poses at rest. Here they act along lines from the data; the ligaments'
viscous part follows from the strands' own `damping`, as in the model that made the recording (Blankevoort strands:
k c times the strain rate while they lengthen). That model's LPFL runs over an ellipsoid on the femur, "lPFL_r" of
DM.osim in opensim-jam-org/jam-resources (Apache-2.0), whose place and size are given below.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from wrapped_line import Ellipsoid

from pftwin.base.arrays import Floats
from pftwin.files.mocap import PoseSeries, read_csv

MUSCLES = ("recfem", "vasint", "vaslat", "vasmed")
LIGAMENTS = {"PT": "patellar_tendon", "MPFL": "mpfl", "LPFL": "lpfl"}
TOE_STRAIN = 0.06
WEIGHT = 9.81 * 0.449  # [N]
# DM.osim: the component's frame in the femur, and the ellipsoid there; body-fixed angles [rad], [m].
IMPLANT_AT, IMPLANT_TURN = np.array([0.00800132, -0.418005, -0.0039984]), (-3.12413977, -9.88335384e-06, -3.05956442)
WRAP_AT, WRAP_TURN = np.array([0.0197, -0.4203, 0.0212]), (-0.1569051, 0.29286625, -0.28989919)
WRAP_RADII = np.array([0.02, 0.035, 0.013])


def lpfl_wrap() -> Ellipsoid:
    """The ellipsoid in the femoral component's frame."""
    implant, own = (Rotation.from_euler("XYZ", a).as_matrix() for a in (IMPLANT_TURN, WRAP_TURN))
    return Ellipsoid(implant.T @ (WRAP_AT - IMPLANT_AT), implant.T @ own, WRAP_RADII)


@dataclass(frozen=True)
class Strand:
    """One strand at every frame."""

    on_patella: Floats  # (n, 3) in the femur's frame [m]
    other_end: Floats  # (n, 3)
    stiffness: float  # [N per strain]
    slack: float  # [m]
    damping: float  # [s]

    def tension(self, length: Floats | float) -> Floats:
        """Elastic tension at lengths [N]."""
        strain = np.maximum(np.asarray(length) / self.slack - 1, 0)
        toe = 0.5 * strain**2 / TOE_STRAIN
        return self.stiffness * np.where(strain < TOE_STRAIN, toe, strain - TOE_STRAIN / 2)

    def viscous(self, times: Floats) -> Floats:
        """Viscous tension (n,) along the straight line, while the strand is taut and lengthens [N]."""
        length = np.linalg.norm(self.other_end - self.on_patella, axis=1)
        rate = np.gradient(length, times) / self.slack
        return np.where(length > self.slack, self.stiffness * self.damping * np.maximum(rate, 0), 0)


class Recording:
    """The files of a folder, in the femur's frame."""

    def __init__(self, folder: Path, poses: dict[str, PoseSeries]) -> None:
        self.times = poses["patella"].times
        self.bodies = {body: p.relative_to(poses["femur"]) for body, p in poses.items()}
        self.to_femur = poses["femur"].matrices()
        self.tensions = read_csv(folder / "passive_flexion_tensions.csv")
        self.muscles = read_csv(folder / "passive_flexion_quadriceps.csv")
        self.strands: dict[str, list[Strand]] = {kind: [] for kind in LIGAMENTS}
        for name, s in json.loads((folder / "ligaments.json").read_text()).items():
            ends = dict(s["points"])
            (body,) = set(ends) - {"patella"}
            self.strands[name.rstrip("0123456789")].append(
                Strand(
                    self.place("patella", ends["patella"]),
                    self.place(body, ends[body]),
                    s["linear_stiffness_N_per_strain"],
                    s["slack_length_m"],
                    s["damping"],
                )
            )

    def place(self, body: str, point: Floats) -> Floats:
        """A body's point or points in the femur's frame (n, 3)."""
        at = self.bodies[body]
        return at.positions + np.einsum("nij,nj->ni", at.matrices(), np.broadcast_to(point, at.positions.shape))

    def muscles_and_weight(self) -> Floats:
        """(n, 3) [N]."""
        weight = np.broadcast_to([0.0, -WEIGHT, 0.0], (self.times.size, 3))
        total = np.einsum("nji,nj->ni", self.to_femur, weight)
        for muscle in MUSCLES:
            via, own = (
                self.muscles.select([f"{muscle}_{k}_{c}" for c in "xyz"]).values
                for k in ("via_femur", "insertion_patella")
            )
            total += self.muscles.column(f"{muscle}_tension")[:, None] * _unit(via - self.place("patella", own))
        return total

    def straight(self, kind: str) -> Floats:
        """(n, 3) the recorded tension [N], all strands sharing it alike."""
        lines = [_unit(s.other_end - s.on_patella) for s in self.strands[kind]]
        return self.tensions.column(LIGAMENTS[kind])[:, None] * np.mean(lines, axis=0)

    def viscous(self, kind: str) -> Floats:
        """(n, 3) [N]."""
        parts = [s.viscous(self.times)[:, None] * _unit(s.other_end - s.on_patella) for s in self.strands[kind]]
        return np.sum(parts, axis=0)

    def wrapped_lpfl(self, frames: Floats) -> tuple[Floats, Floats]:
        """The LPFL around its ellipsoid: forces (k, 3) and total tensions (k,) [N], elastic, at some frames."""
        wrap, forces = lpfl_wrap(), np.zeros((len(frames), 3))
        tensions = np.zeros(len(frames))
        for row, i in enumerate(frames):
            for s in self.strands["LPFL"]:
                length, way = wrap.wrapped(s.on_patella[i], s.other_end[i])
                tension = float(s.tension(length))
                forces[row] += tension * way
                tensions[row] += tension
        return forces, tensions


def _unit(v: Floats) -> Floats:
    return v / np.linalg.norm(v, axis=1, keepdims=True)
