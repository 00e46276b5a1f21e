"""Random lines over ellipsoids, against OpenSim: the row of docs/interchange.md.

    python tests/files/interchange/opensim_wraps.py --seed 2026

Twelve ellipsoids with semi-axes of 12 to 35 mm, turned by up to 29 deg about each axis; forty lines each between points
38 to 70 mm from the middle. Lines that OpenSim lets wrap are compared in length and in direction at the start. Needs
OpenSim's package from PyPI.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.append(str(Path(__file__).resolve().parents[2]))  # for what tests share

from test_osim_wrapping import compared, in_opensim

from pftwin.base.leaves import number, vector
from pftwin.base.runtime import configure
from pftwin.base.spatial import Quaternion
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid


def differences(rng: np.random.Generator) -> np.ndarray:
    """Of one ellipsoid's lines that wrap (n, 3): detour by the wrap [mm], |difference| in length [mm], angle [deg]."""
    radii, turn = rng.uniform(0.012, 0.035, 3), rng.uniform(-0.5, 0.5, 3)
    ends = rng.normal(size=(2, 40, 3))
    ends *= rng.uniform(0.038, 0.07, (2, 40, 1)) / np.linalg.norm(ends, axis=2, keepdims=True)
    pairs = ends.swapaxes(0, 1)
    axes = Quaternion(*map(number, Rotation.from_euler("XYZ", turn).as_quat(scalar_first=True)))
    theirs = in_opensim("ellipsoid", tuple(radii), pairs, rotation=turn)
    longer, angle = compared(Ellipsoid(vector((0, 0, 0)), "femur", vector(tuple(radii)), axes), pairs, theirs)
    detour = theirs[:, 0] - np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1)
    wraps = theirs[:, 1] > 2  # points of the path
    return np.stack([1e3 * detour, 1e3 * np.abs(longer), angle], axis=1)[wraps]


def main() -> None:
    """Prints the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seed", type=int, default=2026)
    rng = np.random.default_rng(options.parse_args().seed)
    configure()
    found = np.concatenate([differences(rng) for _ in range(12)])
    print("detour [mm]  lines  length [mm], up to  direction [deg], up to  within 0.1 mm and 0.5 deg")
    for low, high in ((0, 1), (1, 3), (3, 10), (10, 100), (0, 100)):
        _, length, angle = found[(found[:, 0] >= low) & (found[:, 0] < high)].T
        if length.size:
            near = np.mean((length < 0.1) & (angle < 0.5))
            print(f"{low:3} to {high:3}   {length.size:5}  {length.max():12.3g}  {angle.max():20.2g}  {near:22.0%}")


if __name__ == "__main__":
    main()
