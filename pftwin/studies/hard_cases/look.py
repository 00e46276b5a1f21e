"""One case's run on the host, as checks see it, and what they tolerate: stated here and nowhere else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.studies.hard_cases.case import UNKNOWN, HardCase
from pftwin.studies.hard_cases.knee import KneeNumbers
from pftwin.studies.hard_cases.programs import CaseRun

Floats = NDArray[np.float64]


class Tolerance(NamedTuple):
    """By float type."""

    unit: float  # of the quaternion's length
    created: float  # energy from nowhere, as a share of the largest that moves; times the milliseconds of longer steps
    least: float  # and energy below which nothing is said [J]
    place: float  # of depths found in two ways [m]
    symmetric: float  # [m] and of quaternion components
    same: float  # of two runs that have to be one [m] and of quaternion components
    still: float  # [m] of what must not move


TOLERANCES = {
    "float64": Tolerance(1e-9, 0.02, 1e-6, 2e-5, 1e-7, 1e-7, 1e-6),
    "float32": Tolerance(1e-5, 0.02, 1e-4, 5e-5, 1e-3, 2e-3, 2e-4),
}


class Look(NamedTuple):
    """One case's run on the host, with what the checks need."""

    case: HardCase
    knee: KneeNumbers
    contact: str
    run: CaseRun
    tolerance: Tolerance
    step: float  # [s]
    depth: Floats  # (n,) of the button in the surface, by exhaustive search [m]
    inertia: bool = True  # whether the motion has any: what moves then has kinetic energy

    @property
    def flags(self) -> NDArray[np.int64]:
        """(n,) bits of `Status`."""
        return np.asarray(self.run.seen.status, dtype=np.int64)

    def report(self, name: str) -> Floats:
        """(n,) what the contact reports."""
        return np.asarray(self.run.seen.effects["contact"][name], dtype=np.float64)

    def kinetic(self) -> Floats:
        """(n,) energy of the motion [J]; none in a motion without inertia, whatever its rates are."""
        seen = np.asarray(self.run.seen.kinetic_energy, np.float64)
        return seen if self.inertia else 0.0 * seen

    def clean(self) -> NDArray[np.bool_]:
        """(n,) frames before the first that the run refuses itself."""
        return np.cumsum(self.flags & int(UNKNOWN)) == 0

    def indentation(self) -> Floats:
        """(n,) the larger of the two facets' [m]."""
        return np.fmax(self.report("indentation_medial"), self.report("indentation_lateral"))
