"""How derivatives of runs are judged: by finite differences, as far as those settle. Words on frames count from 1."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases import derivatives, invariants

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


def test_a_wrong_derivative_is_distinguished_from_a_wild_motion():
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


def test_the_first_of_five_frames_is_called_frame_1():
    """In recordings too (TRC, C3D) the first frame is 1."""
    slopes = np.zeros((5, 7, 4))
    slopes[0, :, 1] = np.nan
    assert str(derivatives.not_finite(slopes, np.full(5, True))).endswith("not finite at frame 1")


def test_the_fourth_of_five_frames_is_called_frame_4():
    """A button 1 mm deep throughout, whose run says in the fourth frame that nothing touches, 2 mm away."""
    found, flags = np.full(5, 1e-3), np.zeros(5, dtype=int)
    found[3], flags[3] = -2e-3, int(Status.NO_CONTACT)
    look = SimpleNamespace(
        depth=np.full(5, 1e-3),
        flags=flags,
        contact="P5",
        tolerance=SimpleNamespace(place=1e-6),
        knee=SimpleNamespace(radius=0.022),
        clean=lambda: np.full(5, True),
        indentation=lambda: found,
        report=lambda name: np.ones(5),
    )
    assert invariants.place(look) == "frame 4: -2 mm deep where it is 1 mm"
    assert invariants.geometry_flags(look) == "frame 4: says no contact, touches"
