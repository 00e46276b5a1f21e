"""What the live page computes against `simulate`, and what it refuses to show."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from live_engine import TRANSFER, live_engine, load, turned
from made_estimates import made_estimate
from small_scene import small_scene

import pftwin
from fitting.cli.live import engine as engines
from fitting.cli.live.engine import Engine
from fitting.cli.live.knobs import neutral
from fitting.cli.live.motion import DrawnMotion
from fitting.cli.live.words import outcome
from pftwin.base.errors import InputError
from pftwin.results.viewer.shapes import of_poses

BY = {"medialisation": 6.5, "anteriorisation": 2.0, "quadriceps__stiffness": 120.0}
MOVED = {
    **neutral(),
    f"{TRANSFER}.medialisation": 6.5,
    f"{TRANSFER}.anteriorisation": 2.0,
    "quadriceps.stiffness": 120.0,
}


@pytest.fixture(scope="module")
def engine():
    return live_engine()


def test_gives_what_simulate_gives_of_the_treated_scene(engine):
    answer = engine.run("groove", MOVED)
    result = pftwin.simulate(turned(small_scene(), **BY))
    data = answer.recorded.data
    np.testing.assert_array_equal(data["patella_position"].values, result.position)
    np.testing.assert_array_equal(data["patella_quaternion"].values, result.quaternion)
    np.testing.assert_array_equal(answer.force, result.effects["contact"]["force"])
    np.testing.assert_array_equal(answer.tilt, np.degrees(result.angles.tilt))
    np.testing.assert_array_equal(answer.shift, 1e3 * result.shift)
    assert answer.highest_force == result.effects["contact"]["force"].max()
    assert answer.result.tracking == result.dislocations().describe()
    assert answer.highest_force > engine.model("groove").before.highest_force + 0.1


def test_turning_compiles_nothing(engine):
    treated = turned(small_scene(), **BY)
    assert pftwin.simulate(treated).timing["compile_s"] == 0
    assert pftwin.simulate(turned(small_scene())).timing["compile_s"] == 0
    assert engine.ready("groove")


def test_a_knee_that_starts_invalid_is_shown_invalid_at_all_values():
    """As `predict` judges it: the small knee's equilibrium is 17.1 deg from where its search begins."""
    engine = Engine(lambda _: small_scene().with_limits(), ("groove",))
    engine.prepare("groove")
    turned_by = np.degrees(pftwin.equilibrium(small_scene()).turned)
    why = f"the equilibrium is {turned_by:.1f} deg from the recorded start (at most 15: most_start_turn_deg)"
    for answer in (engine.model("groove").before, engine.run("groove", MOVED)):
        assert answer.recorded.verdict.reasons == (why,)
        assert answer.dislocates is None
        assert not answer.out.any()
        assert f"INVALID: {why}" in outcome(answer)
    near = Engine(lambda _: small_scene().with_limits(most_start_turn_deg=20.0), ("groove",))
    near.prepare("groove")
    assert near.run("groove", MOVED).recorded.verdict.valid


def test_the_fitted_knee_is_judged_not_the_nominal_one():
    """A quadriceps a third as stiff turns the small knee's equilibrium further; no draw of such a knee is in a band."""
    fitted = made_estimate({"K1": (50.0, 0.5)})
    turned_by = np.degrees([pftwin.equilibrium(s).turned for s in (small_scene(), fitted.apply(small_scene()))])
    assert turned_by[1] > turned_by[0] + 2
    between = small_scene().with_limits(most_start_turn_deg=float(turned_by.mean()))
    engine = Engine(lambda _: between, ("groove",), fitted)
    engine.prepare("groove")
    answer = engine.run("groove", MOVED)
    assert answer.recorded.verdict.describe().startswith(f"INVALID: the equilibrium is {turned_by[1]:.1f} deg from")
    band = engine.band("groove", MOVED, answer, lambda: True)
    assert band is not None
    assert (band.ends, band.words) == ({}, "No bands: the untreated knee starts INVALID.")


def test_draws_that_start_invalid_are_in_no_band(monkeypatch):
    """The band is that of the other draws: which they are, the equilibrium of each says, as `pftwin` reports it."""
    monkeypatch.setattr(engines, "DRAWS", 4)
    draws = np.array([[150.0], [90.0], [152.0], [156.0]])  # a softer quadriceps turns the equilibrium further
    fitted = made_estimate({"K1": (154.0, 2.0)}, draws=draws)
    turned_by = np.degrees([pftwin.equilibrium(fitted.apply(small_scene(), d)).turned for d in draws])
    assert turned_by.argmax() == 1
    limit = float(np.sort(turned_by)[-2:].mean())
    engine = Engine(lambda _: small_scene().with_limits(most_start_turn_deg=limit), ("groove",), fitted)
    engine.prepare("groove")
    answer = engine.run("groove", MOVED)
    band = engine.band("groove", MOVED, answer, lambda: True)
    assert band is not None
    assert "4 draws from the estimate; 1 without a valid motion were omitted" in band.words
    tilts = [engine.model("groove").knobs.scene_with(MOVED, d) for d in draws[[0, 2, 3]]]
    ends = np.quantile([np.degrees(pftwin.simulate(s).angles.tilt) for s in tilts], [0.05, 0.95], axis=0)
    np.testing.assert_allclose(band.ends["tilt"], ends[:, answer.recorded.frames])


def test_lines_of_the_treated_scene_are_drawn(engine):
    before = engine.model("groove").before.recorded
    after = engine.run("groove", MOVED).recorded
    moved = after.lines["patellar_tendon"].origin - before.lines["patellar_tendon"].origin
    np.testing.assert_allclose(moved, [[0, -0.0065, 0.002]], atol=1e-12)
    assert after.mesh("surface")[0] is not None
    np.testing.assert_array_equal(after.mesh("surface")[0], before.mesh("surface")[0])


def test_values_out_of_range_are_refused_and_the_next_ones_work(engine):
    with pytest.raises(InputError, match="medialisation"):
        engine.run("groove", {**MOVED, f"{TRANSFER}.medialisation": float("nan")})
    assert engine.run("groove", MOVED).finite


def test_a_scene_that_the_values_make_impossible_is_refused():
    def short(name):
        scene = load(name)
        tendon = scene.effect("patellar_tendon")
        return scene.with_effect(eqx.tree_at(lambda t: t.slack_length, tendon, tendon.slack_length - 0.02))

    engine = Engine(short, ("groove",))
    engine.prepare("groove")
    with pytest.raises(InputError, match=r"patellar_tendon\.slack_length: found -0\.0086; expected: a positive number"):
        engine.run("groove", {**neutral(), "patellar_tendon_length_change.lengthening": -60.0})


def test_motions_that_mean_nothing_are_refused(engine):
    answer = engine.run("groove", MOVED)
    answer.refuse_if_lost(unlike=answer)
    with pytest.raises(InputError, match="the patella is lost"):
        dataclasses.replace(answer, finite=False).refuse_if_lost()
    loose = dataclasses.replace(answer, settled=False)
    with pytest.raises(InputError, match="no static equilibrium to start from"):
        loose.refuse_if_lost(unlike=answer)
    loose.refuse_if_lost(unlike=loose)


def test_contacts_are_prepared_when_they_are_wanted(engine):
    assert not engine.ready("absent")
    with pytest.raises(InputError, match="no mesh to fit it to"):
        engine.prepare("absent")
    with pytest.raises(InputError, match="expected: one of: groove, cubic"):
        engine.prepare("x" * 1000)
    assert engine.prepare("groove") is engine.model("groove")


def test_frames_are_those_of_the_result(engine):
    answer = engine.run("groove", MOVED)
    shown = DrawnMotion(answer.recorded, 10.0)
    data = answer.recorded.data
    matrices = of_poses(data["patella_position"].values, data["patella_quaternion"].values)
    patella = shown.tracks["patella"]
    np.testing.assert_allclose(patella.position, matrices[:, :3, 3], atol=1e-4)
    turns = np.abs(np.sum(patella.wxyz * data["patella_quaternion"].values, axis=1))
    np.testing.assert_allclose(turns, 1, atol=1e-6)
    np.testing.assert_allclose(patella.scale, 1, atol=1e-6)
    force = data["contact_force_lateral"].values
    arrow = shown.tracks["on contact, lateral"]
    here = arrow.present
    np.testing.assert_array_equal(here, force > 0)
    np.testing.assert_allclose(arrow.scale[here], force[here], rtol=1e-5)  # 10 mm for 10 N
    vertices, _ = shown.lines["patellar_tendon"]
    length = np.linalg.norm(np.diff(vertices.reshape(len(vertices), 2, -1, 3).mean(axis=2), axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(length, 1e3 * data["patellar_tendon_length"].values, atol=1e-3)


def test_the_surface_goes_on_where_it_is_touched_beyond_its_edge(engine):
    model = engine.model("groove")
    shown = DrawnMotion(model.before.recorded, 10.0)
    assert model.still.continued(shown.touched) is None
    out = np.where(np.arange(len(shown.touched))[:, None] == 3, [[0.0, 0.030, 0.0]], shown.touched)
    beyond = model.still.continued(out)
    assert beyond is not None
    used = beyond.vertices[np.unique(beyond.triangles)]
    assert 30.0 < used[:, 1].max() < 38.0
    assert used[:, 1].min() > 15.0
