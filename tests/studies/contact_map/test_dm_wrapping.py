"""The DM recording's LPFL, as an effect that runs over its ellipsoid: it pulls as was recorded."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recorded_pulls import TOE_STRAIN, Recording, lpfl_wrap
from scipy.spatial.transform import Rotation as Turn

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion, Vec3
from pftwin.files.mocap import read_csv, read_poses
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid
from pftwin.model.effects.base import Ground, Instant, Patella
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.motion import Frame


def lpfl(pulls: Recording) -> StrandGroup:
    """In the frames of the recording's femur and patella."""
    strands, at = pulls.strands["LPFL"], pulls.bodies["patella"]
    back = at.matrices()[0].T
    insertions = [back @ (s.on_patella[0] - at.positions[0]) for s in strands]
    bump = lpfl_wrap()
    axes = bump.axes * np.sign(np.linalg.det(bump.axes))
    q = Turn.from_matrix(axes).as_quat(scalar_first=True)
    wrap = Ellipsoid(vector(bump.center), "femur", vector(bump.radii), Quaternion(*(number(c) for c in q)))
    stiffness, slack = (number([getattr(s, k) for s in strands]) for k in ("stiffness", "slack"))
    toe, damping = number(np.full(len(strands), TOE_STRAIN)), number(np.zeros(len(strands)))
    insertion, origin = vector(insertions), vector([s.other_end[0] for s in strands])
    return StrandGroup(stiffness, slack, toe, damping, insertion, origin, "femur", wrap=wrap, name="lpfl")


@pytest.mark.slow
def test_over_its_ellipsoid_the_lpfl_pulls_as_recorded(dm_knee):
    poses = read_poses(dm_knee / "passive_flexion_poses.csv")
    pulls = Recording(dm_knee, poses)
    flexion = np.degrees(read_csv(dm_knee / "passive_flexion_poses.csv", units="1").column("knee_flexion"))
    frames: Any = np.flatnonzero((pulls.times >= 0.5) & (flexion >= 2) & (flexion <= 72))[::10]
    effect, at = lpfl(pulls), pulls.bodies["patella"]

    @jax.jit
    def look(position: Vec3, orientation: Quaternion):
        now = Instant(Patella.at_rest(position, orientation), Ground(), Frame.world(), 0.0, 0.0)
        (term,) = effect.load(now, None)[0].stiff
        return jnp.sum(term.force), term.wrench().force.array()

    turns = Quaternion.from_array(jnp.asarray(at.quaternions[frames]))
    tension, force = jax.vmap(look)(vector(at.positions[frames]), turns)
    recorded = pulls.tensions.column("lpfl")[frames]
    assert recorded.max() > 50
    np.testing.assert_allclose(tension, recorded, rtol=0.04, atol=0.02)
    others, total = pulls.wrapped_lpfl(frames)  # plane by plane, with convex hulls
    np.testing.assert_allclose(tension, total, rtol=2e-3, atol=2e-3)
    strong = total > 1
    np.testing.assert_allclose(force[strong], others[strong], atol=0.01 * total[strong].max())
