"""The smallest treatment: right at its limit, honest where nothing helps, and clear about bad requests."""

from __future__ import annotations

import equinox as eqx
import numpy as np
import pytest
import scenes
from small_scene import small_scene

from fitting.prediction.outcomes import outcomes
from fitting.prediction.predicting import Fitted, predict
from fitting.prediction.variants import grid
from fitting.treatments import Treatment
from fitting.treatments.optimise import Limit, optimise_treatment
from pftwin import BDF2, equilibrium, rig, simulate
from pftwin.base.errors import InputError

DT = 5e-3
TRANSFER = "tibial_tuberosity_transfer"


@pytest.fixture(scope="module")
def knee():
    return scenes.knee(13)


def offset(scene, **amounts):
    treated = Treatment.of("tibial_tuberosity_transfer", **amounts)(scene)
    return outcomes(simulate(treated, dt=DT, integrator=BDF2()))["largest_offset"]


@pytest.fixture(scope="module")
def bound(knee):
    """What 7.3 mm of medialisation brings the offset to."""
    return offset(knee, medialisation=7.3e-3)


@pytest.fixture(scope="module")
def swept():
    """The small knee with its tuberosity up to 6.3 mm medial: as many members as a search asks for at once."""
    return predict(small_scene(5), grid(TRANSFER, medialisation=1e-4 * np.arange(64)), dt=DT)


@pytest.mark.slow
def test_a_small_knee_gets_the_least_that_meets_its_limit(swept):
    tilt = np.radians(swept["mean_tilt"].values)
    assert (np.diff(tilt) > 0).all()
    limit = Limit("mean_tilt", at_least=float(tilt[31]))
    plan = optimise_treatment(small_scene(5), limit, {"medialisation": (0.0, 0.02)}, dt=DT)
    assert plan.met
    assert 1e3 * float(plan.treatment.values[0]) == pytest.approx(3.1, abs=0.01)
    assert plan.outcomes["mean_tilt"] >= tilt[31]
    assert "3.1 mm medially" in plan.describe()
    limit = Limit("mean_tilt", at_least=float(tilt[0]) - 1e-3)
    nothing = optimise_treatment(small_scene(5), limit, {"medialisation": (0.0, 0.02)}, dt=DT)
    assert nothing.met
    assert float(nothing.treatment.values[0]) == 0


def test_limits_that_a_small_knee_cannot_meet_are_reported():
    limits = [Limit("peak_contact_force", at_most=0.5), Limit("dislocation_margin", at_least=0.001)]
    reports = []
    plan = optimise_treatment(
        small_scene(5), limits, {"medialisation": (0.0, 0.02)}, dt=DT, progress=lambda *now: reports.append(now)
    )
    assert reports[-1] == (41, 41, "the whole range")
    assert not plan.met
    assert "no amount within the range meets the limits" in plan.describe()
    assert "peak contact force at most 0.5 N" in plan.describe()
    assert "dislocation margin" not in plan.describe()


def test_an_invalid_plan_holds_no_limit():
    """The knee's equilibrium is far from where its search begins: nothing that follows can be trusted."""
    scene, limit = small_scene(5).with_limits(), Limit("mean_contact_force", at_most=1000.0)
    found = optimise_treatment(scene, limit, {"medialisation": (0.0, 0.02)}, dt=DT)
    assert not found.met
    assert "from the recorded start" in found.describe()
    plain = found.to_dict()
    assert plain["verdict"].startswith("INVALID")
    assert not plain["limits"][0]["holds"]
    assert "status" not in plain
    assert all(np.isnan(value) for value in found.outcomes.values())


@pytest.mark.slow
def test_one_amount_ends_where_its_limit_is_just_met(knee, bound):
    plan = optimise_treatment(knee, Limit("largest_offset", at_most=bound), {"medialisation": (0.0, 0.02)}, dt=DT)
    assert plan.met
    assert 1e3 * float(plan.treatment.values[0]) == pytest.approx(7.3, abs=0.01)
    assert plan.outcomes["largest_offset"] <= bound
    assert plan.outcomes["largest_offset"] == pytest.approx(offset(knee, medialisation=float(plan.treatment.values[0])))
    assert "7.3 mm medially" in plan.describe()


@pytest.mark.slow
def test_two_amounts_share_the_work(knee, bound):
    ranges = {"medialisation": (0.0, 0.02), "distalisation": (0.0, 0.02)}
    plan = optimise_treatment(knee, Limit("largest_offset", at_most=bound), ranges, dt=DT)
    assert plan.met
    assert plan.outcomes["largest_offset"] <= bound
    both = np.array([float(v) for v in plan.treatment.values])
    assert np.linalg.norm(both) < 7.3e-3
    for turn in (-0.1, 0.1):  # no other mixture of the same size does better
        c, s = np.cos(turn), np.sin(turn)
        other = 0.998 * np.array([[c, -s], [s, c]]) @ both
        if (other >= 0).all():
            assert offset(knee, medialisation=other[0], distalisation=other[1]) > bound


@pytest.mark.slow
def test_nothing_is_done_where_nothing_is_needed(knee):
    plan = optimise_treatment(knee, Limit("largest_offset", at_most=0.015), dt=DT)
    assert plan.met
    assert float(plan.treatment.values[0]) == 0


@pytest.mark.slow
def test_case_2_needs_some_4_mm():
    plan = optimise_treatment(rig.case(2), Limit("dislocation_margin", at_least=0.001))
    assert plan.met
    assert 1e-3 < float(plan.treatment.values[0]) < 4e-3
    assert 0.001 <= plan.outcomes["dislocation_margin"] < 0.004


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda s: Limit("pain", at_most=1.0), r"no limit on 'pain'.*largest_offset"),
        (lambda s: Limit("dislocation_time", at_least=1.0), "no limit on 'dislocation_time'"),
        (lambda s: Limit("largest_offset"), "either at_most or at_least"),
        (lambda s: Limit("largest_offset", at_most=1.0, at_least=0.0), "either at_most or at_least"),
        (lambda s: Limit("largest_offset", at_most=np.nan), "either at_most or at_least"),
        (lambda s: optimise_treatment(s, []), r"limits: found \(\)"),
        (
            lambda s: optimise_treatment(s, LIMIT, {"medialisation": (0.01, 0.01)}),
            r"ranges: medialisation.*\(least, most\)",
        ),
        (lambda s: optimise_treatment(s, LIMIT, {"medialisation": "wide"}), "found 'wide'"),
        (lambda s: optimise_treatment(s, LIMIT, {"deepening": (0.0, 0.01)}), "no amount 'deepening'"),
        (lambda s: optimise_treatment(s, LIMIT, dict.fromkeys("abcd", (0.0, 1.0))), r"4 amounts.*at most 3"),
        (lambda s: optimise_treatment(s.without("patellar_tendon"), LIMIT), "no tendon or strands named"),
        (lambda s: optimise_treatment(s, LIMIT, samples=5), "samples without an estimate"),
        (lambda s: optimise_treatment(s, LIMIT, samples=-1), "samples: found -1"),
        (lambda s: optimise_treatment(s, LIMIT, confidence=1.5), r"confidence: found 1\.5"),
        (
            lambda s: optimise_treatment(
                s, LIMIT, {"lengthening": (0.0, 1.0)}, Treatment.of("mpfl_graft", shortening=0)
            ),
            "no amount 'lengthening'|no tendon or strands named",
        ),
    ],
)
def test_bad_requests_are_named(knee, make, message):
    with pytest.raises(InputError, match=message):
        make(knee)


LIMIT = Limit("largest_offset", at_most=0.01)


class Uncertain(Fitted):
    """An estimate whose draws are the tuberosity's lateral place, evenly spread by +-1 mm about the scene's."""

    names, units, values = ("patellar_tendon.origin.y",), ("m",), np.zeros(1)

    def apply(self, scene, theta=None):
        if theta is None:
            return scene
        at = scene.index("patellar_tendon")
        return eqx.tree_at(lambda s: s.effects[at].origin.y, scene, scene.effects[at].origin.y + theta[0])

    def samples(self, count, seed=0):
        return np.linspace(-1e-3, 1e-3, count)[:, None]


UNCERTAIN = Uncertain()  # one, as programs know an estimate by its identity


@pytest.mark.slow
def test_draws_that_start_invalid_meet_no_limit():
    """Two of eleven turn further at the start than the limit allows, by the equilibria that `pftwin` reports."""
    knee, draws = small_scene(6), UNCERTAIN.samples(11)
    turned = np.degrees([equilibrium(UNCERTAIN.apply(knee, d)).turned for d in (UNCERTAIN.values, *draws)])
    second, third = np.sort(turned[1:])[[-2, -3]]
    assert turned[0] < third
    near = knee.with_limits(most_start_turn_deg=float(0.5 * (second + third)))
    options = {"estimate": UNCERTAIN, "samples": 11, "confidence": 0.5, "dt": DT}
    plan = optimise_treatment(near, Limit("peak_contact_force", at_most=1e4), {"medialisation": (0.0, 0.02)}, **options)
    assert plan.met
    assert plan.share == pytest.approx(9 / 11)


@pytest.mark.slow
def test_limits_hold_for_the_share_of_draws_that_was_asked_for(knee, bound):
    """Draws displace the tuberosity itself, so that it has to be moved as far more as the worst draw that counts."""
    limit, reach = Limit("largest_offset", at_most=bound), {"medialisation": (0.0, 0.02)}
    options = {"estimate": UNCERTAIN, "samples": 11, "dt": DT}
    plan = optimise_treatment(knee, limit, reach, **options, confidence=0.9)
    assert plan.met
    assert plan.share == pytest.approx(10 / 11)
    moved = 1e3 * float(plan.treatment.values[0])
    assert moved == pytest.approx(7.3 + 0.8, abs=0.02)  # the tenth of eleven draws is at 0.8 mm
    assert "all limits are met in 91% of 11 draws" in plan.describe()
    half = optimise_treatment(knee, limit, reach, **options, confidence=0.5)
    assert 1e3 * float(half.treatment.values[0]) == pytest.approx(7.3, abs=0.02)  # as the estimate itself asks for
    assert half.share == pytest.approx(6 / 11)


@pytest.mark.slow
def test_no_treatment_is_sure_enough(knee, bound):
    """Two points of the grid are left to the draws: 34 members, which the grid's own program of 64 holds."""
    limit = Limit("largest_offset", at_most=bound)
    found = optimise_treatment(
        knee, limit, {"medialisation": (0.0, 7.5e-3)}, estimate=UNCERTAIN, samples=16, confidence=1.0, dt=DT
    )
    assert not found.met
    assert 0.5 < found.share < 1
    assert "which meets the limits in too few draws; all limits are met in" in found.describe()
    plain = found.to_dict()
    assert plain["share_of_draws"] == found.share
    assert plain["limits"][0]["holds"]


@pytest.mark.parametrize(
    ("text", "limit"),
    [
        ("dislocation_margin>=3 mm", Limit("dislocation_margin", at_least=0.003)),
        (" peak_contact_force <= 40N", Limit("peak_contact_force", at_most=40.0)),
        ("largest_tilt<=-1.5e1deg", Limit("largest_tilt", at_most=np.radians(-15.0))),
        ("lateral_share <= 60 %", Limit("lateral_share", at_most=0.6)),
        ("dislocations<=0", Limit("dislocations", at_most=0.0)),
    ],
)
def test_limits_as_people_write_them(text, limit):
    found = Limit.parsed(text)
    assert found.outcome == limit.outcome
    assert found.at_most == pytest.approx(limit.at_most)
    assert found.at_least == pytest.approx(limit.at_least)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dislocation_margin>=3", "expected: dislocation_margin in mm or cm or m"),
        ("dislocation_margin>=3 N", "dislocation_margin in mm"),
        ("lateral_share<=1 mm", "plain numbers or %"),
        ("dislocations<=50 %", "expected: dislocations in plain numbers$"),  # a count
        ("tracks_at_end>=100 %", "expected: tracks_at_end in plain numbers$"),  # yes or no
        ("dislocation_side<=0 %", "expected: dislocation_side in plain numbers$"),  # 1, -1 or 0
        ("pain<=3", "no limit on 'pain'"),
        ("dislocation_margin>3 mm", "such as"),
        ("dislocation_margin>=e mm", "such as"),
        ("3 mm", "such as"),
    ],
)
def test_limits_that_are_none(text, message):
    with pytest.raises(InputError, match=message):
        Limit.parsed(text)


@pytest.mark.slow
def test_interrupted_after_the_draws_it_is_the_smallest_amount_that_enough_of_them_meet(monkeypatch):
    """And says that no separate simulation confirmed it. The estimate's coverage is the plan's."""
    knee, reach, grid_step = small_scene(5), {"medialisation": (0.0, 0.02)}, 0.02 / 40
    reports = predict(knee, grid(TRANSFER, medialisation=grid_step * np.arange(41)), UNCERTAIN, samples=11, dt=DT)
    tilt = np.radians(reports["mean_tilt"].values)
    limit = Limit("mean_tilt", at_least=float(tilt[14, 0]))
    enough = (tilt[:, 1:] >= limit.at_least).mean(axis=1) >= 0.9
    expected = grid_step * np.flatnonzero(enough & (tilt[:, 0] >= limit.at_least))[0]
    monkeypatch.setattr("fitting.treatments.refine.Search.room", interrupt)
    plan = optimise_treatment(knee, limit, reach, estimate=UNCERTAIN, samples=11, confidence=0.9, dt=DT)
    assert plan.interrupted
    assert float(plan.treatment.values[0]) == pytest.approx(expected)
    assert plan.share >= 0.9
    assert "which meets the limits, but was not confirmed; all limits are met in" in plan.describe()
    assert "too few" not in plan.describe()


def interrupt(*_):
    raise KeyboardInterrupt
