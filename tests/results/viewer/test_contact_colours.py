"""Colours of contact on the femur, against depths known in closed form and those that the simulation reports."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pressed_button import DOME, disc, pressed
from small_scene import small_result

from pftwin.results.scene_geometry import geometry
from pftwin.results.viewer import view
from pftwin.results.viewer.assembly import plot
from pftwin.results.viewer.bones import METAL, depths_on_femur
from pftwin.results.viewer.recorded import Recorded

pytest.importorskip("k3d", reason="the viewer needs the extra `viewer`")
RADIUS = 20.0  # [mm]


def below_the_button(recorded: Recorded, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Points about the button of the fifth frame [mm], and how deep they are in a ball of 20 mm about its centre."""
    rng = np.random.default_rng(3)
    way = rng.normal(size=(200, 3)) * [1, 1, 0] + [0, 0, -4]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    at = RADIUS - depth * np.linspace(-1, 1, 200)
    pose = recorded.patella[5].astype(float)
    local = 1e3 * recorded.geometry["button_center"].values + at[:, None] * way
    return local @ pose[:3, :3].T + pose[:3, 3], np.maximum(RADIUS - at, 0.0)


@pytest.mark.parametrize("mesh", [False, True])
def test_a_ball_covers_points_by_their_distance_from_its_centre(mesh):
    from trimesh.creation import icosphere

    recorded = Recorded.of(small_result())
    geometry = recorded.geometry.copy()
    geometry["button_radius"] = geometry["button_radius"] * 0 + 1e-3 * RADIUS
    if mesh:
        ball = icosphere(subdivisions=5, radius=1e-3 * RADIUS)
        geometry["button_vertices"] = (("v", "axis"), ball.vertices + geometry["button_center"].values)
        geometry["button_triangles"] = (("t", "corner"), ball.faces)
    recorded = dataclasses.replace(recorded, geometry=geometry)
    points, expected = below_the_button(recorded, 0.8)
    found = depths_on_femur(recorded, points)
    assert found.shape == (len(recorded.times), 200)
    np.testing.assert_allclose(found[5], expected, atol=0.025)  # 0.02 mm are taken for nothing
    assert np.abs(found[20] - expected).max() > 0.1  # elsewhere in another frame


def test_a_knee_without_contact_has_no_colours():
    recorded = Recorded.of(small_result())
    assert depths_on_femur(recorded, np.array([[0.0, 0.0, 900.0]])) is None
    bare = recorded.geometry.drop_vars(["button_center", "button_radius"])
    assert depths_on_femur(dataclasses.replace(recorded, geometry=bare), np.zeros((1, 3))) is None


def test_the_drawing_is_as_deep_as_the_simulation():
    """The small knee's button sinks in by fractions of a millimetre."""
    result = small_result()
    soft = dataclasses.replace(result, position=result.position - [0, 0, 0.0005])  # 0.5 mm farther in
    surface = next(o for o in view(soft).objects if o.name == "femoral surface")
    deepest = np.array([values.max() for values in surface.attribute.values()])
    assert surface.color_range[1] == pytest.approx(deepest.max(), rel=1e-6)
    contact = result.effects["contact"]
    reported = 1e3 * np.maximum(contact["indentation_medial"], contact["indentation_lateral"])
    # Pushed back, not along the surface's normal, and seen at the grid's vertices.
    assert (deepest > reported).all()
    assert (deepest < reported + 0.5 + 0.02).all()


def test_knees_side_by_side_have_one_scale_and_their_own_bones():
    result = small_result()
    deep, deeper = (dataclasses.replace(result, position=result.position - [0, 0, d]) for d in (0.0005, 0.001))
    drawn = view({"one": deep, "two": deeper}, side_by_side=True)
    surfaces = [o for o in drawn.objects if o.name == "femoral surface"]
    assert surfaces[0].color_range == surfaces[1].color_range
    deepest = [max(v.max() for v in o.attribute.values()) for o in surfaces]
    assert surfaces[0].color_range[1] == pytest.approx(max(deepest), rel=1e-6)
    assert deepest[1] > deepest[0] + 0.3
    aside = [o.model_matrix[1, 3] for o in surfaces]
    assert aside[0] == -aside[1] > 30  # the first lateral, on the left from before
    patellae = [o for o in drawn.objects if o.name == "patella (schematic)"]
    for o, motion, way in zip(patellae, (deep, deeper), aside, strict=True):
        np.testing.assert_allclose(o.model_matrix["0.1000"][:3, 3], 1e3 * motion.position[10] + [0, way, 0], atol=1e-3)
    assert [o.name for o in drawn.objects].count("femur (schematic)") == 2


def test_a_legend_of_colours_has_a_colour_bar():
    """It starts with the colour of a component without contact, as METAL is drawn; overlaid knees have no colours."""
    result = small_result()
    deep = dataclasses.replace(result, position=result.position - [0, 0, 0.0005])
    for drawn, bars in ((view(deep), 1), (view({"one": deep, "two": result}), 0)):
        legend = next(o.text for o in drawn.objects if o.name == "legend")
        assert legend.count("linear-gradient") == legend.count("Colours on the femur") == bars
        assert legend.upper().count(f"{METAL},#F2C14E 25%,#E4572E 60%,#7A0C2E 100%") == bars


def test_layers_tell_their_pressure_at_a_depth():
    """Two layers of 3 mm, E 20 MPa, nu 0.4: confined moduli in series."""
    values = geometry(pressed(disc(1 / DOME)))["pressure"]
    stiffness = 20e6 * 0.6 / (1.4 * 0.2) / 6e-3
    np.testing.assert_allclose(values, stiffness * values["pressed_depth"], rtol=1e-6)
    assert "pressure" not in small_result().geometry()


def test_where_the_contact_tells_pressure_colours_are_of_it():
    """A law of 3 MPa/mm in the place of the small knee's; beside a knee without one, both are coloured by depth."""
    result = small_result()
    deep = dataclasses.replace(result, position=result.position - [0, 0, 0.0005])
    by_depth, values = Recorded.of(deep), deep.geometry()
    values["pressure"] = ("pressed_depth", 3e9 * np.array([0.0, 5e-3]))
    values["pressed_depth"] = [0.0, 5e-3]
    by_pressure = dataclasses.replace(by_depth, geometry=values)
    for results, unit, factor in (([by_pressure], "MPa", 3.0), ([by_pressure, by_depth], "mm", 1.0)):
        drawn, _ = plot(results, side_by_side=True)
        plain, _ = plot([by_depth])
        one, other = (next(o for o in d.objects if o.name == "femoral surface") for d in (drawn, plain))
        np.testing.assert_allclose(one.attribute["0.1000"], factor * other.attribute["0.1000"], rtol=1e-5)
        assert f"up to {one.color_range[1]:.2g}\u00a0{unit}." in next(
            o.text for o in drawn.objects if o.name == "legend"
        )
