"""The case figure shows the data it is given, says when they are synthetic, and is written whole."""

from __future__ import annotations

import numpy as np
import pytest
from small_scene import small_result

from pftwin.base.errors import InputError, OutputError
from pftwin.model.measured import Measured
from pftwin.results.plots import COLOURS, case_figure, save_figure


def measurements(result, synthetic: bool = True) -> Measured:
    force = result.effects["contact"]["force"] + 0.2
    return Measured(result.times, result.center + 1e-3, result.quaternion, force, synthetic=synthetic)


@pytest.fixture(scope="module")
def result():
    return small_result()


def test_figure_shows_the_data(result):
    figure = case_figure({"P5": result, "P4": result}, measurements(result), "case 1")
    across, sagittal, tilt, force = figure.axes
    curves = {line.get_label(): line for line in across.get_lines()}
    np.testing.assert_allclose(curves["P5"].get_xdata(), 1e3 * result.center[:, 1])
    np.testing.assert_allclose(curves["P5"].get_ydata(), 1e3 * result.center[:, 0])
    np.testing.assert_allclose(sagittal.get_lines()[0].get_xdata(), 1e3 * result.center[:, 2] + 1)
    np.testing.assert_allclose(tilt.get_lines()[1].get_ydata(), np.degrees(result.angles.tilt))
    np.testing.assert_allclose(force.get_lines()[-1].get_ydata(), result.effects["contact"]["force"])
    assert curves["P5"].get_color() != curves["P4"].get_color()
    assert all("[" in axes.get_xlabel() and "[" in axes.get_ylabel() for axes in figure.axes)


@pytest.mark.parametrize(("synthetic", "label"), [(True, "synthetic measurements"), (False, "measured")])
def test_measurements_are_labelled_for_what_they_are(result, synthetic, label):
    figure = case_figure({"P5": result}, measurements(result, synthetic), "case 1")
    assert label in [text.get_text() for text in figure.legends[0].get_texts()]


def test_works_without_measurements_and_without_forces(result):
    assert len(case_figure({"P5": result}, None, "alone").axes) == 4
    positions = Measured(result.times, result.center)
    assert len(case_figure({}, positions, "measured alone").axes) == 4
    with pytest.raises(InputError, match="nothing to draw"):
        case_figure({}, None, "empty")


def test_many_results_still_differ(result):
    figure = case_figure({f"run {i}": result for i in range(len(COLOURS))}, None, "many")
    looks = {(line.get_color(), line.get_linestyle()) for line in figure.axes[2].get_lines()}
    assert len(looks) == len(COLOURS)


def test_saved_as_png_and_svg(result, tmp_path):
    figure = case_figure({"P5": result}, measurements(result), "case 1")
    png, svg = save_figure(figure, tmp_path / "case_1.5")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["case_1.5.png", "case_1.5.svg"]
    assert png.read_bytes()[:4] == b"\x89PNG"
    assert "synthetic measurements" in svg.read_text()
    with pytest.raises(OutputError, match="no folder"):
        save_figure(figure, tmp_path / "absent" / "case")
