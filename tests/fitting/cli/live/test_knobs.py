"""Knobs against the treatments that they stand for, and what they refuse."""

from __future__ import annotations

import equinox as eqx
import jax
import numpy as np
import pytest
from live_engine import turned
from small_scene import small_scene

from fitting.cli.live.knobs import GROUPS, KNOBS, Knobs
from fitting.treatments import (
    KINDS,
    button_position,
    femoral_component_rotation,
    patellar_tendon_length_change,
    quadriceps_lengthening,
    tibial_tuberosity_transfer,
)
from pftwin import rig
from pftwin.base.errors import InputError


def assert_same(one, two) -> None:
    a, b = (jax.tree.leaves(eqx.filter(scene, eqx.is_array)) for scene in (one, two))
    for x, y in zip(a, b, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-14, atol=1e-17)


def test_neutral_values_leave_the_scene_as_it_is():
    assert_same(turned(small_scene(5)), small_scene(5))


def test_knobs_are_the_treatments():
    scene = small_scene(5)
    got = turned(
        scene,
        medialisation=12.0,
        distalisation=-3.0,
        quadriceps_lengthening__lengthening=5.0,
        patellar_tendon_length_change__lengthening=-4.5,
        femoral_component_rotation__external_rotation=4.0,
        button_position__anteriorisation=2.0,
    )
    expected = tibial_tuberosity_transfer(scene, medialisation=0.012, distalisation=-0.003)
    expected = patellar_tendon_length_change(quadriceps_lengthening(expected, 0.005), -0.0045)
    expected = femoral_component_rotation(expected, external_rotation=np.pi / 45)
    assert_same(got, button_position(expected, anteriorisation=0.002))


def test_every_amount_of_every_treatment_has_a_knob_whose_range_holds_no_change():
    names = {f"{kind}.{name}" for kind, about in KINDS.items() for name in about.amounts}
    assert {k.name for k in KNOBS} == names | {"quadriceps.stiffness", "patellar_tendon.stiffness"}
    assert all(k.least <= k.neutral < k.most and k.group in GROUPS for k in KNOBS)


def test_stiffness_is_a_share_and_damping_stays():
    scene = small_scene(5)
    soft = turned(scene, patellar_tendon__stiffness=50.0)
    before, after = scene.effect("patellar_tendon"), soft.effect("patellar_tendon")
    assert float(after.stiffness) == pytest.approx(0.5 * float(before.stiffness), rel=1e-15)
    assert float(after.damping) == float(before.damping)
    assert float(soft.effect("quadriceps").stiffness) == float(scene.effect("quadriceps").stiffness)


@pytest.mark.parametrize("value", ["text", None, True, float("nan"), float("inf"), -1e300, 30.1, [1.0], "x" * 500])
def test_nonsense_is_refused_in_words(value):
    expected = r"Tibial tuberosity, medialisation \[mm\]: found .*expected: -20 to 30 mm"
    with pytest.raises(InputError, match=expected) as refused:
        turned(small_scene(5), medialisation=value)
    assert len(str(refused.value)) < 170


def test_a_value_that_is_missing_is_refused():
    with pytest.raises(InputError, match="found None"):
        Knobs.of(small_scene(5)).scene_with({})


def test_knobs_that_a_scene_has_no_part_for_are_left_out_with_the_reason():
    knobs = Knobs.of(small_scene(5).without("quadriceps"))
    assert "Quadriceps tendon" not in {k.group for k in knobs.usable}
    assert "no tendon or strands named 'quadriceps'" in knobs.missing["Quadriceps tendon"]
    assert "degree 2 cannot be deepened" in knobs.missing["Trochlear groove"]
    assert {"Lateral strands", "MPFL graft"} < knobs.missing.keys()


@pytest.mark.slow
def test_the_natural_knee_has_knobs_for_its_strands_and_the_rig_for_its_groove():
    """Lateral release and MPFL graft need strands, trochleoplasty a patch of degree 4 or more."""
    natural, made = (Knobs.of(scene).missing.keys() for scene in (rig.knee(), rig.case(2, contact="P5")))
    assert {"Lateral strands", "MPFL graft"}.isdisjoint(natural)
    assert made == {"Lateral strands", "MPFL graft"}
