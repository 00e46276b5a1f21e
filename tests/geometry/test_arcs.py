"""Points of a taut line on its obstacle: on the surface, tangent where they begin and end, as long as the line says."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion
from pftwin.geometry.wrapping.cylinder import Cylinder
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.geometry.wrapping.sphere import Sphere

R, RADII = 0.03, np.array([0.02, 0.035, 0.013])
CENTER, TURN = np.array([0.004, -0.003, 0.002]), Rotation.from_rotvec([0.3, -0.5, 0.8])
AXIS = np.array([0.3, -0.5, 0.8])


def cylinder(side: Any = None, axis: Any = AXIS, center: Any = CENTER) -> Cylinder:
    return Cylinder(vector(center), "femur", number(R), vector(axis), None if side is None else vector(side))


def ellipsoid(radii: Any = RADII) -> Ellipsoid:
    q = Quaternion(*(number(c) for c in TURN.as_quat(scalar_first=True)))
    return Ellipsoid(vector(CENTER), "femur", vector(radii), q)


@partial(jax.jit, static_argnums=3)
def _both(obstacle: Obstacle, start, end, count):
    return obstacle.around(start, end).length, obstacle.arc(start, end, count).array()


LINES = 400
COUNT = 21  # of points, where any number would do: one program of each kind of obstacle


def both(obstacle: Obstacle, start: Any, end: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (n,), and points (count, n, 3), of lines between points (n, 3); the program is of as many for all n."""
    n, places = len(start), [np.asarray(p, float) for p in (start, end)]
    whole = [vector(np.concatenate([p, np.repeat(p[:1], LINES - n, axis=0)])) for p in places]
    length, points = _both(obstacle, *whole, count)
    return np.asarray(length)[:n], np.asarray(points)[:, :n]


def off_cylinder(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the surface, and outward normals, by the definition of a cylinder."""
    axis = AXIS / np.linalg.norm(AXIS)
    across = points - CENTER - ((points - CENTER) @ axis)[..., None] * axis
    far = np.linalg.norm(across, axis=-1, keepdims=True)
    return far[..., 0] - R, across / far


def off_sphere(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the surface, and outward normals, by the definition of a sphere."""
    far = np.linalg.norm(points - CENTER, axis=-1, keepdims=True)
    return far[..., 0] - R, (points - CENTER) / far


def off_ellipsoid(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the surface to first order, and outward normals, by the equation of an ellipsoid."""
    local = (points - CENTER) @ TURN.as_matrix()
    slope = 2 * local / RADII**2
    size = np.linalg.norm(slope, axis=-1, keepdims=True)
    return ((local**2 / RADII**2).sum(axis=-1) - 1) / size[..., 0], (slope / size) @ TURN.as_matrix().T


def ends(obstacle: Obstacle, seed: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Ends of lines that wrap, by at least 2 mm."""
    rng = np.random.default_rng(seed)
    start, end = rng.uniform(-0.06, 0.06, (2, LINES, 3))
    outside = [np.asarray(obstacle.depth(vector(p))) < -1e-3 for p in (start, end)]
    start, end = start[outside[0] & outside[1]], end[outside[0] & outside[1]]
    long = both(obstacle, start, end, COUNT)[0] > np.linalg.norm(end - start, axis=1) + 2e-3
    assert long.sum() >= 10
    return start[long], end[long]


CASES = {
    "cylinder": (cylinder(), off_cylinder),
    "cylinder's side": (cylinder((1.0, 0.2, 0.1)), off_cylinder),
    "ellipsoid": (ellipsoid(), off_ellipsoid),
    "sphere": (Sphere(vector(CENTER), "femur", number(R)), off_sphere),
}


@pytest.mark.parametrize(("obstacle", "off"), CASES.values(), ids=CASES)
def test_points_are_on_the_surface_where_the_line_is_tangent_to_it(obstacle, off):
    start, end = ends(obstacle)
    _, points = both(obstacle, start, end, COUNT)
    distance, normal = off(points)
    assert np.abs(distance).max() < 1e-12
    for tangent, at in ((points[0] - start, normal[0]), (end - points[-1], normal[-1])):
        assert np.abs(np.einsum("ij,ij->i", tangent, at)).max() < 1e-12
    # It goes on where it touches: from the tangent into the arc, and out of it.
    fine = both(obstacle, start, end, 2001)[1]
    for tangent, first in ((fine[0] - start, fine[1] - fine[0]), (end - fine[-1], fine[-1] - fine[-2])):
        cosine = np.einsum("ij,ij->i", tangent, first)
        np.testing.assert_allclose(
            cosine / np.prod([np.linalg.norm(v, axis=1) for v in (tangent, first)], 0), 1, atol=2e-6
        )


@pytest.mark.parametrize(("obstacle", "off"), CASES.values(), ids=CASES)
def test_chords_between_the_points_are_as_long_as_the_line_but_for_the_sampling(obstacle, off):
    """Chords of an arc are too short by the square of their length."""
    start, end = ends(obstacle)
    lack = []
    for count in (21, 41):
        length, points = both(obstacle, start, end, count)
        chain = np.concatenate([start[None], points, end[None]])
        lack.append(length - np.linalg.norm(np.diff(chain, axis=0), axis=2).sum(axis=0))
        assert (lack[-1] > 0).all()
        assert (lack[-1] < 2e-3 * length).all()
    np.testing.assert_allclose(lack[0] / lack[1], 4, rtol=0.02)


def test_half_way_round_a_cylinder_it_is_a_helix():
    # From (3 cm, -4 cm) to (-3 cm, -4 cm) over the far side: tangents of 4 cm along y, half a turn.
    start, end = np.array([[R, -0.04, 0.0]]), np.array([[-R, -0.04, 0.05]])
    _, points = both(cylinder((0, 1, 0), (0, 0, 2), (0, 0, 0)), start, end, 5)
    angle = np.linspace(0, np.pi, 5)
    height = 0.05 * (0.04 + R * angle) / (0.08 + np.pi * R)
    np.testing.assert_allclose(points[:, 0], np.stack([R * np.cos(angle), R * np.sin(angle), height], 1), atol=1e-15)


def test_on_a_sphere_it_is_a_great_circle():
    sphere = ellipsoid((0.025, 0.025, 0.025))
    start, end = ends(sphere, 2)
    from_center = both(sphere, start, end, COUNT)[1] - CENTER
    np.testing.assert_allclose(np.linalg.norm(from_center, axis=-1), 0.025, rtol=1e-12)
    plane = np.cross(start - CENTER, end - CENTER)
    plane /= np.linalg.norm(plane, axis=1)[:, None]
    assert np.abs(np.einsum("ijk,jk->ij", from_center, plane)).max() < 1e-8


@pytest.mark.parametrize("obstacle", [cylinder(), ellipsoid()])
def test_there_are_none_where_the_line_is_straight(obstacle):
    """Clear of the obstacle, away from it, and from an end within it."""
    start = [[0.09, 0.05, 0.0], [0.05, 0.06, 0.05], CENTER]
    end = [[0.09, -0.05, 0.01], [0.1, 0.12, 0.1], [0.09, 0.05, 0.0]]
    assert np.isnan(both(obstacle, start, end, COUNT)[1]).all()


def test_lines_over_obstacles_of_their_own_are_as_each_alone():
    radii = np.array([0.02, 0.03, 0.035])
    start, end = ends(cylinder())
    start, end = start[:3], end[:3]
    several = Cylinder(vector(CENTER), "femur", number(radii), vector(AXIS))
    together = np.asarray(_both(several, vector(start), vector(end), COUNT)[1])
    for k, radius in enumerate(radii):
        alone = Cylinder(vector(CENTER), "femur", number(radius), vector(AXIS))
        np.testing.assert_allclose(
            together[:, k : k + 1], both(alone, start[k : k + 1], end[k : k + 1], COUNT)[1], atol=1e-15
        )
