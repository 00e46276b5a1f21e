"""The path over the trochlea: places in the chart by plain matrices, contours of the surface itself."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from figure_parts import footers
from pressed_button import disc, pressed
from scenes import J, vec
from small_scene import GROOVE_AT, HALF_U, HALF_V, small_result

import pftwin
from pftwin.base.errors import InputError
from pftwin.geometry.contact.contact_mesh import contact_mesh
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.effects.mesh_contact import MeshContact
from pftwin.model.measured import SYNTHETIC, Measured
from pftwin.results.plots import COLOURS, case_figure
from pftwin.results.plots.trajectory import relief


@pytest.fixture(scope="module")
def result():
    return small_result()


@pytest.fixture(scope="module")
def on_a_mesh():
    """A button pressed on a disc of triangles, by an elastic foundation without a smooth stand-in."""
    return pftwin.simulate(pressed(disc(20.0), n_frames=7))


def in_chart(result, points):
    """(u, v) [mm] of points (n, 3) [m] in the plane chart of the small knee."""
    axes, origin = np.asarray(result.surface.chart.axes.array()), np.asarray(result.surface.chart.origin.array())
    return (1e3 * (points - origin) @ axes)[:, :2].T


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}


def test_paths_are_the_places_below_the_points(result):
    figure = result.plot.trajectory()
    found = lines(figure.axes[0])
    report = result.effects["contact"]
    expected = {
        "centre of the button": result.center,
        "contact, medial facet": report["point_medial"],
        "contact, lateral facet": report["point_lateral"],
    }
    assert list(found) == list(expected)
    for name, points in expected.items():
        u, v = in_chart(result, points)
        np.testing.assert_allclose(found[name].get_xdata(), v, atol=1e-9)
        np.testing.assert_allclose(found[name].get_ydata(), u, atol=1e-9)
    assert np.isfinite(found["contact, medial facet"].get_xdata()).any()
    facets = [found[f"contact, {side} facet"].get_color() for side in ("medial", "lateral")]
    assert facets == list(COLOURS[:2])
    assert found["contact, medial facet"].get_xdata()[0] < found["contact, lateral facet"].get_xdata()[0]


def test_a_facet_that_bears_nothing_breaks_its_path(result):
    effects = {k: dict(v) for k, v in result.effects.items()}
    effects["contact"]["point_medial"] = effects["contact"]["point_medial"].copy()
    effects["contact"]["point_medial"][5:20] = np.nan
    (ax, *_) = dataclasses.replace(result, effects=effects).plot.trajectory().axes
    gap = np.isnan(lines(ax)["contact, medial facet"].get_ydata())
    assert gap[5:20].all()


def test_contours_are_those_of_the_surface(result):
    drawn = relief(result, result.center)
    k = 1 / (2 * 0.015)
    expected = -((1e-3 * drawn.u) ** 2) / (2 * 0.026) + k * (1e-3 * drawn.v - GROOVE_AT) ** 2
    inside = (np.abs(drawn.u) <= 1e3 * HALF_U) & (np.abs(drawn.v) <= 1e3 * HALF_V)
    np.testing.assert_allclose(drawn.height[inside], 1e3 * expected[inside], atol=1e-9)
    np.testing.assert_allclose(drawn.rectangle, [-30, 30, -20, 20])
    assert drawn.labels == (
        "along the groove, proximal [mm]", "across the groove, lateral [mm]", "height over the chart's plane [mm]",
    )  # fmt: skip
    ax, bar = result.plot.trajectory().axes
    assert (ax.get_ylabel(), ax.get_xlabel(), bar.get_ylabel()) == drawn.labels
    assert ax.get_aspect() == 1
    contours = ax.collections[1]
    for level, path in zip(contours.levels, contours.get_paths(), strict=True):  # every line is where its height is
        v, u = 1e-3 * path.vertices.T
        there = (np.abs(u) < HALF_U) & (np.abs(v) < HALF_V)
        heights = 1e3 * (-(u**2) / (2 * 0.026) + k * (v - GROOVE_AT) ** 2)
        np.testing.assert_allclose(heights[there], level, atol=0.02)


def test_measurements_are_labelled_for_what_they_are(result):
    measured = Measured(result.times, result.center + 1e-3, synthetic=True)
    (ax, *_) = result.plot.trajectory(measured=measured).axes
    line = lines(ax)["centre, synthetic measurements"]
    np.testing.assert_allclose(line.get_xdata(), in_chart(result, measured.center)[1], atol=1e-9)


@pytest.mark.slow
def test_a_mesh_is_drawn_from_where_it_is_touched(on_a_mesh):
    assert on_a_mesh.surface is None
    drawn = relief(on_a_mesh, on_a_mesh.center)
    assert drawn.triangles is not None
    assert drawn.triangles.max() < drawn.u.size
    figure = on_a_mesh.plot.trajectory()
    found = lines(figure.axes[0])
    assert list(found) == ["centre of the button", "contact, medial facet", "contact, lateral facet"]
    u, _ = drawn.place(on_a_mesh.effects["contact"]["center_of_pressure"])  # the plate is one facet, called medial
    np.testing.assert_allclose(found["contact, medial facet"].get_ydata(), u, atol=1e-6)
    assert np.isnan(np.asarray(found["contact, lateral facet"].get_ydata())).all()
    assert len(figure.axes[0].collections) == 2  # filled contours and their lines


def on_coarse_triangles(on_a_mesh):
    """The same motion over a ball of 30 mm of 320 triangles, each wider than the map around the short path."""
    femur, button = contact_mesh(icosphere(0.030, 4)), contact_mesh(icosphere(0.020, 4))
    ball = MeshContact(femur, button, Hertz(J(2e8)), vec(0, 0, 0), None)
    return dataclasses.replace(on_a_mesh, scene=on_a_mesh.scene.with_effect(ball))


def test_coarse_triangles_cover_the_map(on_a_mesh):
    """No triangle lies within the map; those that reach into it are drawn."""
    from matplotlib.tri import Triangulation

    coarse = on_coarse_triangles(on_a_mesh)
    drawn = relief(coarse, coarse.center)
    u, v = drawn.place(coarse.center)
    corners = np.array([[a, b] for a in (u.min() - 5, u.max() + 5) for b in (v.min() - 5, v.max() + 5)])
    find = Triangulation(drawn.v, drawn.u, drawn.triangles).get_trifinder()
    assert (find(corners[:, 1], corners[:, 0]) >= 0).all()
    assert drawn.heights[1] == pytest.approx(30.0, rel=0.05)  # the ball's pole, above its centre
    assert np.ptp(drawn.u) < 50  # not the whole ball
    coarse.plot.trajectory().draw_without_rendering()


def test_a_path_beside_the_mesh_is_drawn_beside_the_whole_of_it(on_a_mesh):
    """As of a patella that flew away in a motion that is INVALID."""
    coarse = on_coarse_triangles(on_a_mesh)
    away = dataclasses.replace(coarse, center=coarse.center + np.array([0.2, 0.2, 0.0]))
    drawn = relief(away, away.center)
    assert np.ptp(drawn.u) == pytest.approx(60.0, rel=0.02)
    away.plot.trajectory().draw_without_rendering()


def test_legend_and_title_lie_beside_the_map(result):
    figure = result.plot.trajectory(measured=Measured(result.times, result.center, synthetic=True))
    figure.draw_without_rendering()
    panel = figure.axes[0].get_window_extent()
    legend = figure.legends[0].get_window_extent()
    assert legend.y1 <= panel.y0
    assert legend.x0 >= 0
    assert legend.x1 <= figure.bbox.x1
    assert figure._suptitle.get_window_extent().y0 >= panel.y1


def test_axes_of_ones_own(result):
    from matplotlib.figure import Figure

    figure = Figure()
    ax = figure.subplots()
    assert result.plot.trajectory(ax=ax) is figure
    assert len(lines(ax)) == 3


def test_a_scene_without_contact_is_refused(result):
    bare = dataclasses.replace(result, contact=None, surface=None, scene=result.scene.without("contact"))
    with pytest.raises(InputError, match="small knee: no contact between a button and a trochlea"):
        bare.plot.trajectory()


def test_that_a_motion_is_synthetic_is_said(result):
    made_up = dataclasses.replace(result, scene=dataclasses.replace(result.scene, synthetic=True))
    for figure in (
        made_up.plot.trajectory(),
        made_up.plot.against_flexion(),
        made_up.plot.compared(_positions(result)),
        case_figure({"P5": made_up}, None, "small knee"),
    ):
        (below,) = footers(figure)
        assert SYNTHETIC in below.get_text().replace("\n", " ")
        figure.draw_without_rendering()
        assert below.get_window_extent().y1 <= figure.legends[0].get_window_extent().y0
        assert "synthetic" not in figure.get_suptitle()
    assert not footers(result.plot.trajectory())


def _positions(result):
    return Measured(result.times, result.center, synthetic=True)
