"""Other readings of channels, from a motion that is a formula: which is found, in which words, and where none is."""

from __future__ import annotations

import numpy as np
import pytest
from linear_problems import objective
from scipy.spatial.transform import Rotation

from fitting.channel_checks import (
    LIMITS,
    Reading,
    limits_of,
    merged_readings,
    misread_channels,
    readings,
    residual_doubts,
    step_doubts,
)
from fitting.evaluation import StepError
from pftwin.base.errors import InputError

TIMES = np.linspace(0.0, 4.0, 101)
POSITION = np.stack([0.02 * np.sin(2 * TIMES), 0.008 + 0.002 * np.cos(3 * TIMES), 0.045 + 0.004 * TIMES], axis=1)
FORCES = np.stack([12 + 3 * np.sin(2 * TIMES), 20 + 8 * np.sin(3 * TIMES)], axis=1)
TURNS = np.roll(Rotation.from_rotvec(np.outer(TIMES, [0.1, 0.3, 0.05])).as_quat(), 1, axis=1)
SCALES = np.array([0.8, 1.0, 1.3])  # of the trial motions' forces


def target(channels, measured, widths):
    rows = np.repeat(np.arange(len(channels)), [3 if c in ("position", "orientation") else 1 for c in channels])
    ends = np.cumsum(widths)
    there = [np.isfinite(measured[:, e - w : e]).all(axis=1) for e, w in zip(ends, widths, strict=True)]
    return objective(
        measured, None, channels=channels, groups=channels, group_of=rows, present=np.stack(there, axis=1)[:, rows]
    )


def read(channels, measured, truth, widths):
    trials = np.stack([truth * s if widths[-1] == 1 else truth for s in SCALES])
    return [(r.channels, r.words, r.times) for r in readings(target(channels, measured, widths), trials)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: 1000 * p, "1000 times too large: in millimetres"),
        (lambda p: p / 0.0254, "39 times too large: in inches"),
        (lambda p: p / 1000, "1000 times too small: turned from millimetres to metres twice"),
        (lambda p: p * [1, -1, 1], "like (x, -y, z) in the place of (x, y, z) (mirrored)"),
        (lambda p: p[:, [2, 0, 1]], "like (y, z, x) in the place of (x, y, z)"),
        (lambda p: 100 * p[:, [0, 2, 1]] * [1, -1, 1], "100 times too large: in centimetres and like (x, z, -y)"),
    ],
)
def test_positions_in_other_units_and_axes(change, words):
    measured = change(POSITION) + 0.0
    measured[10:14] = np.nan
    [(channels, said, times)] = read(("position",), measured, POSITION, (3,))
    assert channels == ("position",)
    assert said.startswith(words)
    assert times > 4


def test_positions_as_they_are_and_a_millimetre_off_have_no_other_reading():
    for off in (0.0, 1e-3, -3e-3):
        assert read(("position",), POSITION + off, POSITION, (3,)) == []


def test_positions_in_millimetres_are_not_called_mirrored_too_because_the_twin_happens_to_be_nearer_to_that():
    """With other loads the twin's patella is 9.5 mm from the measured one, and 7.1 mm from its mirror image."""
    elsewhere = POSITION - [0.0, 0.0095, 0.0]
    [(_, said, times)] = read(("position",), 1000 * POSITION, elsewhere, (3,))
    assert said == "1000 times too large: in millimetres"
    assert times > 100
    [(_, _, times)] = read(("position",), POSITION, elsewhere, (3,))
    assert times < LIMITS["reading"][0]


def test_a_frame_turned_by_half_is_named_so_although_the_twin_is_off():
    """Turned about z, with the twin 15 mm off along it: beside the mirror images by x and by y."""
    [(_, said, times)] = read(("position",), POSITION * [-1, -1, 1] + [0, 0, 15e-3], POSITION, (3,))
    assert said == "like (-x, -y, z) in the place of (x, y, z)"
    assert times > LIMITS["reading"][0]


def test_positions_of_zero_are_no_other_reading():
    assert read(("position",), 0 * POSITION, POSITION, (3,)) == []


@pytest.mark.parametrize("off", [[0.2, 0.2, 0.2], [0.0, -0.4, 0.1], [3.0, 2.0, 5.0]])
def test_positions_in_a_frame_far_off_are_not_taken_for_other_units(off):
    assert all("too large" not in said for _, said, _ in read(("position",), POSITION + off, POSITION, (3,)))


def test_a_trial_whose_tendon_hangs_slack_is_resembled_by_nothing():
    """Its force is as good as zero, as is that of any numbers in smaller units."""
    force = FORCES[:, :1]
    trials = np.stack([1.4 * force, 0.7 * force, 1e-3 * force])
    assert list(readings(target(("quadriceps",), force, (1,)), trials)) == []
    [reading] = readings(target(("quadriceps",), 1e3 * force, (1,)), trials)
    assert "1000 times too large" in reading.words
    wide = np.stack([force, 20 * force, 30 * force, 1e-3 * force])
    assert list(readings(target(("quadriceps",), 1.02 * force, (1,)), wide)) == []


def test_orientations_the_other_way_round_or_with_the_scalar_last():
    for measured, words in (
        (TURNS * [1, -1, -1, -1], "turned the other way"),
        (np.roll(TURNS, -1, 1), "the scalar last"),
    ):
        [(_, said, times)] = read(("orientation",), measured, TURNS, (4,))
        assert words in said
        assert times > 10
    assert read(("orientation",), TURNS, TURNS, (4,)) == []
    assert read(("orientation",), -TURNS, TURNS, (4,)) == []  # the same orientation


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda f: f / 9.80665, "9.81 times too small: in kilograms-force"),
        (lambda f: -f / 1000, "negated and 1000 times too small: in kilonewtons"),
        (lambda f: 0.9 * f, ""),  # within what the trial motions pull with
        (lambda f: f[:, ::-1], "swapped"),
    ],
)
def test_forces(change, found):
    said = read(("one", "other"), change(FORCES), FORCES, (1, 1))
    words = [w for _, w, times in said if times > LIMITS["reading"][0]]
    assert set(words) == ({found} if found else set())
    if found == "swapped":
        assert said[-1][0] == ("one", "other")


def test_pounds_are_found_also_where_some_trials_press_hundreds_of_times_harder():
    """As trials with a short and stiff tendon do."""
    force = FORCES[:, :1]
    trials = np.stack([scale * force for scale in (0.6, 0.9, 1.3, 100.0, 500.0)])
    [reading] = readings(target(("contact",), force / 4.4482216, (1,)), trials)
    assert reading.words == "4.45 times too small: in pounds-force"
    assert reading.times == pytest.approx((0.6 - 1 / 4.4482216) / 0.1, rel=1e-6)  # nearest trials: 0.6 and 0.9
    assert list(readings(target(("contact",), force, (1,)), trials)) == []


def test_a_reading_between_the_limits_is_named_and_beyond_them_refused():
    halfway = POSITION * [1, -1, 1]
    times = read(("position",), halfway, POSITION, (3,))[0][2]
    objective, trials = target(("position",), halfway, (3,)), POSITION[None]
    [said] = misread_channels(objective, trials, limits_of({"reading": (1.5, 2 * times)}))
    assert said.startswith("measured positions look like (x, -y, z)")
    assert misread_channels(objective, trials, limits_of({"reading": (2 * times, 3 * times)})) == []
    with pytest.raises(InputError, match=r"mirrored.*correct the file.*--limit reading=1\.5:"):
        misread_channels(objective, trials, LIMITS)


def test_what_is_left_over_is_named_by_size_and_by_the_stated_noise():
    objective = target(("position", "one"), np.concatenate([POSITION, FORCES[:, :1]], axis=1), (3, 1))
    left = np.zeros((101, 4))
    left[:, 0], left[:, 3] = 0.012, 2.0
    said = residual_doubts(objective, left, LIMITS, None)
    size = np.sqrt(np.mean(FORCES[:, 0] ** 2))
    assert said == ["residual of position: 12 mm rms", f"residual of one: 2 N rms of {size:.3g} N measured"]
    noisy = residual_doubts(objective, 0.1 * left, LIMITS, {"position": 1.2e-3 / np.sqrt(3) / 50, "one": 0.1})
    assert noisy == ["residual of position: 1.2 mm rms, 50 times the stated noise"]
    with pytest.raises(InputError, match="residual of one: 8 N rms"):
        residual_doubts(objective, 4 * left * [0, 0, 0, 1], LIMITS, None)
    doubt = "measured one looks 4.45 times too small: in pounds-force"
    with pytest.raises(
        InputError, match=f"residual of one: 8 N rms.*try: {doubt}; check unit, sign and channel of one"
    ):
        residual_doubts(objective, 4 * left * [0, 0, 0, 1], LIMITS, None, [doubt])


def test_steps_whose_error_is_large_or_not_known_are_named():
    left = {"position": 5e-4, "orientation": 0.02}
    errors = {"position": StepError(4e-4, True), "orientation": StepError(0.005, True)}
    said = "the fit's time steps cause an error of 0.4 mm rms of position, beside a residual of 0.5 mm"
    assert step_doubts(errors, left, {}) == [said]
    assert step_doubts({"position": StepError(4e-4, False)}, left, {}) == []
    assert "not known" in step_doubts({}, left, {})[0]
    turned = step_doubts({"orientation": StepError(np.radians(1.5), True)}, {"orientation": np.radians(2.0)}, {})
    assert turned == ["the fit's time steps cause an error of 1.5 deg rms of orientation, beside a residual of 2 deg"]
    pulled = step_doubts({"quadriceps": StepError(0.4, True)}, {"quadriceps": 0.5}, {})
    assert pulled == ["the fit's time steps cause an error of 0.4 N rms of quadriceps, beside a residual of 0.5 N"]


def test_only_forces_or_readings_of_one_unit_are_named_together():
    """A marker in millimetres looks like positions in millimetres, which have a message of their own."""
    words = "1000 times too large: in millimetres"
    found = [
        Reading(("position",), words, 30.0),
        Reading(("m1.x",), words, 20.0),
        Reading(("m2.x",), words, 25.0),
        Reading(("quadriceps",), "negated", 4.0),
        Reading(("strain",), "negated", 3.0),
        Reading(("contact", "quadriceps"), "swapped", 2.5),
    ]
    units = {"m1.x": "m", "m2.x": "m", "strain": "1"}
    channels = [(r.channels, r.times) for r in merged_readings(found, units)]
    assert channels == [
        (("position",), 30.0),
        (("m1.x", "m2.x"), 25.0),
        (("quadriceps",), 4.0),
        (("strain",), 3.0),
        (("contact", "quadriceps"), 2.5),
    ]
