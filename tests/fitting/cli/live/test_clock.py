"""Times that the page tells."""

from __future__ import annotations

import numpy as np

from fitting.cli.live.words import KEPT, Clock


def test_tells_the_last_the_median_and_the_worst_of_the_last_fifty():
    clock = Clock()
    assert clock.words() == "none yet"
    assert np.isnan(clock.milliseconds()).all()
    clock.add(9.0)
    for k in range(KEPT):
        clock.add(1e-3 * (k + 1))
    assert clock.count == KEPT == 50
    np.testing.assert_allclose(clock.milliseconds(), [50.0, 25.5, 50.0])
    assert clock.words() == "50 ms (of the last 50: median 26, worst 50 ms)"
