"""Readings at the frames of a motion: nothing folds, nothing shifts, and the loss is what it says."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.files.mocap import frame_means

FRAMES, TIMES = np.arange(101) / 100, np.arange(1001) / 1000
INSIDE = slice(1, -1)  # the first and the last frame have a reading each, and no interval


def test_readings_as_fast_as_the_frames_or_slower_are_interpolated():
    for rate in (20, 100, 125):
        times = np.arange(rate + 1) / rate
        values = np.random.default_rng(rate).normal(size=times.size)
        np.testing.assert_array_equal(frame_means(FRAMES, times, values), np.interp(FRAMES, times, values))
    np.testing.assert_array_equal(frame_means(FRAMES[:1], TIMES, TIMES), [0.0])


@pytest.mark.parametrize("hum", [100.0, 200.0, 300.0])
def test_what_oscillates_as_fast_as_the_frames_leaves_nothing(hum):
    wave = np.sin(2 * np.pi * hum * TIMES + 0.7)
    assert np.abs(np.interp(FRAMES, TIMES, wave)).min() > 0.6  # picked: a constant that is not there
    assert np.abs(frame_means(FRAMES, TIMES, wave)[INSIDE]).max() < 1e-9


@pytest.mark.parametrize(("share", "lost"), [(0.1, 0.016), (0.25, 0.10)])
def test_a_slow_wave_loses_what_the_mean_of_a_wave_loses_and_is_not_shifted(share, lost):
    times = np.arange(20001) / 20000
    found = frame_means(FRAMES, times, np.sin(2 * np.pi * 100 * share * times + 0.4))[INSIDE]
    kept = np.sin(np.pi * share) / (np.pi * share)
    assert 1 - kept == pytest.approx(lost, abs=0.003)
    np.testing.assert_allclose(found, kept * np.sin(2 * np.pi * 100 * share * FRAMES[INSIDE] + 0.4), atol=2e-5)


def test_a_ramp_stays_a_ramp_to_its_ends_at_any_rate():
    for rate in (137.0, 150.0, 200.0, 1000.0, 960.0):
        times = np.arange(int(rate) + 8) / rate
        np.testing.assert_allclose(frame_means(FRAMES, times, 3 - 2 * times), 3 - 2 * FRAMES, atol=1e-12)


def test_a_missing_reading_costs_its_own_frame():
    values = np.ones(1001)
    values[503] = np.nan
    assert np.flatnonzero(np.isnan(frame_means(FRAMES, TIMES, values))).tolist() == [50]
