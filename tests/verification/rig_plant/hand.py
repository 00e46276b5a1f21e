"""Synthetic hand-guided motion of the virtual rig's femur and tibia, of which the rig's markers are noisy samples.

It starts at 45 deg of flexion and makes two flexions and two extensions, unsteady and slightly different in each case.
In cases 2 and 3 the first extension is only partial, as in the paper (Michaud et al. 2024, section 2.1).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pftwin.rig.geometry import DURATION, HIP, RATE

if TYPE_CHECKING:
    from pftwin.files.mocap.poses import PoseSeries

# Turning points: time [s], knee flexion [deg].
_FULL = ((0, 45), (0.6, 45), (1.7, 88), (3.1, 6), (4.5, 86), (5.9, 0), (7.2, 52))
_PARTIAL = ((0, 45), (0.6, 45), (1.7, 88), (3.1, 50), (4.5, 86), (5.9, 0), (7.2, 52))
_SMOOTHING = 0.08  # [s]


def hand_motion(case: int) -> tuple[PoseSeries, PoseSeries]:
    """Returns the poses of femur and tibia in the world at the rig's frames."""
    from scipy.spatial.transform import Rotation

    from pftwin.files.mocap.poses import PoseSeries

    times = np.arange(round(DURATION * RATE) + 1) / RATE
    random = np.random.default_rng(100 + case)
    flexion = _flexion(times, case, random)
    active = _active(times)
    hip = np.stack(
        [
            _wobble(times, random, 1.5) * active,
            -0.06 * (flexion - flexion[0]) - _wobble(times, random, 1.0) * active,
            _wobble(times, random, 1.2) * active,
        ],
        axis=1,
    )
    femur_turn = Rotation.from_rotvec(np.radians(hip))
    femur_origin = np.array(HIP) - femur_turn.apply(np.array(HIP))
    adduction, internal = _wobble(times, random, 0.8) * active, 0.05 * flexion + _wobble(times, random, 1.0) * active
    tibia_in_femur = Rotation.from_euler("YZX", np.stack([-flexion, adduction, internal], axis=1), degrees=True)
    rollback = np.stack([0 * flexion, 0 * flexion, -4e-5 * flexion], axis=1)
    tibia_turn = femur_turn * tibia_in_femur
    tibia_origin = femur_origin + femur_turn.apply(rollback)
    femur, tibia = (
        PoseSeries(times, origin, turn.as_quat(scalar_first=True), source=f"hand, case {case}")
        for origin, turn in ((femur_origin, femur_turn), (tibia_origin, tibia_turn))
    )
    return femur, tibia


def _flexion(times: NDArray, case: int, random: np.random.Generator) -> NDArray:
    """Knee flexion [deg]."""
    from scipy.interpolate import PchipInterpolator
    from scipy.ndimage import gaussian_filter1d

    knots = np.array(_PARTIAL if case in (2, 3) else _FULL, dtype=float)
    knots[2:-1, 0] += random.uniform(-0.08, 0.08, len(knots) - 3)
    knots[[2, 4], 1] += random.uniform(-2, 2, 2)
    smooth = gaussian_filter1d(PchipInterpolator(*knots.T)(times), _SMOOTHING * RATE, mode="nearest")
    return smooth + _wobble(times, random, 0.6) * _active(times)


def _active(times: NDArray) -> NDArray:
    """Smooth step from 0, while the leg is held still at the start, to 1."""
    s = np.clip((times - 0.35) / 0.6, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s * s)


def _wobble(times: NDArray, random: np.random.Generator, size: float) -> NDArray:
    """Unsteadiness of the hand: four sinusoids between 0.3 and 2 Hz, smaller at higher frequency [deg]."""
    total = np.zeros_like(times)
    for frequency in random.uniform(0.3, 2.0, 4):
        total += np.sin(2 * np.pi * (frequency * times + random.uniform())) / (1 + frequency**2)
    return 0.7 * size * total
