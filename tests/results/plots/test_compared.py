"""Measured against simulated: the lines are the data, and the RMSE in the legend is theirs."""

from __future__ import annotations

import dataclasses
import re
import warnings

import numpy as np
import pytest
from small_scene import small_result

from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array
from pftwin.base.rotations import patellar_orientation
from pftwin.model.measured import Measured
from pftwin.results.plots import compared

RNG = np.random.default_rng(4)


@pytest.fixture(scope="module")
def result():
    return small_result()


@pytest.fixture(scope="module")
def measured(result):
    """What was simulated with errors of some size; a tenth of the frames is missing."""
    n = result.times.size
    center = result.center + RNG.normal(0, 1e-3, (n, 3))
    center[::10] = np.nan
    angles = [a + RNG.normal(0, 0.02, n) for a in result.angles]
    forces = {
        "contact_force": result.effects["contact"]["force"] + RNG.normal(0, 0.4, n),
        "tibial_spring_force": result.effects["patellar_tendon"]["tension"] + 0.7,
        "femoral_spring_force": result.effects["quadriceps"]["tension"] - 0.3,
    }
    return Measured(result.times, center, host_array(patellar_orientation(*angles)), **forces, synthetic=True)


def numbers(result, measured):
    """Simulated and measured, panel by panel, written out once more."""
    angles = [
        (np.degrees(getattr(result.angles, a)), np.degrees(getattr(measured.angles, a)))
        for a in ("flexion", "rotation", "tilt")
    ]
    e = result.effects
    return [
        *((1e3 * result.center[:, i], 1e3 * measured.center[:, i]) for i in range(3)),
        *angles,
        (e["contact"]["force"], measured.contact_force),
        (e["patellar_tendon"]["tension"], measured.tibial_spring_force),
        (e["quadriceps"]["tension"], measured.femoral_spring_force),
    ]


@pytest.mark.parametrize("against", ["time", "flexion"])
def test_lines_are_the_data_and_errors_are_theirs(result, measured, against):
    figure = result.plot.compared(measured, against=against)
    across = result.times if against == "time" else np.degrees(result.knee.flexion)
    assert len(figure.axes) == 9
    for ax, (simulated, recorded), unit in zip(
        figure.axes, numbers(result, measured), ["mm"] * 3 + ["deg"] * 3 + ["N"] * 3, strict=True
    ):
        wide, line = ax.get_lines()
        np.testing.assert_allclose(wide.get_xdata(), across)
        np.testing.assert_allclose(wide.get_ydata(), recorded)
        np.testing.assert_allclose(line.get_ydata(), simulated)
        (words,) = [t.get_text() for t in ax.get_legend().get_texts()]
        said = re.fullmatch(rf"RMSE ([\d.e-]+) {unit}", words)
        assert said, words
        error = np.sqrt(np.nanmean((simulated - recorded) ** 2))
        assert error > 0.1
        assert float(said[1]) == pytest.approx(error, rel=5e-3)
        assert ax.get_ylabel().endswith(f"[{unit}]")


def test_several_results_are_named_each_with_its_error(result, measured):
    other = dataclasses.replace(result, center=result.center + 2e-3)
    figure = compared({"P4": result, "P5": other}, measured)
    texts = [t.get_text() for t in figure.axes[0].get_legend().get_texts()]
    errors = [np.sqrt(np.nanmean((1e3 * (r.center - measured.center)[:, 0]) ** 2)) for r in (result, other)]
    assert texts == [f"RMSE {error:.3g} mm" for error in errors]
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["synthetic measurements", "P4", "P5"]
    assert len({str(line.get_linestyle()) for line in figure.axes[0].get_lines()[1:]}) == 2


def test_long_names_leave_the_panels_their_width(result, measured):
    figure = compared({"a name as people give them to variants": result, "and another one like it": result}, measured)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # matplotlib warns where panels collapse
        figure.canvas.draw()
    assert all(ax.get_position().width > 0.15 for ax in figure.axes)


def test_only_what_was_measured_has_a_panel(result):
    figure = result.plot.compared(Measured(result.times, result.center + 1e-3))
    assert [ax.get_ylabel()[:8] for ax in figure.axes] == ["centre x", "centre y", "centre z"]
    assert figure.legends[0].get_texts()[0].get_text() == "measured"
    assert "RMSE 1 mm" in figure.axes[0].get_legend().get_texts()[0].get_text()


def test_springs_may_be_left_out(result, measured):
    figure = result.plot.compared(measured, tibial=None, femoral=None)
    assert len(figure.axes) == 7
    with pytest.raises(InputError, match="a force of an effect 'graft' with a tension, which this scene lacks"):
        result.plot.compared(measured, tibial="graft")


def test_legends_and_labels_lie_beside_the_data(result, measured):
    figure = compared({"P4": result, "P5": result}, measured)
    figure.draw_without_rendering()
    boxes = [ax.get_window_extent() for ax in figure.axes]
    for ax, box in zip(figure.axes, boxes, strict=True):
        assert ax.get_legend().get_window_extent().y0 >= box.y1 - 1
        label = ax.yaxis.label.get_window_extent()
        assert not any(label.overlaps(other) for other in boxes)
        assert label.y0 >= 0
        assert label.y1 <= figure.bbox.y1
    assert figure.legends[0].get_window_extent().y1 <= min(b.y0 for b in boxes)


def test_axes_of_ones_own(result):
    from matplotlib.figure import Figure

    figure = Figure()
    axes = figure.subplots(3)
    assert result.plot.compared(Measured(result.times, result.center), axes=axes) is figure
    assert all(len(ax.get_lines()) == 2 for ax in axes)
    with pytest.raises(InputError, match="axes: 3 axes; expected: 9: one for each of centre x, proximal"):
        result.plot.compared(_complete(result), axes=axes)


def _complete(result):
    e = result.effects
    forces = (e["contact"]["force"], e["patellar_tendon"]["tension"], e["quadriceps"]["tension"])
    return Measured(result.times, result.center, result.quaternion, *forces)


def test_missing_and_foreign_measurements_are_refused(result):
    with pytest.raises(InputError, match="measured: there are no measurements to compare with; expected: a pftwin"):
        result.plot.compared(None)
    with pytest.raises(InputError, match=r"7 frames at .*; expected: the simulation's 41 frames"):
        result.plot.compared(Measured(result.times[:7], result.center[:7]))
    with pytest.raises(InputError, match="no frame has a measured position"):
        result.plot.compared(Measured(result.times, np.full((41, 3), np.nan)))
    with pytest.raises(InputError, match="against: found 'angle'; expected: one of: time, flexion"):
        result.plot.compared(Measured(result.times, result.center), against="angle")
    with pytest.raises(InputError, match="results: nothing to draw"):
        compared({}, Measured(result.times, result.center))
