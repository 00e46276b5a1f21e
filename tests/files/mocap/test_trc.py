"""Reading and writing TRC files: what laboratories write, and what has to be refused."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import pftwin
from pftwin.base.errors import InputError, OutputError, PftwinWarning
from pftwin.files.mocap import MarkerTrajectories, read_markers, read_trc, write_trc

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100\t100\t{frames}\t2\t{units}\t100\t1\t{frames}\n"
    "Frame#\tTime\tknee\t\t\tankle\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
ROWS = ["1\t0.00\t1\t2\t3\t400\t5\t6", "2\t0.01\t2\t3\t4\t401\t6\t7", "3\t0.02\t3\t4\t5\t402\t7\t8"]


def trc(tmp_path: Path, text: str | None = None, *, rows=ROWS, units="mm", frames=3, end="\n") -> Path:
    path = tmp_path / "a.trc"
    if text is None:
        text = HEAD.format(frames=frames, units=units) + "\n" + "\n".join(rows) + end
    path.write_bytes(text.encode())
    return path


def test_plain_file_comes_in_metres(tmp_path):
    m = read_trc(trc(tmp_path))
    assert m.names == ("knee", "ankle")
    assert m.rate == pytest.approx(100)
    np.testing.assert_allclose(m.positions[1], [[0.002, 0.003, 0.004], [0.401, 0.006, 0.007]])


@pytest.mark.parametrize(("units", "factor"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("meters", 1.0), ("MM", 1e-3)])
def test_units_of_the_header(tmp_path, units, factor):
    rows = [f"{i + 1}\t{i / 100}\t{0.1 / factor}\t0\t1\t{0.3 / factor}\t0\t1" for i in range(3)]
    assert read_trc(trc(tmp_path, rows=rows, units=units)).marker("knee")[0, 0] == pytest.approx(0.1)


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.replace("\n\n", "\n"),  # no blank line after the header
        lambda t: t.replace("\n", "\r\n"),
        lambda t: t.replace("\n", "\r"),
        lambda t: t.replace("\t6\n", "\t6\t\t\n"),  # trailing tabs
        lambda t: t.replace("knee\t\t\tankle\t\t", "knee\t\t\tankle\t\t\t\t"),
        lambda t: t.replace("X1\tY1\tZ1\tX2\tY2\tZ2", "X5\tY5\tZ5\tX6\tY6\tZ6"),  # opensim-core issue 2345
        lambda t: t.replace("\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n", ""),  # neither labels of coordinates nor a blank line
        lambda t: t + "\n\n",
        lambda t: "\ufeff" + t,
        lambda t: t.rstrip("\n"),
    ],
)
def test_tolerated_variants(tmp_path, change):
    plain = read_trc(trc(tmp_path))
    text = HEAD.format(frames=3, units="mm") + "\n" + "\n".join(ROWS) + "\n"
    variant = read_trc(trc(tmp_path, change(text)))
    np.testing.assert_array_equal(variant.positions, plain.positions)
    assert variant.names == plain.names


@pytest.mark.parametrize("cells", ["\t\t", "NaN\tNaN\tNaN", "0\t0\t0", "-0\t0\t0", "1\t\t3"])
def test_missing_markers_are_nan(tmp_path, cells):
    rows = [ROWS[0], f"2\t0.01\t{cells}\t401\t6\t7", ROWS[2]]
    m = read_trc(trc(tmp_path, rows=rows))
    assert np.isnan(m.positions[1, 0]).all()
    assert m.missing.sum() == 1


def test_empty_cells_left_away_at_the_end_of_a_row(tmp_path):
    m = read_trc(trc(tmp_path, rows=[ROWS[0], "2\t0.01\t2\t3\t4", ROWS[2]]))
    assert np.isnan(m.marker("ankle")[1]).all()
    assert np.isfinite(m.marker("knee")).all()


def test_header_counts_that_disagree_are_warned_about(tmp_path):
    with pytest.warns(PftwinWarning, match="header counts 5 frames, the file has 3"):
        m = read_trc(trc(tmp_path, frames=5))
    assert m.times.size == 3


def test_header_rate_that_disagrees_is_warned_about(tmp_path):
    text = HEAD.format(frames=3, units="mm").replace("100\t100\t3", "120\t120\t3") + "\n".join(ROWS) + "\n"
    with pytest.warns(PftwinWarning, match="rate is 120 Hz, the times give 100 Hz"):
        read_trc(trc(tmp_path, text))


def test_unit_by_argument(tmp_path):
    path = trc(tmp_path, units="")
    with pytest.raises(InputError, match=r"no unit of length.*units='mm'"):
        read_trc(path)
    assert read_trc(path, units="mm").marker("ankle")[0, 0] == pytest.approx(0.4)


def test_argument_wins_over_a_wrong_header_with_a_warning(tmp_path):
    path = trc(tmp_path, units="m")
    with pytest.raises(InputError, match=r"span 40\d m in the file's unit: that unit looks wrong"):
        read_trc(path)
    with pytest.warns(PftwinWarning, match="'mm' is used as given"):
        assert read_trc(path, units="mm").marker("ankle")[0, 0] == pytest.approx(0.4)


def test_metres_labelled_millimetres_are_noticed(tmp_path):
    rows = [f"{i + 1}\t{i / 100}\t0.1\t0.2\t1\t0.5\t0.9\t1" for i in range(3)]
    with pytest.raises(InputError, match="unit looks wrong"):
        read_trc(trc(tmp_path, rows=rows))


@pytest.mark.parametrize(
    ("rows", "end", "message"),
    [
        ([ROWS[0], "2\t0.01\t2\tx\t4\t401\t6\t7"], "\n", r"a\.trc, line 8: column 'knee Y' holds 'x', not a number"),
        ([ROWS[0], "2\t0.01\t2\t1,5\t4\t401\t6\t7"], "\n", "decimal points instead of decimal commas"),
        ([ROWS[0], "2\t0.01\t2\tinf\t4\t401\t6\t7"], "\n", "column 'knee Y' holds 'inf'"),
        ([ROWS[0], "2\t\t2\t3\t4\t401\t6\t7"], "\n", "line 8: column 'Time' is empty"),
        ([ROWS[0], "2\t0.00\t2\t3\t4\t401\t6\t7"], "\n", "row 2 repeats the time 0 s"),
        ([ROWS[0], ROWS[2], ROWS[1]], "\n", "row 3 goes back in time"),
        ([*ROWS, "4\t0.05\t2\t3\t4\t401\t6\t7"], "\n", "not evenly spaced: 0.03 s between rows 3 and 4"),
        ([ROWS[0], "2\t0.01\t2\t3"], "", r"line 8: the file breaks off after 4 of 8 columns: it is truncated"),
        ([ROWS[0], "2\t0.01\t2\t3\t4"], "", "truncated"),
        ([ROWS[0], "2\t0.01\t2\t3\t4\t5"], "\n", "line 8: 6 cells; expected: 8 cells"),
        ([ROWS[0] + "\t9\t9\t9"], "\n", "line 7: 11 cells"),
        ([], "", "no rows of data"),
    ],
)
def test_bad_rows_are_named(tmp_path, rows, end, message):
    with pytest.raises(InputError, match=message):
        read_trc(trc(tmp_path, rows=rows, frames=len(rows), end=end))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b" \n\n", "the file is empty"),
        (bytes(range(256)) * 8, "binary, not text"),
        (b"hello\nworld\n", "no line with the marker names"),
        (b"Frame#\tTime\n", r"line 1: no marker names"),
        (HEAD.format(frames=3, units="furlong").encode() + ROWS[0].encode() + b"\n", "no unit called 'furlong'"),
        (HEAD.format(frames=3, units="N").encode() + ROWS[0].encode() + b"\n", "'N' is not a length"),
        (HEAD.format(frames=1, units="mm").replace("ankle", "knee").encode() + ROWS[0].encode() + b"\n", "occur twice"),
    ],
)
def test_bad_files(tmp_path, content, message):
    path = tmp_path / "bad.trc"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_trc(path)


def test_missing_file_folder_and_size(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no such file"):
        read_trc(tmp_path / "absent.trc")
    with pytest.raises(InputError, match="is a folder"):
        read_trc(tmp_path)
    from pftwin.base.text_files import read_bytes

    with pytest.raises(InputError, match="too large"):
        read_bytes(trc(tmp_path), max_bytes=10)


def test_read_markers_goes_by_the_suffix(tmp_path):
    assert read_markers(trc(tmp_path)).names == ("knee", "ankle")
    with pytest.raises(InputError, match=r"suffix '.xyz' is not known.*\.trc, \.c3d, \.csv"):
        read_markers(tmp_path / "a.xyz")


@settings(max_examples=40, deadline=None)
@given(
    positions=arrays(np.float64, (5, 3, 3), elements=st.floats(-0.01, 0.01, allow_subnormal=False)),
    place=arrays(np.float64, (3,), elements=st.floats(-20, 20, allow_subnormal=False)),
    missing=arrays(np.bool_, (5, 3)),
    rate=st.sampled_from([50.0, 100.0, 119.88, 120.0, 1000.0]),
    start=st.floats(0, 100),
)
def test_round_trip(positions, place, missing, rate, start):
    positions += place + np.diag([0, 0.5, 0.5])
    missing[0] = False
    positions[missing] = np.nan
    positions -= positions[0, 0]  # a marker on the origin
    written = MarkerTrajectories(start + np.arange(5) / rate, ("A", "B_1", "C d"), positions)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "r.trc"
        write_trc(path, written)
        read = read_trc(path)
        assert [p.name for p in Path(folder).iterdir()] == ["r.trc"]
    np.testing.assert_allclose(read.positions, written.positions, atol=1.1e-9)
    np.testing.assert_allclose(read.times, written.times, atol=1e-9)
    assert read.names == written.names


def rig_recording() -> MarkerTrajectories:
    return read_trc(Path(pftwin.__file__).parent / "rig" / "data" / "case1_markers.trc")


@pytest.mark.parametrize("size", [1.0, 2.5])  # the rig, and a whole leg
def test_centimetres_labelled_millimetres_are_noticed(tmp_path, size):
    """Nearest neighbours on the rig are 86 mm apart, on a whole body with 68 markers 115 mm; balls do not come nearer
    than 12 mm."""
    whole = rig_recording()
    write_trc(tmp_path / "a.trc", whole.with_positions(whole.positions * 0.1 * size))
    with pytest.raises(InputError, match=r"nearest other one in the file's unit|six markers or more span") as caught:
        read_trc(tmp_path / "a.trc")
    assert "that unit looks wrong" in str(caught.value)
    with pytest.warns(PftwinWarning, match="'cm' is used as given"):
        read = read_trc(tmp_path / "a.trc", units="cm")
    np.testing.assert_allclose(read.positions, whole.positions * size, atol=1e-7)
    assert read_trc(tmp_path / "a.trc", units="mm").names == whole.names  # told that it is right


def test_virtual_markers_in_one_place_are_not_too_near(tmp_path):
    whole = rig_recording()
    names = (*whole.names, "centre", "same_centre")
    both = np.concatenate(
        [whole.positions, whole.positions[:, :2] * [[[1], [0]]] + [[[0], [1]]] * whole.positions[:, :1]], 1
    )
    write_trc(tmp_path / "a.trc", MarkerTrajectories(whole.times, names, both))
    assert read_trc(tmp_path / "a.trc").names == names


@pytest.mark.parametrize("value", ["-9999", "-9999.0", "9999", "-99999"])
def test_numbers_that_stand_for_a_marker_that_was_not_seen(tmp_path, value):
    rows = [ROWS[0], f"2\t0.01\t2\t3\t4\t{value}\t{value}\t{value}", ROWS[2]]
    with pytest.warns(
        PftwinWarning, match="1 places of markers are -9999 or similar in all coordinates: treated as miss"
    ):
        m = read_trc(trc(tmp_path, rows=rows))
    assert m.missing.tolist() == [[False, False], [False, True], [False, False]]


@pytest.mark.parametrize("cells", ["-9999\t6\t7", "-8888\t-8888\t-8888", "-9999\t-9999\t7"])
def test_a_marker_that_jumps_is_refused(tmp_path, cells):
    rows = [ROWS[0], f"2\t0.01\t2\t3\t4\t{cells}", ROWS[2]]
    with pytest.raises(
        InputError, match=r"marker 'ankle' jumps by .* m on row 2; expected: at most 100 m/s; try: empty"
    ):
        read_trc(trc(tmp_path, rows=rows))


@pytest.mark.parametrize(
    ("numbers", "words"), [((1, 2, 4, 5), "from 2 to 4 on row 3"), ((1, 2, 1, 2), "from 2 to 1 on row 3")]
)
def test_gaps_in_the_numbers_of_frames_are_refused(tmp_path, numbers, words):
    rows = [f"{n}\t{i / 100}\t1\t2\t3\t400\t5\t6" for i, n in enumerate(numbers)]
    with pytest.raises(InputError, match=f"Frame# goes {words}, while the times go on evenly; expected: steps of 1"):
        read_trc(trc(tmp_path, rows=rows, frames=4))


@pytest.mark.parametrize("numbers", [(5, 6, 7, 8), (1, 11, 21, 31), ("", "", "", ""), (0, 0, 0, 0)])
def test_other_numbers_of_frames_are_read(tmp_path, numbers):
    rows = [f"{n}\t{i / 100}\t1\t2\t3\t400\t5\t6" for i, n in enumerate(numbers)]
    assert read_trc(trc(tmp_path, rows=rows, frames=4)).times.size == 4


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "X1\tY1\tZ1\tX2\tY2\tZ2",
            "Y1\tX1\tZ1\tY2\tX2\tZ2",
            r"line 5: the columns are labelled Y1, X1, Z1, Y2, X2, Z2",
        ),
        ("X1\tY1\tZ1\tX2\tY2\tZ2", "X1\tX2\tY1\tY2\tZ1\tZ2", r"line 5: the columns are labelled X1, X2"),
        ("X1\tY1\tZ1\tX2\tY2\tZ2", "X2\tY2\tZ2\tX1\tY1\tZ1", r"line 5: .* X2, .* with numbers that ascend"),
        ("(X/Y/Z)", "(Y/X/Z)", r"line 1: the axes are \(Y/X/Z\); expected: \(X/Y/Z\)"),
    ],
)
def test_coordinates_in_another_order_are_refused(tmp_path, old, new, words):
    path = trc(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=words):
        read_trc(path)


def test_a_place_that_cannot_be_written(tmp_path):
    markers = MarkerTrajectories(np.arange(2.0), ("A",), np.ones((2, 1, 3)))
    with pytest.raises(OutputError, match="cannot be written"):
        write_trc(tmp_path / "absent" / "a.trc", markers)


@pytest.mark.parametrize("counted", [2, 4])
def test_a_header_that_is_off_by_one_frame_is_warned_about(tmp_path, counted):
    with pytest.warns(PftwinWarning, match=f"header counts {counted} frames, the file has 3"):
        read_trc(trc(tmp_path, frames=counted))
