"""Spans of a recording: ends that are written in decimals hold the frames they name."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.model.measured import Measured


@pytest.mark.parametrize(("last", "frames"), [(0.57, 58), (0.58, 59), (2.3, 231), (2.304, 231), (2.299, 230)])
def test_the_last_frame_of_a_span_counts(last, frames):
    """At 100 Hz, whose times are sums of hundredths and rounded."""
    times = 0.3 + np.cumsum(np.full(400, 0.01))
    measured = Measured(times, np.zeros((400, 3)))
    weights = measured.during([(float(times[0]) + 1e-12, 0.31 + last)]).weights
    assert np.count_nonzero(weights) == frames
