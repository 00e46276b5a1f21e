"""Frames from markers: Vaughan's three points and least squares."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.mocap import MarkerTrajectories, cluster_poses, mean_cluster, segment_poses, three_point_frames

REFERENCE = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.08, 0.01], [0.03, 0.05, -0.06]])


def moved(seed, n=6, reference=REFERENCE):
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_quat(rng.normal(size=(n, 4)))
    position = rng.normal(size=(n, 3))
    points = np.einsum("nij,mj->nmi", rotation.as_matrix(), reference) + position[:, None]
    return np.arange(n) / 100, rotation.as_matrix(), position, points


@pytest.mark.parametrize("axes", ["xy", "xz", "yx", "yz", "zx", "zy"])
def test_three_points_give_the_frame_they_were_made_from(axes):
    i, j = "xyz".index(axes[0]), "xyz".index(axes[1])
    local = np.zeros((3, 3))
    local[1, i] = 0.2
    local[2, i], local[2, j] = 0.07, 0.1
    times, matrices, position, points = moved(0, reference=local)
    poses = three_point_frames(points[:, 0], points[:, 1], points[:, 2], times, axes=axes)
    np.testing.assert_allclose(poses.matrices(), matrices, atol=1e-12)
    np.testing.assert_allclose(poses.positions, position)


def test_three_points_that_cannot_be_used():
    times, _, _, p = moved(0)
    a, b, c = p[:, 0].copy(), p[:, 1].copy(), p[:, 2].copy()
    line = c.copy()
    line[[2, 4]] = (2 * b - a)[[2, 4]]
    with pytest.raises(InputError, match="lie on a line in frames 3, 5"):
        three_point_frames(a, b, line, times)
    with pytest.raises(InputError, match="lie on a line"):
        three_point_frames(a, a, c, times)
    b[3] = np.nan
    with pytest.raises(InputError, match="point b is missing in frames 4"):
        three_point_frames(a, b, c, times)
    with pytest.raises(InputError, match="axes 'xx'"):
        three_point_frames(a, b, c, times, axes="xx")
    with pytest.raises(InputError, match="point b has the shape"):
        three_point_frames(a, b[:2], c, times)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), planar=st.booleans())
def test_any_pose_is_recovered(seed, planar):
    reference = REFERENCE[:3] if planar else REFERENCE  # three markers: the proper rotation has to be chosen
    times, matrices, position, points = moved(seed, reference=reference)
    poses = cluster_poses(points, reference, times)
    np.testing.assert_allclose(poses.matrices(), matrices, atol=1e-9)
    np.testing.assert_allclose(poses.positions, position, atol=1e-9)
    assert poses.residual_rms is not None
    assert poses.residual_rms.max() < 1e-9


def test_noisy_markers_agree_with_scipy():
    times, _, _, points = moved(5)
    points = points + 0.002 * np.random.default_rng(1).normal(size=points.shape)
    poses = cluster_poses(points, REFERENCE, times)
    assert poses.residual_rms is not None
    for i in range(times.size):
        centre, middle = points[i].mean(axis=0), REFERENCE.mean(axis=0)
        rotation, rssd = Rotation.align_vectors(points[i] - centre, REFERENCE - middle)
        np.testing.assert_allclose(poses.matrices()[i], rotation.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(poses.positions[i], centre - rotation.apply(middle), atol=1e-9)
        assert poses.residual_rms[i] == pytest.approx(rssd / 2)


def test_a_missing_marker_is_done_without():
    times, matrices, position, points = moved(2)
    points[1, 0] = np.nan
    points[4, 3] = np.nan
    poses = cluster_poses(points, REFERENCE, times)
    np.testing.assert_allclose(poses.matrices(), matrices, atol=1e-9)
    np.testing.assert_allclose(poses.positions, position, atol=1e-9)


def test_clusters_that_cannot_be_used():
    times, _, _, points = moved(2)
    names = ["A", "B", "C", "D"]
    few = points.copy()
    few[3, :2] = np.nan
    with pytest.raises(InputError, match=r"fewer than three markers of A, B, C, D in frames 4 .*frame 4 lacks A, B"):
        cluster_poses(few, REFERENCE, times, names=names)
    straight = np.outer(np.arange(4), [0.05, 0.01, 0])
    with pytest.raises(InputError, match="the reference markers A, B, C, D lie on a line in frames 1, 2"):
        cluster_poses(points, straight, times, names=names)
    flat = points.copy()
    flat[2] = straight
    with pytest.raises(InputError, match="the measured markers A, B, C, D lie on a line in frames 3 "):
        cluster_poses(flat, REFERENCE, times, names=names)
    line = REFERENCE.copy()
    line[2] = [0.05, 0, 0]  # three in a row: without D nothing is left that spans a plane
    lost = moved(2, reference=line)[3]
    lost[5, 3] = np.nan
    with pytest.raises(InputError, match="markers A, B, C lie on a line in frames 6 "):
        cluster_poses(lost, line, times, names=names)
    with pytest.raises(InputError, match="the reference lacks B"):
        cluster_poses(points, np.where(np.arange(4)[:, None] == 1, np.nan, REFERENCE), times, names=names)
    with pytest.raises(InputError, match="a reference of shape"):
        cluster_poses(points, REFERENCE[:3], times)


def test_segments_by_name_and_a_cluster_without_static_trial():
    times, matrices, _, points = moved(4, n=30)
    points[0, 2] = np.nan
    markers = MarkerTrajectories(times, ("A", "B", "C", "D"), points)
    by_name = segment_poses(markers, {"D": REFERENCE[3], "A": REFERENCE[0], "B": REFERENCE[1]})
    np.testing.assert_allclose(by_name.matrices(), matrices, atol=1e-9)
    shape = mean_cluster(markers, ["A", "B", "C", "D"])
    poses = segment_poses(markers, shape)
    assert poses.residual_rms is not None
    assert poses.residual_rms.max() < 1e-9
    np.testing.assert_allclose(poses.matrices()[1], np.eye(3), atol=1e-9)  # the first frame with all markers
    with pytest.raises(InputError, match="no marker called 'Cc'"):
        mean_cluster(markers, ["A", "B", "Cc"])
