"""How derivatives of runs are judged: by finite differences, as far as those settle."""

from __future__ import annotations

import numpy as np

from pftwin.studies.hard_cases import derivatives

FRAMES = np.arange(30)
LONG = np.exp(0.4 * FRAMES)[:, None, None] * np.ones((30, 7, 4))  # of a motion that hurries apart


def differences(share: float) -> np.ndarray:
    """Of sin(LONG p) at p = 0: they settle while LONG p is small."""
    p = share * 1e3 * derivatives.CHANGE
    return np.sin(LONG * p) / p


def test_differences_by_changes_of_two_sizes_are_known_until_they_part():
    found = derivatives.agreeing_differences(differences(1.0), differences(derivatives.FINER))
    known = np.isfinite(found)
    assert known[:5].all()
    assert not known[20:].any()
    assert (np.diff(known.astype(int), axis=0) <= 0).all()
    assert derivatives.disagree(LONG, differences(1.0), "float64") is not None
    assert derivatives.disagree(LONG, found, "float64") is None


def test_a_wrong_derivative_is_told_from_a_wild_motion():
    found = derivatives.agreeing_differences(differences(1.0), differences(derivatives.FINER))
    wrong = LONG.copy()
    wrong[:, :, 2] *= 1.05
    assert "height of the surface off by 5" in str(derivatives.disagree(wrong, found, "float64"))


def test_a_motion_whose_differences_never_settle_is_not_passed():
    nothing = np.full((30, 7, 4), np.nan)
    assert derivatives.disagree(LONG, nothing, "float64") == "finite differences settle in no frame"


def test_in_single_precision_derivatives_count_until_the_paths_part():
    path = np.zeros((30, 7))
    parted = path.copy()
    parted[12:, 1] = 2 * derivatives.PARTED
    parted[20:, 1] = 0.0  # near again, by chance
    reference = derivatives.Reference(LONG, path)
    assert np.isfinite(derivatives.known_on(reference, path)).all()
    known = np.isfinite(derivatives.known_on(reference, parted))
    assert known[:12].all()
    assert not known[12:].any()
