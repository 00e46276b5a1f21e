"""A run beyond its kind of contact is refused where it says so itself, before anything else is wrong."""

from __future__ import annotations

from importlib import resources
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

import pftwin
from pftwin.base.errors import InputError
from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import Newmark
from pftwin.dynamics.quasi_static.step import QuasiStatic
from pftwin.dynamics.status import Status
from pftwin.studies.audit.variants import NotApplicable, additions
from pftwin.studies.hard_cases import CONTACTS, case_named
from pftwin.studies.hard_cases.batch import batches
from pftwin.studies.hard_cases.case import LIMITS, limit_of, method_named
from pftwin.studies.hard_cases.matrix import EVERYTHING, run_matrix
from pftwin.studies.hard_cases.verdict import _at_limit

OK, CREATED, LOST = Status.OK, Status.ENERGY_FROM_NOWHERE, Status.SEARCH_OVERFLOW
UNBALANCED, RIM = Status.START_NOT_IN_EQUILIBRIUM, Status.LEFT_PATCH


def is_limit(contact: str, flags: list[Status]) -> bool:
    look: Any = SimpleNamespace(
        case=case_named("tendon_soft"), contact=contact, flags=np.array([int(f) for f in flags])
    )
    return _at_limit(look)


def test_limits_are_of_kinds_of_contact_and_say_why():
    assert set(LIMITS) <= set(CONTACTS)
    page = resources.files("pftwin.studies.hard_cases").joinpath("page.md").read_text(encoding="utf-8")
    assert all(f"- **{name}**: " in page for name in LIMITS)
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
    assert is_limit("contours", flags) == refused
    assert not is_limit("P5", flags)


def test_a_volume_creates_energy_only_over_a_rim():
    assert not is_limit("volume", [OK, CREATED])
    assert is_limit("volume", [RIM, CREATED])
    assert not is_limit("volume", [OK, CREATED, RIM])  # too late
    assert not is_limit("volume", [RIM | LOST, CREATED])


def test_contours_without_inertia_are_refused_in_words_before_anything_is_computed():
    case = case_named("plain_knee")
    selection = EVERYTHING._replace(contacts=("contours",), integrators=(method_named("quasi_static"),))
    cells = run_matrix([case], selection)
    assert [(c.outcome, c.dtype) for c in cells] == [("refused", "float64"), ("refused", "float32")]
    scene = batches([case], "contours")[0][0].scenes
    scene = jax.tree.map(lambda a: a[0], scene)
    for how in ({}, {"tolerance": "0.1 mm"}):
        with pytest.raises(InputError, match=r"jump from triangle to triangle in: contact.*by volume, or of a patch"):
            pftwin.simulate(scene, integrator=QuasiStatic(), **how)
    with pytest.raises(InputError, match="no inertia"):
        frame_states(scene, integrator=QuasiStatic())
    (left_out,) = [v for v in additions(scene, Newmark()) if v.name == "patella inertia"]
    assert isinstance(left_out, NotApplicable)
    assert "jump" in left_out.reason
