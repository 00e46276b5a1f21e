"""Ctrl-C: what there is is saved and named, exit code 130, no traceback; sent to a real process by some tests."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plate_and_ball import write_plate_and_ball
from toy_scene_files import SCENE, write_toy
from typer.testing import CliRunner

from fitting.prediction.outcomes import MEASURES
from fitting.prediction.variants import amounts_of
from pftwin.cli import app
from pftwin.dynamics.status import FLAGS
from pftwin.files.result_files import load_dataset

ROOT = Path(__file__).resolve().parents[2]
READY = "ready for the signal"
PAUSE = f"print('{READY}', flush=True); time.sleep(300)"
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Path:
    measured = '\n[measured]\npatella = { body = "patella" }\n'
    return write_toy(tmp_path_factory.mktemp("toy"), SCENE + measured)


class Run:
    """A process of the program, with a piece of Python before it that makes it pause somewhere."""

    def __init__(self, before: str, *arguments: object, cwd: Path) -> None:
        # Programs in the background may have been started with Ctrl-C ignored, and hand that down.
        heard = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)"
        code = f"import sys, time\nfrom pathlib import Path\n{heard}\n{before}\nfrom pftwin.cli import main\nmain()"
        cache = os.environ.get("PFTWIN_TEST_CACHE", str(ROOT / ".jax_cache"))  # what other tests have compiled
        more = {"PYTHONPATH": str(ROOT), "PFTWIN_CACHE": cache, "NO_COLOR": "1", "COLUMNS": "160"}
        env = {**os.environ, **more}
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, *(str(a) for a in arguments)],
            cwd=cwd,
            env=env,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def until_ready(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if READY in line:
                return
        assert self.process.stderr is not None
        pytest.fail(f"ended before: {self.process.stderr.read()}")

    def until(self, file: Path) -> None:
        deadline = time.monotonic() + 120
        while not file.exists():
            assert self.process.poll() is None, self.process.communicate()
            assert time.monotonic() < deadline, "nothing was written"
            time.sleep(0.05)

    def interrupted(self) -> str:
        """What it says on stderr after the signal."""
        self.process.send_signal(signal.SIGINT)
        self.shown, said = self.process.communicate(timeout=120)
        assert self.process.returncode == 130, said
        assert "Traceback" not in said
        assert said.count("interrupted; ") == 1
        return said


@pytest.mark.slow
def test_fit_keeps_the_best_so_far_and_its_checkpoint(toy, tmp_path):
    options = ["-o", "fit.json", "--free", "K1,L1", "--method", "genetic", "--checkpoint", "state.npz"]
    slow = (
        "import fitting.methods.populations as g\nold = g.Genetic.tell\n"
        "def tell(*a):\n    old(*a); time.sleep(0.3)\ng.Genetic.tell = tell"
    )
    run = Run(slow, "fit", toy, *options, cwd=tmp_path)
    run.until(tmp_path / "state.npz")
    said = run.interrupted()
    assert "saved so far: fit.json, state.npz" in said
    estimate = json.loads((tmp_path / "fit.json").read_text())
    assert estimate["reason"] == "interrupted; the best so far"
    assert estimate["iterations"] >= 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["fit.json", "state.npz"]


@pytest.mark.slow
def test_treat_keeps_the_variants_that_are_done(toy, tmp_path):
    before = (
        "import fitting.cli.treat as t, fitting.prediction.predicting as p\nt._BLOCK = 2\nreal, calls = p.predict, []\n"
        f"def predict(*a, **k):\n    calls.append(1)\n    if len(calls) == 3: {PAUSE}\n    return real(*a, **k)\n"
        "p.predict = predict"
    )
    run = Run(before, "treat", toy, "-o", "v.nc", "--tto-medial", "0:5:1", "--dt", "0.005", cwd=tmp_path)
    run.until_ready()
    assert "saved so far: v.nc" in run.interrupted()
    data = load_dataset(tmp_path / "v.nc")
    assert data["tibial_tuberosity_transfer_medialisation"].values.tolist() == pytest.approx([0, 1e-3, 2e-3, 3e-3])
    assert data["variant"].values.tolist() == [0, 1, 2, 3]
    assert "interrupted: 4 of 6 variants" in data.attrs["title"]
    assert [p.name for p in tmp_path.iterdir()] == ["v.nc"]


def interrupted(*arguments: object) -> str:
    """What a command says on stderr after a Ctrl-C that comes from within, in this process."""
    done = CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})
    assert done.exit_code == 130, done.output
    assert done.stderr.count("interrupted; ") == 1
    return done.stderr


def stopping_at(call: int, real: Callable[..., Any]) -> Callable[..., Any]:
    """A function that is interrupted at its n-th call."""
    calls = []

    def counted(*arguments: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == call:
            raise KeyboardInterrupt
        return real(*arguments, **options)

    return counted


def test_treat_keeps_the_blocks_that_are_done(toy, tmp_path, monkeypatch):
    """With outcomes that are made up: the blocks before the third."""
    from xarray import Dataset

    def predict(scene: Any, rows: Any, estimate: Any, **options: Any) -> Dataset:
        values = [1e3 * float(a) for a in amounts_of(rows)[:, 0]]
        return Dataset({"peak": ("variant", values)}, {"variant": [0, 1]}, {"title": "outcomes"})

    monkeypatch.setattr("fitting.cli.treat._BLOCK", 2)
    monkeypatch.setattr("fitting.prediction.predicting.predict", stopping_at(3, predict))
    output = tmp_path / "v.nc"
    assert f"saved so far: {output}" in interrupted("treat", toy, "-o", output, "--tto-medial", "0:5:1")
    data = load_dataset(output)
    assert data["peak"].values.tolist() == pytest.approx([0, 1, 2, 3])
    assert data["variant"].values.tolist() == [0, 1, 2, 3]
    assert data.attrs["title"] == "outcomes (interrupted: 4 of 6 variants)"
    assert [p.name for p in tmp_path.iterdir()] == ["v.nc"]


@pytest.mark.parametrize(
    ("call", "met", "amounts", "words"),
    [
        (1, False, (7.5, 7.5), "interrupted; the best so far: .* which meets the limits, but was not confirmed"),
        (2, True, (7.5, 7.5), "interrupted; the smallest so far that meets the limits"),
        (4, True, (7.3, 7.4999), "interrupted; the smallest so far that meets the limits"),
    ],
)
def test_optimise_keeps_the_best_so_far(call, met, amounts, words, toy, tmp_path, monkeypatch):
    """With outcomes that are made up: every outcome is the amount, so 7.3 mm are needed; the grid has steps of 0.5."""
    from xarray import Dataset

    def predict(scene: Any, rows: Any, estimate: Any, **options: Any) -> Dataset:
        values = ("variant", amounts_of(rows)[:, 0], {"units": "m"})
        return Dataset({**dict.fromkeys(MEASURES, values), "failed": ("variant", np.zeros(len(values[1]), bool))})

    def run(recipe: Any, values: Any, thetas: Any, *more: Any, **options: Any) -> Any:
        return SimpleNamespace(outcomes=dict.fromkeys(MEASURES, values[:, 0]), flags=np.zeros((1, len(FLAGS)), int))

    monkeypatch.setattr("fitting.treatments.optimise.predict", predict)
    monkeypatch.setattr("fitting.treatments.refine.run", stopping_at(call, run))
    output, asked = tmp_path / "plan.json", ["--limit", "dislocation_margin>=7.3 mm", "--tto-medial", "0:20"]
    assert f"saved so far: {output}" in interrupted("optimise", toy, *asked, "-o", output)
    plan = json.loads(output.read_text())
    assert plan["interrupted"]
    assert plan["met"] is met
    low, high = amounts
    found = 1e3 * plan["amounts"]["tibial_tuberosity_transfer.medialisation"]["value"]
    assert low - 1e-9 <= found <= high + 1e-9
    assert plan["outcomes"]["dislocation_margin"] == pytest.approx(1e-3 * found)
    assert re.match(words, plan["sentence"])
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]


def test_optimise_saves_nothing_before_the_whole_range_is_simulated(toy, tmp_path, monkeypatch):
    monkeypatch.setattr("fitting.treatments.optimise.predict", stopping_at(1, lambda *_: None))
    asked = ["--limit", "dislocation_margin>=7.3 mm", "--tto-medial", "0:20"]
    assert "nothing was saved" in interrupted("optimise", toy, *asked, "-o", tmp_path / "plan.json")
    assert not list(tmp_path.iterdir())


def test_hard_cases_keeps_the_contacts_that_are_done(tmp_path, monkeypatch):
    from pftwin.studies.hard_cases.table import read_piece
    from pftwin.studies.hard_cases.verdict import Cell

    def run_matrix(cases: Any, chosen: Any, say: Any, count: Any) -> list[Cell]:
        return [Cell("hanging", chosen.contacts[0], "newmark", "float64", "pass", "")]

    monkeypatch.setattr("pftwin.studies.hard_cases.run_matrix", stopping_at(2, run_matrix))
    cells = tmp_path / "cells.json"
    said = interrupted("hard-cases", "--contact", "P2", "--contact", "P5", "--json", cells)
    assert f"saved so far: {cells}" in said
    assert [c.contact for c in read_piece(cells).rows] == ["P2"]


def test_accuracy_keeps_the_rows_so_far(toy, tmp_path, monkeypatch):
    def measure(plan: Any, scene_of: Any, measured: Any, tell: Any, keep: Any, progress: Any) -> None:
        keep([])
        raise KeyboardInterrupt

    monkeypatch.setattr("pftwin.studies.accuracy.measure.measure_all", measure)
    said = interrupted("accuracy", toy, "--out", tmp_path / "acc")
    assert f"saved so far: {tmp_path / 'acc' / 'accuracy.csv'}" in said


# Before the second variant that runs alone.
DURING_VARIANTS = (
    "import pftwin.studies.audit.audit as a\nreal, calls = a.run_alone, []\n"
    f"def run_alone(*given):\n    calls.append(1)\n    if len(calls) == 3: {PAUSE}\n    return real(*given)\n"
    "a.run_alone = run_alone"
)
# After variants that run side by side, in one program.
DURING_TIMES = (
    "import pftwin.studies.audit.audit as a\nreal = a._selected_variants\n"
    "a._selected_variants = lambda *given: [v for v in real(*given) if getattr(v, 'alike', True)]\n"
    f"def in_turn(runs): {PAUSE}\na.time_in_turn = in_turn"
)


@pytest.mark.slow
def test_audit_keeps_the_variants_that_are_done(toy, tmp_path):
    run = Run(DURING_VARIANTS, "audit", toy, "--out", "worth", "--json", "worth.json", "--dt", "0.005", cwd=tmp_path)
    run.until_ready()
    said = run.interrupted()
    files = [Path("worth") / "audit.csv", Path("worth") / "audit.nc", Path("worth.json")]
    assert f"saved so far: {', '.join(str(f) for f in files)}" in said
    assert sorted(p.name for p in (tmp_path / "worth").iterdir()) == ["audit.csv", "audit.nc"]
    found = json.loads((tmp_path / "worth.json").read_text())
    assert found["rows"]
    assert all(row["cost"] is None and row["changes"] for row in found["rows"] if row["verdict"] != "indispensable")
    assert found["missing"]
    assert found["run_time"] is None
    assert found["files"] == [str(f) for f in files[:2]]
    import xarray

    with xarray.open_dataset(tmp_path / "worth" / "audit.nc", engine="h5netcdf") as data:
        assert data.sizes["variant"] == len(found["rows"])
        assert ", ".join(found["missing"]) in data.attrs["interrupted"]


@pytest.mark.slow
def test_audit_without_a_place_shows_what_is_done(toy, tmp_path):
    run = Run(DURING_TIMES, "audit", toy, "--dt", "0.005", cwd=tmp_path)
    run.until_ready()
    assert "nothing was saved" in run.interrupted()
    assert "interrupted; all variants run; times were not measured" in run.shown
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_contact_map_keeps_the_frames_that_are_done(tmp_path, monkeypatch):
    import xarray

    from pftwin.studies.contact_map import mapping

    write_plate_and_ball(tmp_path, [4e-4, 5e-4, 6e-4])
    monkeypatch.setattr(mapping, "_on_whole_mesh", stopping_at(5, mapping._on_whole_mesh))
    monkeypatch.chdir(tmp_path)
    parts = ["--femur", "plate.stl", "--patella", "ball.stl", "--poses", "poses.csv", "--units", "m"]
    assert "saved so far: map.nc" in interrupted("contact-map", *parts, "-o", "map.nc", "--figure", "map.png")
    assert not (tmp_path / "map.png").exists()
    with xarray.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as data:
        assert data.sizes["time"] == 2
        assert (data.area > 0).all()
        assert data.attrs["title"] == "contact at given poses (interrupted: 2 of 3 frames)"


@pytest.mark.slow
def test_simulate_names_the_files_that_are_whole(toy, tmp_path):
    before = f"import pftwin.results.result as r\ndef to_csv(*a): {PAUSE}\nr.Result.to_csv = to_csv"
    run = Run(before, "simulate", toy, "-o", "out.nc", "--csv", cwd=tmp_path)
    run.until_ready()
    assert "saved so far: out.nc" in run.interrupted()
    assert [p.name for p in tmp_path.iterdir()] == ["out.nc"]
    assert load_dataset(tmp_path / "out.nc").attrs["scene"] == "toy"


@pytest.mark.slow
def test_a_file_that_is_cut_off_is_removed(toy, tmp_path, monkeypatch):
    whole = Path.write_bytes

    def write_bytes(self: Path, data: bytes) -> None:
        whole(self, data[:100])
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    assert "nothing was saved" in interrupted("simulate", toy, "-o", tmp_path / "out.nc", "--dt", "0.005")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_simulate_leaves_no_half_of_a_file(toy, tmp_path):
    before = (
        "whole = Path.write_bytes\n"
        "def write_bytes(self, data):\n    whole(self, data)\n"
        f"    if self.suffix == '.nc': whole(self, data[:100]); {PAUSE}\n"
        "Path.write_bytes = write_bytes"
    )
    run = Run(before, "simulate", toy, "-o", "out.nc", cwd=tmp_path)
    run.until_ready()
    assert "nothing was saved" in run.interrupted()
    assert not list(tmp_path.iterdir())


def test_where_nothing_is_saved_it_says_so(toy, tmp_path):
    before = f"import pftwin.dynamics.simulate as s\ndef simulate(*a, **k): {PAUSE}\ns.simulate = simulate"
    run = Run(before, "simulate", toy, "-o", "out.nc", cwd=tmp_path)
    run.until_ready()
    assert "nothing was saved" in run.interrupted()
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_blocks_change_no_outcome(toy, tmp_path, monkeypatch):
    for name, block in (("whole.nc", 4096), ("blocks.nc", 2)):
        monkeypatch.setattr("fitting.cli.treat._BLOCK", block)
        options = [
            "-o",
            str(tmp_path / name),
            "--tto-medial",
            "0:2:1",
            "--tto-distal",
            "0,2",
            "--dt",
            "0.001",
            "--no-figure",
        ]
        done = CliRunner().invoke(app, ["treat", str(toy), *options])
        assert done.exit_code == 0, done.output
    whole, blocks = load_dataset(tmp_path / "whole.nc"), load_dataset(tmp_path / "blocks.nc")
    assert whole.attrs == blocks.attrs
    assert set(whole.variables) == set(blocks.variables)
    for name, variable in whole.variables.items():
        assert variable.dims == blocks[name].dims, name
        assert variable.attrs.keys() == blocks[name].attrs.keys()
        if variable.dtype.kind == "f":
            np.testing.assert_allclose(variable.values, blocks[name].values, rtol=1e-9, atol=1e-12, err_msg=str(name))
        else:
            np.testing.assert_array_equal(variable.values, blocks[name].values, err_msg=str(name))
