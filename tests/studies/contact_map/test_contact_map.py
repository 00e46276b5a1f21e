"""`pftwin contact-map`: a ball on a plate, what is written, what is refused; and the DM recording."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from height_meshes import plate
from plate_and_ball import RADIUS, write_plate_and_ball, write_poses
from typer.testing import CliRunner

from pftwin.cli.program import app
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import save_mesh


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("map")
    write_plate_and_ball(folder, [4e-4, 5e-4, -2e-4])
    save_mesh(plate(12).flipped(), folder / "upside_down.stl")
    save_mesh(icosphere(RADIUS, 40), folder / "ball_mm.stl", units="mm")
    return folder


def run(folder: Path, *more: str, femur="plate.stl", patella="ball.stl", poses="poses.csv"):
    names = {"--femur": femur, "--patella": patella, "--poses": poses}
    arguments = [x for option, name in names.items() for x in (option, str(folder / name))]
    return CliRunner().invoke(app, ["contact-map", *arguments, "--units", "m", *more])


@pytest.mark.slow
def test_a_ball_on_a_plate(files, tmp_path):
    import xarray as xr

    nc, png, facts = (tmp_path / n for n in ("out.nc", "out.png", "facts.json"))
    result = run(files, "-o", str(nc), "--figure", str(png), "--json", str(facts))
    assert result.exit_code == 0, result.output
    assert "2 of 3 frames in contact" in result.output
    stiffness = 46.3e6 * 0.54 / (1.46 * 0.08) / 10e-3
    with xr.open_dataset(nc, engine="h5netcdf") as data:
        expected = stiffness * np.pi * RADIUS * np.array([4e-4, 5e-4, 0]) ** 2
        np.testing.assert_allclose(data.force[:, 2], expected, rtol=0.03, atol=1e-9)  # femur's own z
        np.testing.assert_allclose(data.force[:, :2], 0, atol=0.01 * expected[1])
        np.testing.assert_allclose(data.moment, 0, atol=1e-4 * expected[1])  # through the ball's centre
        np.testing.assert_allclose(data.center_of_pressure[:2, :2], 0, atol=1e-4)
        np.testing.assert_allclose(data.center_on_patella[:2, 2], RADIUS, atol=5e-4)  # turned over
        assert data.status.values.tolist() == [0, 0, 1]
        assert float(data.depth[2].max()) == pytest.approx(-2e-4, abs=5e-5)
        areas = icosphere(RADIUS, 40).face_areas
        assert data.sizes["triangle"] == len(areas)
        assert float((data.pressure[1] > 0).sum()) > 50
        assert data.force.attrs["units"] == "N"
    said = json.loads(facts.read_text())
    assert said["frames_in_contact"] == 2
    assert said["status_frames"]["no_contact"] == 1
    assert sum(said["status_frames"].values()) == 1
    assert said["status"] == "the button touches nothing"
    assert png.stat().st_size > 20_000


@pytest.mark.slow
def test_a_stiffer_layer_and_the_logarithmic_law_bear_more(files):
    def force(*more: str) -> float:
        result = run(files, "--from", "0.1", "--to", "0.1", "--json", "-", *more)
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)["largest_force_N"]

    soft, rigid = force(), force("--modulus-mpa", "46.3,1e9")
    assert rigid == pytest.approx(2 * soft, rel=1e-6)
    assert soft < force("--law", "logarithmic") < 1.1 * soft


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        ({"patella": "ball_mm.stl"}, (), "the two are in different units"),
        ({"femur": "upside_down.stl"}, (), "of the button are inside the femur"),
        ({"poses": "apart.csv"}, (), "never touch in 2 frames: at their nearest they are 0.5"),
        ({"poses": "far.csv"}, (), "never nearer than"),
        ({"poses": "deep.csv"}, (), "deeper than 5 mm"),
        ({"poses": "missing.csv"}, (), "no such file"),
        ({"poses": "plate.stl"}, (), "plate.stl"),
        ({}, ("--bodies", "femur,patela"), "patella"),
        ({}, ("--bodies", "femur"), "two names"),
        ({}, ("--law", "cubic"), "linear or logarithmic"),
        ({}, ("--poisson", "0.5"), "Poisson ratio 0.5"),
        ({}, ("--modulus-mpa", "1,2,3"), "a number, or two"),
        ({"femur": "missing.stl"}, ("--thickness", "2,5 mm"), "a decimal point, 2.5 mm"),
        ({"femur": "missing.stl"}, ("--thickness", "3 N"), "a number, or two"),
        ({}, ("--proximity", "-1"), "at least 0 and at most 10"),
        ({}, ("--figure", "map.docx"), "unknown kind of figure"),
        ({}, ("--from", "7"), "no frame between"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(files, changes, options, words):
    write_poses(files / "apart.csv", [-5e-4, -6e-4])
    write_poses(files / "far.csv", [-0.5, -0.6])
    write_poses(files / "deep.csv", [8e-3, 9e-3])
    result = run(files, *options, **changes)
    assert result.exit_code == 2, result.output
    assert words in result.output.replace("\n", " ")
    assert "Traceback" not in result.output


@pytest.mark.filterwarnings("default::pftwin.base.errors.PftwinWarning")
def test_single_frames_that_are_too_deep_are_flagged(files, tmp_path):
    import xarray as xr

    write_poses(files / "some.csv", [4e-4, 6e-3])
    result = run(files, "-o", str(tmp_path / "some.nc"), poses="some.csv")
    assert result.exit_code == 3, result.output  # done and written, and flagged
    assert "1 of 2 frames are deeper than 5 mm" in result.output
    with xr.open_dataset(tmp_path / "some.nc", engine="h5netcdf") as data:
        assert data.status.values.tolist() == [0, 2]
