"""The figure of a contact map: the femur's surface is shaded, sides are named, legends cover no curve."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from height_meshes import grid
from pressed_button import disc
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from pftwin.cli.contact_map import _in_both_frames
from pftwin.cli.program import app
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.results.plots.style import TEXT
from pftwin.studies.contact_map.figures import map_figure
from pftwin.studies.contact_map.mapping import ContactMap

FEMUR = grid(lambda u, v: 5 * u * u - 0 * v, 9)  # a trough along y that looks along +z
BUTTON = disc(0.0)


def made_up(towards: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> ContactMap:
    """Five frames of a force on the patella that grows, along a direction."""
    n, t = 5, np.linspace(0, 1, 5)
    center = np.stack([0.001 * t, 0.01 * t, 0 * t], axis=1)
    pressure = np.tile(np.linspace(0, 1e6, len(BUTTON.faces), dtype=np.float32), (n, 1))
    force = (1 + t)[:, None] * np.array(towards)
    one = np.ones(n)
    return ContactMap(
        t, 100 * force, force, 1e-4 * one, 1e5 * (1 + t), 1e6 * (1 + t), center, center, 1e-4 * one, 0 * pressure,
        pressure,
    )  # fmt: skip


def panel(figure, words):
    return next(ax for ax in figure.axes if words in ax.get_xlabel() or words in ax.get_ylabel())


def test_the_femur_is_a_shaded_surface():
    ax = panel(map_figure(made_up(), FEMUR, BUTTON, "made up"), "femur")
    (shaded,) = (c for c in ax.collections if c.get_label() == "femur")
    greys = shaded.get_facecolor()[:, 0]
    assert len(greys) == len(FEMUR.faces)  # all of them face the viewer
    corners = np.array([path.vertices[:3] for path in shaded.get_paths()])
    steep = np.abs(corners.mean(axis=1)[:, 0])
    assert np.corrcoef(steep, greys)[0, 1] < -0.9  # the steeper, the darker
    behind = SurfaceMesh(FEMUR.vertices, FEMUR.faces[:, ::-1], "turned over")
    ax = panel(map_figure(made_up(), behind, BUTTON, "made up"), "femur")
    assert not [path for c in ax.collections if c.get_label() == "femur" for path in c.get_paths()]


@pytest.mark.parametrize(("towards", "right"), [((0, 0, 1), "lateral"), ((0, 0, -1), "medial")])
def test_sides_are_named_as_they_are_seen(towards, right):
    """Lateral is +x: to the right seen from above; to the left from below, where x runs leftwards."""
    lateral = np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])
    figure = map_figure(made_up(towards), FEMUR, BUTTON, "made up", lateral=lateral)
    on_femur = panel(figure, "femur")
    assert on_femur.get_xlabel().splitlines()[0] == "femur x [mm]"
    assert on_femur.get_xlabel().endswith(right)
    assert on_femur.xaxis_inverted() == (right == "medial")
    assert panel(figure, "patella").xaxis_inverted()  # the disc looks along -z
    assert panel(figure, "patella").get_xlabel().endswith("lateral")  # there +x is medial, and to the left
    plain = map_figure(made_up(towards), FEMUR, BUTTON, "made up")
    assert not [ax for ax in plain.axes if "medial" in ax.get_xlabel()]


TURNS = [(0, 0), (180, 0), (90, 0), (-90, 0), (0, 90), (0, -90)]


@pytest.mark.parametrize(
    ("angles", "closed"),
    [(turn, k % 2 == 0) for k, turn in enumerate(TURNS)]
    + [pytest.param(turn, k % 2 == 1, marks=pytest.mark.slow) for k, turn in enumerate(TURNS)],
)
def test_the_button_is_seen_from_the_side_that_is_pressed(angles, closed):
    """Corners of its cap run counter-clockwise about normals towards the viewer, and must do so on the paper."""
    turn = Rotation.from_euler("xy", angles, degrees=True)
    cap = BUTTON.faces
    behind = cap[:, ::-1] if closed else cap[:0]  # the same triangles, from below: its area vectors sum to nothing
    button = SurfaceMesh(turn.apply(BUTTON.vertices), np.concatenate([cap, behind]), "turned")
    found = made_up()
    pressure = np.concatenate([found.pressure, np.zeros((5, len(behind)), dtype=np.float32)], axis=1)
    figure = map_figure(dataclasses.replace(found, pressure=pressure), FEMUR, button, "made up")
    ax = panel(figure, "patella")
    figure.draw_without_rendering()
    (cells,) = ax.collections
    for path in cells.get_paths()[: len(cap)]:
        (ax_, ay), (bx, by), (cx, cy) = ax.transData.transform(path.vertices[:3])
        assert (bx - ax_) * (cy - ay) - (by - ay) * (cx - ax_) > 0


def test_a_direction_in_the_patellas_frame():
    turned = Rotation.from_euler("z", 90, degrees=True).as_quat(scalar_first=True)
    poses = PoseSeries(np.arange(3.0), np.zeros((3, 3)), np.tile(turned, (3, 1)))
    there, here = _in_both_frames((1.0, 0.0, 0.0), poses)
    np.testing.assert_allclose(there, [1, 0, 0])
    np.testing.assert_allclose(here, [0, -1, 0], atol=1e-12)


def test_legends_lie_above_their_panels():
    figure = map_figure(made_up(), FEMUR, BUTTON, "made up")
    figure.draw_without_rendering()
    found = [(ax.get_legend().get_window_extent(), ax.get_window_extent()) for ax in figure.axes if ax.get_legend()]
    assert len(found) == 2
    assert all(legend.y0 >= box.y1 for legend, box in found)
    legends = [ax.get_legend().get_title() for ax in figure.axes if ax.get_legend()]
    assert {t.get_fontsize() for t in legends} == {TEXT}  # as the titles of the other panels
    titles = [ax.get_title("left") for ax in figure.axes]
    assert [t.get_text() for t in legends] == ["Contact force on the patella, femur axes", "Pressure"]
    assert {"Contact area", "Centre of pressure on the femur"} < set(titles)


def test_an_axis_that_is_none_is_refused(tmp_path):
    names = ("--femur", "--patella", "--poses")
    files = [x for name in names for x in (name, str(tmp_path / "absent"))]
    command = ["contact-map", *files, "--units", "m"]
    result = CliRunner().invoke(app, [*command, "--lateral", "sideways", "--figure", str(tmp_path / "map.png")])
    assert result.exit_code == 2
    assert "--lateral: found 'sideways'" in result.output
    result = CliRunner().invoke(app, [*command, "--lateral=-z"])
    assert result.exit_code == 2
    assert "--lateral: names the sides of a figure, and none is drawn" in result.output
