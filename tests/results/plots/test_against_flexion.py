"""Courses against flexion: lines are means of the results' own numbers, bands their standard deviations."""

from __future__ import annotations

import dataclasses
import sys

import equinox as eqx
import numpy as np
import pytest
from figure_parts import footers
from small_scene import small_result, small_scene

import pftwin
from pftwin.base.errors import InputError
from pftwin.dynamics.status import Status
from pftwin.model.measured import SYNTHETIC, Measured
from pftwin.results.plots import COLOURS, against_flexion
from pftwin.results.plots.quantities import QUANTITIES
from pftwin.results.tracking import find_dislocations


@pytest.fixture(scope="module")
def variants():
    """The small knee, and two with another quadriceps: each bends from 45 to 55 deg and back."""
    scene = small_scene()
    i = scene.index("quadriceps")
    softer = [eqx.tree_at(lambda s: s.effects[i].stiffness, scene, k * scene.effects[i].stiffness) for k in (0.9, 1.2)]
    return [small_result(), *(pftwin.simulate(s) for s in softer)]


def own_numbers(result, name):
    """Of a result, in the figure's unit, written out once more."""
    if name == "contact_force":
        return result.effects["contact"]["force"]
    if name == "shift":
        return 1e3 * result.center[:, 1]
    return np.degrees(getattr(result.angles, name))


def footer_of(figure):
    return " ".join(text.get_text() for text in footers(figure)).replace("\n", " ")


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines()}


@pytest.mark.parametrize("name", ["tilt", "shift", "rotation", "contact_force"])
def test_mean_and_band_are_of_the_results(variants, name):
    figure = against_flexion(variants, show=(name,), strokes="bending")
    (ax,) = figure.axes
    (line,) = ax.get_lines()
    grid = line.get_xdata()
    knee = np.degrees(variants[0].knee.flexion)
    top = int(np.argmax(knee))
    table = np.array([np.interp(grid, knee[: top + 1], own_numbers(r, name)[: top + 1]) for r in variants])
    np.testing.assert_allclose(line.get_ydata(), table.mean(axis=0), rtol=1e-12)
    (band,) = ax.collections
    low, high = table.mean(axis=0) - table.std(axis=0, ddof=1), table.mean(axis=0) + table.std(axis=0, ddof=1)
    corners = band.get_paths()[0].vertices
    for x, a, b in zip(grid[1:-1:30], low[1:-1:30], high[1:-1:30], strict=True):
        there = corners[np.isclose(corners[:, 0], x), 1]
        np.testing.assert_allclose([there.min(), there.max()], [a, b], rtol=1e-9)
    assert f"[{QUANTITIES[name].unit}]" in ax.get_ylabel()
    assert ax.get_xlabel() == "knee flexion [deg]"


def test_one_stroke_has_no_band_and_directions_are_distinguished(variants):
    figure = variants[0].plot.against_flexion()
    assert len(figure.axes) == 4
    for ax in figure.axes:
        found = lines(ax)
        assert list(found) == ["simulated, bending (n = 1)", "simulated, straightening (n = 1)"]
        assert not ax.collections
        assert len({str(line.get_linestyle()) for line in found.values()}) == 2
    knee, tilt = np.degrees(variants[0].knee.flexion), np.degrees(variants[0].angles.tilt)
    turned = lines(figure.axes[0])["simulated, straightening (n = 1)"]
    down = slice(int(np.argmax(knee)), None)
    expected = np.interp(turned.get_xdata(), knee[down][::-1], tilt[down][::-1])
    known = np.isfinite(turned.get_ydata())
    assert known.sum() > 100
    np.testing.assert_allclose(turned.get_ydata()[known], expected[known])


def test_strokes_together_have_the_spread_between_both_ways(variants):
    (ax,) = variants[0].plot.against_flexion(show=("tilt",), strokes="together").axes
    (line,) = ax.get_lines()
    assert line.get_label() == "simulated (n = 2)"  # 45 to 55 deg and back
    assert len(ax.collections) == 1


def test_groups_have_colours_of_their_own_and_measurements_are_black(variants):
    one = variants[0]
    measured = Measured(one.times, one.center, one.quaternion, one.effects["contact"]["force"], synthetic=True)
    figure = against_flexion({"before": one, "after": variants[1:]}, measured=measured, strokes="bending")
    found = lines(figure.axes[0])
    assert list(found) == [
        "synthetic measurements, bending (n = 1)", "before, bending (n = 1)", "after, bending (n = 2)",
    ]  # fmt: skip
    assert [line.get_color() for line in found.values()] == ["black", COLOURS[0], COLOURS[1]]
    first, second, _ = found.values()  # measured is what was simulated
    np.testing.assert_allclose(first.get_ydata(), second.get_ydata(), atol=1e-9)
    assert [t.get_text() for t in figure.legends[0].get_texts()] == list(found)


def test_what_was_not_measured_is_not_drawn(variants):
    one = variants[0]
    figure = one.plot.against_flexion(measured=Measured(one.times, one.center), strokes="bending")
    counts = [len(ax.get_lines()) for ax in figure.axes]
    assert counts == [1, 2, 1, 1]  # positions alone: the shift


def test_axes_of_ones_own(variants):
    from matplotlib.figure import Figure

    figure = Figure()
    axes = figure.subplots(1, 2)
    assert against_flexion(variants, show=("tilt", "flexion"), axes=axes) is figure
    assert all(ax.get_lines() and ax.get_xlabel() for ax in axes)
    assert figure.get_suptitle() == ""
    part = Figure().subfigures(1, 2)[0]
    assert against_flexion(variants, show=("tilt",), axes=part.subplots()) is part.figure


def test_three_panels_leave_no_empty_one_and_name_the_axis_of_each_column(variants):
    figure = against_flexion(variants, show=("tilt", "shift", "rotation"))
    assert len(figure.axes) == 3
    assert [ax.xaxis.label.get_visible() for ax in figure.axes] == [False, True, True]


def test_texts_lie_within_the_figure_and_the_legend_below_the_panels(variants):
    figure = against_flexion({"with a rather long name": variants, "another one": variants[:2]})
    figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1
    assert all(box.y1 <= ax.get_tightbbox().y0 for ax in figure.axes)
    (below,) = (text.get_window_extent() for text in footers(figure))
    assert 0 <= below.y0 < below.y1 <= box.y0
    assert 0 <= below.x0 < below.x1 <= figure.bbox.x1


def displaced(result, frames, by):
    """The result with its patella out of the groove in some frames: its centre moved laterally [m]."""
    center = result.center.copy()
    center[frames, 1] += by
    return dataclasses.replace(result, center=center)


def test_a_stroke_that_dislocates_stands_alone_dotted_from_a_cross_on(variants):
    one = variants[0]
    knee = np.degrees(one.knee.flexion)
    top, low = int(np.argmax(knee)), knee.size - 1  # it straightens to the last frame
    leaves = (top + low) // 2  # well after the turn: it bends within its groove
    dislocating = displaced(one, slice(leaves, low + 1), 0.030)
    assert dislocating.dislocations().dislocated[leaves : low + 1].all()
    figure = against_flexion([one, variants[1], dislocating], show=("shift",), strokes="straightening")
    (ax,) = figure.axes
    mean, before, out = ax.get_lines()
    shift, other = (1e3 * r.center[:, 1] for r in (one, variants[1]))
    assert mean.get_label() == "simulated, straightening (n = 2)"
    down = slice(top, low + 1)
    expected = np.mean([np.interp(mean.get_xdata(), knee[down][::-1], s[down][::-1]) for s in (shift, other)], axis=0)
    known = np.isfinite(mean.get_ydata())
    assert known.sum() > 100
    np.testing.assert_allclose(mean.get_ydata()[known], expected[known], rtol=1e-12)
    assert out.get_label() == "simulated, straightening, dislocates (n = 1)"
    assert (out.get_linestyle(), out.get_marker()) == (":", "x")
    (cross,) = out.get_markevery()
    assert out.get_xdata()[cross] == knee[leaves]
    assert out.get_ydata()[cross] == pytest.approx(shift[leaves] + 30)
    assert np.nanmin(out.get_ydata()) > 20
    assert np.nanmax(before.get_xdata()[np.isfinite(before.get_ydata())]) == knee[top]
    assert before.get_linewidth() < mean.get_linewidth()
    said = footer_of(figure)
    assert "each by itself" in said
    assert "each by itself" not in footer_of(against_flexion(variants, show=("shift",)))
    assert "each by itself" not in footer_of(against_flexion(dislocating, show=("shift",), strokes="bending"))


def test_dislocations_are_computed_once_for_each_result(variants, monkeypatch):
    asked, module = [], sys.modules[against_flexion.__module__]

    def seen(times, offset):
        asked.append(offset)
        return find_dislocations(times, offset)

    monkeypatch.setattr(module, "find_dislocations", seen)
    against_flexion(variants)
    assert [id(offset) for offset in asked] == [id(result.groove[1]) for result in variants]


def test_strokes_of_an_invalid_motion_are_separate_and_the_footer_says_so(variants):
    """An untrustworthy motion that leaves the groove is averaged with nothing either."""
    left = displaced(variants[0], slice(5, None), 0.030)
    invalid = dataclasses.replace(left, flags=np.full_like(left.flags, int(Status.NOT_FINITE)))
    assert invalid.dislocations() is None
    figures = [against_flexion([result, variants[1]], show=("shift",)) for result in (left, invalid)]
    labels = [[line.get_label() for line in f.axes[0].get_lines()] for f in figures]
    assert labels[0] == labels[1]
    assert any("dislocates" in str(label) for label in labels[1])
    assert "INVALID: not finite" in footer_of(figures[1])
    assert "INVALID" not in footer_of(figures[0])


def test_measured_strokes_are_separated_by_their_own_outcome(variants):
    one = variants[0]
    knee = one.knee.flexion
    frames = slice(int(np.argmax(knee)) + 3, None)
    measured = Measured(one.times, displaced(one, frames, 0.030).center)
    labels = list(lines(one.plot.against_flexion(measured=measured, show=("shift",), strokes="straightening").axes[0]))
    assert "measured, straightening, dislocates (n = 1)" in labels
    assert "simulated, straightening (n = 1)" in labels
    assert not [label for label in labels if label.startswith("measured, straightening (n")]


def test_the_footer_says_how_to_read_it_and_the_title_what_it_is(variants):
    synthetic = dataclasses.replace(variants[0], scene=dataclasses.replace(variants[0].scene, synthetic=True))
    figure = synthetic.plot.against_flexion(show=("tilt",))
    assert figure.get_suptitle() == "small knee"
    assert SYNTHETIC in footer_of(figure)
    assert "one standard deviation" in footer_of(figure)
    assert SYNTHETIC not in footer_of(variants[0].plot.against_flexion(show=("tilt",)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"results": []}, "results: nothing to draw"),
        ({"results": {"none": []}}, "at least one result in every group"),
        ({"strokes": "sideways"}, "strokes: found 'sideways'; expected: one of: apart, together"),
        ({"show": ("tild",)}, "quantities: no quantity 'tild'; expected: of: tilt"),
        ({"show": ()}, "quantities: nothing to draw"),
        ({"axes": []}, "axes: 0 axes; expected: 4: one for each of tilt, shift"),
    ],
)
def test_wrong_arguments_are_named(variants, arguments, message):
    with pytest.raises(InputError, match=message):
        against_flexion(**{"results": variants, **arguments})


@pytest.mark.slow
def test_a_still_knee_and_other_frames_are_refused(variants):
    one = variants[0]
    with pytest.raises(InputError, match=r"5 frames at .*; expected: the simulation's 41 frames"):
        one.plot.against_flexion(measured=Measured(one.times[:5], one.center[:5]))
    still = pftwin.simulate(small_scene(5))
    with pytest.raises(InputError, match="small knee: the knee bends by"):
        still.plot.against_flexion()
