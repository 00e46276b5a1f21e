"""A real gait trial, from the file to femur and tibia motion."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pftwin.files.mocap import butterworth_lowpass, fill_gaps, mean_cluster, read_trc, segment_poses
from pftwin.model.motion import KneeMotion

THIGH = ["R_Thigh_Superior", "R_Thigh_Inferior", "R_Thigh_Lateral"]
SHANK = ["R_Shank_Superior", "R_Shank_Inferior", "R_Shank_Lateral"]


def test_the_file_as_the_laboratory_wrote_it(dm_knee):
    m = read_trc(dm_knee / "DM_smooth1_new.trc")
    assert m.positions.shape == (370, 68, 3)
    assert m.rate == pytest.approx(120)
    assert m.times[0] == pytest.approx(1.1)
    assert np.isnan(m.marker("R_Knee_Lateral")).all()  # written as -0 0 0 throughout
    assert m.missing[:, m.names.index("L_Hindfoot")].sum() == 19
    assert not m.select(THIGH + SHANK).missing.any()


def test_gait_becomes_femur_and_tibia_motion(dm_knee):
    raw, gaps = fill_gaps(read_trc(dm_knee / "DM_smooth1_new.trc").select(THIGH + SHANK))
    assert gaps == []
    markers = raw.with_positions(butterworth_lowpass(raw.positions, raw.rate, 12.0))
    assert np.abs(markers.positions - raw.positions).max() < 0.02
    femur = segment_poses(markers, mean_cluster(markers, THIGH), source="thigh")
    tibia = segment_poses(markers, mean_cluster(markers, SHANK), source="shank")
    assert femur.residual_rms is not None
    assert tibia.residual_rms is not None
    assert femur.residual_rms.max() < 0.010  # soft tissue over the thigh
    assert tibia.residual_rms.max() < 0.003

    # knee angles from the first frame on, about the laboratory's medial-lateral axis (z) as it was then
    relative = Rotation.from_matrix(tibia.relative_to(femur).matrices())
    angles = (relative[0].inv() * relative).as_rotvec(degrees=True)
    flexion, others = np.ptp(angles[:, 2]), np.ptp(angles[:, :2], axis=0)
    assert 45 < flexion < 70  # normal gait: about 60 deg
    assert others.max() < 20

    motion = KneeMotion.from_poses(femur, tibia)
    assert motion.n_frames == 370
    f, t = motion.frames(jnp.asarray(np.linspace(motion.start_time, motion.end_time, 3070)))
    assert f is not None
    forward = np.asarray(f.velocity.x).mean()
    assert 0.8 < forward < 1.6  # walking speed [m/s]
    assert np.abs(np.asarray(t.angular_velocity.z)).max() < 12  # shank swing, rad/s
