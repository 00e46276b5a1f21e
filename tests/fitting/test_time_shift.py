"""Shifts in time of channels whose motion is a formula, with white noise and with the slow errors of a wrong model."""

from __future__ import annotations

import numpy as np
import pytest
from linear_problems import objective

from fitting.channel_checks import LIMITS
from fitting.time_shift import late_channels, time_shifts
from pftwin.base.errors import InputError

TIMES = np.linspace(0.0, 4.0, 401)
RATES = np.array([4.0, 5.3, 3.1, 4.6])  # of three coordinates and a force [rad/s]
SIZES = np.array([0.02, 0.003, 0.01, 20.0])
NOISE = np.array([1e-4, 1e-4, 1e-4, 0.1])


PHASES = np.arange(4.0)


def course(times):
    return np.asarray(SIZES * np.sin(np.outer(times, RATES) + PHASES), dtype=np.float64)


def shifts(late, error=0.0, gaps=False):
    """Of the formula's motion, later by so much in each channel; parameters are the force's scale and an offset."""
    random = np.random.default_rng(0)
    measured = np.concatenate([course(TIMES - late[0])[:, :3], course(TIMES - late[1])[:, 3:]], axis=1)
    measured = measured + error + NOISE * random.normal(size=measured.shape)
    if gaps:
        measured[50:90, :3] = measured[200:203, 3:] = np.nan
    slopes = np.zeros((401, 4, 2))
    slopes[:, 3, 0], slopes[:, 0, 1] = course(TIMES)[:, 3], 1.0
    return time_shifts(objective(measured, None), TIMES, course(TIMES), slopes)


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("late", [(0.0, 0.0), (0.03, 0.0), (-0.043, 0.025)])
def test_a_shift_is_found_with_its_deviation(late, gaps):
    found = shifts(late, gaps=gaps)
    for s, true in zip(found.values(), late, strict=True):
        assert s.seconds == pytest.approx(true, abs=max(3 * s.deviation, 2e-4))
        assert s.deviation < 2e-3
        assert s.exceeds(0.02) == (abs(true) > 0.02)


def test_the_deviation_is_that_of_repeats():
    """Of a phase in white noise: Cramer and Rao's bound is the noise over the root of the summed squared slopes."""
    slope = np.gradient(course(TIMES), TIMES, axis=0)[20:-20] / NOISE
    bound = 1 / np.sqrt(np.sum(slope[:, :3] ** 2))
    found = shifts((0.03, 0.0))["position"]
    assert 0.7 * bound < found.deviation < 3 * bound


def test_a_slow_error_of_the_model_is_no_shift():
    """A force that lags by friction, and a drift of positions, as large as a shift of 30 ms would make them."""
    drift = 1e-3 * np.sin(0.7 * TIMES)[:, None] * [1.0, 1.0, 1.0, 0.0]
    friction = -1.5 * np.sign(np.cos(RATES[3] * TIMES + 3.0))[:, None] * [0.0, 0.0, 0.0, 1.0]
    assert not any(s.exceeds(LIMITS["shift"][0]) for s in shifts((0.0, 0.0), drift + friction).values())


def test_a_lead_that_friction_hides_in_part_is_named():
    """A force 80 ms early, and friction of a sixth of it, which makes it lag: together they look 29 ms early."""
    friction = -3.5 * np.sign(np.cos(RATES[3] * TIMES + 3.0))
    rough = 0.3 * np.random.default_rng(1).normal(size=401)
    found = shifts((0.0, -0.08), np.outer(friction + rough, [0.0, 0.0, 0.0, 1.0]))["contact"]
    assert found.seconds == pytest.approx(-0.029, abs=0.004)
    assert 0.1 < found.explained < 1 / 6
    assert found.exceeds(LIMITS["shift"][0])


def test_words_and_the_refusal():
    found = shifts((0.05, -0.15))
    with pytest.raises(
        InputError, match=r"measured contact comes 150 ms .* early .* move its times by \+150 ms; or limits"
    ):
        late_channels(found, "a file", LIMITS)
    said = late_channels({"position": found["position"]}, "a file", LIMITS)
    assert len(said) == 1
    assert said[0].startswith("measured position is 50 ms (+- ")
    assert said[0].endswith(" late against the motion of the bones, of which friction in the joint can be a part")


def test_a_short_recording_and_one_that_does_not_move_have_no_shift():
    still = np.zeros((401, 4))
    assert time_shifts(objective(still + 1e-3, None), TIMES, still, np.zeros((401, 4, 2))) == {}
    few = slice(0, 15)
    assert time_shifts(objective(course(TIMES)[few], None), TIMES[few], course(TIMES)[few], np.zeros((15, 4, 2))) == {}


@pytest.mark.parametrize("late", [0.28, -0.35])
def test_a_delay_longer_than_the_search_range_is_reported(late):
    """Less than 0.2 s is searched, in whole steps of 10 ms."""
    found = shifts((late, 0.0))["position"]
    assert found.at_least
    assert found.seconds == pytest.approx(np.copysign(0.19, late))
    (said,) = late_channels({"position": found}, "a file", LIMITS)
    when = "is at least 190 ms late" if late > 0 else "comes at least 190 ms early"
    assert said == f"measured position {when} against the motion of the bones, or a model error looks like it"
