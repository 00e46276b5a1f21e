"""The report's figures draw the numbers that its files hold: lines, axes' units, captions."""

from __future__ import annotations

import base64
import dataclasses
from xml.etree import ElementTree

import numpy as np
import pytest
from made_estimates import made_estimate
from report_pages import VALUES, estimate, fitted, measured
from small_scene import small_result

from fitting.cli.report import figures
from fitting.cli.report.material import Material
from fitting.cli.report.run import ReportedRun


@pytest.fixture(scope="module")
def material(tmp_path_factory) -> Material:
    history = [{"iteration": i, "evaluations": 10.0 * (i + 1), "best": 7.0 - i, "spread": 0.0} for i in range(3)]
    return fitted(tmp_path_factory.mktemp("fit"), history=history, objective_value=5.0)


def points(axes):
    return [np.array(line.get_data(), dtype=float) for line in axes.get_lines()]


def has(axes, x, y):
    """Whether one of the lines is of these numbers."""
    for a, b in points(axes):
        if a.shape == np.shape(x) and np.allclose(a, x, equal_nan=True) and np.allclose(b, y, equal_nan=True):
            return True
    return False


def test_the_case_figure_has_the_runs_and_the_measurements_numbers(material):
    drawn = figures.case(material)
    coronal, sagittal, tilt, force = drawn.figure.axes
    result, data = small_result(), measured()
    for center in (result.center, data.center):
        assert has(coronal, 1e3 * center[:, 1], 1e3 * center[:, 0])
        assert has(sagittal, 1e3 * center[:, 2], 1e3 * center[:, 0])
    assert has(tilt, result.times, np.degrees(result.angles.tilt))
    assert has(force, result.times, result.effects["contact"]["force"])
    assert "[mm]" in coronal.get_xlabel()
    assert "[mm]" in sagittal.get_ylabel()
    assert "[deg]" in tilt.get_ylabel()
    assert "[N]" in force.get_ylabel()
    assert result.dislocations().describe() in drawn.alternative
    assert drawn.caption == "Path, tilt and contact force: fitted, with measured."


def test_courses_against_flexion_are_the_runs(material):
    drawn = figures.courses(material)
    result = small_result()
    knee = np.degrees(result.knee.flexion)
    top = int(np.argmax(knee))
    values = {
        "tilt": np.degrees(result.angles.tilt),
        "shift": 1e3 * result.center[:, 1],
        "rotation": np.degrees(result.angles.rotation),
        "force": result.effects["contact"]["force"],
    }
    assert len(drawn.figure.axes) == 4
    for axes in drawn.figure.axes:
        (name,) = (n for n in values if n in axes.get_ylabel())
        x, y = points(axes)[0]
        known = np.isfinite(y)
        assert known.sum() > 50
        np.testing.assert_allclose(y[known], np.interp(x[known], knee[: top + 1], values[name][: top + 1]), rtol=1e-6)
    assert "fitted" in drawn.alternative


def test_a_run_from_a_file_is_marked_where_it_dislocates(tmp_path):
    result = small_result()
    center = result.center.copy()
    center[30:, 1] += 0.030  # while the knee straightens
    dataclasses.replace(result, center=center).save(tmp_path / "out.nc")
    run = ReportedRun.of_file(tmp_path / "out.nc", "from a file")
    drawn = figures.courses(Material(tmp_path, "", runs=[run]))
    labels = drawn.figure.axes[1].get_legend_handles_labels()[1]
    assert labels == ["from a file, bending (n = 1)", "from a file, straightening, dislocates (n = 1)"]
    assert drawn.figure.axes[1].get_lines()[-1].get_linestyle() == ":"
    assert drawn.caption.endswith("dotted while the patella is out of its groove.")


def test_the_fits_way_and_its_correlations_are_the_estimates(material):
    (drawn,) = figures.histories(material)
    assert has(drawn.figure.axes[0], [10, 20, 30], [7, 6, 5])
    assert drawn.alternative.endswith("It ends at 5.")
    picture = figures.correlation(material.estimate).figure.axes[0].get_images()[0].get_array()
    np.testing.assert_allclose(picture, estimate().correlation)


def test_of_two_runs_each_is_drawn_under_its_own_name(material):
    other = dataclasses.replace(small_result(), scene=small_result().scene)
    two = dataclasses.replace(material, runs=[*material.runs, ReportedRun.of_result(other, "treated")])
    drawn = figures.case(two)
    assert {"fitted", "treated"} <= {t.get_text() for legend in drawn.figure.legends for t in legend.get_texts()}
    assert "fitted and treated" in drawn.alternative


def test_a_pictures_data_url_states_its_type(material):
    """Bytes of a PNG file as they are; a figure as SVG."""
    kept = figures.Picture(b"\x89PNG\r\n\x1a\n and more", "", "").source
    start, data = kept.split(",")
    assert start == "data:image/png;base64"
    assert base64.b64decode(data) == b"\x89PNG\r\n\x1a\n and more"
    start, data = figures.case(material).source.split(",")
    assert start == "data:image/svg+xml;base64"
    assert ElementTree.fromstring(base64.b64decode(data)).tag.endswith("svg")


def test_the_strongest_correlation_is_that_of_two_parameters():
    two = made_estimate(dict(list(VALUES.items())[:2]), covariance=np.array([[4.0, -0.03], [-0.03, 0.0025]]))
    assert "The strongest: K1 and L1, -0.30." in figures.correlation(two).alternative
    one = made_estimate({"K1": (171.0, 12.5)})
    assert "strongest" not in figures.correlation(one).alternative


def test_a_prediction_whose_amount_does_not_vary_has_no_figure():
    from xarray import Dataset

    assert (
        figures.outcomes(Dataset(coords={"tibial_tuberosity_transfer_medialisation": ("variant", [0.01, 0.01])})) == []
    )


def test_the_viewers_page_looks_nowhere_for_its_fonts(material, monkeypatch):
    drawn = []
    monkeypatch.setattr("pftwin.results.viewer.view", lambda runs, hidden: drawn.append((runs, hidden)) or "plot")
    monkeypatch.setattr("pftwin.results.viewer.page.page", lambda plot: f"<html><head><title>{plot}</title></head>")
    assert figures.viewer(material) == '<html><head><base href="about:invalid"><title>plot</title></head>'
    (run,) = material.runs
    assert drawn.pop() == ([("fitted", run.source)], [])
    figures.viewer(dataclasses.replace(material, runs=[ReportedRun.of_result(run.source, "nominal"), run]))
    assert drawn.pop() == ([("nominal", run.source), ("fitted", run.source)], ["nominal"])
