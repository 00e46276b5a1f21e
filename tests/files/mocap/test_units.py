"""Units as files write them, against a table that was written by hand, through every reader that takes them."""

from __future__ import annotations

import numpy as np
import pytest
from at_once import at_once

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.files.mocap import read_csv, read_markers, read_sto
from pftwin.files.mocap.units import length_factor, split_unit, to_si

DEGREE = 0.017453292519943295  # [rad]
TABLE = {  # as written: SI unit, factor
    "m": ("m", 1.0),
    "cm": ("m", 0.01),
    "mm": ("m", 0.001),
    "um": ("m", 0.000001),
    "in": ("m", 0.0254),
    "s": ("s", 1.0),
    "ms": ("s", 0.001),
    "rad": ("rad", 1.0),
    "deg": ("rad", DEGREE),
    "N": ("N", 1.0),
    "kN": ("N", 1000.0),
    "Nm": ("N m", 1.0),
    "N*m": ("N m", 1.0),
    "Nmm": ("N m", 0.001),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 0.001),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", DEGREE),
    "J": ("J", 1.0),
    "mJ": ("J", 0.001),
    "kg": ("kg", 1.0),
    "Pa": ("Pa", 1.0),
    "MPa": ("Pa", 1000000.0),
    "Hz": ("Hz", 1.0),
    "V": ("V", 1.0),
    "mV": ("V", 0.001),
    "1": ("1", 1.0),
    "-": ("1", 1.0),
    "metres": ("m", 1.0),
    "Millimeters": ("m", 0.001),
    "centimetres": ("m", 0.01),
    "Degrees": ("rad", DEGREE),
    "radians": ("rad", 1.0),
    "seconds": ("s", 1.0),
    "newtons": ("N", 1.0),
    " MM ": ("m", 0.001),
}


@pytest.mark.parametrize(("written", "expected"), TABLE.items())
def test_every_unit_and_its_factor(tmp_path, written, expected):
    unit, factor = to_si(written, where="a file")
    assert unit == expected[0]
    assert factor == pytest.approx(expected[1], rel=1e-12)
    path = tmp_path / "a.csv"
    path.write_text(f"time_s,signal [{written}]\n0,3\n1,-7\n")
    table = read_csv(path)
    assert table.units["signal"] == expected[0]
    np.testing.assert_allclose(table.column("signal"), [3 * expected[1], -7 * expected[1]], rtol=1e-12)


@pytest.mark.parametrize(
    ("label", "name", "unit"),
    [
        ("knee_rate_deg/s", "knee_rate", "deg/s"),
        ("quadriceps_kN", "quadriceps", "kN"),
        ("shift_mm", "shift", "mm"),
        ("Fz (kN)", "Fz", "kN"),
        ("zoom_in", "zoom_in", None),
        ("strand_1", "strand_1", None),
        ("mm", "mm", None),
        ("patella_qx", "patella_qx", "1"),
        ("share []", "share", "1"),
        ("Fz [ N ]", "Fz", "N"),
        ("a (b) [mm]", "a (b)", "mm"),
        ("a (N]", "a", "N"),
        ("(N)", "(N)", None),
        ("a (N))", "a (N))", None),
        ("a) N)", "a) N)", None),
    ],
)
def test_a_columns_label_holds_its_unit(label, name, unit):
    assert split_unit(label) == (name, unit)


M = 200_000


@pytest.mark.parametrize("label", [M * "(", M * "(" + ")", "a (" + M * " " + "x", M * "[ " + "])"])
def test_a_long_label_takes_no_time(label):
    with at_once():
        split_unit(label)


def test_a_files_length_is_the_arguments_before_the_headers():
    assert length_factor("mm", None, where="a") == 0.001
    assert length_factor(None, "cm", where="a") == 0.01
    with pytest.warns(PftwinWarning, match="a: the file says 'mm'; 'm' is used as given"):
        assert length_factor("mm", "m", where="a") == 1.0
    assert length_factor("mm", "mm", where="a") == 0.001
    with pytest.raises(InputError, match="the unit 'N' is not a length"):
        length_factor("N", None, where="a")
    with pytest.raises(InputError, match="no unit of length"):
        length_factor(None, None, where="a")


@pytest.mark.parametrize(("unit", "factor"), [("mm", 0.001), ("cm", 0.01), ("m", 1.0)])
@pytest.mark.parametrize("by", ["header", "argument"])
def test_markers_of_a_csv_come_in_metres(tmp_path, unit, factor, by):
    """The same 0.2 m, 0.1 m, -0.3 m and so on, whatever they are written in."""
    metres = np.array([[0.2, 0.1, -0.3, 0.5, 0.4, 0.9], [0.21, 0.12, -0.33, 0.54, 0.45, 0.96]])
    tail = f"_{unit}" if by == "header" else ""
    labels = ["time_s", *(f"{n}_{a}{tail}" for n in ("KNEE", "HIP") for a in "xyz")]
    rows = [",".join(f"{x:.9g}" for x in [t, *row / factor]) for t, row in zip((0.0, 0.01), metres, strict=True)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([",".join(labels), *rows]) + "\n")
    found = read_markers(path, **({"units": unit} if by == "argument" else {}))
    np.testing.assert_allclose(found.positions, metres.reshape(2, 2, 3), rtol=1e-8)
    assert found.names == ("KNEE", "HIP")


@pytest.mark.parametrize(
    ("line", "degrees"),
    [
        ("inDegrees=yes\n", True),
        ("inDegrees=Yes\n", True),
        ("inDegrees=true\n", True),
        ("inDegrees=1\n", True),
        ("InDegrees = yes\n", True),
        ("inDegrees yes\n", True),
        ("inDegrees=no\n", False),
        ("inDegrees=false\n", False),
        ("inDegrees=0\n", False),
        ("", False),
    ],
)
def test_the_flag_of_degrees_in_all_its_spellings(tmp_path, line, degrees):
    """Without the flag a storage file is in radians, as OpenSim reads it."""
    path = tmp_path / "a.sto"
    path.write_text(f"Coordinates\n{line}endheader\ntime\tknee_angle\tknee_angle/speed\n0\t90\t-180\n1\t30\t60\n")
    factor = DEGREE if degrees else 1.0
    table = read_sto(path, rotational=["*"])
    assert table.in_degrees is degrees
    np.testing.assert_allclose(table.values, np.array([[90, -180], [30, 60]]) * factor, rtol=1e-12)
    expected = {"knee_angle": "rad", "knee_angle/speed": "rad/s"}
    assert table.units == (expected if degrees else dict.fromkeys(expected, ""))
