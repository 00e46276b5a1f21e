"""What no fit can answer is named, and starts that fail are dropped."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from lifted_fits import COMPUTED, FEW, SPRINGS, clean, scene, truth

import fitting
import fitting.fit
import pftwin
from fitting.methods.least_squares import LeastSquares
from fitting.methods.problem import Problem, Request
from fitting.objective import Objective
from pftwin.base.errors import InputError, PftwinError
from pftwin.model.measured import Measured


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"method": "simplex"}, "no method 'simplex'"),
        ({"objective": "likely"}, "no objective"),
        ({"loss": "huge"}, "no loss"),
        ({"loss": "huber"}, "not known here"),
        ({"use": ("orientation",)}, "no 'orientation' was measured"),
        ({"use": ("magic",)}, "no channel 'magic'"),
        ({"objective": "paper", "use": ("quadriceps",)}, "position alone"),
        ({"objective": "paper", "priors": {"K1": (1.0, 1.0)}}, "no noise to weigh"),
        ({"noise": {"orientation": 1.0}}, "no noise of 'position'"),
        ({"noise": {"position": -1.0}}, "positive number"),
        ({"free": ("K9",)}, "no parameter"),
        ({"bounds": {"K1": (1.0, 2.0)}}, "exclude"),
        ({"starts": 0}, "at least 1"),
        ({"starts": 10**9}, "starts: found 1000000000; expected: a whole number, at least 1, at most 1,000,000"),
        ({"seed": -1}, "seed: found -1; expected: a whole number from 0 to"),
        ({"seed": 2**64, "method": "cma_es"}, "seed: found 18446744073709551616"),
        ({"generations": 5}, "no option 'generations'"),
        ({"resume": True}, "nothing to resume"),
        ({"computed": ("position", "magic")}, "computed: no channel 'magic'.*quadriceps"),
        (
            {"free": ("K1", "contact.center.z"), "bounds": {"contact.center.z": (-0.01, 0.03)}},
            "contact.center.z moves the point of the patella whose path was measured",
        ),
        ({"free": ("quadriceps.insertion.z~contact.center.z",)}, "moves the point of the patella"),
        (
            {"nuisance": fitting.Nuisance(others={"contact.center.x": 1e-3})},
            "contact.center.x moves the point of the patella whose path was measured",
        ),
        ({"computed": ("quadriceps",)}, "computed: without position, which the fit compares"),
    ],
)
def test_mistakes_are_named(arguments, said):
    with pytest.raises(InputError, match=said):
        fitting.fit_tendons(scene(), clean(), **arguments)


@pytest.mark.slow
def test_measurements_of_another_length_rate_or_frame():
    far = np.median(np.linalg.norm(truth().center + 0.2 - pftwin.simulate(scene()).center, axis=1))
    for times, center, said in (
        (truth().times[:-1], truth().center[:-1], "40 frames at 100 Hz"),
        (2 * truth().times, truth().center, "was measured at"),
        (truth().times, truth().center * 1000, "measured positions look 1000 times too large: in millimetres"),
        (truth().times, truth().center + 0.2, f"measured positions lie {1e3 * far:.0f} mm from the scene's"),
        (truth().times, np.full_like(truth().center, np.nan), "no 'position' was measured"),
    ):
        with pytest.raises(InputError, match=said):
            fitting.fit_tendons(scene(), Measured(times, center), **FEW)


def test_a_scene_that_is_no_case_needs_measurements():
    with pytest.raises(InputError, match="nothing to compare with"):
        fitting.fit_tendons(scene())


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


def test_a_missing_extra_is_named(monkeypatch):
    from fitting.methods import strategies

    strategies._algorithm.cache_clear()
    monkeypatch.setitem(sys.modules, "evosax", None)
    with pytest.raises(PftwinError, match=r"pftwin\[evosax\]"):
        fitting.fit_tendons(scene(), clean(), method="cma_es", population=11)
