"""The tibial motions of cases, by name: plain, noisy, jumping, with quaternions of either sign, and broken."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pftwin.files.mocap.poses import PoseSeries
from pftwin.studies.hard_cases.knee import FRAMES, RATE, Floats, flexed, flexion, standing, swinging

_NOISE = (0.5e-3, 0.3)  # of positions [m] and of flexion [deg], standard deviations
_LONG = 60.0  # [s]


def _jumping() -> PoseSeries:
    """One frame is 20 mm and 15 deg off, as where two markers change places."""
    angles, positions = flexion(FRAMES), np.zeros((FRAMES, 3))
    angles[25] += 15
    positions[25] = (0.0, 0.02, 0.0)
    return flexed(angles, positions)


def _noisy() -> PoseSeries:
    random = np.random.default_rng(7)
    positions = random.normal(0, _NOISE[0], (FRAMES, 3))
    return flexed(flexion(FRAMES) + random.normal(0, _NOISE[1], FRAMES), positions)


def _with(**changes: Callable[[Floats], Floats]) -> Callable[[], PoseSeries]:
    """The plain motion with times, positions or quaternions changed."""

    def made() -> PoseSeries:
        plain, same = swinging(), lambda a: a
        arrays = (changes.get(n, same)(getattr(plain, n)) for n in ("times", "positions", "quaternions"))
        return PoseSeries(*arrays, source="tibia")

    return made


_frame = np.arange(FRAMES)
MOTIONS: Mapping[str, Callable[[], PoseSeries]] = {
    "standing": standing,
    "swinging": swinging,
    "jumping": _jumping,
    "noisy": _noisy,
    "signs_flip": _with(quaternions=lambda q: np.where(_frame % 3 == 1, -1.0, 1.0)[:, None] * q),
    "all_negative": _with(quaternions=lambda q: -q),
    "ten_times_faster": lambda: swinging(speed=10.0),
    "long": lambda: swinging(round(_LONG * RATE) + 1),
    "three_frames": lambda: flexed(np.full(3, 45.0)),
    "uneven": _with(times=lambda t: np.where(_frame < 20, t, t + 0.02)),
    "not_finite": _with(positions=lambda x: np.where(_frame[:, None] == 3, np.nan, x)),
    "not_unit": _with(quaternions=lambda q: 1.1 * q),
}
