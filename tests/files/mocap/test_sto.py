"""STO and MOT files: degrees, counts that lie, damaged content."""

from __future__ import annotations

import numpy as np
import pytest
from at_once import at_once

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.files.mocap import read_sto

TEXT = (
    "Coordinates\nversion=1\nnRows={rows}\nnColumns=4\ninDegrees={flag}\nendheader\n"
    "time\tknee_angle_r\tpelvis_tx\t/jointset/knee_r/knee_angle_r/speed\n"
    "0.0\t90\t0.5\t180\n0.01\t45\t0.6\t90\n"
)


def sto(tmp_path, text=None, *, rows=2, flag="yes"):
    path = tmp_path / "a.sto"
    path.write_text(TEXT.format(rows=rows, flag=flag) if text is None else text)
    return path


def test_named_columns_come_in_radians(tmp_path):
    t = read_sto(sto(tmp_path), rotational=["knee_angle_r", "*/speed"])
    assert t.in_degrees is True
    np.testing.assert_allclose(t.column("knee_angle_r"), [np.pi / 2, np.pi / 4])
    np.testing.assert_allclose(t.column("/jointset/knee_r/knee_angle_r/speed"), [np.pi, np.pi / 2])
    np.testing.assert_allclose(t.column("pelvis_tx"), [0.5, 0.6])
    assert t.units["knee_angle_r"] == "rad"
    assert t.units["/jointset/knee_r/knee_angle_r/speed"] == "rad/s"
    assert t.units["pelvis_tx"] == ""


def test_unnamed_angles_are_found_by_name_and_reported(tmp_path):
    with pytest.warns(PftwinWarning, match="converted to radians: .*knee_angle_r; name them with rotational"):
        t = read_sto(sto(tmp_path))
    assert t.column("knee_angle_r")[0] == pytest.approx(np.pi / 2)
    assert t.column("pelvis_tx")[0] == 0.5


def test_forces_are_no_angles_whatever_the_flag_says(tmp_path):
    text = "F\ninDegrees=yes\nendheader\ntime ground_force_vx ground_force_px ground_torque_x R_1_vy\n0 10 20 30 40\n"
    with pytest.warns(PftwinWarning, match="converted to radians: none"):
        t = read_sto(sto(tmp_path, text))
    np.testing.assert_array_equal(t.values[0], [10, 20, 30, 40])


def test_translations_and_forces_with_a_side_are_no_angles(tmp_path):
    """The coordinates of OpenSim JAM's knee, by short names and by their places in the model."""
    metres = ["knee_tx_r", "pf_ty_l", "/jointset/pf_r/pf_tz_r/value", "/jointset/pf_r/pf_tz_r/speed", "tx_right"]
    names = [*metres, "ground_force_vx_l", "ground_force_px_r", "pf_flex_r", "hip_flexion_r"]
    rows = ["inDegrees=yes", "endheader", "\t".join(["time", *names]), "\t".join(["0", *["90"] * len(names)])]
    with pytest.warns(PftwinWarning, match="converted to radians: hip_flexion_r, pf_flex_r; name them"):
        t = read_sto(sto(tmp_path, "\n".join(["Coordinates", *rows, ""])))
    np.testing.assert_array_equal(t.values[0, :7], 90)
    np.testing.assert_allclose(t.values[0, 7:], np.pi / 2)
    assert {t.units[n] for n in names[:7]} == {""}


@pytest.mark.parametrize(
    ("name", "angle"),
    [
        (200_000 * "_t", True),
        (40_000 * "force" + "/x", True),
        (40_000 * "force", False),
        (40_000 * "length" + "s", True),
        ("tibialis_fiber_length_r", False),
        ("LENGTH", False),
        ("/forceset/quad/activation", False),
        ("knee_force_total/value", False),
        ("force/knee_angle", True),
    ],
)
def test_names_of_any_length_are_judged_at_once(tmp_path, name, angle):
    path = sto(tmp_path, f"Coordinates\ninDegrees=yes\nendheader\ntime\t{name}\n0\t180\n")
    with at_once(), pytest.warns(PftwinWarning, match="converted to radians"):
        value = read_sto(path).values[0, 0]
    assert value == pytest.approx(np.pi if angle else 180)


def test_without_degrees_nothing_changes(tmp_path):
    t = read_sto(sto(tmp_path, flag="no"))
    assert t.in_degrees is False
    assert t.column("knee_angle_r")[0] == 90


def test_the_rows_are_counted(tmp_path):
    with pytest.warns(PftwinWarning, match="nrows=7, the file has 2"):
        t = read_sto(sto(tmp_path, rows=7), rotational=[])
    assert t.times.size == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("a\nb\n", "no line 'endheader'"),
        ("a\nendheader\n", "nothing after endheader"),
        ("a\nendheader\nx\ty\n0\t1\n", "first column is not time"),
        ("a\nendheader\ntime\ty\n", "no rows of data"),
        ("a\nendheader\ntime\ty\n0\tz\n", r"a\.sto, line 4: column 'y' holds 'z'"),
        ("a\nendheader\ntime\ty\n0\t1\n0\t1\n", "row 2 repeats the time"),
        ("a\nendheader\ntime\ty\n1\t1\n0\t1\n", "row 2 goes back in time"),
        ("a\nendheader\ntime\ty\n0\t1\n1", "breaks off after 1 of 2 columns: it is truncated"),
        ("a\nendheader\ntime\ty\n0\n1\t1\n", "line 4: 1 cells; expected: 2 cells"),
        ("a\ninDegrees=maybe\nendheader\ntime\ty\n0\t1\n", "inDegrees=maybe"),
    ],
)
def test_bad_files(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_sto(sto(tmp_path, text))


def test_unknown_pattern_offers_the_nearest_column(tmp_path):
    with pytest.raises(InputError, match=r"no column called 'knee_angle_l'.*did you mean 'knee_angle_r'"):
        read_sto(sto(tmp_path), rotational=["knee_angle_l"])
