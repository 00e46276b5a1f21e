"""What the search for an equilibrium knows of the forces about a pose: against the springs' and drags' own matrices."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from scenes import J, still_guide, system, tendon, vec

from pftwin.base.spatial import Pose, Quaternion
from pftwin.dynamics.static_load import LEVER, displaced_pose, look_around, patella_at_rest
from pftwin.model.effects.damping import LinearDamping

HERE = Pose(vec(0.01, -0.02, 0.03), Quaternion.from_rotation_vector(vec(0.2, -0.1, 0.3)))
SPRINGS = (  # stiffness, dashpot, insertion in the body, origin in the world
    (700.0, 3.0, np.array([0.02, 0.0, -0.008]), np.array([0.09, 0.05, 0.11])),
    (400.0, 5.0, np.array([-0.01, 0.015, 0.004]), np.array([-0.06, 0.02, -0.09])),
)
DRAG, TURNING_DRAG = 0.4, 0.002


def line_of(insertion, origin):
    """Force and moment / lever for a unit pull."""
    turn = np.asarray(HERE.orientation.rotation().array())
    way = origin - np.asarray(HERE.position.array()) - turn @ insertion
    way = way / np.linalg.norm(way)
    return np.concatenate([way, np.cross(insertion, turn.T @ way) / LEVER])


def test_stiffness_and_viscosity_are_the_springs_and_the_drags():
    lines = [tendon(k, 0.05, c, on, to, name=f"spring {i}") for i, (k, c, on, to) in enumerate(SPRINGS)]
    body = system(*lines, LinearDamping(J(DRAG), J(TURNING_DRAG), "ground"))
    memories = body.remember(patella_at_rest(still_guide(), HERE))

    @jax.jit
    def seen(like):
        around = look_around(body, lambda d: patella_at_rest(still_guide(), displaced_pose(HERE, d)), memories, like)
        return jnp.array(around.convex()), jnp.array(around.viscosity()), jnp.array(around.residual())

    convex, viscosity, residual = seen(J(1.0))
    outer = [np.outer(g, g) for g in (line_of(on, to) for _, _, on, to in SPRINGS)]
    np.testing.assert_allclose(
        convex, sum(s[0] * o for s, o in zip(SPRINGS, outer, strict=True)), rtol=1e-11, atol=1e-9
    )
    drags = np.diag([DRAG] * 3 + [TURNING_DRAG / LEVER**2] * 3)
    wanted = drags + sum(s[1] * o for s, o in zip(SPRINGS, outer, strict=True))
    np.testing.assert_allclose(viscosity, wanted, rtol=1e-11, atol=1e-11)
    pulls = [k * (np.linalg.norm(to - np.asarray(HERE.apply(vec(*on)).array())) - 0.05) for k, _, on, to in SPRINGS]
    lines_of_force = [line_of(on, to) for _, _, on, to in SPRINGS]
    np.testing.assert_allclose(residual, sum(p * g for p, g in zip(pulls, lines_of_force, strict=True)), rtol=1e-10)
