"""Accuracy against time: what is measured of a short motion, what the front and the advice make of it, the files."""

from __future__ import annotations

import json
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from typer.testing import CliRunner

from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.base.sheet import to_csv
from pftwin.cli.program import app
from pftwin.dynamics.status import FLAGS
from pftwin.files.result_files import load_dataset
from pftwin.results.metrics import validate
from pftwin.studies.accuracy.measure import AccuracyMeasured, AccuracyRow, compiling_anew, converged, rows
from pftwin.studies.accuracy.programs import COMMON, FLOATS, MESHES, SMOOTH, MeasuredProgram, chosen, full_table
from pftwin.studies.accuracy.table import advice, columns, front, read_csv, recommended, report, write


def row(error: float, speed: float, **more) -> AccuracyRow:
    known = dict.fromkeys(
        ("tilt_rms_deg", "force_rms_n", "dislocation_ms", "measured_mm", "compile_s", "gradient"), 1.0
    )
    given = {"contact": "P5", "integrator": "newmark", "order": 2, "dtype": "float64", "step_ms": 1.0, "status": "ok"}
    errors = {"position_rms_mm": error, "position_max_mm": 2 * error}
    return AccuracyRow(**{**given, **known, **errors, "real_time": speed, "real_time_batch": 10 * speed, **more})


def test_the_front_is_what_nothing_beats():
    """Both faster and more accurate; what is not known does not count."""
    good = [row(0.1, 1000), row(0.01, 100), row(0.001, 10)]
    worse = [row(0.2, 900), row(0.01, 50), row(np.nan, 5000), row(0.0001, np.nan)]
    assert front([*worse, *good]) == good


def test_advice_is_the_fastest_within_an_error():
    found = recommended([row(0.1, 1000), row(0.01, 100), row(0.02, 60)], (0.5, 0.02, 1e-4))
    assert [a.row and a.row.real_time for a in found] == [1000, 100, None]
    alike = [row(0.1, 1000, dtype="float32"), row(0.1, 980), row(0.09, 950), row(0.01, 800)]
    assert recommended(alike, (0.5,))[0].row == alike[2]
    assert "none measured" in advice([row(0.1, 1000)]).grid()


def test_the_whole_plan_holds_all_that_there_is():
    plan = full_table()
    assert {s.contact for s in plan} == {*SMOOTH, *MESHES}
    assert {s.dtype for s in plan} == set(FLOATS)
    assert {s.integrator for s in plan} >= {*COMMON, "ali3p", "symplectic_euler", "diffrax:Tsit5"}
    assert max(plan[0].substeps) / min(plan[0].substeps) >= 10**1.5
    assert len(set(plan)) == len(plan)


def test_a_choice_of_what_is_not_there_is_refused():
    with pytest.raises(InputError, match="float16"):
        chosen(["P5"], ["newmark"], ["float16"])
    with pytest.raises(InputError, match="no integrator"):
        chosen(["P5"], ["euler"], ["float64"])


@pytest.fixture(scope="module")
def short_case():
    """The first half second of case 1, as a factory of scenes, with its measurements."""

    def scene_of(contact: str):
        scene = rig.case(1, contact=contact)
        return eqx.tree_at(lambda s: s.motion, scene, replace(scene.motion, n_frames=51))

    measured = rig.measured(1)
    parts = ("times", "center", "quaternion", "contact_force", "tibial_spring_force", "femoral_spring_force")
    return scene_of, replace(measured, **{name: getattr(measured, name)[:51] for name in parts})


@pytest.fixture(scope="module")
def found(short_case) -> AccuracyMeasured:
    scene_of, measured = short_case
    reference = converged(scene_of("P5"), "P5")
    plan = [
        MeasuredProgram("P5", "linear_implicit_bdf2", "float64", True, True),
        MeasuredProgram("P5", "linear_implicit", "float32", False, False),
    ]
    measured_rows = []
    for setting in plan:
        with jax.enable_x64(setting.dtype == "float64"):
            measured_rows += rows(setting, scene_of("P5"), reference, measured)
    return AccuracyMeasured(measured_rows, {"P5": reference}, {"P5": validate(reference.result, measured)})


@pytest.mark.slow
def test_errors_fall_with_the_step(found):
    two = [r for r in found.rows if r.integrator == "linear_implicit_bdf2"]
    errors = [r.position_rms_mm for r in two]
    assert [r.step_ms for r in two] == pytest.approx([10, 5, 2, 1, 0.5, 0.2])
    assert errors[0] > errors[2] > errors[4]
    assert errors[4] < 1e-3
    assert found.references["P5"].doubt_mm < 1e-4
    times = [(r.real_time, r.real_time_batch, r.gradient, r.compile_s) for r in two]
    assert (np.asarray(times) > 0).all()  # how they compare is for benchmarks: other work on the machine counts
    assert all(0.1 < r.measured_mm < 20 for r in two[1:])


@pytest.mark.slow
def test_single_precision_has_its_own_floor(found):
    single = [r for r in found.rows if r.dtype == "float32"]
    assert {r.dtype for r in found.rows} == set(FLOATS)
    assert 1e-5 < single[-2].position_rms_mm < 0.1
    assert np.isnan(single[0].real_time_batch)
    assert np.isnan(single[0].gradient)


@pytest.mark.slow
def test_files(found, tmp_path):
    about = {"cpu": "a processor", "date": "a day"}
    paths = write(found, tmp_path / "new", "a case", about)
    assert {p.suffix for p in paths} == {".nc", ".csv", ".md", ".png", ".svg"}
    assert all(p.stat().st_size > 500 for p in paths)
    data = load_dataset(paths[0])
    assert data.sizes["setting"] == len(found.rows)
    assert data["position_rms_mm"].attrs["units"] == "mm"
    assert data.attrs["cpu"] == "a processor"
    text = report(found, "a case", about)
    assert "SYNTHETIC" in text
    assert "(3.33)" in text  # the paper's contact force with P5
    assert text.count("| P5 | linear_implicit") == len(found.rows)


def test_nothing_comes_from_the_folder_of_programs_while_times_are_taken():
    kept = jax.config.jax_compilation_cache_dir
    with compiling_anew():
        assert jax.config.jax_compilation_cache_dir is None
    assert jax.config.jax_compilation_cache_dir == kept


@pytest.mark.slow
def test_the_command(tmp_path):
    out = tmp_path / "accuracy"
    given = ["accuracy", "--case", "2", "--integrator", "linear_implicit", "--out", str(out), "--json", "-"]
    answer = CliRunner().invoke(app, given)
    assert answer.exit_code == 0, answer.output
    rows = json.loads(answer.stdout)["rows"]
    assert len(rows) == 6
    assert all(list(r["status_frames"]) == [str(flag.name).lower() for flag in FLAGS] for r in rows)
    assert all((r["status"] == "ok") == (not any(r["status_frames"].values())) for r in rows)
    assert (out / "accuracy_P5.png").exists()


def test_the_command_refuses(tmp_path):
    both = CliRunner().invoke(app, ["accuracy", "x.toml", "--case", "1"])
    assert both.exit_code == 2
    assert "one of them" in both.stderr
    file = tmp_path / "file"
    file.write_text("")
    assert "is a file; try: " in CliRunner().invoke(app, ["accuracy", "--case", "1", "--out", str(file)]).stderr
    full = CliRunner().invoke(app, ["accuracy", "--full", "--contact", "P5", "--out", str(tmp_path / "a")])
    assert "omit --full" in full.stderr


def test_a_stored_table_is_read_back(tmp_path):
    """With a column that an older version did not know, one that no version knows, and what is said of the machine."""
    good = [row(0.1, 1000.0), row(0.01, np.nan, dtype="float32", status="one, two")]
    path = tmp_path / "kept.csv"
    path.write_text(to_csv(columns(good)), encoding="utf-8")
    assert repr(read_csv(path)) == repr(good)  # NaN and all
    lines = [line.replace("gradient", "colour") for line in path.read_text().splitlines()]
    path.write_text("\n".join(["# machine: a processor", *lines]))
    assert [r.position_rms_mm for r in read_csv(path)] == [0.1, 0.01]
    assert np.isnan([r.gradient for r in read_csv(path)]).all()


@pytest.mark.parametrize(
    ("text", "words"), [("a,b\n1,2\n", "no contact"), (None, "no such file"), ("fast", "could not convert")]
)
def test_a_file_that_is_no_table_is_refused(tmp_path, text, words):
    path = tmp_path / "kept.csv"
    if text == "fast":
        text = to_csv(columns([row(0.1, 1000)])).replace("1000", "fast")
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        read_csv(path)
