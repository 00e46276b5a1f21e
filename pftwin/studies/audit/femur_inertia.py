"""The scene without the inertial forces of a moving femur: its frame taken for an inertial one.

The tibia is re-expressed in the femur, the patella starts at rest there, and weight keeps the direction that it really
has at every instant. What is gone is what a patella feels in an accelerated, turning frame: -m a, the centrifugal, the
Coriolis and the Euler force, and their moments.
"""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from pftwin.base.spatial import Pose, Quaternion
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.motion import KneeMotion, SegmentMotion
from pftwin.model.scene import Scene
from pftwin.studies.audit.variant import NotApplicable, Variant

NAME = "moving-femur inertia"


def without_femur_inertia(scene: Scene) -> Variant | NotApplicable:
    """The variant, or why there is none."""
    femur = scene.motion.femur
    if femur is None:
        reason = "the femur stands still in this scene, and nothing in it tells how it moved in the world"
        return NotApplicable(NAME, "put in", reason)
    seen = {e.name: e.in_still_femur(femur) for e in scene.effects}
    if grounded := [name for name, effect in seen.items() if effect is None]:
        return NotApplicable(NAME, "left out", f"fixed to the ground, which would move then: {', '.join(grounded)}")
    effects = tuple(e for e in seen.values() if e is not None)
    motion, start = _seen_from_femur(scene.motion, femur), _start(scene, femur)
    fixed = dataclasses.replace(scene, effects=effects, motion=motion, start=start)
    return Variant(NAME, "left out", "the femur's frame taken for an inertial one, weight turning in it", fixed)


def _seen_from_femur(motion: KneeMotion, femur: SegmentMotion) -> KneeMotion:
    tibia = _series(motion.tibia, motion.times).relative_to(_series(femur, motion.times))
    fixed = KneeMotion.from_poses(None, tibia)
    return KneeMotion(None, fixed.tibia, motion.start_time, motion.frame_interval, motion.n_frames)


def _start(scene: Scene, femur: SegmentMotion) -> Pose:
    """The patella's start pose in the femur at the first frame."""
    first = femur.frames(scene.motion.start_time)
    turn = Quaternion.from_rotation(first.rotation).conjugate()
    return Pose(turn.rotate(scene.start.position - first.origin), turn * scene.start.orientation)


def _series(segment: SegmentMotion, times: np.ndarray) -> PoseSeries:
    """Poses at the recorded times: the splines go through them."""
    origins, matrices = jax.device_get(_origins_and_matrices(segment, times))
    return PoseSeries.from_matrices(times, origins, matrices)


@eqx.filter_jit
def _origins_and_matrices(segment: SegmentMotion, times: np.ndarray) -> tuple[Array, Array]:
    frames = segment.frames(times)
    return frames.origin.array(), frames.rotation.array()
