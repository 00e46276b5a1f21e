"""The quadriceps of an implanted knee (DM) while it bends, as OpenSim has it: lengths and tensions."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.files.interchange.osim_document import read_osim
from pftwin.files.interchange.osim_knee import find_knee
from pftwin.files.interchange.osim_model import read_model
from pftwin.files.interchange.osim_motion import Motion, poses
from pftwin.files.interchange.osim_muscle_force import MILLARD, read_force
from pftwin.files.interchange.osim_muscle_path import MovingBodies, path_over_motion
from pftwin.files.interchange.osim_wraps import Wraps, wraps_of

MUSCLES = ("recfem_r", "vasint_r", "vaslat_r", "vasmed_r")
TIBIA, PATELLA = (("flex", "add", "rot", "tx", "ty", "tz"), ("flex", "rot", "tilt", "tx", "ty", "tz"))
COORDINATES = [f"knee_{k}_r" for k in TIBIA] + [f"pf_{k}_r" for k in PATELLA]
# Of the simulated passive flexion, at 0, 25, 53, 71 and 90 deg: tibia, then patella.
ROWS = [
    [
        [3.7e-05, -0.036286, 0.016886, -0.005818, 0.008152, -0.008775],
        [0.054473, -0.02, 0.007347, 0.052102, 0.005798, 0.000306],
    ],
    [
        [0.43455, -0.036372, 0.011533, -0.002375, 0.013085, -0.008794],
        [0.336272, -0.06295, 0.01935, 0.04629, -0.012084, -2e-05],
    ],
    [
        [0.930511, -0.04037, 0.017862, 0.005426, 0.013671, -0.008803],
        [0.609939, -0.088096, 0.116934, 0.031568, -0.027879, 0.001653],
    ],
    [
        [1.235529, -0.041883, 0.028986, 0.009555, 0.010391, -0.00884],
        [0.821624, -0.070529, 0.18538, 0.020454, -0.032693, 0.002292],
    ],
    [
        [1.573451, -0.042666, 0.044352, 0.011973, 0.004091, -0.008932],
        [1.07201, -0.029736, 0.240823, 0.007972, -0.034153, 0.00239],
    ],
]
LENGTHS = np.array(  # of OpenSim 4.6, wrapping included [m]
    [
        [0.4423754, 0.1890454, 0.194052, 0.1764762],
        [0.4638865, 0.2090078, 0.2125455, 0.1979856],
        [0.4845058, 0.227635, 0.2304087, 0.2169272],
        [0.494059, 0.2364715, 0.2404423, 0.2256445],
        [0.5038885, 0.2459776, 0.251217, 0.2349094],
    ]
)
TENSIONS = np.array(  # of OpenSim 4.6, at these lengths and an activation of 0.02, at rest [N]
    [
        [5.194, 1.383, 0.002, 6.809],
        [14.165, 13.942, 14.41, 16.792],
        [20.274, 18.371, 32.239, 21.744],
        [38.375, 19.774, 36.188, 23.878],
        [75.276, 20.42, 40.093, 25.096],
    ]
)


@pytest.fixture(scope="module")
def knee(dm_knee):
    """The muscles' elements, their straight paths, and their paths over cylinders."""
    root = read_osim(dm_knee / "DM.osim")
    found = read_model(root)
    bones = find_knee(found, "right")
    times = np.linspace(0, 1, len(ROWS))
    values = dict(zip(COORDINATES, np.reshape(ROWS, (len(ROWS), -1)).T, strict=True))
    placed = poses(found.tree, [bones.femur, bones.tibia, bones.patella], times, values)
    bodies = MovingBodies(bones, Motion(times, placed, "", values=values))
    elements = {m.name: m for m in root.all(MILLARD) if m.name in MUSCLES}
    wraps = {name: wraps_of(elements[name], Wraps(bones))[0] for name in MUSCLES}
    straight, wrapped = (
        {name: path_over_motion(elements[name], bodies, wraps[name] if over else ()) for name in MUSCLES}
        for over in (False, True)
    )
    return elements, straight, wrapped


def test_lengths_are_opensims_until_they_wrap(knee):
    """What wrapping adds: nothing up to 25 deg, and ever more from 53 deg on; the vastus lateralis wraps first."""
    short = LENGTHS - np.stack([knee[1][name].lengths for name in MUSCLES], axis=1)
    np.testing.assert_allclose(short[:2], 0, atol=2e-7)
    assert (short > -2e-7).all()
    np.testing.assert_allclose(1e3 * short[2:].max(axis=1), [0.2, 1.9, 5.8], atol=0.1)


def test_lengths_are_opensims_where_they_wrap(knee):
    """Over cylinders, to 0.01 mm."""
    found = np.stack([knee[2][name].lengths for name in MUSCLES], axis=1)
    np.testing.assert_allclose(found, LENGTHS, atol=2e-5)
    np.testing.assert_allclose(found[:2], LENGTHS[:2], atol=4e-7)


def test_tensions_are_opensims_at_its_lengths(knee):
    for name, lengths, expected in zip(MUSCLES, LENGTHS.T, TENSIONS.T, strict=True):
        found = read_force(knee[0][name], {}).tensions(lengths, np.full(len(ROWS), 0.02))
        np.testing.assert_allclose(found, expected, atol=2e-3, err_msg=name)
