"""The path that results follow, as a pure function of a scene: to be jitted, mapped over and differentiated."""

from __future__ import annotations

from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.trajectory import trajectory
from pftwin.scene import Scene
from pftwin.spatial import Scalar, Vec3


def tracked_path(
    scene: Scene,
    *,
    integrator: str = "linear_implicit",
    substeps: int | Scalar = 10,
    start: Solution | None = None,
) -> Vec3:
    """The button's centre (without a contact: the patella's origin) in the femur's frame at the recorded frames [m].

    Args:
        scene: any leaf of it may be traced.
        integrator, substeps, start: as in `pftwin.dynamics.trajectory.trajectory`.
    """
    states = trajectory(scene, integrator=integrator, substeps=substeps, start=start).states
    center = states.position + states.orientation.rotate(scene.tracked_point() - scene.patella.center_of_mass)
    motion = scene.motion
    if motion.femur is None:
        return center
    return motion.femur.frames(motion.frame_times()).to_local(center)
