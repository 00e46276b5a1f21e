"""Where the parts of a report may not be of one knee, the page says so."""

from __future__ import annotations

import numpy as np
from report_pages import fitted, prediction, words_of


def test_a_scene_with_other_values_than_the_fit_began_from_is_doubted(tmp_path):
    words = "This scene has other values of K1, L1, K2, L2 than the fit began from"
    assert words in words_of(fitted(tmp_path)).text
    same = fitted(tmp_path, nominal=np.array([156.0, 0.1432, 629.0, 0.0714]))
    assert "began from" not in words_of(same).text


def test_a_prediction_of_another_fit_is_called_so(tmp_path):
    material = fitted(tmp_path)
    material.treatment = prediction().assign_coords(scene=("variant", ["another knee"] * 3))
    material.treatment["parameters"] = 1.01 * material.treatment["parameters"]
    text = words_of(material).text
    assert "other parameters than those under Fit" in text
    assert "The prediction is of another knee; this report is of small knee." in text
