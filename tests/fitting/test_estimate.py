"""What an estimate says of itself, from numbers chosen by hand: intervals, correlations, draws, bounds, its table."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from made_estimates import made_estimate
from scipy import stats

import fitting
from fitting.coverage import QUICK
from fitting.estimate import Estimate
from fitting.uncertainty import in_words, percent, relative, sizes
from pftwin.rig.cases import case

VALUES = {"K1": (160.0, 4.0), "L1": (0.15, 1e-3), "K2": (600.0, 30.0)}
SD = np.array([4.0, 1e-3, 30.0])
CORRELATION = np.array([[1.0, 0.8, -0.3], [0.8, 1.0, 0.1], [-0.3, 0.1, 1.0]])


def correlated(**more):
    return made_estimate(VALUES, covariance=CORRELATION * np.outer(SD, SD), **more)


def test_intervals_hold_95_percent_of_a_normal_distribution():
    e = correlated()
    low, high = e.intervals.T
    np.testing.assert_allclose(stats.norm.cdf(high, e.values, SD), 0.975, rtol=1e-9)
    np.testing.assert_allclose(stats.norm.cdf(low, e.values, SD), 0.025, rtol=1e-9)
    np.testing.assert_allclose(e.standard_deviations, SD)
    np.testing.assert_allclose(e.correlation, CORRELATION, atol=1e-12)


def test_draws_have_the_estimates_mean_and_covariance_and_keep_the_bounds():
    wide = correlated(lower=np.zeros(3), upper=np.full(3, 1e4))
    draws = wide.samples(40_000, seed=1)
    np.testing.assert_allclose((draws.mean(axis=0) - wide.values) / SD, 0, atol=0.02)
    np.testing.assert_allclose(np.cov(draws.T) / np.outer(SD, SD), CORRELATION, atol=0.02)
    np.testing.assert_array_equal(wide.samples(5, seed=1), wide.samples(5, seed=1))
    assert not np.array_equal(wide.samples(5, seed=1), wide.samples(5, seed=2))
    narrow = correlated(lower=np.array([159.0, 0.0, 0.0]), upper=np.array([1e4, 0.1505, 1e4]))
    draws = narrow.samples(2000)
    assert draws[:, 0].min() == 159.0
    assert draws[:, 1].max() == 0.1505


def test_bounds_that_are_reached_are_named_on_either_side():
    e = made_estimate(VALUES, lower=np.array([160.0, 0.1, 500.0]), upper=np.array([200.0, 0.2, 600.05]))
    assert e.at_bounds == ("K1", "K2")
    unknown = "the precision is not known, and the true value may lie beyond"
    assert f"(SD). At a bound: K1, K2; {unknown}. But 95 % intervals " in e.sentence()
    given = "positions give K1 = 160 N/m (at its bound), L1 = 150.0 +- 1.0 mm and K2 = 600 N/m (at its bound) (SD). "
    assert e.sentence().startswith(given)
    marked = [line.endswith("; at its bound)") for line in e.summary().splitlines()[1:4]]
    assert marked == [True, False, True]
    assert [" +- " in line for line in e.summary().splitlines()[1:4]] == [False, True, False]
    assert e.to_dict()["at_bounds"] == ["K1", "K2"]
    tied = np.diag(SD**2)
    tied[0, 2] = tied[2, 0] = 0.8 * SD[0] * SD[2]
    at_bound = made_estimate(VALUES, upper=np.array([160.0, 1.0, 1e4]), covariance=tied)
    assert f". At a bound: K1; {unknown}; strongly correlated with it: K2. But" in at_bound.sentence()
    draws = np.minimum(np.linspace(160.0, 240.0, 41), 200.0)[:, None] + np.array([0.0, 0.15 - 160, 550 - 160])
    by_simulations = dataclasses.replace(e, draws=draws, lower=np.array([100.0, 0.0, 500.0]))
    assert by_simulations.bound_mark("K1") == "interval to its bound"  # its end, as the value is amid the bounds
    assert made_estimate(VALUES).at_bounds == ()
    assert "bound" not in made_estimate(VALUES).sentence()
    doubted = made_estimate(VALUES, upper=np.array([160.0, 1.0, 1e4]), doubts=["a doubt"])
    assert doubted.sentence().endswith(
        ". At a bound: K1; the precision is not known, and the true value may lie beyond"
    )


def test_the_table_has_estimate_deviation_interval_and_nominal():
    """K1 160 N/m, 4 % above its nominal value; L1 8 %; K2 12 %."""
    text = correlated().summary()
    assert "K1           160 +- 4 N/m  (95 %: 152.16 to 167.84; nominal 153.846)" in text
    assert "L1           0.15 +- 0.001 m  (95 %: 0.14804 to 0.15196; nominal 0.138889)" in text
    assert "K2           600 +- 30 N/m  (95 %: 541.201 to 658.799; nominal 535.714)" in text


def test_remarks_say_what_weakens_the_numbers():
    assert correlated(synthetic=False).remarks() == []
    assert "residuals are autocorrelated (0.35 " in correlated(serial_correlation=0.35).remarks()[-1]
    assert not any("correlated" in r for r in correlated(serial_correlation=0.1).remarks())
    assert "3 of 8 starts found no equilibrium" in correlated(dropped=3, starts=8).remarks()[-1]


def test_doubts_of_the_measurements_come_before_any_number():
    e = correlated(doubts=["measured contact looks negated", "residual of position: 12 mm rms"])
    assert e.invalid
    assert e.summary().splitlines()[0] == e.sentence()
    assert e.sentence() == (
        "INVALID: measured contact looks negated; residual of position: 12 mm rms. "
        "The precision of K1, L1, K2 is not known"
    )
    assert "fix" not in e.summary()
    assert list(e.to_dict())[:3] == ["format", "sentence", "doubts"]
    assert not correlated().invalid
    assert QUICK.intervals in correlated().sentence()


def two_stiffnesses(deviation: float, correlation: float, **more):
    values, rho = np.array([160.0, 600.0]), np.array([[1.0, correlation], [correlation, 1.0]])
    covariance = deviation**2 * rho * np.outer(values, values)
    return made_estimate({"K1": (160.0, 1.0), "K2": (600.0, 1.0)}, covariance=covariance, **more).sentence()


@pytest.mark.parametrize("correlation", [0.999, 0.9])
def test_the_sentence_splits_two_stiffnesses_into_ratio_and_scale(correlation):
    """Relative errors d correlate by c: the ratio's is d sqrt(2 - 2 c), the common scale's d sqrt((1 + c) / 2)."""
    words = two_stiffnesses(0.05, correlation)
    ratio, common = 5 * np.sqrt(2 - 2 * correlation), 5 * np.sqrt((1 + correlation) / 2)
    assert common > 2 * ratio
    if common > 3 * ratio:
        assert words == (
            f"positions give K1/K2 to {ratio:.2g} %, the common scale of K1 and K2 only to {common:.2g} %: "
            f"measure one force to fix both. But {QUICK.intervals}"
        )
    else:
        assert words.startswith("positions give K1 = 160.0 +- 8.0 N/m and K2 = 600 +- 30 N/m (SD); the weakest ")


def test_no_force_is_asked_for_where_one_was_measured_or_all_is_well_known():
    assert "measure one force" not in two_stiffnesses(0.05, 0.999, channels=("position", "quadriceps"))
    assert "measure one force" not in two_stiffnesses(0.015, 0.999)
    asked: dict = {"channels": ("m1.x", "contact.force_medial")}
    assert "measure one force" not in two_stiffnesses(0.05, 0.999, readings={"m1.x": "m"}, **asked)
    places = {"m1.x": "m", "contact.force_medial": "m"}  # as if both were places
    assert "measure one force" in two_stiffnesses(0.05, 0.999, readings=places, **asked)
    assert two_stiffnesses(0.05, -0.999).startswith("positions give K1 = 160.0 +- 8.0 N/m and K2 = 600 +- 30 N/m (SD)")


def test_relative_covariances_are_those_of_logarithms():
    """Draws of small relative deviations, their logarithms' covariance."""
    e = correlated()
    draws = np.random.default_rng(0).multivariate_normal(e.values, e.covariance, 100_000)
    found = relative(sizes(e.names, e.upper - e.lower, e.values), e.covariance)
    size = np.outer(SD / e.values, SD / e.values)
    np.testing.assert_allclose(found / size, np.cov(np.log(draws).T) / size, atol=0.03)
    at_zero = relative(sizes(e.names, np.full(3, 10.0), np.array([0.0, 0.15, 600.0])), e.covariance)
    assert at_zero[0, 0] == pytest.approx((4.0 / 10) ** 2)  # by the range, where a value is nothing to go by


def test_shares_in_words():
    assert [percent(s) for s in (0.0123, 0.5, 1.2, 11.0, np.inf)] == [
        "1.2 %",
        "50 %",
        "120 %",
        "no useful accuracy",
        "no useful accuracy",
    ]


def test_its_file_holds_its_numbers_and_what_follows_from_them(tmp_path):
    e = correlated(priors={"L1": (0.149, 0.002)}, noise={"position": 2e-4}, history=[{"best": 3.0}])
    content = json.loads(e.save(tmp_path / "fit.json").read_text())
    assert content["format"] == "pftwin estimate 1"
    assert content["names"] == ["K1", "L1", "K2"]
    assert content["values"] == [160.0, 0.15, 600.0]
    np.testing.assert_allclose(content["nominal"], [160 / 1.04, 0.15 / 1.08, 600 / 1.12])
    np.testing.assert_allclose(content["standard_deviations"], SD)
    np.testing.assert_allclose(content["intervals_95"][0], [160 - 1.959964 * 4, 160 + 1.959964 * 4], rtol=1e-7)
    np.testing.assert_allclose(content["correlation"], CORRELATION)
    assert content["sentence"] == e.sentence()
    assert content["remarks"] == ["the measurements are synthetic"]
    again = Estimate.load(tmp_path / "fit.json")
    np.testing.assert_array_equal(again.covariance, e.covariance)
    assert (again.priors, again.noise, again.history) == ({"L1": (0.149, 0.002)}, {"position": 2e-4}, [{"best": 3.0}])
    assert (again.nominal_scene, again.measured) == (None, None)
    assert again.to_dict() == e.to_dict()


def test_a_file_with_the_key_of_older_versions_is_read(tmp_path):
    path = made_estimate(VALUES, auxiliary=("K2",)).save(tmp_path / "fit.json")
    content = json.loads(path.read_text())
    content["besides"] = content.pop("auxiliary")
    path.write_text(json.dumps(content))
    again = Estimate.load(path)
    assert (again.auxiliary, again.asked) == (("K2",), 2)


def test_its_file_is_json_where_numbers_are_not_finite(tmp_path):
    """JSON has no Infinity: R and JavaScript refuse a file that holds it."""

    def refused(name: str) -> float:
        raise AssertionError(name)

    unknown = np.diag([1.0, np.inf, 3.0])
    e = made_estimate(
        VALUES, covariance=unknown, condition=np.inf, history=[{"best": -np.inf}, {"best": 2.0}], rmse={"X": np.nan}
    )
    text = e.save(tmp_path / "fit.json").read_text()
    assert json.loads(text, parse_constant=refused)["covariance"][1][1] == "Infinity"
    again = Estimate.load(tmp_path / "fit.json")
    np.testing.assert_array_equal(again.covariance, unknown)
    assert (again.condition, again.history) == (np.inf, [{"best": -np.inf}, {"best": 2.0}])
    assert np.isnan(again.rmse["X"])


def test_coordinates_of_points_are_stated_in_millimetres():
    """An attachment 1 mm from the middle is as well known as one 20 mm from it."""
    names, values, sd = ("K1", "insertion.y", "insertion.x"), np.array([160.0, 1e-3, -0.02]), [4.0, 4e-4, 6e-4]
    said = in_words(names, np.array([90.0, 0.01, 0.01]), values, np.diag(sd) ** 2, ("position",), names[1:])
    assert said.startswith("positions fix K1 to 2.5 %, insertion.y to 0.4 mm and insertion.x to 0.6 mm")
    content = in_words(names, np.ones(3), values, np.diag(sd) ** 2, ("contact",), names[1:], units=("N/m", "m", "m"))
    numbers = "K1 = 160.0 +- 4.0 N/m, insertion.y = 1.00 +- 0.40 mm and insertion.x = -20.00 +- 0.60 mm (SD)"
    assert content.startswith(f"contact gives {numbers}")
    both = np.array([0.07, 9.0]), np.diag([1.4, 0.9]) ** 2
    lost = in_words(("L2", "K1"), np.ones(2), *both, ("contact",), units=("m", "N/m"))
    assert lost.startswith("contact gives L2 with no useful accuracy and K1 = 9.00 +- 0.90 N/m (SD)")


def test_a_coordinate_is_applied_to_another_knee_as_an_offset(tmp_path):
    """What the fit moved by 2 mm is moved by 2 mm; the other knee's transfer of its tuberosity stays."""
    fitted, other = case(2), case(1)  # their tuberosities are 16 mm apart
    names = ("K1", "patellar_tendon.origin.y")
    nominal = fitting.free_parameters(fitted, names, {"patellar_tendon.origin.y": (-0.1, 0.1)})
    start = [float(fitted.get(n)) for n in ("quadriceps.stiffness", names[1])]
    e = made_estimate({"K1": (1.1 * start[0], 1.0), "L1": (start[1] + 0.002, 1e-4)}, names=names,
                      coordinates=nominal.coordinates, nominal=np.array(start))  # fmt: skip
    e.save(tmp_path / "fit.json")
    for estimate in (e, Estimate.load(tmp_path / "fit.json")):
        moved = estimate.apply(other)
        np.testing.assert_allclose(moved.get(names[1]) - other.get(names[1]), 0.002, atol=1e-12)
        np.testing.assert_allclose(moved.get("quadriceps.stiffness"), 1.1 * start[0])
        np.testing.assert_allclose(estimate.apply(fitted).get(names[1]), start[1] + 0.002)
    assert abs(float(other.get(names[1])) - start[1]) > 0.01
