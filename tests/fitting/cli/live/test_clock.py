"""Times that the page tells."""

from __future__ import annotations

from fitting.cli.live.words import PACE_COUNT, times_taken


def test_tells_the_last_the_median_and_the_worst():
    assert PACE_COUNT == 50
    assert times_taken([]) == "none yet"
    assert times_taken([1e-3 * (k + 1) for k in range(50)]) == "50 ms (of the last 50: median 26, worst 50 ms)"
    assert times_taken([9.0, 0.001]) == "1 ms (of the last 2: median 4500, worst 9000 ms)"
