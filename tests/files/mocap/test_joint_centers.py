"""Joint centres from markers that turn about them: recovered, with the error that least squares has, or not told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.mocap import sphere_center

CENTER = np.array([0.8, 0.1, -0.3])
MARKERS = np.array([[0.10, 0.03, 0.02], [0.25, -0.04, 0.05], [0.30, 0.02, -0.05]])


def turning(angle: float, frames: int = 300, markers: int = 2, center=CENTER) -> np.ndarray:
    """Markers (n, m, 3) that turn about a ball joint, by up to some angle [deg] about each of two axes."""
    t, a = np.linspace(0, 2 * np.pi, frames), np.radians(angle)
    turns = Rotation.from_rotvec(np.stack([a * np.sin(t), a * np.sin(2 * t + 1), a / 2 * np.sin(3 * t)], axis=1))
    return np.einsum("nij,mj->nmi", turns.as_matrix(), MARKERS[:markers]) + center


def noise(like: np.ndarray, size: float, seed: int) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=like.shape)


def bound(points: np.ndarray, size: float, center=CENTER) -> np.ndarray:
    """Cramer and Rao's covariance (3, 3) of the centre, of markers whose radii are not known either."""
    rays = points - center
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    k = points.shape[1]
    slopes = np.concatenate([rays, np.tile(np.eye(k), (len(points), 1, 1))], axis=2).reshape(-1, 3 + k)
    return size**2 * np.linalg.inv(slopes.T @ slopes)[:3, :3]


@settings(max_examples=30, deadline=None)
@given(
    angle=st.floats(5, 60),
    markers=st.integers(1, 3),
    center=st.tuples(*[st.floats(-2, 2)] * 3),
    seed=st.integers(0, 2**31),
)
def test_without_noise_the_centre_is_exact(angle, markers, center, seed):
    points = turning(angle, markers=markers, center=np.array(center))
    points[np.random.default_rng(seed).random(points.shape[:2]) < 0.2] = np.nan  # not seen
    found = sphere_center(points)
    np.testing.assert_allclose(found.point, center, atol=1e-6)
    assert found.residual_rms < 1e-9


@pytest.mark.parametrize(("angle", "markers"), [(25.0, 2), (15.0, 3), (40.0, 1)])
def test_with_noise_the_centre_is_as_good_as_it_can_be_and_says_so(angle, markers):
    points = turning(angle, markers=markers)
    least = bound(points, 1e-3)
    found = [sphere_center(points + noise(points, 1e-3, seed)) for seed in range(200)]
    errors = np.array([f.point for f in found]) - CENTER
    worst = np.linalg.eigh(least)[1][:, -1]
    expected = float(np.sqrt(worst @ least @ worst))
    assert np.std(errors @ worst) == pytest.approx(expected, rel=0.15)  # of 200: three deviations
    assert np.mean([f.deviation for f in found]) == pytest.approx(expected, rel=0.1)
    squares = np.einsum("si,ij,sj->s", errors, np.linalg.inv(least), errors)  # chi-square with 3 degrees of freedom
    assert np.mean(squares) == pytest.approx(3, abs=0.6)
    assert np.mean([f.residual_rms for f in found]) == pytest.approx(1e-3, rel=0.02)


def test_noise_that_is_alike_in_successive_frames_tells_less():
    from scipy.ndimage import gaussian_filter1d

    points = turning(25, frames=1200)
    smooth = [gaussian_filter1d(noise(points, 1e-3, seed), 6, axis=0) for seed in range(100)]
    scale = 1e-3 / np.std(smooth)
    found = [sphere_center(points + scale * s) for s in smooth]
    worst = np.linalg.eigh(bound(points, 1e-3))[1][:, -1]
    observed = np.std([(f.point - CENTER) @ worst for f in found])
    estimated = np.mean([f.deviation for f in found])
    assert observed > 3 * np.sqrt(worst @ bound(points, 1e-3) @ worst)  # had the frames been independent
    assert estimated == pytest.approx(observed, rel=0.25)


@pytest.mark.parametrize("size", [0.0, 1e-3])
def test_a_hinge_does_not_tell_where_on_its_axis(size):
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, 1.2, 300), [0, 1, 0]))
    points = np.einsum("nij,mj->nmi", turns.as_matrix(), MARKERS[:2])
    assert sphere_center(points + noise(points, size, 0)).deviation > 0.1


@pytest.mark.parametrize("markers", [1, 2, 3])
@pytest.mark.parametrize("size", [3e-4, 1e-3, 3e-3])
def test_a_small_motion_is_never_said_to_tell_more_than_it_does(size, markers):
    """Among noise the best sphere is often one through the markers themselves, far from the joint."""
    for angle in (0.5, 1.0, 2.0, 4.0, 7.0, 12.0):
        points = turning(angle, markers=markers)
        for seed in range(5):
            found = sphere_center(points + noise(points, size, seed))
            assert np.linalg.norm(found.point - CENTER) < 4 * found.deviation


def test_what_is_no_motion_of_markers_is_refused():
    with pytest.raises(InputError, match=r"shape \(3, 2, 2\)"):
        sphere_center(np.zeros((3, 2, 2)))
    with pytest.raises(InputError, match=r"hip: 4 places of 2 markers; expected: more than 5"):
        sphere_center(turning(20, frames=2), source="hip")
    assert sphere_center(np.ones((50, 2, 3))).deviation == np.inf
