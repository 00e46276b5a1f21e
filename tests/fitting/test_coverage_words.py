"""Words of the measured coverage, which every text with an interval or a band prints."""

import pytest

from fitting import coverage

KINDS = [kind for kind in vars(coverage).values() if isinstance(kind, coverage.Coverage)]


@pytest.mark.parametrize("kind", KINDS)
def test_knees_are_called_knees(kind):
    """A stranger knows neither plants nor the virtual rig."""
    assert not [words for words in kind if "plant" in words or "rig of" in words or "virtual rig" in words]
