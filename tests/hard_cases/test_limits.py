"""A run beyond its kind of contact is refused where it says so itself, before anything else is wrong."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pftwin.dynamics.observe import Status
from pftwin.hard_cases import CONTACTS, case_named
from pftwin.hard_cases.limits import LIMITS, limit_of
from pftwin.hard_cases.verdict import _at_limit

OK, CREATED, LOST = Status.OK, Status.ENERGY_FROM_NOWHERE, Status.SEARCH_OVERFLOW
UNBALANCED, RIM = Status.START_NOT_IN_EQUILIBRIUM, Status.LEFT_PATCH


def told(contact: str, flags: list[Status]) -> bool:
    look: Any = SimpleNamespace(
        case=case_named("tendon_soft"), contact=contact, flags=np.array([int(f) for f in flags])
    )
    return _at_limit(look)


def test_limits_are_of_kinds_of_contact_and_say_why():
    assert set(LIMITS) <= set(CONTACTS)
    assert all(len(limit.why) > 100 for limit in LIMITS.values())
    assert limit_of("P5").flags == OK


@pytest.mark.parametrize(
    ("flags", "refused"),
    [
        ([OK, CREATED, CREATED | LOST], True),
        ([OK, LOST, CREATED], False),  # a contact that may be wrong came first
        ([UNBALANCED, UNBALANCED | CREATED], False),
        ([UNBALANCED | RIM, UNBALANCED | CREATED], True),  # on the rim, and it says so
    ],
)
def test_contours_may_create_energy_but_nothing_else_first(flags, refused):
    assert told("contours", flags) == refused
    assert not told("P5", flags)


def test_a_volume_creates_energy_only_over_a_rim():
    assert not told("volume", [OK, CREATED])
    assert told("volume", [RIM, CREATED])
    assert not told("volume", [OK, CREATED, RIM])  # too late
    assert not told("volume", [RIM | LOST, CREATED])
