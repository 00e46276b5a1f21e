"""The benchmark of fitting: what it counts it counts right, every method takes part, table and figure show it."""

from __future__ import annotations

import csv
import dataclasses
import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lifting_scene import lifting_scene
from typer.testing import CliRunner

import fitting
import pftwin
from fitting.methods.problem import Problem, ProblemAnswer, Request
from fitting.objective import Objective
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from tests.benchmarks.fitting import efficiency, memory, page
from tests.benchmarks.fitting.__main__ import app, chosen
from tests.benchmarks.fitting.efficiency import KINDS, Found
from tests.benchmarks.fitting.methods.comparison import Setting, compared, runs
from tests.benchmarks.fitting.methods.entrants import ENTRANTS
from tests.benchmarks.fitting.methods.figure import best_so_far, comparison_figure
from tests.benchmarks.fitting.methods.mapped_starts import Residuals
from tests.benchmarks.fitting.methods.meter import FAILED, Best, Budget, Course, Meter, OneStepEvaluator, SpentError
from tests.benchmarks.fitting.methods.table import COLUMNS, comma_list, courses_of, markdown, rows_of
from tests.benchmarks.report import from_json, to_json
from tests.benchmarks.row import Row

RUNNER = CliRunner()
SPRINGS = ("K1", "L1", "K2", "L2")
MACHINE = {"cpu": "some", "cores": 2, "dtype": "float64", "jax": "0", "date": "2026-01-01T00:00"}
SEEDS = 2
HEAVY = ("gradient", "optimistix")  # compile programs of their own for the better part of a minute: slow tests
LIGHT = tuple(e for e in ENTRANTS if e.name not in HEAVY)
BATCH = 60  # of everybody's plain values here, so that they share one program


@pytest.fixture(scope="module")
def scene():
    return lifting_scene()


@pytest.fixture(scope="module")
def parameters(scene):
    return fitting.free_parameters(scene, SPRINGS)


@pytest.fixture(scope="module")
def measured(scene, parameters):
    truth = pftwin.simulate(
        parameters.apply(scene, efficiency.TRUE * parameters.nominal), dt=1 / 600, integrator=pftwin.LinearImplicit()
    )
    return Measured(truth.times, truth.center, synthetic=True, source="twin")


@pytest.fixture(scope="module")
def setting(scene, parameters, measured):
    evaluator = OneStepEvaluator(scene, parameters, ("position",), steps=6)
    evaluator.prepare(None)
    return Setting(Objective.of(scene, measured, "paper"), evaluator, Budget(60, 0.05), SEEDS)


@pytest.fixture(scope="module")
def comparison(setting):
    alike = [e._replace(widest=lambda problem: BATCH) if e.name != "least_squares" else e for e in LIGHT]
    return compared(setting, alike, say=lambda text: None)


@pytest.fixture(scope="module")
def rows(comparison):
    return rows_of(comparison)


@pytest.mark.slow
def test_every_method_takes_part_from_every_seed_within_its_budget(comparison):
    assert set(comparison.courses) == {e.name for e in LIGHT}
    for name, courses in comparison.courses.items():
        assert [c.seed for c in courses] == [0, 1], name
        for course in courses:
            assert course.evaluations >= 60
            assert (np.diff([b.value for b in course.bests]) < 0).all()
            assert (np.diff([b.evaluations for b in course.bests]) > 0).all()
            assert course.bests[-1].cpu <= course.cpu


@pytest.mark.slow
def test_one_point_at_a_time_is_counted_as_that(comparison):
    batches = {name: courses[0].evaluations / courses[0].batches for name, courses in comparison.courses.items()}
    assert batches["scipy_dual_annealing"] == 1
    assert batches["scipy_differential_evolution"] == 60
    assert batches["pycma"] == 8
    assert batches["genetic"] >= 47


@pytest.mark.slow
@pytest.mark.parametrize(("name", "batch"), [("optimistix", 32 * 5), ("gradient", 8 * 5)])
def test_derivatives_count_for_as_many_as_there_are_parameters(setting, name, batch):
    short = dataclasses.replace(setting, seeds=1)
    course = runs(short, next(e for e in ENTRANTS if e.name == name))[0]
    assert course.evaluations / course.batches == batch
    problem = Problem(setting.evaluator.scene, setting.nominal, setting.objective, setting.evaluator)
    last = course.bests[-1]
    assert problem.answer(Request(np.array([last.theta]), 6, "normal")).value[0] == pytest.approx(last.value, rel=1e-6)


@pytest.mark.slow
def test_what_was_found_is_worth_what_was_noted(comparison, setting):
    problem = Problem(setting.evaluator.scene, setting.nominal, setting.objective, setting.evaluator)
    lasts = {name: courses[0].bests[-1] for name, courses in comparison.courses.items()}
    values = problem.answer(Request(np.array([b.theta for b in lasts.values()]), 6, "normal")).value
    np.testing.assert_allclose(values, [b.value for b in lasts.values()], rtol=1e-6)


@pytest.mark.slow
def test_the_mapped_residuals_are_the_papers_objective(setting):
    problem = Problem(setting.evaluator.scene, setting.nominal, setting.objective, setting.evaluator)
    residuals = Residuals.of(problem)
    theta = 1.05 * setting.nominal.nominal
    guess = setting.evaluator.guesses(theta[None])
    one = jax.tree.map(lambda a: a[0], guess)
    found = residuals(jnp.asarray(setting.nominal.to_unbounded(theta)), one)
    expected = problem.answer(Request(theta[None], 6, "normal")).value[0]
    assert float(jnp.sum(found**2)) == pytest.approx(expected, rel=1e-6)


def test_guesses_differ_between_seeds_and_not_between_methods(setting):
    one, other = (setting.guess(seed) for seed in (0, 1))
    assert (one.nominal != other.nominal).all()
    np.testing.assert_array_equal(one.nominal, setting.guess(0).nominal)
    np.testing.assert_array_equal(one.lower, setting.nominal.lower)
    share = (one.nominal - one.lower) / (one.upper - one.lower)
    assert ((share >= 0.25) & (share <= 0.75)).all()


@pytest.mark.slow
def test_the_table_has_every_method_and_says_where_ours_stands(rows, comparison):
    places = [r for r in rows if r.what.startswith("place of our least squares")]
    assert len(places) == 2
    for k, row in enumerate(places):
        medians = {name: np.median(fine[:, k]) for name, fine in comparison.fine.items()}
        better = int(sum(value < medians["least_squares"] for value in medians.values()))
        assert row.value == 1 + better
        assert row.passed is (better == 0)
    text = markdown(rows)
    assert all(e.label in text for e in LIGHT)
    table = list(csv.DictReader(io.StringIO(comma_list(rows))))
    assert [line["method"] for line in table] == [e.name for e in LIGHT]
    for line in table:
        for key in COLUMNS:
            assert float(line[f"{key}_least"]) <= float(line[f"{key}_median"]) <= float(line[f"{key}_largest"])
    assert min(float(line["excess_evaluations_mm_least"]) for line in table) >= 0


@pytest.mark.slow
def test_the_figure_shows_every_method(rows, comparison):
    figure = comparison_figure(courses_of(rows), comparison.budget)
    labels = {line.get_label() for axes in figure.axes for line in axes.lines}
    assert all(e.label in labels for e in LIGHT)
    assert "SYNTHETIC" in figure.get_suptitle()


@pytest.mark.slow
def test_the_page_is_written_from_the_file_of_figures(rows, tmp_path):
    file, target = tmp_path / "b.json", tmp_path / "page.md"
    file.write_text(to_json(rows, MACHINE))
    target.write_text(f"before\n{page.BEGIN}\nold\n{page.END}\nafter\n")
    answer = RUNNER.invoke(app, ["--read", str(file), "--page", str(target)])
    assert answer.exit_code == 0, answer.output
    text = target.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert "place of our least squares" in text
    assert "SYNTHETIC" in text
    assert {p.name for p in (tmp_path / "page").iterdir()} == {"methods.png", "methods.svg", "methods.csv"}
    again = courses_of(from_json(file)[0])
    assert again == courses_of(rows)


def test_a_page_without_a_place_for_figures_is_refused_before_anything_is_measured(tmp_path):
    target = tmp_path / "page.md"
    target.write_text("nothing")
    answer = RUNNER.invoke(app, ["--page", str(target)])
    assert answer.exit_code == 2
    assert "no place for figures" in answer.output
    answer = RUNNER.invoke(app, ["--page", str(tmp_path / "none.md")])
    assert "cannot be read" in answer.output


def test_topics_are_named_with_commas():
    assert chosen("methods, speed") == ("speed", "methods")
    with pytest.raises(InputError, match="no topic 'sped'"):
        chosen("sped")


class _Parabola:
    """A problem without a knee."""

    class evaluator:  # noqa: N801
        coarse = fine = 1

    def answer(self, request):
        value = np.sum(request.theta**2, axis=1)
        value[0] = np.nan
        slopes = None if request.want == "value" else 2 * request.theta
        return ProblemAnswer(value, slopes)


def test_the_meter_counts_derivatives_and_keeps_the_best():
    course = Course("some", 0)
    meter = Meter(_Parabola(), course, Budget(12, 0.0))  # pyright: ignore[reportArgumentType]
    values = meter.values(np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 2.0]]))
    np.testing.assert_array_equal(values, [FAILED, 9.0, 4.0])
    assert course.evaluations == 3
    assert course.bests[-1].theta == [0.0, 2.0]
    meter.answer(Request(np.array([[9.0, 9.0], [1.0, 1.0], [2.0, 2.0]]), 1, "gradient"))
    assert course.evaluations == 3 + 3 * 3
    assert [b.value for b in course.bests] == [4.0, 2.0]
    with pytest.raises(SpentError):
        meter.values(np.zeros((2, 2)))
    assert course.batches == 2


def test_the_best_at_a_budget_is_the_last_within_it():
    course = Course("some", 0, [Best(10, 1.0, 1.0, 5.0, [1.0]), Best(20, 2.0, 2.0, 4.0, [2.0])])
    assert course.at_evaluations(9) is None
    assert course.at_evaluations(19).value == 5.0  # pyright: ignore[reportOptionalMemberAccess]
    assert course.at_time(2.0).value == 4.0  # pyright: ignore[reportOptionalMemberAccess]
    other = Course("some", 1, [Best(12, 1.0, 1.0, 3.0, [1.0])])
    grid, excess = best_so_far([course, other], lambda b: b.evaluations, 3.0)
    assert grid[0] == 12
    assert grid[-1] == 20
    np.testing.assert_allclose(excess[:, [0, -1]], [[2000.0, 1000.0], [1e-4, 1e-4]])


def test_efficiency_has_a_row_for_every_target():
    random = np.random.default_rng(0)
    true, bound = np.array([100.0, 0.1, 600.0, 0.07]), np.diag(np.array([5.0, 1e-4, 30.0, 1e-4]) ** 2)
    values = random.multivariate_normal(true, bound, size=4000)
    deviations = np.broadcast_to(np.sqrt(np.diagonal(bound)), values.shape)
    found = Found(values, deviations, true, bound)
    np.testing.assert_allclose(found.errors / found.relative_bound, 1.0, atol=0.05)
    np.testing.assert_allclose(found.coverage, 0.95, atol=0.02)
    assert found.ratio_error == pytest.approx(np.hypot(0.05, 0.05), rel=0.1)
    rows = efficiency.rows_of("case 9", dict.fromkeys((k.name for k in KINDS), found), 4000)
    assert sum(r.target == efficiency.OVER_BOUND for r in rows) == 4
    assert sum(r.target == efficiency.PERCENT for r in rows) == 3 + 4
    assert all(r.passed for r in rows if r.target == efficiency.OVER_BOUND)
    assert "one spring force" in to_json(rows, MACHINE)


def test_a_biased_estimator_is_detected():
    true, bound = np.ones(4), 1e-4 * np.eye(4)
    found = Found(np.full((50, 4), 1.05), np.full((50, 4), 0.01), true, bound)
    rows = efficiency.rows_of("case 9", dict.fromkeys((k.name for k in KINDS), found), 50)
    assert not any(r.passed for r in rows if r.target == efficiency.OVER_BOUND)
    assert found.coverage.max() == 0


def test_memory_grows_with_what_is_held():
    before = memory.peak()
    if before is None:
        pytest.skip("this system does not say")
    block = np.ones(40 * 2**17)  # 40 MiB
    after = memory.peak()
    assert after is not None
    assert block.sum() > 0
    assert 1 < before <= after


@pytest.mark.slow
@pytest.mark.parametrize("topic", ["speed", "efficiency", "plant", "treatments", "methods"])
def test_a_quick_run_of_each_topic(topic, tmp_path):
    out = tmp_path / "b.json"
    answer = RUNNER.invoke(app, ["--topics", topic, "--quick", "--out", str(out)])
    assert answer.exit_code == 0, answer.output
    rows: list[Row] = from_json(out)[0]
    assert {r.topic for r in rows} == {topic}
    assert all(np.isfinite(r.value) for r in rows)
