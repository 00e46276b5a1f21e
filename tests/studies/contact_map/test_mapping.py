"""A contact map of a flat button beside the middle of its frame, turned: forces and moments in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from height_meshes import plate
from pressed_button import disc
from scipy.spatial.transform import Rotation as Turn

from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer
from pftwin.studies.contact_map.mapping import ContactMap, map_contact, status

ASIDE = np.array([0.004, -0.003, 0.002])  # of the button from its frame's origin
BUTTON = disc(0.0)
AT, QUARTER = np.array([0.002, 0.005]), Turn.from_rotvec([0, 0, np.pi / 2])
DEPTHS = np.array([2e-4, 3e-4, -5e-4, -2e-3, 4.9e-3, 5.1e-3])
STIFFNESS = 1 / (1e-3 / 10e6 + 8e-3 / 40e6)  # of two layers in series, confined [Pa/m]


@pytest.fixture(scope="module")
def found() -> ContactMap:
    """The button looks down on a plate, turned by a quarter about its axis, and goes down."""
    button = SurfaceMesh(BUTTON.vertices + ASIDE, BUTTON.faces, "aside")
    n = len(DEPTHS)
    positions = np.column_stack([np.tile(AT, (n, 1)), -DEPTHS - ASIDE[2]])
    turns = np.tile(QUARTER.as_quat(scalar_first=True), (n, 1))
    law = LinearFoundation(checked_layer(10e6, 0.0, 1e-3), checked_layer(40e6, 0.0, 8e-3))
    poses = PoseSeries(0.1 * np.arange(n), positions, turns)
    return map_contact(pressed_surface(plate(8)), pressing_surface(button), law, poses, triangles=len(button.faces))


TOUCHING = DEPTHS > 0
MIDDLE = QUARTER.apply(ASIDE)[:2] + AT  # of the button, femur frame


def test_the_force_is_stiffness_times_area_times_depth(found):
    expected = STIFFNESS * BUTTON.area * np.maximum(DEPTHS, 0)
    np.testing.assert_allclose(found.force[:, 2], expected, rtol=1e-6)
    np.testing.assert_allclose(found.force[:, :2], 0, atol=1e-9)


def test_its_moment_is_about_the_origin_of_the_patellas_frame(found):
    """In femur axes: the arm is the button's, turned by a quarter: (0.003, 0.004)."""
    force = STIFFNESS * BUTTON.area * np.maximum(DEPTHS, 0)
    x, y = 0.003, 0.004
    np.testing.assert_allclose(found.moment, np.outer(force, [y, -x, 0.0]), rtol=1e-6, atol=1e-9)


def test_the_centre_of_pressure_is_the_buttons_middle_in_either_frame(found):
    centre, own = found.center_of_pressure[TOUCHING], found.center_on_patella[TOUCHING]
    np.testing.assert_allclose(centre[:, :2], np.tile(MIDDLE, (TOUCHING.sum(), 1)), rtol=1e-6)
    np.testing.assert_allclose(centre[:, 2], -DEPTHS[TOUCHING], rtol=1e-6)
    np.testing.assert_allclose(own, np.tile(ASIDE, (TOUCHING.sum(), 1)), rtol=1e-6)
    assert np.isnan(found.center_of_pressure[~TOUCHING]).all()


def test_pressures_and_areas(found):
    np.testing.assert_allclose(found.area, np.where(TOUCHING, BUTTON.area, 0), rtol=1e-9)
    for pressure in (found.mean_pressure, found.max_pressure):
        np.testing.assert_allclose(pressure, STIFFNESS * np.maximum(DEPTHS, 0), rtol=1e-6)
    np.testing.assert_allclose(found.pressure, np.tile(found.max_pressure[:, None], len(BUTTON.faces)), rtol=1e-6)


def test_depths_are_reported_down_to_the_band(found):
    """A millimetre outside by default: 0.5 mm apart is told, 2 mm is not."""
    np.testing.assert_allclose(found.largest_depth, np.maximum(DEPTHS, 0), atol=1e-12)
    expected = np.where(DEPTHS > -1e-3, DEPTHS, np.nan)
    np.testing.assert_allclose(found.depth, np.tile(expected[:, None], len(BUTTON.faces)), rtol=1e-5)


def test_deeper_than_five_millimetres_is_too_deep(found):
    assert found.touching.tolist() == [True, True, False, False, True, True]
    assert found.too_deep.tolist() == [False, False, False, False, False, True]
    assert status(found).tolist() == [0, 0, 1, 1, 0, 2]
