"""Units in which numbers are shown to readers."""

import pytest

from pftwin.base.quantities import shown


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [(2.07686e6, "Pa", "2.08 MPa"), (1.5e-4, "m^2", "150 mm^2"), (0.0123, "m", "12.3 mm"), (9.5, "N", "9.5 N")],
)
def test_a_number_is_shown_in_the_unit_of_readers(value, unit, words):
    assert shown(value, unit, 3) == words
