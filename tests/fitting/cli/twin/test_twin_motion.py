"""The twin's motion in Node against `pftwin.simulate` of the same treated scene: path, forces, flags and words."""

from __future__ import annotations

import equinox as eqx
import numpy as np
import pytest
from small_scene import number, small_scene, vec
from twin_in_node import simulated

import pftwin
from fitting.cli.live.knobs import Knobs, neutral
from fitting.cli.twin.programs import facts, missing, programs, sliders
from pftwin.model.effects.gravity import Gravity

CLOSE = 1e-9  # [m]: a millionth of a millimetre


def check_twin(folder, scene, changes) -> list[dict]:
    knobs = Knobs.of(scene)
    made = programs(knobs)
    rest = {k.name: k.neutral for k in sliders(knobs)}
    assert all(change.keys() <= rest.keys() for change in changes)
    values = [rest | change for change in changes]
    page_facts = {**made.facts, **facts(scene, sliders(knobs), missing(knobs))}
    motions = simulated(folder, made, page_facts, [list(v.values()) for v in values])
    for v, motion in zip(values, motions, strict=True):
        result = pftwin.simulate(knobs.scene_with(neutral() | v))
        outcome = result.dislocations()
        assert motion["substeps"] == result.settings["substeps"]
        np.testing.assert_allclose(motion["center"], result.center.reshape(-1), rtol=0, atol=CLOSE)
        turn = np.reshape(motion["quaternion"], (-1, 4))
        np.testing.assert_allclose(np.abs(np.sum(turn * result.quaternion, axis=1)), 1, atol=1e-12)
        force = result.effects[result.contact]["force"]
        np.testing.assert_allclose(motion["force"], force, rtol=0, atol=1e-4)
        assert motion["status"] == result.flags.tolist()
        assert motion["verdict"] == result.verdict.describe()
        assert motion["tracking"] == ("" if outcome is None else outcome.describe())
    return motions


def test_a_small_knee(tmp_path):
    changes = [
        {},
        {"quadriceps.stiffness": 40.0, "tibial_tuberosity_transfer.medialisation": -6.0},
        {"patellar_tendon_length_change.lengthening": 60.0},
    ]
    motions = check_twin(tmp_path, small_scene(), changes)
    assert motions[0]["verdict"] == "valid"


def test_a_knee_that_starts_invalid_is_invalid_on_the_page():
    scene = small_scene().with_limits(least_upward_lines=2)
    page_facts = facts(scene, (), {})["reasons"]
    assert tuple(page_facts) == pftwin.simulate(scene).verdict.reasons
    assert len(page_facts) == 2


def test_a_patella_that_falls_out_of_the_groove(tmp_path):
    scene = small_scene()
    k = scene.index("gravity")
    upward = eqx.tree_at(lambda s: s.effects[k], scene, Gravity(number(0.12), vec(0, 0, 9.81)))
    motions = check_twin(
        tmp_path,
        upward,
        [{"quadriceps_lengthening.lengthening": 60.0, "patellar_tendon_length_change.lengthening": 60.0}],
    )
    assert motions[0]["verdict"].startswith("INVALID: ")
    assert "touches nothing" in motions[0]["verdict"]


@pytest.mark.slow
def test_case_2_of_the_rig(tmp_path):
    moved = {
        "tibial_tuberosity_transfer.medialisation": 12.5,
        "tibial_tuberosity_transfer.anteriorisation": 5.0,
        "quadriceps.stiffness": 150.0,
        "patellar_tendon_length_change.lengthening": 4.0,
    }
    motions = check_twin(
        tmp_path, pftwin.rig.case(2, contact="P5"), [{}, moved, {"quadriceps_lengthening.lengthening": 30.0}]
    )
    assert "lateral dislocation" in motions[0]["tracking"]
    assert motions[1]["tracking"] == "normal tracking"
