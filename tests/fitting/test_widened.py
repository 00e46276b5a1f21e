"""Intervals that a calibration widens: the factors hold on plants that were not used, and estimates say so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import pftwin, refused
from lifting_scene import lifting_scene
from made_estimates import made_estimate

import fitting
from fitting.calibration import quick_fit
from fitting.calibration.quick_fit import QuickFit
from fitting.calibration.result import Answers, Calibration
from fitting.estimate import Estimate
from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured

VALUES = {"K1": (151.0, 3.0), "L1": (0.14, 2e-4), "K2": (640.0, 21.0), "L2": (0.072, 5e-4)}
DEVIATIONS = np.array([sd for _, sd in VALUES.values()])
FACTORS = (2.5, 1.0, 3.0, 1.25)  # of K1, L1, K2, L2
PLANTS = {"misplaced": 23, "stiffening": 19}


def still() -> Measured:
    times = lifting_scene().motion.times
    return Measured(times, np.zeros((times.size, 3)))


def estimate() -> Estimate:
    """Of correlations of 0.4."""
    return made_estimate(VALUES, covariance=np.outer(DEVIATIONS, DEVIATIONS) * (0.4 + 0.6 * np.eye(4)))


def quick(**changed: Any) -> QuickFit:
    return replace(QuickFit.of(lifting_scene(), still(), noise={"position": 1e-4}), **changed)


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Fits give that estimate; the list is of what they were asked for."""
    asked: list[dict[str, Any]] = []

    def fit(*_: Any, **options: Any) -> Estimate:
        asked.append(options)
        return estimate()

    monkeypatch.setattr(quick_fit, "fit_tendons", fit)
    return asked


def off(width: float, count: int, seed: int) -> Answers:
    """For two parameters, whose posteriors are as wide as their errors times a factor; the second's errors are of
    Student's distribution with three degrees of freedom."""
    random, truth, rows = np.random.default_rng(seed), np.array([150.0, 0.07]), []
    for _ in range(count):
        error = np.array([3.0, 7e-4]) * [random.standard_normal(), random.standard_t(3)]
        draws = truth + error + width * np.array([3.0, 7e-4]) * random.standard_normal((400, 2))
        rows.append((truth, draws, False))
    return Answers.of(rows, dropped=0, refused=0, asked=2)


def test_widened_intervals_contain_the_true_value_of_further_plants():
    """On average over calibrations, as split conformal prediction promises of any distribution of errors; on their own
    plants a calibration of 39 leaves out one (the 38th of 39 is the quantile)."""
    further = off(0.5, count=4000, seed=1)
    sizes = np.abs(further.errors) / further.half_widths
    covered = []
    for seed in range(2, 42):
        some = off(0.5, count=39, seed=seed)
        covered.append((sizes <= some.factors).mean(axis=0))
        own = np.abs(some.errors) / some.half_widths <= some.factors
        assert (own.sum(axis=0) == 38).all()
    assert (np.mean(covered, axis=0) > 0.94).all()
    assert (np.mean(covered, axis=0) < 0.97).all()
    assert ((sizes <= 1).mean(axis=0) < 0.8).all()


def test_what_was_calibrated_takes_the_largest_factors_of_all_kinds():
    kinds = {"misplaced": off(0.5, count=40, seed=3), "stiffening": off(0.7, count=25, seed=4)}
    found = Calibration(("K1", "L2"), kinds, "fits", 0, 1.0)
    wanted = np.maximum(kinds["misplaced"].factors, kinds["stiffening"].factors)
    wider = found.widened(quick(widened=(1.0, 2.0)))
    np.testing.assert_allclose(wider.widened, wanted * [1.0, 2.0])
    assert wider.plants == {"misplaced": 40, "stiffening": 25}


def test_too_few_plants_widen_nothing():
    """The largest of n errors is not exceeded by a further one with probability n / (n + 1): 95 % with 19."""
    few, enough = (Calibration(("K1", "L2"), {"odd": off(0.5, n, 5)}, "fits", 0, 1.0) for n in (18, 19))
    with pytest.raises(InputError, match=r"18 valid answers for plants 'odd'.*at least 19 of each kind"):
        few.widened(quick())
    assert (np.array(enough.widened(quick()).widened) > 1).all()


def test_an_estimate_is_widened_and_says_by_how_much(fitted, tmp_path):
    plain, wide = estimate(), quick(widened=FACTORS, plants=PLANTS).estimate(lifting_scene(), still())
    assert fitted[0]["free"] == tuple(VALUES)
    assert fitted[0]["noise"] == {"position": 1e-4}
    half = np.diff(wide.intervals)[:, 0] / np.diff(plain.intervals)[:, 0]
    np.testing.assert_allclose(half, FACTORS)
    np.testing.assert_allclose(wide.correlation, plain.correlation)
    np.testing.assert_array_equal(wide.values, plain.values)
    np.testing.assert_allclose(wide.samples(4000).std(axis=0), DEVIATIONS * FACTORS, rtol=0.1)
    said = wide.coverage.intervals
    assert "(K1 2.5, L1 1, K2 3, L2 1.2)" in said
    assert "(23 misplaced, 19 stiffening) that a calibration made of small knee" in said
    assert Estimate.load(wide.save(tmp_path / "fit.json")).coverage == wide.coverage
    assert plain.coverage.intervals != said


def test_a_widened_interval_is_stated_at_a_bound_too(monkeypatch):
    """Fits that end at a bound are among those of the calibration."""
    at_bound = made_estimate(VALUES, upper=np.array([151.0, 1.0, 1e4, 1.0]))
    monkeypatch.setattr(quick_fit, "fit_tendons", lambda *_, **__: at_bound)
    wide = quick(widened=FACTORS, plants=PLANTS).estimate(lifting_scene(), still())
    assert at_bound.set_by_bounds == wide.at_bounds == ("K1",)
    assert "K1 = 151.0 +- 7.5 N/m" in wide.sentence()
    assert "K1 = 151 N/m (at its bound)" in at_bound.sentence()


def test_a_calibrated_fit_is_saved_and_loaded(tmp_path):
    kept = quick(widened=FACTORS, plants=PLANTS)
    kept = replace(
        kept, set_up=kept.set_up._replace(priors={"K1": (150.0, 9.0)}, nuisance=fitting.Nuisance(damping=0.5))
    )
    assert QuickFit.load(kept.save(tmp_path / "wider.json")) == kept
    assert "widened by a calibration: K1 2.5, K2 3, L2 1.2 times" in kept.sentence()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"format": "pftwin estimate 1"}, "its format is 'pftwin estimate 1'"),
        ({"widened": [2.0]}, "its factors are not those of K1, L1, K2, L2"),
        ({"widened": [2.0, "inf", 1.0, 1.0]}, "its factors are not those of K1, L1, K2, L2"),
        ({"widened": [2.0, 0.5, 1.0, 1.0]}, "its factors are not those of K1, L1, K2, L2"),
        ({"widened": ["wide"] * 4}, "no calibrated fit"),
        ({"method": "simulations"}, "no method 'simulations'"),
        ({"set_up": {}}, "no calibrated fit"),
    ],
)
def test_other_files_are_refused(tmp_path, changed, said):
    path = quick(widened=FACTORS).save(tmp_path / "wider.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))
    with pytest.raises(InputError, match=rf"wider\.json.*{said}"):
        QuickFit.load(path)


def test_recordings_of_another_length_are_refused():
    data = still()
    with pytest.raises(InputError, match="31 frames; expected: 41, as it was set up for"):
        quick().estimate(lifting_scene(31), Measured(data.times[:31], data.center[:31]))


def test_another_nominal_knee_is_refused():
    other = lifting_scene().set("K2", 1.01 * lifting_scene().get("K2"))
    with pytest.raises(InputError, match=r"K2 is .* in scene .*as in 'small knee'"):
        quick().estimate(other, still())
    more = quick(nominal=(*quick().nominal, 0.3))
    with pytest.raises(InputError, match=r"'small knee' has 4 free and nuisance parameters; expected: 5"):
        more.estimate(lifting_scene(), still())


def test_an_interrupted_fit_is_not_widened(monkeypatch):
    cut = made_estimate(VALUES, reason="interrupted")
    monkeypatch.setattr(quick_fit, "fit_tendons", lambda *_, **__: cut)
    assert quick(widened=FACTORS, plants=PLANTS).estimate(lifting_scene(), still()) is cut


def test_draws_of_a_calibration_have_the_quantiles_of_the_intervals():
    """Also at a bound, where `samples` would be cut in half."""
    found = made_estimate(VALUES, upper=np.array([151.0, 1.0, 640.0, 1.0]))
    ends = np.quantile(quick_fit.interval_draws(found), (0.025, 0.975), axis=0).T
    np.testing.assert_allclose(ends, found.intervals, rtol=0, atol=0.15 * np.max(found.standard_deviations))
    assert ends[0, 1] > 154


def test_intervals_without_width_are_not_widened():
    flat = off(0.5, count=30, seed=6)._replace(half_widths=np.tile([0.1, 0.0], (30, 1)))
    with pytest.raises(InputError, match="intervals of L2 have no width"):
        Calibration(("K1", "L2"), {"odd": flat}, "fits", 0, 1.0).widened(quick())


def test_settings_of_the_file_hold(tmp_path):
    wider = quick(widened=FACTORS, plants=PLANTS).save(tmp_path / "wider.json")
    asked = ("fit", "--case", 2, "-o", tmp_path / "fit.json", "--calibrated", wider)
    assert "--calibrated: --free, --nuisance together with this file" in refused(
        *asked, "--free", "K1", "--nuisance", "rig"
    )
    assert "both --trained and --calibrated" in refused(*asked, "--trained", tmp_path / "no.npz")
    assert "--calibrated with --posterior" in refused(*asked, "--posterior", 8)
    assert "721 frames; expected: 41" in refused(*asked)
    assert [p.name for p in tmp_path.iterdir()] == ["wider.json"]


def test_the_command_fits_as_calibrated(fitted, tmp_path):
    wider = replace(QuickFit.of(rig.case(2)), widened=FACTORS, plants=PLANTS).save(tmp_path / "wider.json")
    output = tmp_path / "fit.json"
    result = pftwin("fit", "--case", 2, "-o", output, "--calibrated", wider, "--no-figures")
    assert result.exit_code == 0, result.output
    assert json.loads(Path(output).read_text())["widened"] == dict(zip(VALUES, FACTORS, strict=True))
    assert "23 misplaced, 19 stiffening" in result.stdout
