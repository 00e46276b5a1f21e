"""Filters for marker and force recordings, and gap filling."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.files.mocap.markers import MarkerTrajectories
from pftwin.files.mocap.tables import runs


def butterworth_lowpass(
    signal: ArrayLike, rate: float, cutoff: float = 12.0, order: int = 2, *, correct_two_passes: bool = False
) -> NDArray[np.float64]:
    """Zero-phase Butterworth low-pass filter, run forwards and backwards along the first axis.

    Michaud et al. 2024 filter marker trajectories in this way, with order 2 and 12 Hz.

    Args:
        signal: (n, ...) samples.
        rate: sampling rate [Hz].
        cutoff: cut-off frequency [Hz].
        order: order of one pass.
        correct_two_passes: False: each pass has its -3 dB point at `cutoff`, both together -6 dB. True: each pass is
            designed at a higher frequency f_d, such that both together have -3 dB at the cut-off f exactly (Winter
            2009, section 2.2.4.4, with the bilinear transform's warping:
            tan(pi f_d/rate) = tan(pi f/rate) / (sqrt(2) - 1)^(1/(2 order))).

    Returns:
        The filtered signal, of the same shape.

    Raises:
        InputError: a cut-off at or above half the rate, a signal shorter than the filter needs, missing values.
    """
    x = _checked(signal)
    if not rate > 0:
        raise InputError(f"the sampling rate is {rate:g} Hz", where="rate", expected="a positive rate")
    if not 0 < cutoff < rate / 2:
        expected = f"more than 0 and less than half the sampling rate, {rate / 2:g} Hz"
        raise InputError(f"a cut-off of {cutoff:g} Hz cannot be had at {rate:g} Hz", where="cutoff", expected=expected)
    if order < 1:
        raise InputError(f"the filter's order is {order}", where="order", expected="1 or more")
    design = cutoff
    if correct_two_passes:
        warped = math.tan(math.pi * cutoff / rate) / (math.sqrt(2) - 1) ** (1 / (2 * order))
        design = rate / math.pi * math.atan(warped)

    padding = samples_needed(rate, cutoff, order) - 1
    if x.shape[0] <= padding:
        found = f"{x.shape[0]} samples are too few for a filter of {cutoff:g} Hz at {rate:g} Hz"
        raise InputError(found, where="signal", expected=f"more than {padding} samples ({padding / rate:.3g} s)")
    from scipy.signal import butter, sosfiltfilt

    sections = butter(order, design, btype="low", fs=rate, output="sos")
    return sosfiltfilt(sections, x, axis=0, padtype="odd", padlen=padding)


def samples_needed(rate: float, cutoff: float, order: int) -> int:
    """Shortest signal that `butterworth_lowpass` accepts: one sample more than the padding at each end.

    The padding is a point reflection, as long as the memory of one pass.
    """
    return 1 + max(3 * (order + 1), math.ceil(order * rate / cutoff))


def singular_spectrum_filter(signal: ArrayLike, window: int = 30, components: int | None = None) -> NDArray[np.float64]:
    """Smooths a signal by singular spectrum analysis, keeping the leading components.

    The signal's lagged copies form a Hankel matrix (window x (n - window + 1)). Its leading singular triples are kept
    and converted back to a signal by averaging over the anti-diagonals (Golyandina & Zhigljavsky 2013, chapter 2).
    Michaud et al. 2024 filter measured forces in this way, with window 30.

    Args:
        signal: (n,) samples, or (n, k) for k signals filtered one by one.
        window: length of the lag window [samples].
        components: number of components to keep. None: those whose singular value is above the optimal threshold for
            noise of unknown level, omega(beta) times the median one (Gavish & Donoho 2014, IEEE Trans Inf Theory
            60:5040), and at least one.

    Returns:
        The smoothed signal, of the same shape.

    Raises:
        InputError: fewer than 2 window samples, an impossible window or number of components, missing values.
    """
    x = _checked(signal)
    if x.ndim == 2:
        columns = [singular_spectrum_filter(c, window, components) for c in x.T]
        return np.stack(columns, axis=1) if columns else x
    if x.ndim != 1:
        raise InputError(f"a signal of shape {x.shape}", where="signal", expected="(n,) or (n, k)")
    n = x.size
    if window < 2:
        raise InputError(f"a window of {window} samples", where="window", expected="2 or more")
    if n < 2 * window:
        raise InputError(
            f"{n} samples are too few for a window of {window}", where="signal", expected=f"at least {2 * window}"
        )
    if components is not None and not 1 <= components <= window:
        raise InputError(f"{components} components", where="components", expected=f"1 to the window, {window}")

    hankel = np.lib.stride_tricks.sliding_window_view(x, n - window + 1)  # (window, n - window + 1)
    left, values, right = np.linalg.svd(hankel, full_matrices=False)
    if components is None:
        beta = hankel.shape[0] / hankel.shape[1]
        omega = 0.56 * beta**3 - 0.95 * beta**2 + 1.82 * beta + 1.43
        components = max(1, int(np.sum(values > omega * np.median(values))))
    reconstructed = (left[:, :components] * values[:components]) @ right[:components]
    total, count = np.zeros((2, n))
    for lag, row in enumerate(reconstructed):
        total[lag : lag + row.size] += row
        count[lag : lag + row.size] += 1
    return total / count


def _checked(signal: ArrayLike) -> NDArray[np.float64]:
    x = np.asarray(signal, dtype=np.float64)
    if x.ndim == 0 or x.size == 0:
        raise InputError("no samples", where="signal", expected="samples along the first axis")
    if not np.isfinite(x).all():
        row = int(np.argwhere(~np.isfinite(x))[0][0])
        found = f"sample {row + 1} (counted from 1) is missing or not finite"
        raise InputError(found, where="signal", expected="a signal without gaps", remedy="fill_gaps first")
    return x


@dataclass(frozen=True)
class Gap:
    """A run of frames (indices, both inclusive) in which a marker was not seen."""

    marker: str
    first_frame: int
    last_frame: int
    filled: bool

    @property
    def frames(self) -> int:
        """Number of frames in the gap."""
        return self.last_frame - self.first_frame + 1

    def in_words(self) -> str:
        """Description of the frames, counted from 1: "frames 3 to 5"."""
        return f"frames {self.first_frame + 1} to {self.last_frame + 1}"


def find_gaps(markers: MarkerTrajectories) -> list[Gap]:
    """All gaps of all markers, ordered by marker and time."""
    return [
        Gap(name, int(first), int(end) - 1, False)
        for name, missing in zip(markers.names, markers.missing.T, strict=True)
        for first, end in runs(missing)
    ]


def fill_gaps(
    markers: MarkerTrajectories, *, max_gap_s: float = 0.1, keep_long: bool = False
) -> tuple[MarkerTrajectories, list[Gap]]:
    """Fills interior gaps by the cubic spline through the frames around them; `select` the markers needed first.

    Args:
        markers: the recording.
        max_gap_s: longest gap that is filled [s] (duration of the missing frames).
        keep_long: leave gaps that cannot be filled as NaN instead of raising (`cluster_poses` accepts them).

    Returns:
        The filled markers, and all gaps that were found.

    Raises:
        InputError: a gap longer than `max_gap_s` or at the recording's start or end, naming marker and frames.
    """
    if not max_gap_s >= 0:
        raise InputError(
            f"the longest gap to fill is {max_gap_s}", where="max_gap_s", expected="a duration of 0 s or more"
        )
    gaps = find_gaps(markers)
    if not gaps:
        return markers, []
    limit = int(np.floor(max_gap_s * markers.rate + 1e-9)) if markers.times.size > 1 else 0
    last = markers.times.size - 1
    present = dict(zip(markers.names, (~markers.missing).sum(axis=0), strict=True))
    inside = (g.first_frame > 0 and g.last_frame < last for g in gaps)
    report = [
        replace(g, filled=there and g.frames <= limit and int(present[g.marker]) >= 4)
        for g, there in zip(gaps, inside, strict=True)
    ]
    refused = [g for g in report if not g.filled]
    if refused and not keep_long:
        raise _refusal(refused, limit, last, max_gap_s, markers)
    from scipy.interpolate import CubicSpline

    positions = markers.positions.copy()
    for column, name in enumerate(markers.names):
        frames = [f for g in report if g.marker == name and g.filled for f in range(g.first_frame, g.last_frame + 1)]
        if frames:
            there = ~markers.missing[:, column]
            spline = CubicSpline(markers.times[there], positions[there, column])
            positions[frames, column] = spline(markers.times[frames])
    return markers.with_positions(positions), report


def _refusal(gaps: list[Gap], limit: int, last: int, max_gap_s: float, markers: MarkerTrajectories) -> InputError:
    listed = []
    for g in gaps[:6]:
        at_end = " at the start" if g.first_frame == 0 else " at the end" if g.last_frame == last else ""
        listed.append(f"{g.marker!r} " + ("is never seen" if g.frames > last else f"{g.in_words()}{at_end}"))
    more = f"; and {len(gaps) - 6} more" if len(gaps) > 6 else ""
    return InputError(
        f"gaps that cannot be filled: {'; '.join(listed)}{more} (frames counted from 1)",
        where=markers.source,
        expected=f"gaps of at most {max_gap_s:g} s ({limit} frames), not at the ends",
        remedy="fewer markers (select), a part of the recording (between), or a larger max_gap_s",
    )
