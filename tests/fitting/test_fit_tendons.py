"""Known springs are found again: from clean, noisy and incomplete motions, through touch and lift-off.

Refusals and checkpoints that take the same program are here too: of two files both processes would compile it at once.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lifted_fits import COMPUTED, FEW, NOISE, SPRINGS, TRUTH, clean, estimate, found, noisy, scene, truth
from small_scene import small_scene

import fitting
import fitting.fit
import pftwin
from fitting.evaluation import Evaluator
from fitting.methods.least_squares import LeastSquares
from fitting.methods.problem import Problem, Request
from fitting.objective import Objective
from fitting.outcome import judge
from pftwin.base.errors import InputError
from pftwin.dynamics.status import Status
from pftwin.model.limits import Limits
from pftwin.model.measured import Measured
from pftwin.results.verdict import ALLOWED


@pytest.mark.parametrize("objective", ["likelihood", "paper"])
def test_known_parameters_are_recovered(objective):
    fit = found() if objective == "likelihood" else fitting.fit_tendons(scene(), clean(), objective=objective, **FEW)
    assert fit.objective == objective
    np.testing.assert_allclose(fit.values, TRUTH, rtol=1e-5)
    assert fit.reason == "converged"
    assert fit.values_compared == 3 * len(clean().times)
    assert fit.rmse["position"] < 1e-8
    assert fit.verdict == "valid"


def test_a_fit_whose_motion_may_not_be_spoken_of_says_so_first(monkeypatch):
    """The patella is off its groove in some frames; here that is one too many."""
    estimate = replace(found())
    assert "touches nothing" not in estimate.sentence()
    monkeypatch.setitem(ALLOWED, Status.NO_CONTACT, 0.0)
    judge(estimate)  # the last that a fit does; that it does is seen where one is valid
    assert estimate.sentence().startswith("INVALID: the button touches nothing (")
    assert estimate.summary().startswith("INVALID: ")


def test_a_fitted_scene_beyond_the_limits_makes_the_estimate_invalid():
    """As an attachment within an obstacle would: the fit's result is not lost, and its other figures are drawn."""
    estimate = found()
    trials = tuple(t._replace(nominal=replace(t.nominal, limits=Limits())) for t in estimate.trials)
    estimate = replace(estimate, values=estimate.values * np.array([1.0, 0.01, 1.0, 1.0]), trials=trials)
    judge(estimate)
    assert estimate.sentence().startswith("INVALID: ")
    assert "least_slack_share" in estimate.verdict
    assert estimate.plot.fit().get_suptitle().endswith("(INVALID: no fitted motion)")


def test_an_unknown_noise_is_estimated():
    estimate = fitting.fit_tendons(scene(), noisy(0), **FEW)
    assert estimate.noise["position"] == pytest.approx(NOISE, rel=0.2)
    assert not estimate.noise_known


def test_missing_frames_are_left_out():
    center = truth().center.copy()
    center[5:9] = np.nan
    estimate = fitting.fit_tendons(scene(), Measured(truth().times, center), noise={"position": 1e-8}, **FEW)
    np.testing.assert_allclose(estimate.values, TRUTH, rtol=1e-5)


@pytest.mark.slow
def test_a_robust_loss_minds_an_outlier_less():
    center = noisy(1).center
    center[20] += 0.01
    data, known = Measured(truth().times, center), {"position": NOISE}
    plain, robust = (fitting.fit_tendons(scene(), data, noise=known, loss=loss, **FEW) for loss in ("linear", "huber"))
    assert np.abs(robust.values / TRUTH - 1).max() < 0.5 * np.abs(plain.values / TRUTH - 1).max()


def test_a_prior_pulls():
    prior = (0.95 * estimate().values[0], 1e-3)
    fit = fitting.fit_tendons(scene(), noisy(0), noise={"position": NOISE}, priors={"K1": prior}, **FEW)
    assert fit.values[0] == pytest.approx(prior[0], rel=1e-3)
    assert fit.standard_deviations[0] < 1.1e-3


def test_the_same_seed_gives_the_same_result():
    again = fitting.fit_tendons(scene(), clean(), **FEW)
    np.testing.assert_array_equal(again.values, found().values)
    assert again.history == found().history


def test_derivatives_through_touch_and_lift_off():
    contact = pftwin.simulate(scene(), dt=1 / 600, integrator=pftwin.LinearImplicit()).effects["contact"]["force"]
    away = contact <= 0
    assert away.any()
    assert not away[0]
    assert not away[-1]
    p = fitting.free_parameters(scene(), SPRINGS)
    evaluator = Evaluator(scene(), p, ("position",), computed=COMPUTED)
    evaluator.prepare(None)
    slopes = evaluator.with_slopes(p.nominal[None], 10).slopes
    assert slopes is not None
    for i in range(4):
        step = np.zeros(4)
        step[i] = 1e-6 * p.nominal[i]
        plus, minus = (evaluator.with_slopes((p.nominal + s * step)[None], 10).values[0] for s in (1, -1))
        numeric = (plus - minus) / (2 * step[i])
        error = np.sqrt(np.mean((slopes[0, ..., i] - numeric) ** 2) / np.mean(numeric**2))
        assert error < 0.02
        # Some frames before lift-off two facets merge in haste: see the changelog on derivatives.
        before = slice(0, int(np.argmax(away)) - 4)
        error = np.abs(slopes[0, before, :, i] - numeric[before]).max() / np.abs(numeric[before]).max()
        assert error < 2e-3


def test_long_steps_that_will_not_do_are_not_used():
    """Where the patella lifts off and falls back 5 ms are 0.8 mm off; where it slides they are 0.02 mm off."""
    for motion, long_steps_do in ((scene(), False), (small_scene(), True)):
        free = fitting.free_parameters(motion, SPRINGS)
        evaluator = Evaluator(motion, free, ("position",), computed=COMPUTED)
        evaluator.prepare(None)
        nominal = evaluator.parameters.nominal[None]
        long, short = (evaluator.with_slopes(nominal, n) for n in (2, 6))
        assert long.usable[0]
        off = np.sqrt(np.mean(np.sum((long.values - short.values)[0, :, :3] ** 2, axis=1)))
        assert off < 1e-4 if long_steps_do else off > 6e-4
        assert evaluator.fine == (6 if long_steps_do else 24)
        assert evaluator.coarse == (2 if long_steps_do else 24)


@pytest.mark.slow
def test_the_error_of_the_steps_is_what_far_shorter_steps_show():
    evaluator = Evaluator(scene(), fitting.free_parameters(scene(), SPRINGS), ("position", "quadriceps"))
    evaluator.prepare(None)
    nominal = evaluator.parameters.nominal
    errors = evaluator.step_errors(nominal, 6)
    off = (evaluator.with_slopes(nominal[None], 6).values - evaluator.with_slopes(nominal[None], 192).values)[0]
    rms = np.sqrt(np.mean(np.sum(off[:, :3] ** 2, axis=1))), np.sqrt(np.mean(off[:, 3] ** 2))
    np.testing.assert_allclose([errors[c].rms for c in ("position", "quadriceps")], rms, rtol=0.2)
    assert errors["position"].large
    assert not errors["quadriceps"].large  # 0.07 N of some 20


def test_a_fit_whose_steps_are_too_long_says_so_first(monkeypatch):
    """Without more than six steps a frame, which are half a millimetre off here, beyond the noise of 0.1 mm."""
    monkeypatch.setattr("fitting.evaluation.HALVINGS", 0)
    monkeypatch.setattr("fitting.finish._MOST", 1)
    estimate = fitting.fit_tendons(scene(), noisy(0), noise={"position": NOISE}, **FEW)
    long, short = (
        pftwin.simulate(estimate.scene, dt=1e-2 / n, integrator=pftwin.LinearImplicit()).center for n in (6, 192)
    )
    rms = np.sqrt(np.mean(np.sum((long - short) ** 2, axis=1)))
    assert estimate.step_error["position"] == pytest.approx(rms, rel=0.2)
    said = f"the fit's time steps cause an error of {1e3 * estimate.step_error['position']:.2g} mm rms of position"
    assert said in "; ".join(estimate.doubts)
    assert estimate.sentence().startswith("INVALID: ")


def test_a_checkpoint_of_another_problem_is_refused(tmp_path):
    path = tmp_path / "state.json"
    fitting.fit_tendons(scene(), clean(), checkpoint=path, **FEW)
    for other in ({"seed": 1}, {"bounds": 0.2}, {"objective": "paper"}, {"starts": 4}):
        with pytest.raises(InputError, match="another problem"):
            fitting.fit_tendons(scene(), clean(), checkpoint=path, resume=True, **{**FEW, **other})
    with pytest.raises(InputError, match="another problem"):
        fitting.fit_tendons(scene(), noisy(5), checkpoint=path, resume=True, **FEW)
    for text, words in (("not json", "not valid JSON.*pftwin fit checkpoint"), ("{}", "no checkpoint of a fit")):
        path.write_text(text)
        with pytest.raises(InputError, match=words):
            fitting.fit_tendons(scene(), clean(), checkpoint=path, resume=True, **FEW)


def test_what_makes_no_difference_is_refused_before_the_search():
    """A stiffness that may change by 2e-9 N/m moves nothing that could be seen."""
    k1 = float(scene().effect("quadriceps").stiffness)
    with pytest.raises(InputError, match=r"reacts to K1(\W|$)"):
        fitting.fit_tendons(scene(), clean(), bounds={"K1": (k1 - 1e-9, k1 + 1e-9)}, computed=COMPUTED)


def test_starts_that_die_are_dropped_and_counted():
    free, target = fitting.free_parameters(scene(), SPRINGS), Objective.of(scene(), clean())
    problem = Problem.of([scene()], [free], target, computed=COMPUTED)
    problem.evaluator.prepare(None)
    search = LeastSquares(problem, 0, starts=8)
    state = search.begin()
    answer = problem.answer(request := search.ask(state))
    dead = answer._replace(value=np.where(np.arange(8) < 3, np.inf, answer.value))
    search.tell(state, request, dead)
    alive = int(np.isfinite(answer.value[3:]).sum())
    assert alive > 0
    assert len(state["u"]) == alive
    assert state["dropped"] == 8 - alive
    all_dead = search.begin()
    search.tell(all_dead, request, answer._replace(value=np.full(8, np.inf)))
    assert all_dead["stopped"] == "all starts failed"


def test_all_starts_failing_is_an_error(monkeypatch):
    real = Problem.answer

    def dead(self, request):
        answer = real(self, request)
        return answer._replace(value=np.full(len(request.theta), np.inf))

    monkeypatch.setattr(Problem, "answer", dead)
    with pytest.raises(InputError, match="all 8 starts failed"):
        fitting.fit_tendons(scene(), clean(), **FEW)


def test_an_unusable_prediction_is_infinitely_bad():
    free, target = fitting.free_parameters(scene(), SPRINGS), Objective.of(scene(), clean())
    problem = Problem.of([scene()], [free], target, computed=COMPUTED)
    problem.evaluator.prepare(None)
    at = problem.parameters.nominal[None]
    prediction = problem.evaluator.with_slopes(np.repeat(at, 2, axis=0), 6)
    values = prediction.values.copy()
    values[1, 3, 0] = np.nan
    normal = problem.objective.normal(prediction._replace(values=values, usable=np.array([True, False])))
    assert np.isfinite(normal.value[0])
    assert np.isinf(normal.value[1])
    assert (normal.gradient[1] == 0).all()
    whole = problem.answer(Request(at, 6, "normal"))
    np.testing.assert_array_equal(normal.gradient[:1], whole.gradient)
