"""Error over time spent: every row of the kept study is where its numbers are, in the house style."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.results.plots.style import COLOURS, MARKERS
from pftwin.studies.accuracy.table import front, read_csv, work_precision

KEPT = Path(__file__).resolve().parents[3] / "docs" / "benchmarks"


@pytest.fixture(scope="module")
def rows():
    return read_csv(max(KEPT.glob("accuracy-*.csv")))


def settings() -> dict:
    import matplotlib as mpl

    return dict(mpl.rcParams)


@pytest.mark.parametrize(("panel", "speed"), [(0, "real_time"), (1, "real_time_batch")])
def test_lines_are_the_rows(rows, panel, speed):
    before = settings()
    figure = work_precision(rows, "case 1 (synthetic)", contact="P5")
    assert settings() == before
    own = [r for r in rows if r.contact == "P5" and r.dtype == "float64" and np.isfinite(getattr(r, speed))]
    own = [r for r in own if np.isfinite(r.position_rms_mm) and r.position_rms_mm > 0]
    lines = {line.get_label(): line for line in figure.axes[panel].get_lines()}
    methods = list(dict.fromkeys(r.integrator for r in own))
    assert len(methods) >= 4
    for name in methods:
        some = [r for r in own if r.integrator == name]
        np.testing.assert_allclose(lines[name].get_xdata(), [1e3 / getattr(r, speed) for r in some])
        np.testing.assert_allclose(lines[name].get_ydata(), [r.position_rms_mm for r in some])
        assert lines[name].get_color() in COLOURS
        assert lines[name].get_marker() in MARKERS
    looks = {(lines[m].get_color(), lines[m].get_marker()) for m in methods}
    assert len(looks) == len(methods)
    (wide,) = (line for name, line in lines.items() if name.startswith("front"))
    assert len(wide.get_xdata()) == len(front(own, speed))
    assert "[ms]" in figure.axes[panel].get_xlabel()


def test_the_legend_lies_below_the_panels(rows):
    figure = work_precision(rows, "case 1 (synthetic)", contact="P5")
    figure.draw_without_rendering()
    legend = figure.legends[0].get_window_extent()
    assert legend.y1 <= min(ax.get_window_extent().y0 for ax in figure.axes)
    assert legend.x0 >= 0
    assert legend.x1 <= figure.bbox.x1


def test_nothing_to_draw_is_said():
    with pytest.raises(InputError, match="work_precision: nothing to draw"):
        work_precision([], "empty")
