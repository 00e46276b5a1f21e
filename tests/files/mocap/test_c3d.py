"""C3D files written with ezc3d, whole and damaged."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from c3d_files import write_c3d

from pftwin.base.errors import InputError, MissingExtraError, PftwinWarning
from pftwin.files.mocap import read_c3d, read_c3d_channels, read_markers, read_readings

pytest.importorskip("ezc3d", reason="the extra c3d is not installed")

FRAMES, NAMES = 50, ("A", "B", "C")


def positions_mm() -> np.ndarray:
    t = np.arange(FRAMES)[:, None, None] / 100
    return np.array([[100.0, 0, 0], [0, 200, 0], [0, 0, 300]]) + 50 * np.sin(t + np.arange(3))


def write(path, points=None, *, labels=NAMES, **more):
    return write_c3d(path, positions_mm() if points is None else points, labels, **more)


def test_positions_rate_and_names(tmp_path):
    m = read_markers(write(tmp_path / "a.c3d"))
    assert m.names == NAMES
    assert m.rate == pytest.approx(100)
    np.testing.assert_allclose(m.positions, positions_mm() / 1000, atol=1e-7)


def test_unseen_points_are_nan_not_zero(tmp_path):
    points = positions_mm()
    points[10:14, 1] = np.nan
    points[20, 0] = 0.0
    residuals = np.zeros((1, 3, FRAMES))
    residuals[0, 1, 10:14] = -1
    residuals[0, 2, 5] = -1
    m = read_c3d(write(tmp_path / "a.c3d", points, residuals=residuals))
    expected = np.zeros((FRAMES, 3), dtype=bool)
    expected[10:14, 1] = expected[5, 2] = expected[20, 0] = True
    np.testing.assert_array_equal(m.missing, expected)


def test_units(tmp_path):
    path = write(tmp_path / "a.c3d", units="")
    with pytest.raises(InputError, match=r"POINT:UNITS: no unit of length.*units='mm'"):
        read_c3d(path)
    assert read_c3d(path, units="mm").marker("A")[0, 0] == pytest.approx(0.1)
    wrong = write(tmp_path / "b.c3d", units="m")
    with pytest.raises(InputError, match="unit looks wrong"):
        read_c3d(wrong)
    with pytest.warns(PftwinWarning, match="'mm' is used as given"):
        read_c3d(wrong, units="mm")


def test_damaged_files_are_refused_rather_than_read_in_part(tmp_path):
    whole = write(tmp_path / "a.c3d").read_bytes()
    noise = np.random.default_rng(0).integers(0, 256, 4000, dtype=np.uint8).tobytes()
    cases = {
        b"\n": "empty",
        b"hello world" * 100: "not C3D",
        noise: "not C3D",
        whole[:2]: "truncated",
        whole[:700]: "breaks off in its parameter section",
        whole[: len(whole) - 600]: r"breaks off in frame \d+ of 50",
        whole[:515] + b"\x00" + whole[516:]: "damaged",
        whole[:520] + b"\x01" * 3000: "damaged|truncated|not a readable",
    }
    for content, message in cases.items():
        path = tmp_path / "bad.c3d"
        path.write_bytes(content)
        with pytest.raises(InputError, match=message):
            read_c3d(path)


def test_labels_have_to_name_every_point(tmp_path):
    with pytest.raises(InputError, match="labels for 3 points"):
        read_c3d(write(tmp_path / "a.c3d", labels=("A", "B", "")))


def test_without_ezc3d_the_extra_is_named(tmp_path, monkeypatch):
    path = write(tmp_path / "a.c3d")
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(MissingExtraError, match=r"pftwin\[c3d\]"):
        read_c3d(path)


SAMPLES = np.arange(500) / 1000
CHANNELS = {
    "Force.Fz1": ("N", 300 * np.sin(2 * np.pi * SAMPLES) + 7),
    "cable": ("kN", 0.2 + SAMPLES),
    "raw": ("mV/V", -SAMPLES),
    "moment": ("Nmm", 1e3 * SAMPLES**2),
    "": ("", np.arange(500.0)),
}


def test_channels_have_their_labels_units_and_rate(tmp_path):
    table = read_readings(write(tmp_path / "a.c3d", channels=CHANNELS, first=30))
    assert table.names == ("Force.Fz1", "cable", "raw", "moment", "channel 5")
    assert table.units == {"Force.Fz1": "N", "cable": "N", "raw": "mV/V", "moment": "N m", "channel 5": "1"}
    np.testing.assert_allclose(table.times, 0.3 + SAMPLES, atol=1e-12)  # the header's first frame is frame 30
    assert table.rate == pytest.approx(1000)
    np.testing.assert_allclose(table.column("Force.Fz1"), CHANNELS["Force.Fz1"][1], rtol=1e-6)
    np.testing.assert_allclose(table.column("cable"), 1e3 * CHANNELS["cable"][1], rtol=1e-6)
    np.testing.assert_allclose(table.column("raw"), CHANNELS["raw"][1], rtol=1e-6)
    np.testing.assert_allclose(table.column("moment"), CHANNELS["moment"][1] / 1e3, rtol=1e-6)
    markers = read_markers(tmp_path / "a.c3d")
    np.testing.assert_allclose(table.times[::10], markers.times, atol=1e-12)


def integers(path, raw, offset, form):
    """A C3D file of one channel, in integers of two bytes, as older systems write."""
    whole = bytearray(write(path, channels={"Fz": ("N", np.zeros(FRAMES))}, form=form).read_bytes())
    offset_at = whole.index(b"OFFSET") + len(b"OFFSET") + 4  # link, type, no dimensions
    scale_at = whole.index(b"SCALE") + len(b"SCALE") + 4  # of the points; above 0: integers
    whole[offset_at : offset_at + 2] = np.int64(offset).astype("<u2").tobytes()
    whole[scale_at : scale_at + 4] = whole[12:16] = np.array(0.1, "<f4").tobytes()
    frames = np.zeros((FRAMES, 4 * len(NAMES) + 1), "<i2")
    frames[:, :-1] = 100
    frames[:, -1] = np.asarray(raw).astype("<u2").view("<i2")
    begin = 512 * (int.from_bytes(whole[16:18], "little") - 1)
    path.write_bytes(whole[:begin] + frames.tobytes())
    return path


@pytest.mark.parametrize(
    ("form", "offset", "first"),
    [("SIGNED", 0, -25), ("SIGNED", 300, -25), ("SIGNED", -40, -25), ("SIGNED", -32768, -25), ("", -40, -25),
     ("UNSIGNED", 2048, 2000), ("UNSIGNED", 32768, 32740), ("UNSIGNED", 65500, 65450)],
)  # fmt: skip
def test_offset_and_scale_of_integers_count(tmp_path, form, offset, first):
    raw = first + np.arange(FRAMES)
    table = read_c3d_channels(integers(tmp_path / "a.c3d", raw, offset, form))
    np.testing.assert_allclose(table.column("Fz"), (raw - offset) * 0.5, atol=1e-6)  # the layout's definition


def test_channels_that_cannot_be_used(tmp_path):
    with pytest.raises(InputError, match=r"a\.c3d: the file holds no analog data"):
        read_c3d_channels(write(tmp_path / "a.c3d"))
    table = read_c3d_channels(write(tmp_path / "b.c3d", channels=CHANNELS))
    with pytest.raises(InputError, match=r"no column called 'Force\.Fz2'; expected: did you mean 'Force\.Fz1'"):
        table.column("Force.Fz2")
    twice = {"a": ("N", SAMPLES), "a ": ("N", SAMPLES)}
    with pytest.raises(InputError, match=r"b\.c3d: columns that occur twice: a"):
        read_c3d_channels(write(tmp_path / "b.c3d", channels=twice))


@pytest.mark.parametrize("name", [b"OFFSET", b"SCALE"])
def test_channels_without_offset_or_scale_are_refused(tmp_path, name):
    """ezc3d ends the process there."""
    whole = write(tmp_path / "a.c3d", channels={k: v for k, v in CHANNELS.items() if k}).read_bytes()
    at = whole.index(b"ANALOG")  # SCALE is a name in POINT too
    (tmp_path / "a.c3d").write_bytes(whole[:at] + whole[at:].replace(b"\x02" + name, b"\x02" + b"X" * len(name), 1))
    for read in (read_c3d, read_c3d_channels):
        with pytest.raises(InputError, match=rf"a\.c3d: 4 analog channels, and 0 values of ANALOG:{name.decode()}"):
            read(tmp_path / "a.c3d")
