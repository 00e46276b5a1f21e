"""One style, that leaves matplotlib as it was; files of every kind, whole, and the same every time."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from figure_parts import clipped
from small_scene import small_result

from pftwin.base.errors import InputError, OutputError
from pftwin.model.measured import Measured
from pftwin.results.plots import COLOURS, STYLE, case_figure, house_style, save_figure
from pftwin.results.plots.against_flexion import against_flexion
from pftwin.results.plots.style import DASHES, MARKERS, line, shortened, title


@pytest.fixture(scope="module")
def result():
    return small_result()


def settings() -> dict:
    import matplotlib as mpl

    return dict(mpl.rcParams)


@pytest.mark.slow
def test_no_global_setting_is_changed(result, tmp_path):
    before = settings()
    measured = Measured(result.times, result.center + 1e-3, result.quaternion, synthetic=True)
    figures = [
        case_figure({"P5": result}, measured, "case"),
        result.plot.against_flexion(),
        result.plot.trajectory(),
        result.plot.compared(measured),
    ]
    for i, figure in enumerate(figures):
        save_figure(figure, tmp_path / str(i), kinds=("png", "svg", "pdf"))
    assert settings() == before


def test_settings_come_back_after_an_error():
    def failing():
        with house_style(axes__grid=False):
            assert settings()["axes.grid"] is False
            assert settings()["font.size"] == STYLE["font.size"]
            return 1 / 0

    before = settings()
    with pytest.raises(ZeroDivisionError):
        failing()
    assert settings() == before


def test_pyplot_does_not_hold_figures(result):
    import matplotlib.pyplot as plt

    result.plot.against_flexion()
    result.plot.trajectory()
    assert plt.get_fignums() == []


@pytest.mark.parametrize(("kind", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_files_of_every_kind_are_the_same_every_time(result, tmp_path, kind, start):
    files = [save_figure(result.plot.against_flexion(), tmp_path / name, kinds=(kind,))[0] for name in "ab"]
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"a.{kind}", f"b.{kind}"]
    one, two = (f.read_bytes() for f in files)
    assert one.startswith(start)
    assert one == two


def test_savefig_alone_writes_vectors_with_letters(result, tmp_path):
    figure = result.plot.against_flexion()
    for kind in ("pdf", "svg", "png"):
        figure.savefig(tmp_path / f"tracking.{kind}")
        assert (tmp_path / f"tracking.{kind}").stat().st_size > 5000


def test_unknown_kinds_and_folders_are_named(result, tmp_path):
    figure = result.plot.against_flexion()
    with pytest.raises(InputError, match="unknown kind of figure 'bmp'; expected: png, svg, pdf"):
        save_figure(figure, tmp_path / "x", kinds=("bmp",))
    with pytest.raises(OutputError, match="no folder"):
        save_figure(figure, tmp_path / "absent" / "x")
    assert list(tmp_path.iterdir()) == []


def luminance(colour: str) -> float:
    """Relative, of sRGB (WCAG 2.1)."""
    parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_colours_stand_out_from_paper_and_lines_differ_without_colour():
    assert all((1.05) / (luminance(c) + 0.05) > 2.0 for c in COLOURS)
    assert len(COLOURS) == len(set(COLOURS)) == len({str(d) for d in DASHES})
    assert len({str(line(i)["linestyle"]) for i in range(6)}) == 6
    assert len(set(MARKERS)) == len(MARKERS)


@pytest.mark.parametrize("width", [3.5, 7.2, 11.0])
def test_titles_fit_their_figure(width):
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(width, 3.0))
        title(figure, "a scene with a long name " * 6, None, "a note on where its motion comes from " * 4)
        figure.draw_without_rendering()
        box = figure.get_suptitle(), figure._suptitle.get_window_extent()
    assert box[1].x0 >= 0
    assert box[1].x1 <= figure.bbox.x1


@pytest.mark.parametrize("name", ["a knee with a very long name " * 5, "knee_" * 30, "W" * 150])
@pytest.mark.filterwarnings("error:constrained_layout")
def test_long_names_leave_room_and_are_not_clipped(result, name):
    """Of scenes, and of results in the legend, which begin alike."""
    named = {f"{name}{k}": dataclasses.replace(result, scene_name=f"{k}{name}") for k in range(6)}
    for figure in (case_figure(named, None, name), against_flexion(named), against_flexion(named[f"{name}0"])):
        assert clipped(figure) == []
        drawn = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
        assert len(drawn) == len(set(drawn))
        assert all(ax.get_window_extent().height > 50 for ax in figure.axes)


def test_a_long_name_keeps_its_ends():
    assert shortened("a" * 30) == "a" * 30
    assert shortened("first" + "m" * 100 + "last", 12) == "firstm…mlast"
    assert len(shortened("m" * 31)) == 30


def test_using_a_result_does_not_import_matplotlib():
    code = "import sys, pftwin; pftwin.Result, pftwin.plots.ResultPlots; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize("name", ["knee $\\frac{$ of A", "$5 and $6", "a_b^c", "100 % {x} <b>&amp;</b>", "\\"])
def test_names_are_text_and_no_formulas(tmp_path, name):
    """A formula that does not parse is an error of matplotlib's; one that does would show another name."""
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(5, 3))
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], label=name)
        axes.legend()
        title(figure, name)
    (path,) = save_figure(figure, tmp_path / "a", ("svg",))
    text = ElementTree.parse(path).getroot()
    shown = [e.text for e in text.iter("{http://www.w3.org/2000/svg}text")]
    assert shown.count(name) == 2
