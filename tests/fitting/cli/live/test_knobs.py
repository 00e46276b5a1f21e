"""Knobs against the treatments that they stand for, and what they refuse."""

from __future__ import annotations

import equinox as eqx
import jax
import numpy as np
import pytest
from small_scene import small_scene

from fitting.cli.live.knobs import KNOBS, neutral, scene_with_knobs, usable_knobs
from fitting.treatments import patellar_tendon_length_change, quadriceps_lengthening, tibial_tuberosity_transfer
from pftwin.base.errors import InputError


def leaves(scene):
    return [np.asarray(a) for a in jax.tree.leaves(eqx.filter(scene, eqx.is_array))]


def same(one, two) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(leaves(one), leaves(two), strict=True))


def test_neutral_values_leave_the_scene_as_it_is():
    scene = small_scene(5)
    assert same(scene_with_knobs(scene, KNOBS, neutral()), scene)


def test_knobs_are_the_treatments():
    scene = small_scene(5)
    values = {
        **neutral(),
        "medialisation": 12.0,
        "distalisation": -3.0,
        "quadriceps_length": 5.0,
        "patellar_tendon_length": -4.5,
    }
    expected = tibial_tuberosity_transfer(scene, medialisation=0.012, distalisation=-0.003)
    expected = patellar_tendon_length_change(quadriceps_lengthening(expected, 0.005), -0.0045)
    assert same(scene_with_knobs(scene, KNOBS, values), expected)


def test_stiffness_is_a_share_and_damping_stays():
    scene = small_scene(5)
    soft = scene_with_knobs(scene, KNOBS, {**neutral(), "patellar_tendon_stiffness": 50.0})
    before, after = scene.effect("patellar_tendon"), soft.effect("patellar_tendon")
    assert float(after.stiffness) == pytest.approx(0.5 * float(before.stiffness), rel=1e-15)
    assert float(after.damping) == float(before.damping)
    assert float(soft.effect("quadriceps").stiffness) == float(scene.effect("quadriceps").stiffness)


@pytest.mark.parametrize("value", ["text", None, True, float("nan"), float("inf"), -1e300, 30.1, [1.0], "x" * 500])
def test_nonsense_is_refused_in_words(value):
    with pytest.raises(InputError, match=r"medialisation \[mm\]: found .*expected: -20 to 30 mm") as refused:
        scene_with_knobs(small_scene(5), KNOBS, {**neutral(), "medialisation": value})
    assert len(str(refused.value)) < 150


def test_a_value_that_is_missing_is_refused():
    with pytest.raises(InputError, match="found None"):
        scene_with_knobs(small_scene(5), KNOBS, {})


def test_knobs_that_a_scene_has_no_part_for_are_left_out_with_the_reason():
    found, reasons = usable_knobs(small_scene(5).without("quadriceps"))
    assert {k.group for k in found} == {"Tibial tuberosity", "Patellar tendon"}
    assert "no tendon or strands named 'quadriceps'" in reasons["Quadriceps tendon"]
    assert usable_knobs(small_scene(5)) == (KNOBS, {})
