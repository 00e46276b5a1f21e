"""What is on the page is what the files hold; labels, escaping, what is missing, size."""

from __future__ import annotations

import sys
from itertools import pairwise

import numpy as np
import pytest
from report_pages import VALUES, Seen, estimate, fitted, prediction, words_of
from small_scene import small_result

from fitting.cli.report import command
from fitting.cli.report.command import report_page as report
from fitting.cli.report.material import Material
from fitting.cli.report.run import ReportedRun
from fitting.nuisance import Nuisance
from pftwin.dynamics.status import Status
from pftwin.model.measured import SYNTHETIC


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("results") / "knee.nc"
    small_result().save(path)
    return path


def of_file(path, **more):
    run = ReportedRun.of_file(path)
    return Material(path, f"Simulated knee: {run.name}", runs=[run], files=[path], **more)


@pytest.fixture(scope="module")
def fit_page(tmp_path_factory):
    material = fitted(tmp_path_factory.mktemp("fit"))
    material.treatment = prediction()
    return report(material, "pftwin report fit.json")[0]


@pytest.fixture(scope="module")
def fit_seen(fit_page):
    return Seen(fit_page)


@pytest.fixture(scope="module")
def page(file):
    pytest.importorskip("k3d")
    page, viewer = report(of_file(file), "pftwin report knee.nc")
    assert viewer
    return page


@pytest.fixture(scope="module")
def seen(page):
    return Seen(page)


def shown(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}g}".replace("-", "−")


def test_what_a_clinician_reads_comes_before_the_appendix(fit_seen):
    titles = ["verdict", "view", "treatment", "sure", "appendix", "fit", "prediction", "scene", "quality", "figures"]
    found = [a["id"] for tag, a in fit_seen.tags if a.get("id") in titles and tag in ("section", "h2")]
    assert found == titles
    tables = [i for i, (tag, _) in enumerate(fit_seen.tags) if tag == "table"]
    assert min(tables) > next(i for i, (_, a) in enumerate(fit_seen.tags) if a.get("id") == "appendix")


def test_forces_are_those_of_the_file(seen):
    result = small_result()
    rows = {
        "contact: total normal contact force, sum over the facets": result.effects["contact"]["force"],
        "quadriceps: tension": result.effects["quadriceps"]["tension"],
        "patellar tendon: tension": result.effects["patellar_tendon"]["tension"],
    }
    for name, values in rows.items():
        assert seen.rows[name] == [[*(shown(v) for v in (values.min(), values.mean(), values.max())), "N"]]
    tilt = np.degrees(result.angles.tilt)
    (row,) = seen.rows["patellar tilt about its long axis, lateral positive"]
    assert row == [*(shown(v) for v in (tilt.min(), tilt.mean(), tilt.max())), "deg"]


def test_quality_and_settings_are_those_of_the_file(seen):
    result = small_result()
    assert seen.rows["largest indentation"] == [[shown(1e3 * result.largest_indentation, 3), "mm"]]
    assert seen.rows["residual force at the start"] == [[shown(result.equilibrium.residual, 2), "N"]]
    assert f"Start: {result.equilibrium.description}" in seen.text
    assert result.dislocations().describe() in seen.text
    assert seen.rows["integrator"] == [[result.settings["integrator"]]]
    assert seen.rows["longest time step [s]"] == [[f"{result.settings['dt_s']:g}"]]
    assert seen.rows["steps between frames"] == [[str(result.settings["substeps"])]]
    assert {"date", "command", "pftwin", "JAX", "Python"} <= set(seen.rows)


def test_flagged_frames_are_counted(file):
    run = ReportedRun.of_file(file)
    flag = int(run.data["status"].attrs["flag_masks"][0])
    run.data["status"].values[:] = 0
    run.data["status"].values[3:6] = flag
    material = Material(file, "flagged", runs=[run], files=[file])
    ((frames, words),) = run.marks
    assert frames == 3
    assert f"3 of 41 frames: {words}" in words_of(material).text


def of_flag(path, flag: Status, frames: int, name: str | None = None) -> ReportedRun:
    """The run of a file with a flag in its first frames, and no other."""
    run = ReportedRun.of_file(path, name)
    run.data["status"].values[:] = np.where(np.arange(41) < frames, int(flag), 0)
    return run


def verdict_in(text: str) -> str:
    """The words between the headings of the verdict and of the view."""
    return " ".join(text.partition("Verdict")[2].partition("The knee")[0].split())


def test_a_remark_stands_with_the_verdict(file):
    """As in the summary of `pftwin simulate`; frames with another flag are referred to."""
    run = of_flag(file, Status.LEFT_PATCH, 3)
    text = words_of(Material(file, "remarked", runs=[run], files=[file])).text
    assert verdict_in(text).endswith(f"Remark: 3 of 41 frames: {Status.LEFT_PATCH.describe()}.")
    assert "Some frames of" not in text
    run = of_flag(file, Status.INACCURATE, 2)
    text = words_of(Material(file, "flagged", runs=[run], files=[file])).text
    assert "Remark" not in text
    assert f"Some frames of {run.name} are flagged: see Data quality." in text


def test_the_verdict_on_several_valid_motions_is_said_once(file):
    runs = [of_flag(file, Status.OK, 0, name) for name in ("nominal", "fitted")]
    said = verdict_in(words_of(Material(file, "two", runs=runs, files=[file])).text)
    assert said.startswith("Valid: nominal and fitted. nominal: ")
    assert said.count("Valid") == 1


def test_the_fit_with_its_intervals_and_sentence(fit_seen):
    e = estimate()
    meanings = {"K1": "quadriceps, stiffness", "L2": "patellar tendon, slack length"}
    for i, name in enumerate(VALUES):
        scale, unit = (1e3, "mm") if e.units[i] == "m" else (1.0, "N/m")
        low, high = scale * e.intervals[i]
        (row,) = fit_seen.rows[name]
        assert row[1:3] == [shown(scale * e.values[i]), f"{shown(low)} to {shown(high)}"]
        assert row[3:] == [shown(scale * e.standard_deviations[i], 3), shown(scale * e.nominal[i]), unit]
        assert row[0] == meanings.get(name, row[0])
    assert e.sentence()[1:] in fit_seen.text
    assert all(remark in fit_seen.text for remark in e.remarks())
    assert fit_seen.rows["seed"] == [["7"]]


def test_a_parameter_at_its_bound_is_marked_in_the_table(tmp_path):
    free = estimate()
    upper = np.where(np.arange(len(VALUES)) == 0, free.values, free.upper)
    seen = words_of(fitted(tmp_path, upper=upper))
    marked = [seen.rows[name][0][1].endswith(", at its bound") for name in VALUES]
    assert marked == [True, *[False] * (len(VALUES) - 1)]


def test_fitted_nuisance_is_reported_though_the_scene_lacks_it(tmp_path):
    name = "contact.friction.coefficient"
    values = {**VALUES, name: (0.031, 0.002)}
    seen = words_of(fitted(tmp_path, values=values, auxiliary=(name,), nuisance=Nuisance(friction=0.05)))
    assert f"{name}: contact, friction.coefficient" in seen.text
    [row] = seen.rows[name]
    assert row[1] == "0.031"


def test_gaps_and_residuals_are_reported(fit_seen):
    assert fit_seen.rows["position of the button's centre"] == [["41", "5", "4"]]
    assert fit_seen.rows["contact force"] == [["not measured", "–", "–"]]
    assert fit_seen.rows["position"] == [["1.23", "1.1", "mm"]]


def test_parameters_of_the_scene_have_their_units(fit_seen):
    assert ["stiffness", "156", "N/m"] in fit_seen.rows["quadriceps"]
    assert ["slack length", "71.4", "mm"] in fit_seen.rows["patellar tendon"]
    assert ["radius of the button", "22", "mm"] in fit_seen.rows["contact"]


def test_the_prediction_has_a_row_per_variant(fit_seen):
    (row,) = fit_seen.rows["10"]
    assert row[0] == "none; 0 % of draws"
    assert row[1].startswith("15.0 (")  # 0.02 m less 5 steps of 1 mm
    assert fit_seen.rows["20"][0][1].startswith("-10.0 (")
    assert "25.2 (" in row[4] or "25.3 (" in row[4]
    assert "Without dislocation from 10 mm of transfer medialisation on." in fit_seen.text
    assert "other parameters" not in fit_seen.text


def test_labels(page, fit_page, tmp_path):
    """The research label on every page; that data are synthetic, where they are, and nowhere else."""
    for text in (page, fit_page):
        assert "Research use, not a medical device." in text
        assert "synthetic" not in Seen(text).text.lower()
    made_up = fitted(tmp_path, synthetic=True)
    made_up.treatment = prediction(synthetic=1)
    text = words_of(made_up).text
    assert "Synthetic data: the measurements are synthetic" in text
    assert "estimated from synthetic measurements" in text


def test_a_synthetic_motion_is_labelled_from_its_file(file):
    run = ReportedRun.of_file(file)
    run.data.attrs["note"] = SYNTHETIC
    seen = words_of(Material(file, "made up", runs=[run], files=[file]))
    assert f"Synthetic data: {SYNTHETIC}." in seen.text


def test_names_do_not_break_out(file, tmp_path):
    evil = "</script></style><img src=x onerror=alert(1)>\"'&"
    run = ReportedRun.of_file(file, evil)
    run.data.attrs |= {"tracking": evil, "equilibrium": evil, "integrator": evil}
    material = fitted(tmp_path, source=evil, reason=evil, notes=[evil])
    material.title, material.treatment = evil, prediction(title=evil, parameters=evil)
    material.runs = [run]
    seen = words_of(material, evil)
    assert len(seen.all("script")) == 0
    assert len(seen.all("style")) == 1
    assert all(i["src"].startswith("data:image/") and "onerror" not in i for i in seen.all("img"))
    assert seen.text.count(evil) >= 8


def test_a_page_is_accessible(seen, fit_seen):
    for page in (seen, fit_seen):
        assert page.all("html") == [{"lang": "en"}]
        assert all(len(i["alt"]) > 40 for i in page.all("img"))
        levels = [int(tag[1]) for tag, _ in page.tags if tag in ("h1", "h2", "h3", "h4")]
        assert levels[0] == 1
        assert levels.count(1) == 1
        assert all(b <= a + 1 for a, b in pairwise(levels))
        assert all(a.get("scope") in ("col", "row") for a in page.all("th"))
        anchors = {a["id"] for _, a in page.tags if "id" in a}
        assert {link["href"].removeprefix("#") for link in page.all("a")} <= anchors
    assert all(f["title"] for f in seen.all("iframe"))


def test_without_k3d_the_page_says_how_to_get_it(file, monkeypatch):
    monkeypatch.setitem(sys.modules, "k3d", None)
    page, viewer = report(of_file(file), "")
    assert not viewer
    assert "python -m pip install 'pftwin[viewer]'" in Seen(page).text


def test_a_page_too_large_goes_without_the_drawing(file, page, monkeypatch):
    assert len(page.encode()) < command.MOST_BYTES == 12_000_000
    monkeypatch.setattr(command, "MOST_BYTES", 1_000_000)
    page, viewer = report(of_file(file), "")
    assert not viewer
    assert len(page.encode()) < 1_000_000
    assert "Left out: with it this page would have" in page
