"""What a laboratory records of a plant: exact without noise, and with noise as rigid bodies with markers give it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scene import small_scene

import pftwin
from fitting.calibration.laboratory import Laboratory
from fitting.calibration.plants import PlantMotion
from pftwin.base.errors import InputError

SPRINGS = {"femoral": "quadriceps", "tibial": "patellar_tendon"}
FRAMES = 400


def motion_of(frames: int) -> PlantMotion:
    """A patella that moves and turns."""
    t = np.linspace(0, 1, frames)[:, None]
    turns = Rotation.from_rotvec(np.hstack([0.3 * t, 0.1 - 0.2 * t, 0.05 + 0 * t])).as_quat(scalar_first=True)
    forces = {"contact": 20 + 5 * t[:, 0], "quadriceps": 30 - 3 * t[:, 0], "patellar_tendon": 11 + t[:, 0]}
    return PlantMotion(
        np.hstack([0.03 * t, 0.01 - 0.02 * t, 0.05 + 0.01 * t]),
        turns,
        {name: {"force": force} for name, force in forces.items()},
    )


def test_without_noise_everything_is_as_it_was():
    scene, true = small_scene(41), motion_of(41)
    quiet = Laboratory(marker_noise=0.0, force_noise=0.0, force_bias=0.0, cutoff=None)
    motion, found = quiet.recorded(scene, true, SPRINGS, np.random.default_rng(0))
    point = np.array(scene.tracked_point().array())
    turns = Rotation.from_quat(true.quaternion, scalar_first=True)
    np.testing.assert_allclose(found.center, true.position + turns.apply(point), atol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(found.quaternion * true.quaternion, axis=1)), 1, atol=1e-12)
    springs = {f"{part}_spring_force": name for part, name in SPRINGS.items()}
    for ours, name in {"contact_force": "contact", **springs}.items():
        np.testing.assert_array_equal(getattr(found, ours), true.forces[name])
    assert found.synthetic
    for time in np.asarray(scene.motion.frame_times())[[0, 13, 40]]:
        was, now = (m.tibia.frames(time) for m in (scene.motion, motion))
        np.testing.assert_allclose(now.origin.array(), was.origin.array(), atol=1e-9)
        np.testing.assert_allclose(now.rotation.array(), was.rotation.array(), atol=1e-9)


def test_noise_of_markers_becomes_noise_of_poses():
    """Four markers at the corners of a tetrahedron: the origin to s / 2, a turn about any axis to s / r sqrt(3 / 8)."""
    scene, true, sd, r = small_scene(FRAMES), motion_of(FRAMES), 3e-4, 0.04
    lab = Laboratory(marker_noise=sd, cluster=r, cutoff=None, force_noise=0.2, force_bias=0.0)
    motion, found = lab.recorded(scene, true, SPRINGS, np.random.default_rng(1))
    quiet = Laboratory(marker_noise=0.0, cutoff=None, force_noise=0.0, force_bias=0.0)
    exact = quiet.recorded(scene, true, SPRINGS, np.random.default_rng(1))[1]
    off = found.center - exact.center
    turn = sd / r * np.sqrt(3 / 8)
    arms = np.mean(np.sum(exact.center**2, axis=1)) + np.sum(np.asarray(scene.tracked_point().array()) ** 2)
    expected = np.sqrt(2 * 3 * sd**2 / 4 + 2 * turn**2 * arms)
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) == pytest.approx(expected, rel=0.07)
    assert (found.contact_force - true.forces["contact"]).std() == pytest.approx(0.2, rel=0.12)
    assert motion.femur is None


def test_the_filter_takes_noise_away_and_offsets_stay():
    true, random = motion_of(FRAMES), np.random.default_rng(2)
    scene = small_scene(FRAMES)
    plain = Laboratory(cutoff=None).recorded(scene, true, SPRINGS, random)[1]
    smooth = Laboratory().recorded(scene, true, SPRINGS, random)[1]
    exact = Laboratory(marker_noise=0.0, cutoff=None).recorded(scene, true, SPRINGS, random)[1]
    rough, filtered = ((m.center - exact.center).std() for m in (plain, smooth))
    share = 12 / (0.5 / scene.motion.frame_interval)
    assert filtered < 1.2 * np.sqrt(share) * rough
    biased = Laboratory(force_noise=0.0, force_bias=0.5).recorded(scene, true, SPRINGS, random)[1]
    off = biased.contact_force - true.forces["contact"]
    assert np.ptp(off) < 1e-12
    assert off[0] != 0


@pytest.mark.slow
def test_errors_of_sensors_stay_the_same_throughout():
    """Of forces that are straight lines over time: late by s they read s times their slope less. The noise is that of
    the same seed without such errors."""
    scene, true = small_scene(41), motion_of(41)

    def read(**errors: float):
        """What 200 such laboratories record, and by how much it is off that of the default one."""
        recorded = [
            [lab.recorded(scene, true, SPRINGS, np.random.default_rng(i))[1] for lab in (Laboratory(**errors), plain)]
            for i in range(200)
        ]
        return recorded, np.array([found.center - exact.center for found, exact in recorded])

    plain = Laboratory(force_bias=0.0, force_noise=0.0)
    errors = {"force_bias": 0.0, "force_noise": 0.0}
    placed, off = read(placement=2e-3, **errors)
    assert np.ptp(off, axis=1).max() < 1e-12
    assert np.std([each[0] for each in off]) == pytest.approx(2e-3, rel=0.1)
    np.testing.assert_array_equal(placed[0][0].contact_force, placed[0][1].contact_force)
    turned, off = read(turn=0.01, **errors)
    both = [[Rotation.from_quat(m.quaternion, scalar_first=True) for m in pair] for pair in turned]
    turns = [measured * exact.inv() for measured, exact in both]
    assert max(np.ptp(turn.as_rotvec(), axis=0).max() for turn in turns) < 1e-7
    assert np.std([turn.as_rotvec()[0] for turn in turns]) == pytest.approx(0.01, rel=0.1)
    for turn, (found, exact), moved in zip(turns, turned, off, strict=True):
        np.testing.assert_allclose(found.center, turn.apply(exact.center), atol=1e-9)
        assert np.abs(moved).max() > 1e-5
    scaled, off = read(force_scale=0.03, **errors)
    shares = [found.contact_force / exact.contact_force for found, exact in scaled]
    assert np.ptp(shares, axis=1).max() < 1e-12
    assert np.std(shares) == pytest.approx(0.03, rel=0.15)
    assert np.abs(off).max() == 0
    late, off = read(time_shift=0.02, **errors)
    moved = np.array([found.contact_force - exact.contact_force for found, exact in late])[:, 10:30]
    assert np.ptp(moved, axis=1).max() < 1e-9
    rate = 5 / (40 * scene.motion.frame_interval)  # [N/s]
    assert np.std(moved) == pytest.approx(0.02 * rate, rel=0.15)
    assert np.abs(off).max() == 0


def test_a_femur_that_moves_is_recorded_too():
    scene = pftwin.rig.case(1)
    n = scene.motion.n_frames
    moving = SimpleNamespace(motion=scene.motion, contact=scene.contact, tracked_point=scene.tracked_point, effects=())
    motion, _ = Laboratory(marker_noise=0.0, cutoff=None).recorded(
        moving, motion_of(n), SPRINGS, np.random.default_rng(0)
    )
    assert (motion.femur is None) is (scene.motion.femur is None)


@pytest.mark.parametrize("wrong", [{"marker_noise": -1.0}, {"cluster": 0.0}, {"force_bias": np.nan}])
def test_what_is_no_laboratory_is_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Laboratory(**wrong)
