"""Measurements belong to a scene as its motion does: by no name, to every copy of it, to no treated knee."""

from __future__ import annotations

import pickle
from dataclasses import replace

import jax
import numpy as np
import pytest
from lifted_fits import SPRINGS, clean, scene

import fitting
from fitting.treatments import Treatment
from fitting.trials import measured_of
from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured

NOTHING = "nothing to compare with"


def test_a_case_of_the_rig_carries_its_own():
    for n in (1, 2):
        assert measured_of(rig.case(n)) is rig.measured(n)
    assert rig.measured(1) != rig.measured(2)


def test_a_name_neither_gives_nor_takes_them():
    case = rig.case(2)
    assert measured_of(replace(case, name="knee 7")) is rig.measured(2)
    assert measured_of(rig.with_retinacula(case)) is rig.measured(2)
    with pytest.raises(InputError, match=NOTHING):
        measured_of(replace(scene(), name="rig case 2, P5"))


def test_a_treated_knee_has_none():
    case = rig.case(2)
    assert Treatment()(case).measured is rig.measured(2)
    with pytest.raises(InputError, match=NOTHING):
        measured_of(Treatment.of("tibial_tuberosity_transfer", medialisation=0.01)(case))


@pytest.mark.slow
def test_a_fit_compares_with_what_the_scene_carries():
    carrying = replace(scene(), measured=clean())
    found = fitting.fit_tendons(carrying, free=SPRINGS[:1], starts=1)
    assert found.source == "twin"
    assert found.measured is clean()
    assert found.scene.measured is clean()
    given = Measured(clean().times, clean().center, source="given")
    assert fitting.fit_tendons(carrying, given, free=SPRINGS[:1], starts=1).source == "given"


def test_scenes_with_equal_measurements_have_one_structure():
    """So that what is compiled is shared, and a batch can be made of them."""
    mine = replace(scene(), measured=clean())
    again = replace(scene(), measured=pickle.loads(pickle.dumps(clean())))
    assert again.measured is not mine.measured
    assert jax.tree.structure(again) == jax.tree.structure(mine)
    assert hash(again.measured) == hash(mine.measured)
    assert jax.tree.structure(mine.unnamed()) == jax.tree.structure(scene().unnamed())
    moved = replace(clean(), center=np.asarray(clean().center) + 1e-3)
    assert jax.tree.structure(replace(scene(), measured=moved)) != jax.tree.structure(mine)
