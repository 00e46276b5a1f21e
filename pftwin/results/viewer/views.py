"""From where the knee is looked at: a surgeon's four views, proximal (skyline: anterior) up."""

from __future__ import annotations

import numpy as np

from pftwin.results.viewer.matrices import MM
from pftwin.results.viewer.recorded import Recorded

DISTANCE = 370.0  # of the camera [mm]
# Where the camera stands from the joint, and what is up: femur axes x proximal, y lateral, z anterior.
_FROM = {
    "anterior": ((0.12, 0.12, 1.0), (1, 0, 0)),
    "lateral": ((0.05, 1.0, 0.15), (1, 0, 0)),
    "medial": ((0.05, -1.0, 0.15), (1, 0, 0)),
    "skyline": ((-1.0, 0.0, 0.25), (0, 0, 1)),
}


def views(result: Recorded) -> dict[str, list[float]]:
    """Cameras by name: place, target, up, nine numbers each [mm]."""
    center = MM * np.nanmean(result.data["sphere_center"].values, axis=0)
    target = np.array([center[0] + 8.0, center[1] * 0.5, center[2] - 12.0])
    found = {}
    for name, (toward, up) in _FROM.items():
        place = target + DISTANCE * np.asarray(toward) / np.linalg.norm(toward)
        found[name] = [float(v) for v in (*place, *target, *up)]
    return found
