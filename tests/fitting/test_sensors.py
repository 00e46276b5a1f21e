"""Errors of sensors that stay the same throughout a recording, as they are drawn into simulated ones."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from linear_problems import design, objective, parameters, problem
from made_estimates import made_estimate
from scipy.spatial.transform import Rotation
from small_scene import small_scene

import fitting
from fitting.nuisance import EXACT, PRESETS, Nuisance
from fitting.sensors import noise_beside, sensed
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured

N, FRAMES = 4000, 40


def case():
    """Two trials of unlike rates, a position and a force."""
    one = problem(design(), np.zeros((FRAMES, 4)), parameters())
    target = objective(np.full((FRAMES, 4), 3.0), frames=(slice(0, 25), slice(25, FRAMES)))
    motions = [SimpleNamespace(frame_interval=interval) for interval in (0.01, 0.02)]
    one.evaluator.scenes = tuple(SimpleNamespace(motion=motion) for motion in motions)
    return replace(one, objective=target)


def ramps(count: int = N) -> np.ndarray:
    """(count, frames, 4): straight lines over time, the force's of 0.1 N a frame."""
    slopes = np.array([0.001, 0.002, -0.001, 0.1])
    return np.broadcast_to(5.0 + slopes * np.arange(FRAMES)[:, None], (count, FRAMES, 4))


def changed(**errors: float) -> np.ndarray:
    return sensed(ramps(), Nuisance(**errors), case(), np.random.default_rng(2)) - ramps()


def test_exact_sensors_change_nothing():
    values = ramps(3)
    assert sensed(values, EXACT, case(), np.random.default_rng(0)) is values


def test_a_placement_is_the_same_in_all_frames_and_trials():
    off = changed(placement=2e-3)
    np.testing.assert_allclose(off, np.broadcast_to(off[:, :1], off.shape), atol=1e-12)
    assert (off[..., 3] == 0).all()
    np.testing.assert_allclose(off[:, 0, :3].std(axis=0), 2e-3, rtol=0.05)
    np.testing.assert_allclose(np.corrcoef(off[:, 0, :3].T), np.eye(3), atol=0.06)


def test_a_turn_is_of_the_frame_of_points_and_orientations():
    """Distances from the frame's origin and angles between frames stay; each vector turns as SciPy turns it."""
    random = np.random.default_rng(3)
    poses = Rotation.from_rotvec(random.normal(0, 0.8, (FRAMES, 3)))
    points = np.array([0.03, -0.05, 0.02]) + random.normal(0, 0.02, (FRAMES, 3))
    quaternions = poses.as_quat(scalar_first=True)
    values = np.broadcast_to(np.concatenate([points, quaternions], axis=1), (N, FRAMES, 7))
    channels, columns = ("position", "orientation"), np.array([0, 0, 0, 1, 1, 1])
    target = objective(values[0], channels=channels, groups=channels, group_of=columns, noise=None)
    misread = sensed(values, Nuisance(turn=0.02), replace(case(), objective=target), np.random.default_rng(2))
    turns = Rotation.from_quat(misread[:, 0, 3:], scalar_first=True) * poses[0].inv()
    np.testing.assert_allclose(turns.as_rotvec().std(axis=0), 0.02, rtol=0.05)
    for i in (0, 17):
        np.testing.assert_allclose(misread[i, :, :3], turns[i].apply(points), atol=1e-12)
        found = Rotation.from_quat(misread[i, :, 3:], scalar_first=True)
        assert (found * (turns[i] * poses).inv()).magnitude().max() < 1e-7
    noise = {"position": 1e-9, "orientation": 1e-9}
    beside = noise_beside(noise, Nuisance(turn=0.02), replace(target, present=np.ones((FRAMES, 6), bool)))
    assert beside["orientation"] == pytest.approx(0.02)
    assert beside["position"] == pytest.approx((misread[..., :3] - values[..., :3]).std(), rel=0.03)


def test_a_scale_is_of_the_sensor_and_a_bias_of_each_trial():
    shares = changed(force_scale=0.03)[..., 3] / ramps()[..., 3]
    np.testing.assert_allclose(shares, np.broadcast_to(shares[:, :1], shares.shape), atol=1e-12)
    assert shares[:, 0].std() == pytest.approx(0.03, rel=0.05)
    bias = changed(force_bias=0.2)[..., 3]
    for trial in (slice(0, 25), slice(25, FRAMES)):
        np.testing.assert_allclose(bias[:, trial], np.broadcast_to(bias[:, trial][:, :1], bias[:, trial].shape))
        assert bias[:, trial.start].std() == pytest.approx(0.2, rel=0.05)
    assert abs(np.corrcoef(bias[:, 0], bias[:, -1])[0, 1]) < 0.06


def test_a_shift_moves_forces_in_time_and_no_positions():
    """0.1 N a frame of 10 ms, or of 20: late by 5 ms they read 0.05 N less, or 0.025."""
    off = changed(time_shift=5e-3)
    assert (off[..., :3] == 0).all()
    inner = off[:, 8:17, 3], off[:, 31:35, 3]
    for moved, expected in zip(inner, (0.05, 0.025), strict=True):
        np.testing.assert_allclose(moved, np.broadcast_to(moved[:, :1], moved.shape), atol=1e-9)
        assert moved[:, 0].std() == pytest.approx(expected, rel=0.05)
    first = off[:, 0, 3]  # held at the first frame: it reads no less than there
    assert first.min() >= 0
    late = inner[0][:, 0] < 0
    np.testing.assert_array_equal(first[late], 0)


def test_what_a_right_fit_leaves_counts_them():
    target = case().objective  # forces of 3 N
    off = Nuisance(force_scale=0.1, force_bias=0.4, placement=0.03)
    found = noise_beside({"position": 0.04, "contact": 1.2}, off, target)
    assert found == {"position": pytest.approx(0.05), "contact": pytest.approx(1.3)}


def test_they_are_stated_in_text_beside_a_preset():
    found = Nuisance.of("rig, force_scale=0.02, placement=0.001")
    assert found == replace(PRESETS["rig"], force_scale=0.02, placement=1e-3)
    estimate = made_estimate({"K1": (150.0, 2.0)}, nuisance=found)
    assert any("forces read 2 % too large or small, the measured point 1 mm off" in line for line in estimate.remarks())
    with pytest.raises(InputError, match="found 'rig'"):
        Nuisance.of("force_scale=0.02,rig")


def test_searches_and_plans_refuse_them():
    scene, errors = small_scene(11), Nuisance(force_bias=0.1)
    measured = Measured(scene.motion.frame_times(), np.zeros((11, 3)))
    with pytest.raises(InputError, match=r"method 'least_squares' cannot allow for force_bias"):
        fitting.fit_tendons(scene, measured, nuisance=errors)
    with pytest.raises(InputError, match=r"a plan of experiments cannot allow for force_bias"):
        fitting.plan_experiment(scene, nuisance=errors)
