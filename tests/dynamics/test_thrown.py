"""Where damped relaxation ends is a start, unless it has thrown the patella."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from scenes import vec

from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.dynamics.relaxation import THROWN, ended_far_away

PUT = Pose(vec(0.0, 0.0, 0.05), Quaternion.identity())


def at(x: float) -> Pose:
    return Pose(vec(x, 0.0, 0.05), Quaternion.identity())


def test_it_is_a_matter_of_the_way() -> None:
    assert not ended_far_away(PUT, PUT)
    assert not ended_far_away(PUT, at(0.9 * THROWN))
    assert ended_far_away(PUT, at(1.1 * THROWN))
    turned = Pose(PUT.position, Quaternion.from_rotation_vector(vec(0.0, np.pi, 0.0)))
    assert not ended_far_away(PUT, turned)  # a small button rolls half a turn before it rests


def test_nowhere_is_no_start() -> None:
    assert ended_far_away(PUT, at(np.nan))


def test_of_a_stack_it_tells_which() -> None:
    zero = jnp.zeros(2)
    upright = Quaternion(zero + 1, zero, zero, zero)
    put = Pose(Vec3(zero, zero, zero), upright)
    assert ended_far_away(put, Pose(Vec3(jnp.asarray([0.0, 2 * THROWN]), zero, zero), upright)).tolist() == [
        False,
        True,
    ]
