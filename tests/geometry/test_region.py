"""The trochlear region: found on the parametric component and on a real implant, from rough directions."""

from __future__ import annotations

import math

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation as ScipyRotation

from pftwin.base.errors import InputError
from pftwin.base.written_amounts import AXES
from pftwin.geometry.mesh.mesh import SurfaceMesh, check_mesh, load_mesh
from pftwin.geometry.patch.fit import fit_patch
from pftwin.geometry.patch.groove import fit_axis_direction, fit_circle
from pftwin.geometry.patch.implant import FemoralComponent, rig_implant
from pftwin.geometry.patch.region import directions_with_groove, trochlear_region
from pftwin.results.plots.region import plot_region

_FRONT = {"anterior": (0, 0, 1), "proximal": (1, 0, 0)}
_DM = {"anterior": (-1, 0, 0), "proximal": (0, 1, 0)}


@pytest.fixture(scope="module")
def component() -> SurfaceMesh:
    return rig_implant().mesh(deviation=0.02e-3)


@pytest.fixture(scope="module")
def dm_femur(dm_knee) -> SurfaceMesh:
    return load_mesh(dm_knee / "femoral_component_contact.stl", units="m")


def angle_between(a, b) -> float:
    return math.degrees(math.acos(np.clip(np.dot(a, b) / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))


def test_circle_through_points_of_a_circle():
    t = np.linspace(0.2, 1.9, 30)
    center, radius = fit_circle(np.stack([0.3 + 0.02 * np.cos(t), -0.1 + 0.02 * np.sin(t)], axis=1))
    np.testing.assert_allclose([*center, radius], [0.3, -0.1, 0.02], atol=1e-12)


def test_axis_of_a_surface_of_revolution_is_found():
    t, s = (g.ravel() for g in np.meshgrid(np.linspace(-1.2, 0.4, 60), np.linspace(-0.02, 0.02, 40), indexing="ij"))
    r, slope = 0.025 + 0.003 * np.cos(s / 5e-3), -0.6 * np.sin(s / 5e-3)
    points = np.stack([r * np.sin(t), s, r * np.cos(t)], axis=1)
    normals = np.stack([np.sin(t), -slope, np.cos(t)], axis=1) / np.sqrt(1 + slope**2)[:, None]
    tilt = ScipyRotation.from_rotvec([0.1, 0.0, -0.08]).as_matrix()
    turn = fit_axis_direction(points @ tilt.T, normals @ tilt.T, np.ones(len(t)), np.zeros(2))
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-12)
    assert angle_between([0, 1, 0], tilt[:, 1]) > 5
    assert angle_between(turn[:, 1], tilt[:, 1]) < 1.0


def test_groove_line_follows_that_of_the_parametric_component(component):
    c = rig_implant()
    region = trochlear_region(component, **_FRONT, angles=(-math.radians(45), math.radians(20)))
    angle = np.arctan2(region.groove[:, 0], region.groove[:, 2])
    v = np.linspace(-0.01, 0.01, 2001)
    height = jax.jit(c.height)
    deepest = [v[np.argmin(np.asarray(height(np.full_like(v, a * c.trochlear_radius), v)))] for a in angle]
    assert len(region.groove) >= 10
    assert np.abs(region.groove[:, 1] - deepest).max() < 1.0e-3
    assert region.groove_depth.min() > 1e-3
    assert angle_between(region.cylinder.axes.array()[:, 1], [0, 1, 0]) < 5


def test_region_is_a_rectangle_about_the_groove(component):
    region = trochlear_region(component, **_FRONT, half_width=0.015, angles=(-0.7, 0.3))
    q = region.cylinder.to_frame(_vec(component.vertices[region.mask]))
    angle = np.arctan2(np.asarray(q.x), np.asarray(q.z))
    assert np.abs(np.asarray(q.y)).max() <= 0.015
    assert angle.min() >= -0.7 - 1e-9
    assert angle.max() <= 0.3 + 1e-9
    assert np.ptp(np.asarray(q.y)) > 0.027
    fit = fit_patch(component, degree=5, chart="cylinder", region=region)
    assert fit.coverage == 1
    assert fit.rms < 0.15e-3


def _vec(points: np.ndarray):
    from pftwin.base.spatial import Vec3

    return Vec3.from_array(points)


@pytest.mark.parametrize("turn", [(0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10), (-10, 8, 5)])
def test_rough_directions_give_nearly_the_same_axis(dm_femur, turn):
    q = ScipyRotation.from_rotvec(np.radians(turn)).as_matrix()
    region = trochlear_region(dm_femur, anterior=q @ _DM["anterior"], proximal=q @ _DM["proximal"])
    assert angle_between(region.cylinder.axes.array()[:, 1], [0, 0, -1]) < 2.0
    assert 0.025 < float(region.cylinder.radius) < 0.042


def test_the_region_moves_with_the_mesh(component):
    turn, shift = ScipyRotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix(), np.array([0.3, -0.2, 1.0])
    moved = SurfaceMesh(component.vertices @ turn.T + shift, component.faces)
    here = trochlear_region(component, **_FRONT)
    there = trochlear_region(moved, anterior=turn[:, 2], proximal=turn[:, 0])
    np.testing.assert_allclose(there.groove, here.groove @ turn.T + shift, atol=1e-6)
    assert np.mean(there.mask != here.mask) < 1e-3
    np.testing.assert_allclose(there.cylinder.axes.array(), turn @ here.cylinder.axes.array(), atol=1e-6)


def test_fits_of_the_dm_trochlea(dm_femur):
    region = trochlear_region(dm_femur, **_DM)
    rms = {
        chart: [1e3 * fit_patch(dm_femur, degree=d, chart=chart, region=region).rms for d in (2, 4, 5, 8)]
        for chart in ("plane", "cylinder")
    }
    # another prototype's region was somewhat wider: plane 0.94/0.21/0.20/0.08, cylinder 0.70/0.19/0.15/0.07 mm
    np.testing.assert_allclose(rms["plane"], [0.94, 0.21, 0.20, 0.08], rtol=0.25)
    np.testing.assert_allclose(rms["cylinder"], [0.70, 0.19, 0.15, 0.07], rtol=0.15)
    assert 4e-3 < region.groove_depth.max() < 7e-3
    assert region.angles[0] == pytest.approx(-math.pi / 3)
    assert math.radians(15) < region.angles[1] < math.radians(45)


def test_figure_shows_both_views(component):
    from matplotlib.figure import Figure

    region = trochlear_region(component, **_FRONT)
    figure = plot_region(region, component)
    assert sum(1 for a in figure.axes if a.lines) == 2
    assert any("proximal" in a.get_ylabel() for a in figure.axes)
    ax = Figure().subplots()
    assert plot_region(region, component, ax) is ax.figure
    assert ax.lines


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"anterior": (0, 0, 0)}, "anterior: .* is not a direction"),
        ({"proximal": (1, 0)}, "proximal: .* is not a direction"),
        ({"proximal": (0.05, 0, 1)}, "anterior and proximal are 3 deg apart"),
        ({"anterior": (0, 0, -1)}, "check the anterior and proximal directions"),
        ({"half_width": -1.0}, "a positive width"),
        ({"angles": (1.0, -1.0)}, "ascending angles"),
        ({"anterior": (0, 1, 0), "proximal": (1, 0, 0)}, "anterior"),
    ],
)
def test_bad_arguments(component, arguments, message):
    with pytest.raises(InputError, match=message):
        trochlear_region(component, **{**_FRONT, **arguments})


def test_inward_normals_are_noticed(component):
    with pytest.raises(InputError, match=r"normals .* point backward.*mesh\.flipped\(\)"):
        trochlear_region(component.flipped(), **_FRONT)


@pytest.mark.parametrize("anterior", ["-y", "-z"])
def test_directions_that_see_hardly_any_surface_are_refused(dm_femur, anterior):
    """Seen from behind or from below: nothing faces away from the axis, or the search ends in a single section."""
    with pytest.raises(InputError, match="anterior"):
        trochlear_region(dm_femur, anterior=AXES[anterior], proximal=(-1, 0, 0))


def test_the_right_directions_are_among_the_candidates(dm_femur, component):
    for mesh, right in ((dm_femur, ("-x", "+y")), (component, ("+z", "+x"))):
        first, *others = directions_with_groove(mesh)
        assert (first.anterior, first.proximal) == right
        assert len(others) <= 3
        assert all(len(c.region.groove) >= 5 for c in others)


def test_a_box_has_no_directions_with_a_groove():
    import trimesh

    box = trimesh.creation.box((0.05, 0.06, 0.05)).subdivide_to_size(0.002)
    assert directions_with_groove(check_mesh(box.vertices, box.faces)) == []


def test_a_bent_sheet_has_none_either():
    """Its normals lie in a plane, so that nothing tells an axis across them."""
    t, y = (g.ravel() for g in np.meshgrid(np.linspace(-1.2, 1.2, 50), np.linspace(-0.03, 0.03, 30), indexing="ij"))
    points = np.stack([0.025 * np.sin(t), y, 0.025 * np.cos(t)], axis=1)
    corner = (30 * np.arange(49)[:, None] + np.arange(29)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 30, corner + 31], 1), np.stack([corner, corner + 31, corner + 1], 1)]
    )
    sheet = check_mesh(points, faces)
    assert (sheet.face_areas > 0).all()
    assert directions_with_groove(sheet) == []
    with pytest.raises(InputError, match=r"mesh.*: what faces away .* cylindrical sheet"):
        trochlear_region(sheet if sheet.vertex_normals[0] @ points[0] > 0 else sheet.flipped(), **_FRONT)


@pytest.mark.slow
def test_a_cylinder_has_no_groove():
    smooth = FemoralComponent(
        sulcus_angle=math.radians(179.8), sulcus_angle_proximal=math.radians(179.8), notch_depth=0
    )
    with pytest.raises(InputError, match="no trochlear groove found"):
        trochlear_region(smooth.mesh(deviation=0.02e-3), **_FRONT)


def test_a_mesh_far_too_coarse(component):
    import trimesh

    box = trimesh.creation.box((0.05, 0.06, 0.05))
    with pytest.raises(InputError, match="use a finer mesh"):
        trochlear_region(check_mesh(box.vertices, box.faces), **_FRONT)
