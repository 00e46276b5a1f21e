"""Markers on the skin over the patella: how alike courses are, and nothing of their place."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from small_scene import small_scene, vec
from typer.testing import CliRunner

import pftwin
from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.model.effects.marker import Marker
from pftwin.model.measured import Measured
from pftwin.results.metrics import mean_of, validate
from pftwin.results.skin_markers import QUALITATIVE

FRAMES = 41
OFFSET = 0.012  # of the skin from the bone [m]


@pytest.fixture(scope="module")
def result() -> pftwin.Result:
    return pftwin.simulate(small_scene(FRAMES).with_effect(Marker(vec(0.021, 0.013, 0.009), name="m1")))


def measured_of(result: pftwin.Result, **changes) -> Measured:
    """The simulated course with an offset, half as large, and off by noise; eight frames are missing."""
    noise = np.random.default_rng(3).normal(scale=5e-4, size=(3, FRAMES))
    seen = {f"m1.{k}": OFFSET + 0.5 * result.effects["m1"][k] + e for k, e in zip("xyz", noise, strict=True)}
    seen["m1.x"][4:12] = np.nan
    nothing = np.full((FRAMES, 3), np.nan)
    return Measured(result.times, nothing, readings=seen, skin_markers=("m1",), **changes)


def test_figures_are_numpys(result: pftwin.Result) -> None:
    measured = measured_of(result)
    found = {row.key: row for row in validate(result, measured).skin_markers}
    assert list(found) == ["m1.x", "m1.y", "m1.z"]
    for axis, missing in (("x", 8), ("y", 0), ("z", 0)):
        row, theirs = found[f"m1.{axis}"], measured.readings[f"m1.{axis}"]
        there = np.isfinite(theirs)
        ours, theirs = 1e3 * result.effects["m1"][axis][there], 1e3 * theirs[there]
        assert row.frames == FRAMES - missing
        assert row.correlation == pytest.approx(np.corrcoef(ours, theirs)[0, 1])
        assert row.measured_range == pytest.approx(theirs.max() - theirs.min())
        assert row.simulated_range == pytest.approx(ours.max() - ours.min())
        apart = (ours - ours.mean()) - (theirs - theirs.mean())
        assert row.rms_about_mean == pytest.approx(np.sqrt((apart**2).mean()))
        assert row.unit == "mm"
    assert found["m1.x"].words == "x in the femur frame, proximal"


def test_nothing_is_said_of_the_place(result: pftwin.Result) -> None:
    found = validate(result, measured_of(result))
    assert (found.x, found.y, found.z, found.mean_distance, found.frames_compared) == (None, None, None, None, 0)
    assert not found.readings
    assert all(row.value is None for row in found.to_rows()[:10])
    data = found.to_dict()
    assert data["skin_markers"]["m1.z"]["note"] == QUALITATIVE
    assert json.loads(json.dumps(data))["skin_markers"]["m1.y"]["frames"] == FRAMES
    assert mean_of([found, found]).mean_distance is None


def test_a_marker_in_the_bone_keeps_its_place(result: pftwin.Result) -> None:
    found = validate(result, replace(measured_of(result), skin_markers=(), center=result.center))
    assert not found.skin_markers
    assert [row.key for row in found.readings] == ["m1.x", "m1.y", "m1.z"]
    assert found.mean_distance == 0


def test_what_does_not_change_has_no_correlation(result: pftwin.Result) -> None:
    measured = measured_of(result)
    still = replace(measured, readings={"m1.x": np.full(FRAMES, 0.03)})
    (row,) = validate(result, still).skin_markers
    assert (row.correlation, row.measured_range) == (None, 0)
    few = np.full(FRAMES, np.nan)
    few[:2] = 0.03
    with pytest.raises(InputError, match=r"m1\.x was measured in 2 frames; expected: 3 or more"):
        validate(result, replace(measured, readings={"m1.x": few}))


def test_the_figure_says_which_error_it_shows(result: pftwin.Result) -> None:
    measured = measured_of(result)
    figure = result.plot.compared(measured)
    labels = [str(text.get_text()) for ax in figure.axes for text in ax.get_legend().get_texts()]
    shown = [row.rms_about_mean for row in validate(result, measured).skin_markers]
    assert labels == [f"RMSE {v:.3g} mm less mean offset" for v in shown]


def test_the_command_shows_them_with_what_they_can_mean(toy, tmp_path) -> None:
    from toy_scene_files import CLUSTERS, LIGHT, changed

    text = changed('poses = "poses.csv"', 'markers = "walk.trc"', LIGHT)
    cluster = ", ".join(f"{name} = {list(place)}" for name, place in CLUSTERS["tibia"].items())
    text = changed('body = "tibia"\n\n[patella]', f"cluster_m = {{ {cluster} }}\n\n[patella]", text)
    text += '\n[measured]\nmarkers = { "p1" = "P1" }\n\n[[marker]]\nname = "p1"\npoint_m = [0.02, 0.015, 0.03]\n'
    (toy / "skin.toml").write_text(text)
    path = tmp_path / "skin.json"
    done = CliRunner().invoke(app, ["validate", str(toy / "skin.toml"), "--dt", "0.002", "--json", str(path)])
    assert done.exit_code == 0, done.output
    assert "markers on the skin" in done.output
    assert "skin slides over the bone" in " ".join(done.output.split())
    found = json.loads(path.read_text())
    assert found["mean_distance"] is None
    assert found["skin_markers"]["p1.x"]["measured_range"] == pytest.approx(0, abs=1e-5)  # walk.trc: it stands still
    assert found["skin_markers"]["p1.x"]["simulated_range"] > 0.1
