"""Fits, predictions, plans and pages say INVALID where a motion may not be spoken of."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made_estimates import made_estimate
from small_scene import small_result, small_scene

from fitting.cli.live import words
from fitting.cli.live.motion import ShownMotion
from fitting.estimate import Estimate
from fitting.prediction.plots import draws_failed, facts, main_finding, narrow_bands
from fitting.prediction.predicting import predict
from fitting.prediction.variants import grid
from fitting.treatments.limits import Limit
from fitting.treatments.optimise import optimise_treatment
from pftwin.dynamics.status import Status

WHY = "INVALID: the button touches nothing (41 of 41 frames)"


def in_the_air():
    result = small_result()
    return dataclasses.replace(result, flags=np.full_like(result.flags, int(Status.NO_CONTACT)))


def slack():
    """No equilibrium: nothing pulls the patella up."""
    return small_scene(11).set("quadriceps.slack_length", 143.0)


@pytest.mark.slow
def test_a_prediction_whose_variants_are_all_invalid_says_only_that():
    data = predict(slack(), grid("tibial_tuberosity_transfer", medialisation=[0.0, 0.005]))
    assert data["failed"].all()
    assert np.isnan(data["largest_offset"].values).all()
    assert data["verdict"].values[0].startswith("INVALID: the run did not start from a converged equilibrium")
    assert main_finding(data).startswith("INVALID: 2 of 2 variants (the run did not start")
    assert "track" not in main_finding(data)
    assert all(v["verdict"].startswith("INVALID") for v in facts(data)["variants"])


@pytest.mark.slow
def test_some_invalid_variants_come_first_and_do_not_count_as_dislocating():
    data = predict(small_scene(11), grid("tibial_tuberosity_transfer", medialisation=[0.0, 0.002, 0.004]))
    assert main_finding(data) == "no variant dislocates"
    data["failed"].values[2] = True
    data = data.assign_coords(verdict=("variant", ["valid", "valid", WHY]))
    said = WHY.replace("INVALID: ", "INVALID: 1 of 3 variants (")
    assert main_finding(data) == f"{said}); 2 of the other 2 track without dislocation"


@pytest.mark.slow
def test_a_plan_without_one_sound_motion_says_so():
    plan = optimise_treatment(slack(), Limit("dislocation_margin", at_least=0.003), {"medialisation": (0.0, 0.005)})
    assert not plan.met
    assert plan.describe().startswith("INVALID: 41 of 41 variants (the run did not start")
    assert plan.to_dict()["verdict"] == plan.describe()
    assert plan.to_dict()["status_frames"]["start_not_in_equilibrium"] == 11
    assert "the run did not start from a converged equilibrium" in plan.to_dict()["status"]


def test_an_invalid_fit_says_so_first_and_older_files_are_read(tmp_path):
    made = made_estimate({"K1": (171.0, 12.5)}, verdict=WHY)
    assert made.invalid
    assert made.sentence() == f"{WHY} (the fitted motion). The precision of K1 is not known"
    assert made.summary().startswith("INVALID")
    assert Estimate.load(made.save(tmp_path / "fit.json")).verdict == WHY
    text = (tmp_path / "fit.json").read_text().replace(f'"verdict": "{WHY}",', "")
    assert "INVALID" not in text.split('"sentence"')[0]
    (tmp_path / "older.json").write_text(text)
    assert not Estimate.load(tmp_path / "older.json").invalid


def test_the_live_page_says_so_first_and_nothing_of_dislocation():
    pytest.importorskip("k3d")
    result = in_the_air()
    text = words.outcome(ShownMotion.of(result, "after", result.geometry(), lambda points: None, ()))
    assert WHY in text
    assert "islocat" not in text


def outcomes(angles, dislocations, failed=None):
    """Of a rotated component by so many degrees: dislocations by variant, or by variant and sample."""
    from xarray import Dataset

    out = np.asarray(dislocations, dtype=float)
    dims, n = ("variant", "sample")[: out.ndim], len(angles)
    failed = np.isnan(out) if failed is None else failed
    amounts = ("variant", np.radians(angles), {"units": "rad"})
    coords = {"variant": range(n), "scene": ("variant", ["knee"] * n), "component_rotation": amounts}
    return Dataset({"failed": (dims, failed), "dislocations": (dims, out)}, coords)


@pytest.mark.parametrize(
    ("angles", "out", "said"),
    [
        ([0, 3, 6], [1, 1, 0], "without dislocation from 6 deg of component rotation on"),
        ([0, -3, -6], [1, 0, 0], "without dislocation from -3 deg of component rotation on"),
        ([-6, -3, 0, 3, 6], [1, 1, 1, 0, 0], "2 of 5 variants track without dislocation"),
        ([-6, -3, 0, 3, 6], [0, 0, 1, 1, 1], "2 of 5 variants track without dislocation"),
    ],
)
def test_from_an_amount_on_is_said_of_amounts_to_one_side_alone(angles, out, said):
    assert main_finding(outcomes(angles, out)) == said


def test_draws_that_failed_are_counted_and_doubted():
    out = np.zeros((2, 51))
    out[1, 4:] = np.nan  # 3 of 50 draws are left
    data = outcomes([0, 3], out)
    assert draws_failed(data).tolist() == [0, 47]
    assert narrow_bands(data) == "1 of 2 variants have bands of too few draws (up to 47 of 50 failed)"
    assert not narrow_bands(data.isel(variant=[0]))
    assert not narrow_bands(outcomes([0, 3], [0, 0]))
