"""A small knee whose tibia jerks the patella off its groove and lets it fall back: touch and lift-off in one motion."""

from __future__ import annotations

import equinox as eqx
import numpy as np
from small_scene import small_scene

from pftwin.base.rotations import tibiofemoral_orientation
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene


def lifting_scene(n_frames: int = 41, height: float = 0.1, interval: float = 0.01) -> Scene:
    times = interval * np.arange(n_frames)
    flexion = np.full(n_frames, np.radians(45.0))
    q = tibiofemoral_orientation(flexion, np.full(n_frames, 0.05), np.full(n_frames, -0.03))
    up = height * np.exp(-(((times - 0.2) / 0.05) ** 2))
    positions = np.stack([0.3 * up, 0.0 * up, up], axis=1)
    tibia = PoseSeries(times, positions, np.stack([q.w, q.x, q.y, q.z], axis=1))
    return eqx.tree_at(lambda s: s.motion, small_scene(n_frames), KneeMotion.from_poses(None, tibia))
