"""Figures of estimates and predictions: what is drawn is what they hold, and what is missing is named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from figure_parts import clipped, footers
from made_estimates import made_estimate, of_trial
from scipy.stats import norm
from small_scene import small_scene

import pftwin
from fitting.estimate import Estimate
from fitting.posterior.result import Posterior
from fitting.prediction.plots import outcome_figure
from fitting.prediction.variants import grid
from pftwin.base.errors import InputError

SD = np.array([2.0, 1e-3, 20.0])
CORRELATION = np.array([[1.0, 0.8, -0.3], [0.8, 1.0, -0.1], [-0.3, -0.1, 1.0]])
AMOUNT = "tibial_tuberosity_transfer_medialisation"


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    found = made_estimate({"K1": (160.0, 2.0), "L1": (0.15, 1e-3), "K2": (600.0, 20.0)})
    history = [{"iteration": i, "evaluations": 10.0 * i, "best": 5.0 / (i + 1), "spread": 0.0} for i in range(4)]
    covariance = CORRELATION * np.outer(SD, SD)
    return dataclasses.replace(found, covariance=covariance, nominal=found.values * [0.8, 1.1, 1.0], history=history)


@pytest.fixture(scope="module")
def posterior(estimate) -> Posterior:
    draws = np.random.default_rng(5).multivariate_normal(estimate.values, estimate.covariance, (2, 150))
    known = np.ones(3)
    return Posterior(
        estimate.names, estimate.units, draws, np.zeros((2, 150)), np.ones(2), known, 500 * known, estimate, False,
        300, 0, 0, 0, 1.0,
    )  # fmt: skip


def settings() -> dict:
    import matplotlib as mpl

    return dict(mpl.rcParams)


def test_correlations_and_intervals_are_the_estimates(estimate):
    figure = estimate.plot.correlation()
    left, right = figure.axes[:2]
    np.testing.assert_allclose(left.get_images()[0].get_array(), CORRELATION, atol=1e-12)
    written = [t.get_text().replace("\N{MINUS SIGN}", "-") for t in left.texts]
    assert written == [f"{v:.2f}" for v in CORRELATION.ravel()]
    (points,) = right.containers
    middle, _, (bars,) = points.lines
    expected = 100 * (estimate.values / estimate.nominal - 1)
    np.testing.assert_allclose(middle.get_xdata(), expected)
    ends = np.array([s[:, 0] for s in bars.get_segments()])
    np.testing.assert_allclose(ends, 100 * (estimate.intervals / estimate.nominal[:, None] - 1))
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], 2 * 1.959964 * 100 * SD / estimate.nominal, rtol=1e-6)
    assert "synthetic measurements" in figure.get_suptitle()
    assert "[%]" in right.get_xlabel()


def test_a_parameter_at_its_bound_is_marked_beside_its_interval(estimate):
    assert not [t for t in estimate.plot.correlation().axes[1].texts if t.get_text()]
    bounded = dataclasses.replace(estimate, upper=np.array([300.0, 1.0, 600.0]))
    (mark,) = (t for t in bounded.plot.correlation().axes[1].texts if t.get_text())
    assert (mark.get_text(), mark.xy[1]) == ("at its bound", 2)  # K2, the last row


def test_nuisance_is_left_out_of_the_correlations(estimate):
    estimate = dataclasses.replace(estimate, auxiliary=estimate.names[-1:])
    left, right = estimate.plot.correlation().axes[:2]
    asked = len(estimate.names) - 1
    np.testing.assert_allclose(left.get_images()[0].get_array(), CORRELATION[:asked, :asked], atol=1e-12)
    for axis in (left.yaxis, right.yaxis):
        assert [t.get_text() for t in axis.get_ticklabels()] == list(estimate.names[:asked])


def test_axes_of_ones_own(estimate):
    from matplotlib.figure import Figure

    figure = Figure()
    assert estimate.plot.correlation(axes=figure.subplots(1, 2)) is figure
    assert estimate.plot.history(ax=figure.add_subplot()) is figure
    with pytest.raises(InputError, match="axes: 3 axes; expected: 2: for the correlations, and for the values"):
        estimate.plot.correlation(axes=figure.subplots(1, 3))


def test_history_is_drawn(estimate):
    (line,) = estimate.plot.history().axes[0].get_lines()
    np.testing.assert_allclose(line.get_xdata(), [0, 10, 20, 30])
    np.testing.assert_allclose(line.get_ydata(), [5, 2.5, 5 / 3, 1.25])


@pytest.mark.parametrize("sampled", [False, True])
def test_marginals_and_ellipses_are_the_estimates_normal_distribution(estimate, posterior, sampled):
    figure = estimate.plot.posterior(posterior if sampled else None)
    panels = np.array(figure.axes).reshape(3, 3)
    scale = np.array([1.0, 1e3, 1.0])  # lengths in millimetres
    for i in range(3):
        (line,) = panels[i, i].get_lines()
        x = line.get_xdata()
        np.testing.assert_allclose(line.get_ydata(), norm.pdf(x, scale[i] * estimate.values[i], scale[i] * SD[i]))
        for j in range(i):
            pair = [j, i]
            inverse = np.linalg.inv(estimate.covariance[np.ix_(pair, pair)])
            for size, ellipse in zip((1.0, 2.0), panels[i, j].get_lines()[-2:], strict=True):
                off = ellipse.get_xydata() / scale[pair] - estimate.values[pair]
                np.testing.assert_allclose(np.sqrt(np.einsum("ki,ij,kj->k", off, inverse, off)), size)
    assert panels[2, 1].get_xlabel() == "L1 [mm]"
    assert panels[1, 0].get_ylabel() == "L1 [mm]"
    assert ("not sampled" in figure.get_suptitle()) is not sampled
    assert "synthetic measurements" in figure.get_suptitle()


def test_draws_of_a_posterior_are_all_drawn(estimate, posterior):
    panels = np.array(posterior.plot.corner().axes).reshape(3, 3)
    flat = posterior.draws.reshape(-1, 3)
    np.testing.assert_allclose(panels[1, 0].get_lines()[0].get_xydata(), flat[:, :2] * [1.0, 1e3])
    heights = np.array([p.get_height() * p.get_width() for p in panels[2, 2].patches])
    assert heights.sum() == pytest.approx(1.0)
    edges = [p.get_x() for p in panels[2, 2].patches]
    assert edges[0] == pytest.approx(flat[:, 2].min())


def test_a_posterior_of_other_parameters_is_refused(posterior):
    other = made_estimate({"K1": (160.0, 2.0), "L1": (0.15, 1e-3)})
    with pytest.raises(InputError, match="posterior: a posterior of K1, L1, K2; expected: of K1, L1"):
        other.plot.posterior(posterior)


@pytest.fixture(scope="module")
def prediction():
    """Outcomes of 4 amounts in 41 samples, made up; the first amount dislocates."""
    from xarray import Dataset

    rng = np.random.default_rng(2)
    axes = ("variant", "sample")
    amounts = 1e-3 * np.array([0.0, 4.0, 8.0, 12.0])
    about = {"largest_offset": "m", "peak_contact_force": "N", "mean_tilt": "deg", "medial_share": "1"}
    variables = {n: (axes, rng.uniform(0.1, 1, (4, 41)), {"units": u}) for n, u in about.items()}
    variables["dislocations"] = (axes, np.repeat([[1.0], [0.0], [0.0], [0.0]], 41, axis=1))
    variables["peak_contact_force"][1][2, 5:9] = np.nan  # draws that failed
    variables["failed"] = (axes, np.isnan(variables["peak_contact_force"][1]))
    coordinates = {
        AMOUNT: ("variant", amounts, {"units": "m"}),
        "scene": ("variant", ["rig case 2"] * 4),
        "treatment": ("variant", ["transfer"] * 4),
        "sample": np.arange(41),
    }
    attributes = {"title": "predicted outcomes: rig case 2", "threshold": 0.02, "note": "from synthetic measurements"}
    return Dataset(variables, coordinates, attributes)


def test_response_curves_are_the_outcomes_and_bands_their_quantiles(prediction):
    figure = outcome_figure(prediction)
    outcomes = {"largest_offset": 1e3, "peak_contact_force": 1.0, "mean_tilt": 1.0, "medial_share": 100.0}
    for ax, (name, scale) in zip(figure.axes, outcomes.items(), strict=True):
        line, crosses = ax.get_lines()[:2]
        values = scale * prediction[name].values
        np.testing.assert_allclose(line.get_xdata(), [0, 4, 8, 12])
        np.testing.assert_allclose(line.get_ydata(), values[:, 0])
        np.testing.assert_allclose(crosses.get_xydata(), [[0, values[0, 0]]])
        corners = ax.collections[0].get_paths()[0].vertices
        for k, x in enumerate((0, 4, 8, 12)):
            drawn = values[k, 1:][np.isfinite(values[k, 1:])]
            there = corners[np.isclose(corners[:, 0], x), 1]
            ends = np.quantile(drawn, (0.025, 0.975))
            np.testing.assert_allclose([there.min(), there.max()], ends, rtol=1e-9)
    assert {ax.get_xlabel() for ax in figure.axes} == {"tibial tuberosity transfer medialisation [mm]"}
    assert figure.get_suptitle() == "predicted outcomes: rig case 2"
    (below,) = footers(figure)
    said = below.get_text().replace("\n", " ")
    assert "95 % of 40 draws from the estimate" in said
    assert "synthetic measurements" in said
    assert all("[" in ax.get_ylabel() for ax in figure.axes)
    assert said.startswith("crosses: dislocated; ")


def test_crosses_are_explained_only_where_there_are_any(prediction):
    (below,) = footers(outcome_figure(prediction.isel(variant=[1, 2, 3])))
    assert "crosses" not in below.get_text()


@pytest.mark.parametrize(("height", "columns"), [(None, 2), (4.8, 2), (None, 1)])  # the last two as of the report
def test_labels_are_no_longer_than_their_axes(prediction, height, columns):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = outcome_figure(prediction, columns=columns)
    if height is not None:
        figure.set_size_inches(figure.get_figwidth(), height)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    for ax in figure.axes:
        for axis, side in ((ax.yaxis, "height"), (ax.xaxis, "width")):
            written = getattr(axis.label.get_window_extent(canvas.get_renderer()), side)
            assert written <= getattr(ax.bbox, side), axis.label.get_text()


def test_a_prediction_without_a_varying_amount_is_refused(prediction):
    with pytest.raises(InputError, match="outcome_figure: no amount varies; expected: a grid of amounts"):
        outcome_figure(prediction.isel(variant=[1]))
    with pytest.raises(InputError, match="axes: 1 axes; expected: 4: one for each of largest_offset"):
        outcome_figure(prediction, axes=[None])


@pytest.fixture(scope="module")
def of_the_small_knee() -> Estimate:
    names = {"quadriceps.stiffness": "N/m", "quadriceps.slack_length": "m"}
    values, sd = np.array([156.0, 0.1432]), np.array([6.0, 3e-4])
    made = made_estimate({"K1": (156.0, 6.0), "L1": (0.1432, 3e-4)})
    return dataclasses.replace(
        made, names=tuple(names), units=tuple(names.values()), values=values, covariance=np.diag(sd**2),
        **of_trial(small_scene()), scene_name="small knee",
    )  # fmt: skip


def test_courses_over_draws_are_those_of_the_drawn_scenes(of_the_small_knee):
    e = of_the_small_knee
    figure = e.plot.against_flexion(draws=2, seed=4, show=("tilt",), strokes="bending")
    (line,) = figure.axes[0].get_lines()
    runs = [pftwin.simulate(e.apply(small_scene(), theta)) for theta in [e.values, *e.samples(2, 4)]]
    knee = np.degrees(runs[0].knee.flexion)
    up = slice(0, int(np.argmax(knee)) + 1)
    table = [np.interp(line.get_xdata(), knee[up], np.degrees(r.angles.tilt)[up]) for r in runs]
    np.testing.assert_allclose(line.get_ydata(), np.mean(table, axis=0), atol=1e-9)
    assert np.ptp(table, axis=0).max() > 1e-3
    assert "2 draws from its uncertainty" in figure.get_suptitle().replace("\n", " ")


@pytest.mark.slow
def test_response_of_the_small_knee(of_the_small_knee):
    amounts = grid("tibial_tuberosity_transfer", medialisation=[0.0, 0.002, 0.004])
    figure = of_the_small_knee.plot.response(amounts, samples=3)
    line = figure.axes[1].get_lines()[0]
    np.testing.assert_allclose(line.get_xdata(), [0, 2, 4], atol=1e-9)
    assert np.isfinite(line.get_ydata()).all()
    assert figure.axes[1].collections


def test_what_an_estimate_from_a_file_lacks_is_named(estimate):
    amounts = grid("tibial_tuberosity_transfer", medialisation=[0.0, 0.002])
    for draw in (lambda: estimate.plot.response(amounts), estimate.plot.against_flexion):
        with pytest.raises(InputError, match="scene: an estimate from a file holds no scene; try: name it"):
            draw()
    with pytest.raises(InputError, match="draws: found 0; expected: a whole number, at least 1"):
        estimate.plot.against_flexion(small_scene(), draws=0)
    with pytest.raises(InputError, match="an estimate from a file holds no measurements to draw"):
        estimate.plot.fit()


def test_no_global_setting_is_changed_and_vectors_are_written(estimate, posterior, prediction, tmp_path):
    from pftwin.results.plots import save_figure

    before = settings()
    drawn = [estimate.plot.correlation(), estimate.plot.posterior(posterior), outcome_figure(prediction)]
    for i, figure in enumerate(drawn):
        for path in save_figure(figure, tmp_path / f"{i}", kinds=("png", "svg", "pdf")):
            assert path.stat().st_size > 5000
    assert settings() == before


@pytest.mark.filterwarnings("error:constrained_layout")
def test_long_names_of_parameters_leave_room_to_the_panels():
    long = made_estimate({f"{'a tendon with a long name ' * 5}.stiffness": (160.0, 2.0), "L1": (0.15, 1e-3)})
    for figure in (long.plot.correlation(), long.plot.posterior()):
        assert clipped(figure) == []
        assert all(
            ax.get_window_extent().width > 50 for ax in figure.axes if ax.axison and ax.get_label() != "<colorbar>"
        )


def test_legends_and_titles_lie_beside_the_panels(estimate, posterior, prediction):
    for figure in (estimate.plot.posterior(posterior), estimate.plot.correlation(), outcome_figure(prediction)):
        figure.draw_without_rendering()
        boxes = [ax.get_window_extent() for ax in figure.axes if ax.axison]
        title = figure._suptitle.get_window_extent()
        assert title.y0 >= max(b.y1 for b in boxes)
        assert title.x0 >= 0
        assert title.x1 <= figure.bbox.x1
        assert all(legend.get_window_extent().y1 <= min(b.y0 for b in boxes) for legend in figure.legends)
        for text in footers(figure):
            below = text.get_window_extent()
            assert 0 <= below.y0 < below.y1 <= min(ax.get_tightbbox().y0 for ax in figure.axes if ax.axison)
