"""Filters against their definitions: gain at the cut-off, no phase shift, exact low-rank signals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pftwin.base.errors import InputError
from pftwin.files.mocap import butterworth_lowpass, singular_spectrum_filter


def measured_gain(frequency, rate, cutoff, **options):
    """Complex gain of the whole filter for a cosine, from its middle part."""
    n = int(200 * rate / frequency)
    t = np.arange(n) / rate
    out = butterworth_lowpass(np.cos(2 * np.pi * frequency * t), rate, cutoff, **options)
    middle = slice(n // 4, 3 * n // 4)
    basis = np.stack([np.cos(2 * np.pi * frequency * t), np.sin(2 * np.pi * frequency * t)], axis=1)[middle]
    a, b = np.linalg.lstsq(basis, out[middle], rcond=None)[0]
    return complex(a, -b)


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize(("rate", "cutoff"), [(100.0, 12.0), (120.0, 6.0), (100.0, 40.0)])
def test_gain_at_the_cutoff(order, rate, cutoff):
    plain = measured_gain(cutoff, rate, cutoff, order=order)
    corrected = measured_gain(cutoff, rate, cutoff, order=order, correct_two_passes=True)
    assert plain.real == pytest.approx(0.5, abs=1e-4)
    assert corrected.real == pytest.approx(np.sqrt(0.5), abs=1e-4)
    assert abs(plain.imag) < 1e-4
    assert abs(corrected.imag) < 1e-4


def test_slow_motion_passes_and_noise_does_not():
    t = np.arange(1000) / 100
    slow = np.sin(2 * np.pi * 0.5 * t)
    assert np.abs(butterworth_lowpass(slow, 100.0) - slow).max() < 1e-3
    fast = np.sin(2 * np.pi * 45 * t)
    assert np.abs(butterworth_lowpass(fast, 100.0))[50:-50].max() < 1e-3


def test_a_straight_line_passes_unchanged_ends_included():
    line = 3.0 - 0.2 * np.arange(60.0)
    np.testing.assert_allclose(butterworth_lowpass(line, 100.0), line, atol=1e-4)


def test_axes_are_filtered_one_by_one():
    x = np.random.default_rng(0).normal(size=(200, 4, 3))
    whole = butterworth_lowpass(x, 100.0)
    np.testing.assert_allclose(whole[:, 2, 1], butterworth_lowpass(x[:, 2, 1], 100.0), atol=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: butterworth_lowpass(np.ones(99), 100.0, 50.0), "cut-off of 50 Hz cannot be had at 100 Hz.*50 Hz"),
        (lambda: butterworth_lowpass(np.ones(99), 100.0, 0.0), "cut-off of 0 Hz"),
        (lambda: butterworth_lowpass(np.ones(99), 0.0), "sampling rate is 0 Hz"),
        (lambda: butterworth_lowpass(np.ones(99), 100.0, order=0), "order is 0"),
        (lambda: butterworth_lowpass(np.ones(17), 100.0), "17 samples are too few.*more than 17 samples"),
        (lambda: butterworth_lowpass(np.r_[np.ones(50), np.nan], 100.0), "sample 51 .*missing.*fill_gaps"),
        (lambda: butterworth_lowpass(np.ones(0), 100.0), "no samples"),
        (lambda: singular_spectrum_filter(np.ones(59)), "59 samples are too few for a window of 30.*at least 60"),
        (lambda: singular_spectrum_filter(np.ones(99), window=1), "a window of 1"),
        (lambda: singular_spectrum_filter(np.ones(99), components=31), "31 components"),
        (lambda: singular_spectrum_filter(np.r_[np.nan, np.ones(70)]), "sample 1 "),
        (lambda: singular_spectrum_filter(np.ones((99, 2, 2))), "shape"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()


@settings(max_examples=25, deadline=None)
@given(level=st.floats(-100, 100), slope=st.floats(-10, 10), frequency=st.floats(0.3, 8), amplitude=st.floats(0.1, 50))
def test_signals_of_low_rank_pass_exactly(level, slope, frequency, amplitude):
    t = np.arange(300) / 100
    scale = 1e-9 * (1 + abs(level) + 3 * abs(slope) + amplitude)
    constant = np.full(300, level)
    np.testing.assert_allclose(singular_spectrum_filter(constant, components=1), constant, atol=scale)
    trend = level + slope * t
    np.testing.assert_allclose(singular_spectrum_filter(trend, components=2), trend, atol=scale)
    wave = trend + amplitude * np.sin(2 * np.pi * frequency * t)
    np.testing.assert_allclose(singular_spectrum_filter(wave, components=4), wave, atol=scale)
    for signal in (constant, trend, wave):
        np.testing.assert_allclose(singular_spectrum_filter(signal), signal, atol=1e3 * scale)


def test_noise_is_removed_without_a_given_cutoff():
    t = np.arange(720) / 100
    truth = 40 + 25 * np.sin(2 * np.pi * 0.3 * t)
    noisy = truth + np.random.default_rng(3).normal(size=t.size)
    before = np.sqrt(np.mean((noisy - truth) ** 2))
    after = np.sqrt(np.mean((singular_spectrum_filter(noisy) - truth) ** 2))
    assert after < 0.4 * before


def test_several_signals_at_once():
    x = np.random.default_rng(0).normal(size=(100, 2))
    both = singular_spectrum_filter(x, components=3)
    np.testing.assert_array_equal(both[:, 1], singular_spectrum_filter(x[:, 1], components=3))
