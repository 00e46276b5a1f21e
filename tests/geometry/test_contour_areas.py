"""Contours of boxes in a plate of two facets: their areas, middles and depths are known exactly."""

from __future__ import annotations

import equinox as eqx
import numpy as np
import pytest
from height_meshes import lateral, plate
from mesh_contacts import at, mesh_pair

from pftwin.base.spatial import Pose
from pftwin.geometry.contact.contact_mesh import contact_mesh
from pftwin.geometry.contact.contour import Contacts, MeshPair
from pftwin.geometry.mesh.mesh import SurfaceMesh

PLATE = plate(9)
TURN = (0.0, 0.0, 0.3)  # about the vertical: no edge of a box along one of the plate's
SIDES = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
                  [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]])  # fmt: skip


def box(middle: tuple[float, float], half: tuple[float, float], bottom: float) -> np.ndarray:
    """Corners of a box of 10 mm height [m]."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(half) + np.array(middle)
    return np.concatenate([np.column_stack([square, np.full(4, z)]) for z in (bottom, bottom + 0.01)])


def boxes(*corners: np.ndarray) -> MeshPair:
    faces = np.concatenate([SIDES + 8 * k for k in range(len(corners))])
    mesh = SurfaceMesh(np.concatenate(corners), faces, "boxes")
    return mesh_pair(contact_mesh(PLATE, lateral(PLATE)), contact_mesh(mesh))


@eqx.filter_jit
def contacts(pair: MeshPair, X: Pose) -> Contacts:
    return pair.contacts(X)


@pytest.fixture(scope="module")
def two() -> MeshPair:
    """One of 6 x 4 mm at y = -8 mm, and one of 3 x 5 mm at y = 8 mm that reaches 0.1 mm deeper."""
    return boxes(box((0.002, -0.008), (3e-3, 2e-3), 0.0), box((-0.001, 0.008), (1.5e-3, 2.5e-3), -1e-4))


EXPECTED = ((24e-6, 3e-4, (0.002, -0.008)), (15e-6, 4e-4, (-0.001, 0.008)))


def placed(x: float, y: float) -> np.ndarray:
    """A box's middle after the turn."""
    c, s = np.cos(TURN[2]), np.sin(TURN[2])
    return np.array([c * x - s * y, s * x + c * y])


LEAN = np.sqrt(3)  # depths go along a corner's own normal, which at a box leans towards all three of its sides


def check(contact, area: float, depth: float, place: np.ndarray) -> None:
    assert float(contact.area) == pytest.approx(area, rel=1e-9)
    assert float(contact.indentation) == pytest.approx(LEAN * depth, rel=1e-9)
    np.testing.assert_allclose(contact.normal.array(), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(contact.point.array(), [*place, 0], atol=1e-9)


def test_each_facet_has_the_contour_that_lies_on_it(two):
    found = contacts(two, at(0.0, 0.0, -3e-4, TURN))
    assert not found.merged
    assert not found.at_rim
    assert not found.overflow
    assert not found.too_deep
    for contact, (area, depth, middle) in zip(found.each, EXPECTED, strict=True):
        check(contact, area, depth, placed(*middle))


def test_one_contact_is_its_own_facets_alone(two):
    """0.05 mm above the plate the shorter box is clear of it."""
    found = contacts(two, at(0.0, 0.0, 5e-5, TURN))
    medial, side = found.each
    check(side, 15e-6, 5e-5, placed(-0.001, 0.008))
    assert float(medial.area) == float(medial.indentation) == 0
    np.testing.assert_array_equal(medial.normal.array(), 0)
    assert not found.merged


def test_a_contour_across_the_border_is_one_contact_of_the_whole_area(two):
    """The larger box on the border, the other one 16 mm away beyond it: both are one, of both areas."""
    found = contacts(two, at(0.0, 0.008, -3e-4, (0.0, 0.0, 0.0)))
    one, other = found.each
    assert found.merged
    assert float(other.area) == float(other.indentation) == 0
    assert float(one.area) == pytest.approx(39e-6, rel=1e-9)
    assert float(one.indentation) == pytest.approx(LEAN * 4e-4, rel=1e-9)
    # Middles by the contours' lengths: 20 mm and 16 mm.
    y = (20 * 0.0 + 16 * 0.016) / 36
    np.testing.assert_allclose(one.point.array(), [(20 * 0.002 - 16 * 0.001) / 36, y, 0], atol=1e-9)


@pytest.mark.parametrize("aside", [0.0, 0.0285])
def test_a_contour_that_the_rim_cuts_says_so(two, aside):
    """The plate ends at x = 30 mm."""
    found = contacts(two, at(aside, 0.0, -3e-4, (0.0, 0.0, 0.0)))
    assert bool(found.at_rim) is (aside > 0)
