"""Cases of motion and of time: jumps, noise, speed, length, steps, signs of quaternions, weight the other way."""

from __future__ import annotations

import numpy as np

from pftwin.dynamics.status import Status
from pftwin.mocap.poses import PoseSeries
from pftwin.studies.hard_cases.case import Case, Expected
from pftwin.studies.hard_cases.knee import FRAMES, RATE, Knee, flexed, swinging

TOPIC = "motion and time"
LONG = 60.0  # [s]
_NOISE = (0.5e-3, 0.3)  # of positions [m] and of flexion [deg], standard deviations


def _flexion(n: int = FRAMES) -> np.ndarray:
    return 45 + 20 * np.sin(2 * np.pi * np.arange(n) / RATE / 1.8) ** 2


def _jumping() -> PoseSeries:
    """One frame is 20 mm and 15 deg off, as where two markers change places."""
    angles, positions = _flexion(), np.zeros((FRAMES, 3))
    angles[25] += 15
    positions[25] = (0.0, 0.02, 0.0)
    return flexed(angles, positions)


def _noisy() -> PoseSeries:
    random = np.random.default_rng(7)
    positions = random.normal(0, _NOISE[0], (FRAMES, 3))
    return flexed(_flexion() + random.normal(0, _NOISE[1], FRAMES), positions)


def _flipped() -> PoseSeries:
    """Every third quaternion with the other sign: the same rotations."""
    plain = swinging()
    signs = np.where(np.arange(FRAMES) % 3 == 1, -1.0, 1.0)[:, None]
    return PoseSeries(plain.times, plain.positions, plain.quaternions * signs, source="tibia")


def _all_signs_flipped() -> PoseSeries:
    plain = swinging()
    return PoseSeries(plain.times, plain.positions, -plain.quaternions, source="tibia")


def _long() -> PoseSeries:
    return swinging(round(LONG * RATE) + 1)


def _plain() -> Knee:
    return Knee()


CASES = (
    Case(
        "plain_knee",
        TOPIC,
        "The knee that other cases vary, in a slow flexion: nothing is hard, all is met.",
        _plain,
        Expected(smooth=True),
    ),
    Case(
        "quaternion_signs_flip",
        TOPIC,
        "Every third recorded quaternion has the other sign, which is the same rotation: the same motion.",
        lambda: Knee(tibia=_flipped),
        Expected(smooth=True, same_as="plain_knee"),
    ),
    Case(
        "quaternions_all_negative",
        TOPIC,
        "All recorded quaternions have the other sign: the same motion.",
        lambda: Knee(tibia=_all_signs_flipped),
        Expected(smooth=True, same_as="plain_knee"),
    ),
    Case(
        "jump_of_one_frame",
        TOPIC,
        "One frame of the tibia is 20 mm and 15 deg off: the interpolated motion has 4 m/s in it, and tendons jerk.",
        lambda: Knee(tibia=_jumping),
        Expected(),
    ),
    Case(
        "noise",
        TOPIC,
        "Unfiltered noise of 0.5 mm and 0.3 deg on every frame of the tibia.",
        lambda: Knee(tibia=_noisy),
        Expected(),
    ),
    Case(
        "ten_times_too_fast",
        TOPIC,
        "The same flexion in a tenth of the time: the tibia turns at up to 7 rad/s and back, and the patella may"
        " be thrown"
        " out of its groove.",
        lambda: Knee(tibia=lambda: swinging(speed=10.0)),
        Expected(),
    ),
    Case(
        "gravity_reversed",
        TOPIC,
        "Weight pulls out of the groove: tendons alone hold the patella in.",
        lambda: Knee(gravity=(0.0, 0.0, 9.81)),
        Expected(smooth=True),
    ),
    Case(
        "step_of_50_us",
        TOPIC,
        "Steps of 0.05 ms, 10,000 of them: rounding must not add up.",
        _plain,
        Expected(smooth=True),
        step=5e-5,
    ),
    Case(
        "step_of_5_ms",
        TOPIC,
        "Steps of 5 ms, twenty times the contact's own time constant: stable where the method is implicit, else"
        " refused.",
        _plain,
        Expected(smooth=True),
        step=5e-3,
    ),
    Case(
        "step_of_10_ms",
        TOPIC,
        "Steps of 10 ms, as long as a frame: stable where the method is implicit, else refused.",
        _plain,
        Expected(may=Status.STEP_TOO_LONG, smooth=True),
        step=1e-2,
    ),
    Case(
        "motion_of_60_s",
        TOPIC,
        "60 s of flexion and extension, 66 times the same: the quaternion stays one, nothing drifts from cycle"
        " to cycle.",
        lambda: Knee(tibia=_long),
        Expected(),
        step=2.5e-3,
        contacts=("P5", "spline"),
        group="long",
    ),
)
