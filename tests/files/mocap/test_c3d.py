"""C3D files written with ezc3d, whole and damaged."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from pftwin.base.errors import InputError, MissingExtraError, PftwinWarning
from pftwin.files.mocap import read_c3d, read_markers

ezc3d = pytest.importorskip("ezc3d", reason="the extra c3d is not installed")

FRAMES, NAMES = 50, ("A", "B", "C")


def positions_mm() -> np.ndarray:
    t = np.arange(FRAMES)[:, None, None] / 100
    return np.array([[100.0, 0, 0], [0, 200, 0], [0, 0, 300]]) + 50 * np.sin(t + np.arange(3))


def write(path, points=None, *, units="mm", labels=NAMES, residuals=None):
    points = positions_mm() if points is None else points
    file = ezc3d.c3d()
    data = np.ones((4, points.shape[1], points.shape[0]))
    data[:3] = points.transpose(2, 1, 0)
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = labels
    if units is not None:
        file["parameters"]["POINT"]["UNITS"]["value"] = [units]
    file["data"]["points"] = data
    if residuals is not None:
        file["data"]["meta_points"]["residuals"] = residuals
    file.write(str(path))
    return path


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
    with pytest.warns(PftwinWarning, match="'mm' is used as told"):
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
