"""A muscle's tension at flexions of the knee as unknowns: found again, treated, and in another recording."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from made_estimates import made_estimate
from small_scene import small_scene
from toy_scene_files import LIGHT, START, fixed_poses, tibia_poses, write_poses, write_toy
from typer.testing import CliRunner

import fitting
import pftwin
from fitting.parameters import free_parameters
from fitting.treatments import Treatment
from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.cli import app
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

KNOTS = tuple(f"quadriceps.tension[{k}]" for k in range(3))
LEFT = {"X": 0.4e-3, "Y": 0.9e-3, "Z": 1.7e-3, "tilt": 0.02, "flexion": 0.03, "rotation": 0.05}
NOMINAL, TRUTH = (12.0, 12.0, 12.0), (9.0, 14.0, 11.0)
MUSCLE = """
[[prescribed_tension]]
name = "quadriceps"
body = "femur"
tension_N = [3, 3, 3]
at_flexion_deg = [46, 50, 54]
insertion_mm = [[20, 0, -8]]
origin_m = [[0.22, 0.012, 0.035]]
"""


@cache
def scene() -> Scene:
    """The small knee, which bends from 45 to 55 deg and back, with two lines whose knots lie in between."""
    muscle = PrescribedTension(
        number(NOMINAL),
        vector([[(0.22, 0.0, 0.035), (0.21, 0.012, 0.04)]]),
        vector([(0.02, 0.0, -0.008), (0.02, 0.002, -0.007)]),
        start_time=0.0,
        interval=1.0,
        body="femur",
        knots=tuple(map(math.radians, (46.0, 50.0, 54.0))),
        share=number((0.6, 0.4)),
        name="quadriceps",
    )
    return small_scene(41).with_effect(muscle)


def test_all_knots_or_some_are_free_and_none_below_zero():
    found = free_parameters(scene(), ("quadriceps.tension",), {"quadriceps.tension": (0.0, 40.0)})
    assert found.names == KNOTS
    assert [p.unit for p in found.items] == ["N"] * 3
    assert free_parameters(scene(), KNOTS[1:]).names == KNOTS[1:]
    with pytest.raises(InputError, match=r"quadriceps\.tension\[3\].*which has 3 there"):
        free_parameters(scene(), ("quadriceps.tension[3]",))


@pytest.mark.slow
def test_distinct_tensions_at_knots_are_found():
    true = scene()
    for name, value in zip(KNOTS, TRUTH, strict=True):
        true = true.set(name, value)
    result = pftwin.simulate(true, dt=1e-2 / 48, integrator=pftwin.LinearImplicit())
    measured = Measured(result.times, result.center, contact_force=np.asarray(result.effects["contact"]["force"]))
    found = fitting.fit_tendons(
        scene(),
        measured,
        free=KNOTS,
        bounds=dict.fromkeys(KNOTS, (1.0, 30.0)),
        use=("position", "contact"),
        noise={"position": 1e-5, "contact": 1e-2},
        starts=2,
    )
    assert found.undetermined.count == 0
    np.testing.assert_allclose(found.values, TRUTH, rtol=2e-3)
    moved = Treatment.of("tibial_tuberosity_transfer", medialisation=0.005)(found.apply(scene()))
    np.testing.assert_allclose(moved.get("quadriceps.tension"), found.values)


@pytest.mark.slow
def test_an_estimate_of_knots_holds_in_another_recording(tmp_path: Path):
    """Which bends as far, but for twice as long; a knot's value or range may be given there."""
    text = LIGHT.replace('name = "quadriceps"', 'name = "slip"', 1) + MUSCLE
    file = write_toy(tmp_path, text + '\n[measured]\npatella = { body = "patella" }\n')
    for path, rate, count in ((file.with_name("poses.csv"), 120, 31), (tmp_path / "other.csv", 60, 31)):
        tibia = tibia_poses(count, rate=rate)
        write_poses(path, {"tibia": tibia, "patella": fixed_poses(tibia, *START)})
    fit = made_estimate(dict(zip(KNOTS, ((4.0, 0.1), (3.0, 0.1), (2.0, 0.1)), strict=True)), rmse=LEFT)
    file.with_name("fit.json").write_text(json.dumps(fit.to_dict()))
    command = ["predict", file, "--estimate", file.with_name("fit.json"), "--motion", tmp_path / "other.csv"]
    for given in ("5", "4:8"):
        options = ["--set", f"{KNOTS[1]}={given}", "--samples", 4, "-o", tmp_path / f"{given[0]}.nc", "--no-figure"]
        result = CliRunner().invoke(app, [str(a) for a in (*command, *options)], env={"NO_COLOR": "1"})
        assert result.exit_code == 0, result.output
    from xarray import open_dataset

    with open_dataset(tmp_path / "5.nc") as one, open_dataset(tmp_path / "4.nc") as ranged:
        assert one.sizes["time"] == ranged.sizes["time"] == 31
        assert float((ranged.high - ranged.low).mean()) > 1.02 * float((one.high - one.low).mean())
