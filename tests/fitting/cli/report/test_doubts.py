"""Where the parts of a report may not be of one knee, the page says so."""

from __future__ import annotations

import dataclasses

import numpy as np
from report_pages import fitted, prediction, words_of
from small_scene import small_result

from fitting.cli.report.run import ReportedRun
from fitting.parameters import REQUESTED
from pftwin.dynamics.status import Status

OUTCOMES = ("largest_offset", "peak_contact_force", "mean_tilt", "medial_share")


def test_a_scene_with_other_values_than_the_fit_began_from_is_doubted(tmp_path):
    words = "This scene has other values of K1, L1, K2, L2 than at the start of the fit"
    assert words in words_of(fitted(tmp_path)).text
    same = fitted(tmp_path, nominal=np.array([156.0, 0.1432, 629.0, 0.0714]))
    assert words not in words_of(same).text


def test_a_prediction_of_another_fit_is_called_so(tmp_path):
    material = fitted(tmp_path)
    material.treatment = prediction().assign_coords(scene=("variant", ["another knee"] * 3))
    material.treatment["parameters"] = 1.01 * material.treatment["parameters"]
    text = words_of(material).text
    assert "other parameters than those of the fit" in text
    assert "The prediction is of another knee; this report is of small knee." in text


def test_a_prediction_from_an_estimate_that_is_invalid_is_left_out(tmp_path):
    material = fitted(tmp_path)
    material.treatment = prediction(objection="INVALID: the forces look as if they were in kN")
    text = words_of(material).text
    assert "INVALID: the forces look as if they were in kN (the treatment's estimate)" in text
    assert "No treatment is reported, because this is INVALID: the treatment's estimate." in text
    assert "medialisation on" not in text


def test_a_motion_that_may_not_be_spoken_of_comes_first_and_nothing_is_said_of_its_tracking(tmp_path):
    material = fitted(tmp_path)
    result = small_result()
    lost = dataclasses.replace(result, flags=np.full_like(result.flags, int(Status.NO_CONTACT)))
    assert "normal tracking" in words_of(material).text
    assert "All 41 frames clean." in words_of(material).text
    material.runs[:] = [ReportedRun.of_result(lost, "fitted")]
    text = words_of(material).text
    assert text.split("Verdict", 1)[1].split()[0] == "INVALID:"
    assert "normal tracking" not in text
    assert "frames clean" not in text


def test_nothing_is_said_of_a_treatment_whose_untreated_knee_is_invalid(tmp_path):
    material = fitted(tmp_path)
    material.treatment = prediction()
    finding = "Without dislocation from 10 mm"
    table = "In brackets: 95 % interval over"
    assert finding in words_of(material).text
    assert table in words_of(material).text
    result = small_result()
    lost = dataclasses.replace(result, flags=np.full_like(result.flags, int(Status.NO_CONTACT)))
    material.runs[:] = [ReportedRun.of_result(lost, "fitted")]
    text = words_of(material).text
    assert finding not in text
    assert table not in text
    assert "Left out, because this is INVALID: fitted." in text
    assert "No treatment is reported, because this is INVALID: fitted." in text


def test_a_fit_that_may_not_be_spoken_of_is_in_the_verdict(tmp_path):
    material = fitted(tmp_path, verdict="INVALID: not finite")
    material.treatment = prediction()
    text = words_of(material).text
    assert text.split("Verdict", 1)[1].split()[0] == "INVALID:"
    assert "Without dislocation" not in text
    assert "see the verdict" in text


def test_the_main_source_of_the_bands_is_named(tmp_path):
    """An outcome that is a straight function of the fitted K1 alone, over draws in which friction varies as well."""
    from xarray import Dataset

    from fitting.cli.report.tables import uncertainty_of_prediction

    draws = np.random.default_rng(0).normal(size=(41, 2))
    outcomes = dict.fromkeys(OUTCOMES, (("variant", "sample"), draws[:, :1].T))
    numbers = {"parameters": (("sample", "parameter"), draws)}
    kinds = {"parameter": ["K1", "mu"], "parameter_kind": ("parameter", [REQUESTED, "friction"])}
    said = uncertainty_of_prediction(Dataset({**outcomes, **numbers}, kinds, {"variants_missing": 2}))
    assert said[0] == "The prediction was interrupted: 2 variants are missing."
    known = "If this source were known, the bands would be 100 % narrower."
    assert said[1] == f"Widest source of the bands: requested parameters (K1). {known}"
