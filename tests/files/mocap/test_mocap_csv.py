"""CSV tables and markers: units by header or argument, never guessed."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.files.mocap import MarkerTrajectories, Table, read_csv, read_marker_csv, read_markers, write_csv


def file(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    return path


def test_units_of_the_header_are_converted_to_si(tmp_path):
    t = read_csv(
        file(
            tmp_path, "# rig, case 1\ntime [ms],force (kN),tilt_deg,patella_px_mm,patella_qw\n0,1,180,5,1\n10,2,90,,1\n"
        )
    )
    np.testing.assert_allclose(t.times, [0, 0.01])
    np.testing.assert_allclose(t.column("force"), [1000, 2000])
    np.testing.assert_allclose(t.column("tilt"), [np.pi, np.pi / 2])
    np.testing.assert_allclose(t.column("patella_px"), [0.005, np.nan])
    assert t.units == {"force": "N", "tilt": "rad", "patella_px": "m", "patella_qw": "1"}


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_delimiters(tmp_path, delimiter):
    t = read_csv(file(tmp_path, "time_s,F_N\n0,1\n1,2\n".replace(",", delimiter)))
    np.testing.assert_allclose(t.column("F"), [1, 2])


def test_units_by_argument(tmp_path):
    path = file(tmp_path, "time_s,force,angle\n0,1,2\n1,2,3\n")
    with pytest.raises(InputError, match="column 'force': no unit in the header"):
        read_csv(path)
    t = read_csv(path, units={"force": "kN", "angle": "1"})
    assert t.column("force")[0] == 1000
    with pytest.raises(InputError, match=r"no column called 'forse'.*did you mean 'force'"):
        read_csv(path, units={"forse": "kN", "angle": "1"})
    contradicting = file(tmp_path, "time_s,force_N\n0,1\n")
    with pytest.raises(InputError, match="header says 'N', the argument units says 'kN'"):
        read_csv(contradicting, units={"force": "kN"})


def test_a_number_at_a_name_s_end_is_no_unit(tmp_path):
    path = file(tmp_path, "time_s,strand_1,strand_2\n0,1,2\n")
    with pytest.raises(InputError, match="column 'strand_1': no unit"):
        read_csv(path)
    assert read_csv(path, units="N").names == ("strand_1", "strand_2")


def test_the_time_needs_a_unit_and_a_name(tmp_path):
    with pytest.raises(InputError, match="column 'time': no unit"):
        read_csv(file(tmp_path, "time,F_N\n0,1\n"), units="N")
    assert read_csv(file(tmp_path, "time,F_N\n0,1\n5,1\n"), units={"time": "ms"}).times[1] == pytest.approx(0.005)
    assert read_csv(file(tmp_path, "clock_s,F_N\n0,1\n5,1\n"), time_column="clock").times[1] == 5
    with pytest.raises(InputError, match="no column of times"):
        read_csv(file(tmp_path, "F_N\n0\n"))
    with pytest.raises(InputError, match=r"no column called 'clok'.*did you mean 'clock_s'"):
        read_csv(file(tmp_path, "clock_s,F_N\n0,1\n"), time_column="clok")
    with pytest.raises(InputError, match="unit of the times is m"):
        read_csv(file(tmp_path, "time_mm,F_N\n0,1\n"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("\x00\x01\x02", "binary"),
        ("# only a comment\n", "no header line"),
        ("time_s,F_N\n", "no rows"),
        ("time_s,F_N\n0,x\n", r"a\.csv, line 2: column 'F_N' holds 'x', not a number"),
        ("time_s;F_N\n0;1,5\n", "decimal points instead of decimal commas"),
        ("time_s,F_N\n0,1\n1\n2,2\n", "line 3: 1 cells; expected: 2 cells"),
        ("time_s,F_N\n0,1\n1", "truncated"),
        ("time_s,,F_N\n0,1,2\n", "column 2 has no name"),
        ("time_s,F_N,F_kN\n0,1,2\n", "columns that occur twice: F"),
        ("time_s,F_N,time_s\n0,1,2\n", r"line 1: columns that occur twice: time_s"),
        ("time_s,F_N,time_ms\n0,1,2\n", "several columns of times: 'time_s', 'time_ms'"),
        ("time_s,F_N\n0," + 200_000 * "1" + "\n", r"a\.csv, line 2: a cell of more than 131,072 characters"),
        ("time_s,F_N\n0,1\n1," + 200_000 * " " + "\n", r"a\.csv, line 3: a cell of more than 131,072 characters"),
        ("time_s,F_N\n0,1\n0,1\n", "row 2 repeats the time"),
        ("time_s,F_N\n1,1\n0,1\n", "row 2 goes back"),
        ("time_s,F_N\n,1\n", "row 1 has no finite time"),
        ("time_s,F [lbf]\n0,1\n", "no unit called 'lbf'"),
    ],
)
def test_bad_tables(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_csv(file(tmp_path, text))


def test_markers_with_and_without_units(tmp_path):
    rows = "0,100,0,0,0,300,1\n0.01,,,,0,300,1\n0.02,0,0,0,0,300,1\n"
    with_unit = file(tmp_path, "time_s,A_x_mm,A_y_mm,A_z_mm,B_x_mm,B_y_mm,B_z_mm\n" + rows)
    m = read_markers(with_unit)
    assert m.names == ("A", "B")
    np.testing.assert_allclose(m.marker("A")[0], [0.1, 0, 0])
    np.testing.assert_array_equal(m.missing[:, 0], [False, True, True])
    without = file(tmp_path, "time,A_x,A_y,A_z,B_x,B_y,B_z\n" + rows)
    with pytest.raises(InputError, match="time_unit='s'"):
        read_marker_csv(without, units="mm")
    with pytest.raises(InputError, match="no unit of length"):
        read_marker_csv(without, time_unit="s")
    np.testing.assert_array_equal(read_marker_csv(without, units="mm", time_unit="s").positions, m.positions)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time_s,A_x_m,A_y_m,A_q_m", "column 'A_q_m' is no coordinate"),
        ("time_s,A_x_m,A_y_m,B_z_m", "without all three coordinates: A, B"),
        ("time_s,A_x_m,A_y_m,A_z_m,A_x_m", "line 1: columns that occur twice: A_x_m"),
        ("time_s,A_x_m,A_y_m,A_z_m,A_x_mm", "column 'A_x_mm' is marker 'A''s second x; expected: each once"),
        ("time_s,A_x_m,A_y_m,A_z_m,Ax_m", "column 'Ax_m' is marker 'A''s second x; expected: each once"),
        ("time_s,A_x_m,A_y_m,A_z_m,A_X_m", "column 'A_X_m' is marker 'A''s second x"),
    ],
)
def test_bad_markers(tmp_path, header, message):
    with pytest.raises(InputError, match=message):
        read_marker_csv(file(tmp_path, header + "\n0" + ",1" * header.count(",") + "\n"))


def test_round_trips(tmp_path):
    rng = np.random.default_rng(1)
    times = 0.25 + np.arange(20) / 100
    table = Table(
        times, ("force", "a,b", "angle"), rng.normal(size=(20, 3)), {"force": "N", "a,b": "1", "angle": "rad"}
    )
    table.values[3, 1] = np.nan
    write_csv(tmp_path / "t.csv", table)
    again = read_csv(tmp_path / "t.csv")
    assert again.units == table.units
    np.testing.assert_allclose(again.values, table.values, rtol=1e-11)
    np.testing.assert_allclose(again.times, times, atol=1e-9)

    positions = rng.normal(size=(1, 2, 3)) + 0.01 * rng.normal(size=(20, 2, 3))
    positions[4, 1] = np.nan
    markers = MarkerTrajectories(times, ("R_Knee", "L"), positions)
    write_csv(tmp_path / "m.csv", markers)
    np.testing.assert_allclose(read_markers(tmp_path / "m.csv").positions, positions, rtol=1e-11)


def test_markers_that_jump_or_are_too_near_are_refused(tmp_path):
    names = ",".join(f"{name}_{axis}_mm" for name in "AB" for axis in "xyz")
    lone = file(tmp_path, f"time_s,{names}\n0,1,2,3,400,5,6\n0.01,1,2,-9999,400,5,6\n")
    with pytest.raises(InputError, match=r"marker 'A' jumps by 10 m to .* on row 2"):
        read_marker_csv(lone)
    near = file(tmp_path, f"time_s,{names}\n0,1,2,3,12,5,6\n0.01,1,2,3,12,5,6\n")
    with pytest.raises(InputError, match=r"markers are 11\.8 mm from the nearest other one"):
        read_marker_csv(near)
