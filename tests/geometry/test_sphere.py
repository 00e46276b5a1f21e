"""The button's sphere: radius and reach of the spherical cap, on made-up buttons and a real one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation as ScipyRotation

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.mesh import SurfaceMesh, check_mesh, load_mesh
from pftwin.geometry.patch.sphere import fit_sphere


def revolved(reach: np.ndarray, height: np.ndarray, n: int = 72) -> SurfaceMesh:
    """A surface of revolution about z, its profile given from the apex on; outside is above the apex."""
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rings = np.stack(
        [np.outer(reach[1:], np.cos(t)), np.outer(reach[1:], np.sin(t)), np.repeat(height[1:, None], n, 1)], axis=2
    )
    k = 1 + np.arange(n * (len(reach) - 1)).reshape(-1, n)
    after = np.roll(k, -1, axis=1)
    cap = np.stack([np.zeros(n, int), k[0], after[0]], axis=1)
    a, b, c, d = k[:-1].ravel(), k[1:].ravel(), after[1:].ravel(), after[:-1].ravel()
    faces = np.concatenate([cap, np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    vertices = np.concatenate([[[0, 0, height[0]]], rings.reshape(-1, 3)])
    return check_mesh(vertices, faces)


def button(radius: float = 0.02, cap: float = 0.011, rim: float = 0.016, back: bool = False) -> SurfaceMesh:
    """A dome that is a sphere about the origin up to `cap` from its axis, then flares upward."""
    r = np.linspace(0, rim, 61)
    h = np.sqrt(radius**2 - r**2) + np.where(r > cap, 60 * (r - cap) ** 2, 0)
    if back:
        r, h = np.r_[r, np.linspace(rim, 1e-4, 40)[1:]], np.r_[h, np.full(39, h[-1] - 1e-3)]
    return revolved(r, h)


def moved(mesh: SurfaceMesh) -> tuple[SurfaceMesh, np.ndarray, np.ndarray]:
    turn, shift = ScipyRotation.from_rotvec([1.0, -0.4, 0.3]).as_matrix(), np.array([0.4, -0.1, 0.2])
    return SurfaceMesh(mesh.vertices @ turn.T + shift, mesh.faces), turn[:, 2], shift


@pytest.mark.parametrize("back", [False, True])
def test_cap_and_radius_of_a_flared_button(back):
    mesh, axis, center = moved(button(back=back))
    fit = fit_sphere(mesh)
    assert fit.axis @ axis > 0.99
    assert fit.radius == pytest.approx(0.02, abs=5e-6)
    assert fit.cap_radius == pytest.approx(0.0115, abs=0.7e-3)  # 0.02 mm above the sphere at 0.58 mm past its end
    np.testing.assert_allclose(fit.center, center, atol=1e-5)
    assert fit.rms < 0.02e-3
    assert fit.cap_half_angle == pytest.approx(np.arcsin(fit.cap_radius / fit.radius))
    assert "radius 20.0" in str(fit)


def test_a_button_that_is_all_sphere():
    fit = fit_sphere(button(cap=1.0))
    assert fit.radius == pytest.approx(0.02, rel=1e-9)
    assert fit.cap_radius == pytest.approx(0.016, rel=1e-6)
    assert fit.max_error < 1e-12


def test_a_whole_sphere():
    import trimesh

    ball = trimesh.creation.icosphere(3, 0.021)
    fit = fit_sphere(check_mesh(np.asarray(ball.vertices) + np.array([0.1, 0.0, 0.2]), ball.faces))
    assert fit.radius == pytest.approx(0.021, rel=1e-9)
    assert fit.cap_half_angle == np.pi
    assert fit.cap_radius == pytest.approx(0.021)


def test_noise_needs_and_gets_a_larger_tolerance():
    mesh = button()
    noisy = SurfaceMesh(
        mesh.vertices + np.random.default_rng(0).normal(0, 0.03e-3, mesh.vertices.shape), mesh.faces, "scan.stl"
    )
    with pytest.raises(InputError, match=r"scan\.stl: no spherical cap.*a larger tolerance="):
        fit_sphere(noisy)
    fit = fit_sphere(noisy, tolerance=0.06e-3)
    assert fit.radius == pytest.approx(0.02, abs=0.2e-3)
    assert 0.010 < fit.cap_radius < 0.013


def test_the_real_button(dm_knee):
    fit = fit_sphere(load_mesh(dm_knee / "patellar_button_contact.stl", units="m"))
    assert fit.radius == pytest.approx(19.05e-3, abs=2e-6)
    assert fit.cap_radius == pytest.approx(10e-3, abs=0.2e-3)
    assert fit.rms < 5e-6
    np.testing.assert_allclose(fit.center, [-8.435e-3, 0, 0], atol=5e-6)
    assert fit.axis[0] > 0.99


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tolerance": 0.0}, "tolerance: .*a positive length"),
        ({"axis": (0, 0, 0)}, "axis: .* is not a direction"),
        ({"axis": (0, 0, -1)}, "only 0 vertices on the apex's side"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(InputError, match=message):
        fit_sphere(button(), **arguments)


def test_shapes_that_are_no_dome():
    with pytest.raises(InputError, match="hollow, or its normals point inward"):
        fit_sphere(button().flipped())
    r = np.linspace(0, 0.02, 40)
    with pytest.raises(InputError, match="flat"):
        fit_sphere(revolved(r, np.zeros(40)))
    with pytest.raises(InputError, match="no spherical cap"):
        fit_sphere(revolved(r, 0.01 - 0.9 * r))
