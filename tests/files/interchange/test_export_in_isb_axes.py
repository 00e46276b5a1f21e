"""Tables in the axes of the ISB: x anterior, y proximal, z to the right (Wu et al. 2002), of right and left knees."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from other_readers import read_table
from small_scene import small_result
from typer.testing import CliRunner

from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.files.interchange import export
from pftwin.files.mocap.csv_files import read_csv
from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.result_files import save_csv, save_dataset
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.side import AxesSection, Side

LINE = "# Axes: ISB (Wu et al. 2002), {} knee: x anterior, y proximal, z to the right"


def side_of(result, left: bool):
    return dataclasses.replace(result, scene=dataclasses.replace(result.scene, left=left))


def numbers_of(path: Path) -> dict[str, float]:
    """The first row of a table by columns without their units."""
    labels, row = [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")][:2]
    return {label.partition(" [")[0]: float(cell) for label, cell in zip(labels, row, strict=True)}


@pytest.mark.parametrize(
    ("side", "point", "force", "turn"),
    [
        ("right", (3, 1, 2), (30, 10, 20), (0.5, 0.1, 0.3)),
        # In a left knee lateral is leftwards; the mirror image keeps turns about the medial-lateral axis alone.
        ("left", (3, 1, -2), (30, 10, -20), (-0.5, -0.1, 0.3)),
    ],
)
def test_each_number_goes_where_it_belongs(side, point, force, turn, tmp_path):
    """A point 1 m proximal, 2 lateral and 3 anterior, 10, 20 and 30 N likewise, turns about the three axes."""
    from xarray import Dataset

    data = Dataset(
        {
            "patella_position": (("time", "axis"), [[1.0, 2.0, 3.0]], {"units": "m"}),
            "patella_quaternion": (("time", "component"), [[np.sqrt(0.65), 0.1, 0.3, 0.5]], {"units": "1"}),
            "ball_point": (("time", "balls", "axis"), [[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]], {"units": "m"}),
            **{
                f"contact_force_{k}": (("time",), [v], {"units": "N"})
                for k, v in {"x": 10.0, "y": 20.0, "z": 30.0}.items()
            },
            "contact_force": (("time",), [37.4], {"units": "N"}),
            "patella_tilt": (("time",), [7.0], {"units": "deg"}),
            "slack_x": (("time",), [8.0], {"units": "m"}),  # no vector: it has no y and z
        },
        {"time": [0.0], "axis": list("xyz"), "component": list("wxyz")},
        {"side": side},
    )
    save_csv(data, tmp_path / "a.csv", "isb")
    found = numbers_of(tmp_path / "a.csv")
    assert [found[f"patella_position_{k}"] for k in "xyz"] == list(point)
    assert [found[f"ball_point_2_{k}"] for k in "xyz"] == [6, 4, 5 if side == "right" else -5]
    assert [found[f"contact_force_{k}"] for k in "xyz"] == list(force)
    assert [found[f"patella_q{k}"] for k in "xyz"] == pytest.approx(turn, abs=1e-12)
    assert found["patella_qw"] == pytest.approx(np.sqrt(0.65))
    assert (found["contact_force"], found["patella_tilt"], found["slack_x"]) == (37.4, 7, 8)
    assert (tmp_path / "a.csv").read_text().splitlines()[0] == LINE.format(side)
    save_csv(data, tmp_path / "b.csv")
    assert [numbers_of(tmp_path / "b.csv")[f"patella_position_{k}"] for k in "xyz"] == [1, 2, 3]
    assert "#" not in (tmp_path / "b.csv").read_text()


@pytest.mark.parametrize("left", [False, True])
def test_scene_files_axes_give_the_result_back(left, tmp_path):
    """Poses and points of the femur, by the reader of `[axes]` = "isb"."""
    result = side_of(small_result(), left)
    result.to_csv(tmp_path / "a.csv", "isb")
    result.to_sto(tmp_path / "a.sto", "isb")
    lines = [line for line in (tmp_path / "a.csv").read_text().splitlines() if not line.startswith("#")]
    kept = [i for i, label in enumerate(lines[0].split(",")) if "[J]" not in label]  # no unit of recordings
    (tmp_path / "b.csv").write_text("\n".join(",".join(line.split(",")[i] for i in kept) for line in lines) + "\n")
    table = read_csv(tmp_path / "b.csv", units="1")
    named = dict.fromkeys(("femur", "tibia", "patella"), "isb")
    side = Side.read(left, AxesSection.model_validate(named), Document(Path("scene.toml"), {}))
    for body, pose in (("patella", (result.position, result.quaternion)), ("tibia", result.tibia)):
        places = table.select([f"{body}_position_{k}" for k in "xyz"]).values
        turns = table.select([f"{body}_q{k}" for k in "wxyz"]).values
        back = side.poses("femur", body, PoseSeries(table.times, places, turns))
        np.testing.assert_allclose(back.positions, pose[0], atol=1e-11)
        np.testing.assert_allclose(np.abs(np.sum(back.quaternions * pose[1], axis=1)), 1, atol=1e-10)
    force = side.points("femur", table.select([f"contact_force_{k}" for k in "xyz"]).values)
    np.testing.assert_allclose(force, result.contact_force, rtol=1e-9, atol=1e-9)
    _, labels, rows = read_table(tmp_path / "a.sto")
    i = labels.index("sphere_center_x")
    np.testing.assert_allclose(side.points("femur", rows[:, i : i + 3]), result.center, atol=1e-11)
    assert LINE.format("left" if left else "right")[2:] in (tmp_path / "a.sto").read_text().partition("endheader")[0]


def pftwin(*arguments: object):
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})


def test_the_command(tmp_path):
    side_of(small_result(), True).save(tmp_path / "knee.nc")
    done = pftwin("export", tmp_path / "knee.nc", "--axes", "isb", "-o", tmp_path / "a.csv", "-o", tmp_path / "a.sto")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "a.csv").read_text().startswith(LINE.format("left"))


def test_the_command_refuses(tmp_path):
    small_result().save(tmp_path / "knee.nc")
    old = small_result().to_dataset()
    del old.attrs["side"]
    save_dataset(old, tmp_path / "old.nc")
    for name, axes, output, words in (
        ("knee.nc", "isb", "a.glb", "expected: .sto or .csv, which are tables"),
        ("knee.nc", "isb", "a.mot", ".mot files have OpenSim's axes in any case"),
        ("knee.nc", "ISB", "a.csv", "axes: found 'ISB'; expected: pftwin or isb"),
        ("old.nc", "isb", "a.csv", "does not tell a left knee from a right one"),
    ):
        done = pftwin("export", tmp_path / name, "--axes", axes, "-o", tmp_path / output)
        assert done.exit_code == 2, done.output
        assert words in done.stderr
    with pytest.raises(InputError, match=r"found 'isb' for .*a\.glb"):
        export(small_result(), tmp_path / "a.glb", "isb")
    done = pftwin("simulate", "--case", "1", "-o", tmp_path / "b.nc", "--axes", "isb")
    assert done.exit_code == 2
    assert "--axes: found 'isb', and no table; expected: --csv or --sto" in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["knee.nc", "old.nc"]
